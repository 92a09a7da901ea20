"""The page: everything is on it, nothing that a user wrote breaks it, and it loads nothing."""

from __future__ import annotations

import base64
import gzip
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from contactqp.study import rows
from contactqp.study.curves import Chart, variant_name
from contactqp.study.footprint import Footprint, StageTime
from contactqp.study.page import render as pages
from contactqp.study.page.case_view import MARKS, marked, plain_table, table_of_rows
from contactqp.study.page.render import render_study
from contactqp.study.rows import VERDICTS
from contactqp.study.statistics import Route
from tests.study.page.samples import EVIL, bare_record, chart, data_of, hostile, report_of

for package in pages.NEEDED:
    pytest.importorskip(package)

LOADS = ("src", "href", "srcset", "data", "action", "poster", "background", "xlink:href")
VOID = {"meta", "input", "img", "br", "link"}


class Page(HTMLParser):
    """Elements, texts and scripts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: list[str] = []
        self.scripts: list[tuple[dict[str, str], str]] = []
        self.styles: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attributes}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self.open[-1] if self.open else ""
        if inside == "script":
            self.scripts.append((self.elements[-1][1], data))
        elif inside == "style":
            self.styles.append(data)
        else:
            self.texts.append(data)

    def all(self, tag: str, **wanted: str) -> list[dict[str, str]]:
        return [a for t, a in self.elements if t == tag and wanted.items() <= a.items()]


@pytest.fixture(scope="module")
def text() -> str:
    data = hostile()
    by_case = {case.name: (chart(data.rows_of(case.name), "force", EVIL),) for case in data.cases}
    return pages.render(data, (chart(data.rows),), by_case)


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    found = Page(text)
    assert not found.open  # every element is closed, in its order
    return found


def test_texts_of_users_stay_texts(page: Page, text: str) -> None:
    assert not [a for a in page.all("img") if "onerror" in a]
    assert not any("onerror" in a for _, a in page.elements)
    assert EVIL in " ".join(page.texts)  # word for word, once read as HTML
    assert "{{" in text  # a template of a user is none of ours
    assert not any("alert(" in script for _, script in page.scripts)
    assert len(page.scripts) == 3  # Plotly, the figures, ours


def test_the_head_promises_no_truth_that_a_case_has_not() -> None:
    bare = bare_record("bar_impact")
    assert bare.truth == "nothing"
    said = " ".join(Page(pages.render(report_of([bare], []))).texts)
    assert "the right one where that is known" in said
    assert "whose right answer is known" not in said


def _unpacked(page: Page, name: str) -> str:
    (packed,) = (script for attributes, script in page.scripts if attributes.get("id") == name)
    return gzip.decompress(base64.b64decode(packed)).decode()


def test_figures_survive_the_page(page: Page) -> None:
    figures = json.loads(_unpacked(page, "figures"))
    assert list(figures) == [a["data-figure"] for a in page.all("div") if "data-figure" in a]
    assert figures["all-force"] == json.loads(json.dumps(chart(hostile().rows).figure))
    assert "plotly.js v" in _unpacked(page, "plotly")


def test_it_loads_nothing(page: Page) -> None:
    assert page.elements
    for tag, attributes in page.elements:
        assert tag not in ("link", "iframe", "object", "embed", "base")
        for name in LOADS:
            value = attributes.get(name, "#")
            assert value.startswith(("#", "data:image/png;base64,")), f"{tag} {name} {value[:80]}"
    assert all("url(" not in style and "@import" not in style for style in page.styles)
    (policy,) = (a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy
    assert "http" not in policy


def test_a_page_that_loads_something_is_noticed() -> None:
    with pytest.raises(AssertionError, match="https://"):
        test_it_loads_nothing(Page('<script src="https://cdn.example/plotly.js"></script>'))


def test_identifiers_are_unique_and_links_have_targets(page: Page) -> None:
    found = [a["id"] for _, a in page.elements if "id" in a]
    assert len(set(found)) == len(found)
    assert {a["href"][1:] for a in page.all("a")} <= set(found)
    assert {a["data-figure"] for a in page.all("div") if "data-figure" in a} <= set(found)


def test_every_row_and_case_is_there(page: Page) -> None:
    data = hostile()
    assert any(data.rows_of(case.name) for case in data.cases)
    assert any(case.judgements for case in data.cases)
    assert any(case.remarks for case in data.cases)
    for case in data.cases:
        told = table_of_rows(case.title, data.rows_of(case.name))
        assert [(line.cells[0], line.cells[1]) for line in told.lines] == [
            (row.method, variant_name(Route.of(row))) for row in data.rows_of(case.name)
        ]
        assert set(told.facets.values()) == {"method", "variant", "verdict"}
        assert [line.cells[told.headings.index("verdict")] for line in told.lines] == [
            marked(row.verdict) for row in data.rows_of(case.name)
        ]
    assert len(page.all("th", **{"data-facet": "verdict"})) == len(data.cases)
    assert len([a for a in page.all("details") if a.get("class") == "case"]) == len(data.cases)
    said = " ".join(page.texts)
    for case in data.cases:
        for trial in case.judgements:
            for line in (*trial["expectations"], *trial["published"]):
                assert line["reason"] in said
        for remark in case.remarks:
            assert remark.statement in said
            assert remark.why in said
    assert "erratum E29" in said
    assert all(block.reason in said for case in data.cases for block in case.explanation.blocks)


def test_pictures_are_on_the_page(page: Page) -> None:
    pytest.importorskip("matplotlib")
    from PIL import Image

    sources = [a["src"] for a in page.all("img")]
    assert len(sources) == 2 + 3  # stamps of two answers, these, and one load path
    for source in sources:
        with Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2]))) as image:
            assert image.format == "PNG"
    assert [bool(a["alt"]) for a in page.all("img")] == [False] * 2 + [True] * 3  # stamps stand beside their titles


def test_tables_and_charts_are_named_and_reached_by_keyboard(page: Page) -> None:
    scrolls = [a for a in page.all("div") if a.get("class", "").startswith("scroll")]
    assert scrolls
    assert all(a.get("tabindex") == "0" and a.get("role") == "region" and a.get("aria-label") for a in scrolls)
    plots = [a for a in page.all("div") if a.get("class") == "plot"]
    assert len(plots) == 3
    assert all(a.get("role") == "img" and a.get("aria-label") for a in plots)
    labelled = {a["for"] for a in page.all("label") if "for" in a}
    assert {a["id"] for a in page.all("input") if a["type"] != "checkbox"} <= labelled


def test_what_is_not_met_catches_the_eye(page: Page) -> None:
    said = " ".join(page.texts)
    assert "✗ 1 expectation not met" in said
    assert "‼ must be 0" not in said
    wrong = [replace(row, verdict=rows.WRONG) for row in data_of("bar_wall").rows[:1]]
    loud = Page(pages.render(report_of([bare_record("bar_wall")], wrong)))
    assert "‼ must be 0" in " ".join(loud.texts)
    assert len([a for a in loud.all("tr") if a.get("class") == "bad"]) == 1
    assert not [a for a in page.all("tr") if a.get("class") == "bad"]


def test_every_verdict_has_a_mark_of_its_own() -> None:
    assert set(VERDICTS) == set(MARKS)
    assert len({marked(verdict)[0] for verdict in VERDICTS}) == len(VERDICTS)


def test_facts_are_told_in_words() -> None:
    facts = dict(
        created="today",
        left_out=["a: no answer", "b: another"],
        load=dict(at_end=3.169921875),
        machine=dict(OMP_NUM_THREADS=1),
    )
    single, load, machine = pages.fact_tables(facts)
    assert [line.cells for line in single.lines] == [("created", "today"), ("left out", "a: no answer, b: another")]
    assert load.lines[0].cells == ("at end", "3.17")
    assert machine.lines[0].cells == ("OMP_NUM_THREADS", "1")


def test_sections_of_another_study_and_a_chart_without_a_figure() -> None:
    told = Chart("ranges", "Safe ranges", "Where each method ends.", {}, ("method", "β"), (("penalty", "1e16"),))
    table = plain_table("Verdicts", ("verdict", "meaning"), (("lost", "all digits"),))
    section = pages.Section("Penalty stiffness", ("Best β: 1e12 <kN/m>.",), (told,), (table,))
    tiles = (pages.Tile(3, "rows", "of one axis"),)
    found = Page(render_study((section,), tiles, {"axis": "which"}, {"seeds": "none"}, "contactqp report --stability"))
    said = " ".join(found.texts)
    assert all(
        text in said
        for text in ("Penalty stiffness", "Best β: 1e12 <kN/m>.", "Safe ranges", "1e16", "all digits", "of one axis")
    )
    assert not [a for a in found.all("div") if a.get("class") == "plot"]
    assert {"href": "#part-Penalty-stiffness"} in found.all("a")


def test_what_one_answer_takes() -> None:
    taken = Footprint(
        "bar_wall.toml", "active-set", seconds=0.2, stages=(StageTime("solve", 0.05),), instants=1, certified=True
    )
    case, rows_of_case = data_of("bar_wall").cases[0], list(data_of("bar_wall").rows)
    found = Page(pages.render(report_of([replace(case, footprint=taken)], rows_of_case)))
    said = " ".join(found.texts)
    assert "By active-set in a fresh interpreter: certificate passed." in said
    assert "25 %" in said
    died = replace(case, footprint=Footprint("bar_wall.toml", "active-set", failure="killed by signal 9"))
    assert "killed by signal 9" in " ".join(Page(pages.render(report_of([died], rows_of_case))).texts)


def test_two_cases_with_one_name_after_all() -> None:
    assert pages.anchors_of(["a b", "a/b", "a-b", "ü"]) == ["a-b", "a-b-1", "a-b-2", "-"]


def test_what_is_missing_is_said_with_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    assert pages.missing_packages() == ""
    monkeypatch.setattr(pages, "NEEDED", ("jinja2", "plotly_is_not_here"))
    assert pages.missing_packages() == (
        "no page, as plotly_is_not_here is not installed: pip install plotly_is_not_here"
    )


def test_without_scripts_a_line_says_so(text: str) -> None:
    assert re.search(r"<noscript><p[^>]*>Without JavaScript", text)


def test_the_curves_of_a_case_come_before_its_long_tables_and_the_study_of_stability_is_named() -> None:
    text = pages.render(hostile())
    names = re.findall(r"<h4>([^<]*)</h4>", text.split('class="case"')[1])
    assert names.index("Error against run time") < names.index("What the case expects of its answer")
    assert "contactqp report --stability" in text
