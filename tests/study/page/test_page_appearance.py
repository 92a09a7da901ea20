"""How the page looks in a real browser: contrast, widths of screens, paper, and texts that lie over others."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from contactqp.study.conclusion import PENALTY, WHICH, WRONG
from contactqp.study.page import render as pages
from contactqp.study.page.case_view import bars_of
from contactqp.study.page.render import Section, render_study
from contactqp.study.stability.axis_problem import Axis
from contactqp.study.stability.stability_cells import AXES
from contactqp.study.stability.stability_report import stability_sections, write_stability
from contactqp.study.telling import telling_chart
from tests.study.charts_examples import report
from tests.study.page.samples import chart, hostile

pytest.importorskip("selenium", reason="selenium is not installed: pip install selenium")
from tests.study.page.chromium import OVERVIEW, complaints, count, find, look, needs_chromium, open_all, traces, wait

pytestmark = needs_chromium
# Texts need this contrast with what is behind them (WCAG 2.2, level AA); large ones 3.
CONTRAST, LARGE_CONTRAST = 4.5, 3.0


# Colours of every text that is seen, with the first colour behind it that is not transparent.
COLOURS = """
const rgb = (text) => (text.match(/[\\d.]+/g) ?? [0, 0, 0, 0]).map(Number);
const found = new Map();
for (const element of document.querySelectorAll('body *')) {
  const own = [...element.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
  if (!own || !element.checkVisibility() || element.closest('script, style, .modebar')) continue;
  const style = getComputedStyle(element), inside = element.closest('svg');
  let behind = element, back = [0, 0, 0, 0];
  do back = rgb(getComputedStyle(behind).backgroundColor);
  while (back[3] === 0 && (behind = behind.parentElement));
  const front = rgb(inside ? style.fill : style.color), size = parseFloat(style.fontSize);
  const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
  found.set([front, back, large].join(), [front, back, large, element.textContent.slice(0, 40)]);
}
return [...found.values()];
"""


def _luminance(colour: list[float]) -> float:
    parts = [part / 255 for part in colour[:3]]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(one: list[float], other: list[float]) -> float:
    """
    >>> _contrast([0, 0, 0], [255, 255, 255])
    21.0
    """
    light, dark = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def _faint(found: list[Any]) -> list[Any]:
    """Texts that do not stand out."""
    return [
        (text, front, back)
        for front, back, large, text in found
        if _contrast(front, back) < (LARGE_CONTRAST if large else CONTRAST)
    ]


@pytest.mark.slow
def test_texts_stand_out_from_what_is_behind_them_on_light_and_dark_pages(browser: Any) -> None:
    open_all(browser)
    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 4")
    light = browser.execute_script(COLOURS)
    look(browser, 1280, "dark")
    dark = browser.execute_script(COLOURS)
    assert min(len(light), len(dark)) > 3
    assert all(_luminance(back) > 0.7 for _, back, *_ in light)
    assert all(_luminance(back) < 0.2 for _, back, *_ in dark)
    assert _faint(light) == _faint(dark) == []
    browser.execute_script("document.querySelector('h1').style.color = document.body.style.color = '#6b6b6b'")
    assert _faint(browser.execute_script(COLOURS))  # grey on black is noticed
    stroke = f"return getComputedStyle(document.querySelector('{OVERVIEW} .legendlines path')).stroke"
    assert browser.execute_script(stroke) == "rgb(231, 234, 237)"  # a black curve is light


@pytest.mark.slow
def test_a_telephone_does_not_scroll_sideways(browser: Any) -> None:
    look(browser, 400, "light")
    open_all(browser)
    for i in range(3):
        browser.execute_script(f"document.querySelectorAll('.plot')[{i}].scrollIntoView()")
        wait(browser, f"Number(document.querySelectorAll('.plot')[{i}].dataset.drawn) <= 400")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 400
    inside = "[...document.querySelectorAll('.scroll')].some((e) => e.scrollWidth > e.clientWidth)"
    assert browser.execute_script(f"return {inside}")
    legend = "document.querySelector('#all-all .legend').getBoundingClientRect()"
    plot = "document.querySelector('#all-all .xtitle').getBoundingClientRect()"
    assert browser.execute_script(f"return {legend}.top >= {plot}.bottom - 1")
    assert not browser.execute_script("return document.querySelector('#all-all .scrollbar')?.height.baseVal.value")


@pytest.mark.slow
def test_paper_has_every_case_and_chart_and_the_screen_is_as_before(browser: Any) -> None:
    wait(browser, f"document.querySelectorAll('{traces(OVERVIEW)}').length === 4")
    opened = browser.execute_script("return document.querySelectorAll('details[open]').length")
    browser.execute_script(
        "addEventListener('beforeprint', () => { window.printed = {"
        " closed: document.querySelectorAll('.case:not([open])').length,"
        " drawn: document.querySelectorAll('.plot .scatterlayer .trace').length,"
        " plots: document.querySelectorAll('.plot').length,"
        " plotted: document.querySelectorAll('.js-plotly-plot').length }; })"
    )
    options = dict(preferCSSPageSize=True, generateTaggedPDF=True, generateDocumentOutline=True)
    paper = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", options)["data"])
    assert paper.startswith(b"%PDF")
    assert paper.count(b"/Type /Page\n") >= 6
    outline = paper.replace(b"\\(", b"(").replace(b"\\)", b")")
    assert b"A bar and a rigid wall" in outline
    assert b"Methods" in outline
    printed = browser.execute_script("return window.printed")
    assert printed["closed"] == 0
    assert printed["plotted"] == printed["plots"] == 3
    assert printed["drawn"] >= 8
    assert browser.execute_script("return document.querySelectorAll('details[open]').length") == opened


@pytest.mark.slow
def test_a_page_of_sections_alone_draws_its_charts(browser: Any, tmp_path: Path) -> None:
    drawn = chart(hostile().rows)
    sections = (Section("First", ("Words.",), (drawn,), ()), Section("Second", (), (drawn,), ()))
    file = tmp_path / "sections.html"
    file.write_text(render_study(sections, (), {}, {}, "contactqp report --stability"), encoding="utf-8")
    complaints(browser)
    browser.get(file.as_uri())
    wait(browser, f"document.querySelectorAll('{traces('.plot')}').length === 4")
    browser.execute_cdp_cmd("Page.printToPDF", {})
    assert count(browser, ".part:not([open])") == 1  # as before
    assert browser.execute_script("return document.querySelectorAll('.js-plotly-plot').length") == 2
    assert complaints(browser) == []


def _named(axis: Axis) -> dict[str, Any]:
    return dict(title=axis.title, quantity=axis.quantity, labels=axis.labels)


def _everywhere(axis: Axis) -> list[dict[str, Any]]:
    """Two methods that are right at all values."""
    names = ("active-set", "augmented-lagrangian (uzawa)")
    return [dict(method=name, words="right", lowest=axis.values[0], highest=axis.values[-1]) for name in names]


def _stability_page(folder: Path) -> Path:
    """A study of two axes with few values and methods, and the safe ranges of fourteen axes."""
    axes = [replace(axis, values=axis.values[:: len(axis.values) // 12]) for axis in AXES[:2]]
    study, _, _ = write_stability(folder, axes, ("active-set", "penalty", "perturbed-lagrangian"))
    ranges = bars_of([dict(_named(axis), values=axis.values, ranges=_everywhere(axis)) for axis in AXES])
    file = folder / "stability.html"
    text = render_study(stability_sections(study), (), {}, {}, "contactqp report --stability", ranges=ranges)
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.slow
@pytest.mark.parametrize("width", [pytest.param(1280, marks=pytest.mark.slow), 400])
def test_the_page_of_stability_is_read_on_a_screen_and_on_a_telephone(session: Any, tmp_path: Path, width: int) -> None:
    """Bars of all axes first, whole on a screen; no heat map of few methods has a blank below, nor cells too narrow."""
    file = _stability_page(tmp_path)
    look(session, width, "light")
    session.get(file.as_uri())
    open_all(session)
    for i in range(session.execute_script("return document.querySelectorAll('.plot').length")):
        plot = f"document.querySelectorAll('.plot')[{i}]"
        session.execute_script(f"{plot}.scrollIntoView()")
        wait(session, f"{plot}.querySelector('.main-svg')")
    bars = find(session, ".ranges")
    assert bars.location["y"] < find(session, "#axes").location["y"]
    if width == 1280:
        assert session.execute_script("return arguments[0].parentElement.scrollWidth", bars) <= width - 30
    heights = session.execute_script(
        "return [...document.querySelectorAll('.plot')]"
        ".map((e) => [e.clientHeight, e.querySelector('.main-svg').clientHeight])"
    )
    assert len(heights) > 4
    assert all(abs(box - drawn) < 8 for box, drawn in heights), heights
    cells = "[...document.querySelectorAll('.plot')].filter((e) => e.querySelector('.heatmaplayer image, .hm'))"
    widths = session.execute_script(f"return {cells}.map((e) => e.clientWidth)")
    assert len(widths) == 4
    assert min(widths) >= 700
    names = session.execute_script(
        "return [...document.querySelectorAll('.plot:not(.panels)')].flatMap((plot) => [...plot.querySelectorAll("
        "'.legendtext, .annotation-text')].map((e) => [e.textContent, e.getBoundingClientRect().right - "
        "plot.getBoundingClientRect().right]))"
    )
    assert names
    assert all(beyond <= 1 for _, beyond in names), names
    texts = session.execute_script(TEXTS)
    assert _overlapping(texts) == []
    assert max(text[3] for text in texts) <= width


def test_without_scripts_the_tables_are_there(browser: Any, address: str) -> None:
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", dict(value=True))
    try:
        browser.get(address)
        assert "Without JavaScript" in find(browser, "header").text
        assert not find(browser, "#filters").is_displayed()
        assert len(browser.find_elements("css selector", ".rows tbody tr")) > 10
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", dict(value=False))


FIRST_SCREEN = """
const boxes = (selector) => [...document.querySelectorAll(selector)].filter((e) => e.checkVisibility()).map((e) => {
  const b = e.getBoundingClientRect();
  return [e.textContent.trim().slice(0, 80), b.left, b.top, b.right, b.bottom];
});
return {
  sentence: boxes('.conclusion .sentence'), table: boxes('.conclusion tbody tr'), axis: boxes('.conclusion .xtitle'),
  names: boxes('.conclusion .annotation-text'), marks: boxes('.conclusion .points path'),
  plot: boxes('.conclusion .plot'),
};
"""


def _apart(one: list[Any], other: list[Any]) -> bool:
    (_, left, top, right, bottom), (_, left2, top2, right2, bottom2) = one, other
    return bool(right <= left2 + 1 or right2 <= left + 1 or bottom <= top2 + 1 or bottom2 <= top + 1)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("width", [1280, 400])
def test_the_first_screen_is_the_conclusion(session: Any, tmp_path: Path, width: int) -> None:
    """Sentence, table and chart stand in one window, and no text over another; on a telephone one below another."""
    data = report("one", "two")
    facts = dict(command="contactqp report", machine=dict(python="CPython"))
    file = tmp_path / "index.html"
    text = pages.render(replace(data, facts=facts), telling=telling_chart(data))
    file.write_text(text, encoding="utf-8")
    look(session, width, "light")
    session.get(file.as_uri())
    wait(session, "document.querySelector('.conclusion .xtitle')")
    found = session.execute_script(FIRST_SCREEN)
    assert found["sentence"][0][0].startswith("Which method? On 2 cases with a known answer: active-set, the default")
    assert [text.partition("?")[0] for text, *_ in found["sentence"]] == [
        q.rstrip("?") for q in (WHICH, PENALTY, WRONG)
    ]
    assert len(found["table"]) == 4
    assert len(found["names"]) == (
        5 if width == 1280 else 1
    )  # of the line, and of methods, of one in the band and at its curve; on a telephone in a legend
    shown = [*found["sentence"], *found["table"], *found["axis"]]
    if width == 1280:
        assert max(box[4] for box in shown) <= 800
    assert all(box[3] <= width for box in (*found["sentence"], *found["plot"]))
    for i, box in enumerate(found["names"]):
        assert all(_apart(box, other) for other in found["names"][:i]), found["names"]
        assert all(_apart(box, other) for other in found["marks"]), found["names"]


# Every line of text that can be seen, as far as the boxes that it is scrolled in show it; drawings label themselves.
TEXTS = """
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
while (walker.nextNode()) {
  const node = walker.currentNode, parent = node.parentElement, clips = [];
  if (!node.textContent.trim() || !parent.checkVisibility() || parent.closest('svg, script, style, math')) continue;
  for (let e = parent; e !== document.body; e = e.parentElement)
    if (getComputedStyle(e).overflow !== 'visible') clips.push(e.getBoundingClientRect());
  const range = document.createRange();
  range.selectNodeContents(node);
  for (const line of range.getClientRects()) {
    let [left, top, right, bottom] = [line.left, line.top, line.right, line.bottom];
    for (const clip of clips) {
      left = Math.max(left, clip.left), top = Math.max(top, clip.top);
      right = Math.min(right, clip.right), bottom = Math.min(bottom, clip.bottom);
    }
    if (right - left > 1 && bottom - top > 1)
      found.push([node.textContent.trim().slice(0, 60), left, top + scrollY, right, bottom + scrollY]);
  }
}
return found;
"""


def _overlapping(texts: list[list[Any]]) -> list[tuple[str, str]]:
    """Texts that lie over one another by more than the edges of their letters."""
    ordered, found = sorted(texts, key=lambda text: text[2]), []
    for i, one in enumerate(ordered):
        for other in ordered[i + 1 :]:
            if other[2] >= one[4] - 3:
                break
            if min(one[3], other[3]) - max(one[1], other[1]) > 2 and min(one[4], other[4]) - other[2] > 3:
                found.append((one[0], other[0]))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 400])
def test_no_text_of_the_page_lies_over_another(session: Any, address: str, width: int) -> None:
    look(session, width, "light")
    session.get(address)
    for opened in (False, True):
        if opened:
            session.execute_script("document.querySelectorAll('details').forEach((e) => { e.open = true; })")
            wait(session, "[...document.querySelectorAll('details')].every((e) => e.open)")
        texts = session.execute_script(TEXTS)
        assert len(texts) > 100
        assert _overlapping(texts) == []
        assert max(text[3] for text in texts) <= width


@pytest.mark.slow
def test_text_over_text_is_found(session: Any, address: str) -> None:
    look(session, 1280, "light")
    session.get(address)
    session.execute_script("document.querySelector('h1').style.marginBottom = '-40px'")
    assert _overlapping(session.execute_script(TEXTS))
