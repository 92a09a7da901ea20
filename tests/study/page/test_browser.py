"""The page in a real browser without a network: what it does when it is read, searched, filtered and linked to."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from tests.study.page.chromium import OVERVIEW, complaints, count, find, needs_chromium, open_all, traces, wait

pytestmark = needs_chromium


def test_it_opens_without_errors_and_without_the_network(browser: Any) -> None:
    open_all(browser)
    wait(browser, "document.querySelectorAll('.js-plotly-plot').length > 0")
    assert complaints(browser) == []
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [event["params"] for event in events if event["method"] == "Network.requestWillBeSent"]
    asked = [request["request"]["url"] for request in sent if request["documentURL"].startswith("file:")]
    assert asked
    assert all(url.startswith(("file:", "data:", "blob:")) for url in asked)
    browser.execute_script("fetch('http://127.0.0.1:9/').catch(() => {})")
    assert any("Content Security Policy" in text for text in complaints(browser))  # refused, and noticed


@pytest.mark.slow
def test_charts_are_drawn_when_they_are_near(browser: Any) -> None:
    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 4")
    drawn = "document.querySelectorAll('.case')[1].querySelectorAll('.js-plotly-plot').length"
    assert browser.execute_script(f"return {drawn}") == 0
    browser.execute_script(
        "const one = document.querySelectorAll('.case')[1];one.open = true; one.querySelector('.plot').scrollIntoView()"
    )
    wait(browser, f"{drawn} === 1")
    title = browser.execute_script("return document.querySelector('#all-all .xtitle').textContent")
    assert title == "run time [ms]"


def test_hovering_shows_the_numbers(browser: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 4")
    point = find(browser, f"{OVERVIEW} .points path")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", point)
    ActionChains(browser).move_to_element(point).perform()
    said = wait(browser, f"document.querySelector('{OVERVIEW} .hovertext')?.textContent")
    assert re.search(r"[\d.]+ ms, error [\d.]+e[-+]\d+", said)


@pytest.mark.slow
def test_cases_are_found_by_words(browser: Any) -> None:
    find(browser, "#filters summary").click()
    assert count(browser, ".case") == 2
    find(browser, "#search").send_keys("RIGID wall")
    wait(browser, "document.querySelectorAll('.case:not([hidden])').length === 1")
    assert find(browser, "#shown").text == "1 of 2 cases shown"
    assert count(browser, ".contents li") == 1
    find(browser, "#search").send_keys(" nothing like it")
    wait(browser, "!document.getElementById('none').hidden")
    assert count(browser, ".case") == 0
    find(browser, "button[type=reset]").click()
    wait(browser, "document.querySelectorAll('.case:not([hidden])').length === 2")


@pytest.mark.slow
def test_methods_variants_and_verdicts_are_hidden_in_charts_and_tables(browser: Any) -> None:
    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 4")
    find(browser, "#filters summary").click()
    penalties = count(browser, ".rows tr[data-method=penalty]")
    assert penalties > 0
    find(browser, "input[name=method][value=penalty]").click()
    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 3")
    assert count(browser, "tr[data-method=penalty]") == 0
    assert count(browser, "tr[data-method=osqp]") > 0
    find(browser, "input[name=variant][value=raw]").click()
    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 2")
    assert count(browser, "tr[data-variant=raw]") == 0
    find(browser, "fieldset[data-facet=verdict] button[data-all='']").click()
    wait(browser, "!document.getElementById('none').hidden")
    find(browser, "button[type=reset]").click()
    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 4")
    assert count(browser, ".rows tr[data-method=penalty]") == penalties


@pytest.mark.slow
def test_messages_stand_whole_below_their_rows_and_are_hidden_with_them(browser: Any) -> None:
    browser.execute_script("document.querySelectorAll('.case').forEach((one) => { one.open = true; })")
    notes = count(browser, ".rows .note-of-row")
    assert notes > 0
    tall = "[...document.querySelectorAll('.rows tbody tr:not(.note-of-row)')].map((e) => e.clientHeight)"
    assert max(browser.execute_script(f"return {tall}")) < 60  # one or two lines
    ends = "[...document.querySelectorAll('.note-of-row div')].map((e) => e.getBoundingClientRect().right)"
    assert max(browser.execute_script(f"return {ends}")) <= 1280
    browser.execute_script(
        "document.querySelectorAll('input[name=method]').forEach((box) => { box.checked = false; });"
        "document.getElementById('choices').dispatchEvent(new Event('input', {bubbles: true}))"
    )
    assert count(browser, ".rows .note-of-row") == 0


@pytest.mark.slow
def test_a_link_opens_its_case(browser: Any) -> None:
    links = browser.find_elements("css selector", ".contents a")
    links[1].click()
    wait(browser, "document.querySelectorAll('.case')[1].open")
    assert browser.execute_script("return document.activeElement.closest('.case').id") == "case-evil-b-"


REACHABLE = """
return [...document.querySelectorAll('a[href], summary, input, button, [tabindex="0"]')]
  .filter((e) => e.checkVisibility() && !e.disabled && e.tabIndex >= 0).length
"""


@pytest.mark.slow
def test_the_keyboard_reaches_everything_and_shows_where_it_is(browser: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    browser.execute_script("document.getElementById('filters').open = true")
    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 4")
    wanted = browser.execute_script(REACHABLE)
    browser.execute_script(
        "window.seen = new Set(); window.bare = [];"
        "addEventListener('focusin', (e) => { seen.add(e.target);"
        " if (getComputedStyle(e.target).outlineStyle === 'none') bare.push(e.target.outerHTML); })"
    )
    ActionChains(browser).send_keys(Keys.TAB * (wanted + 5)).perform()
    assert browser.execute_script("return seen.size") >= wanted
    assert browser.execute_script("return bare") == []
    summary = find(browser, ".case:not([open]) > summary")
    summary.send_keys(Keys.ENTER)
    assert count(browser, ".case:not([open])") == 0
    box = find(browser, "input[name=method][value=osqp]")
    box.send_keys(Keys.SPACE)
    assert count(browser, "tr[data-method=osqp]") == 0
