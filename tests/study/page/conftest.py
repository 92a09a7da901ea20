"""The page of a hostile report in one browser for all tests of pages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="package")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    from contactqp.study.page import render as pages
    from tests.study.page.samples import chart, hostile

    data = hostile()
    charts = {case.name: (chart(data.rows_of(case.name)),) for case in data.cases}
    file: Path = tmp_path_factory.mktemp("page") / "index.html"
    file.write_text(pages.render(data, (chart(data.rows, "all"),), charts), encoding="utf-8")
    return file.as_uri()


@pytest.fixture(scope="package")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """One browser for all tests of pages, with a profile of its own."""
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    from tests.study.page.chromium import CHROMIUM, DRIVER, FLAGS

    options = Options()
    options.binary_location = str(CHROMIUM)
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    yield driver
    driver.quit()


@pytest.fixture
def browser(session: Any, address: str) -> Any:
    """The page as it opens, 1280 by 1000 pixels, light."""
    from tests.study.page.chromium import look

    look(session, 1280, "light")
    session.get(address)
    return session
