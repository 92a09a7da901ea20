"""Chromium, headless and without a network, and what tests ask of a page in it."""

from __future__ import annotations

import shutil
from typing import Any

import pytest

from contactqp.study.page import render as pages

pytest.importorskip("selenium", reason="selenium is not installed: pip install selenium")
for package in pages.NEEDED:
    pytest.importorskip(package)

CHROMIUM, DRIVER = (shutil.which(name) for name in ("chromium", "chromedriver"))
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None or DRIVER is None, reason="chromium and chromedriver are not installed"
)
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--force-prefers-reduced-motion",
)


def look(browser: Any, width: int, scheme: str) -> None:
    size = dict(width=width, height=1000, deviceScaleFactor=1, mobile=False)
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    media = dict(features=[dict(name="prefers-color-scheme", value=scheme)])
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)


def wait(browser: Any, script: str) -> Any:
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(browser, 10, 0.05).until(lambda b: b.execute_script(f"return {script}"))


def find(browser: Any, selector: str) -> Any:
    return browser.find_element("css selector", selector)


def count(browser: Any, selector: str) -> int:
    """How many of these are seen."""
    seen = "[...document.querySelectorAll(arguments[0])].filter((e) => e.checkVisibility()).length"
    return int(browser.execute_script(f"return {seen}", selector))


def open_all(browser: Any) -> None:
    browser.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")


def traces(plot: str) -> str:
    return f"{plot} .scatterlayer .trace"


OVERVIEW = "#all-all .plot"


def complaints(browser: Any) -> list[str]:
    """What the console says since it was read last."""
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
