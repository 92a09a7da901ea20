"""The report as one HTML page that needs nothing beside it."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape

from contactqp.study.report.summary import Summary
from contactqp.study.rows import COLUMNS, READABLE, VERDICTS, WRONG, Row, readable

STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 80rem; padding: 0 1rem; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid #8886; padding: .2rem .6rem; text-align: left; vertical-align: top; }
.wide { overflow-x: auto; }
.wrong { background: #d5500033; font-weight: bold; }
img { background: #fff; height: auto; max-width: 100%; }
summary { cursor: pointer; font-weight: bold; }
"""


def page(
    cases: Sequence[tuple[str, str, str]],
    rows: Sequence[Row],
    summary: Summary,
    facts: Mapping[str, str],
    pictures: Mapping[str, bytes],
) -> str:
    """The page.

    Parameters
    ----------
    cases : sequence of (name, title, truth)
    facts : mapping
        Machine, versions and settings.
    pictures : mapping of case names to PNG
        That of the empty name is about all cases.
    """
    body = [
        "<h1>Contact problems: error against run time</h1>",
        f"<p>Cases: {len(cases)}; rows: {len(rows)}; {escape(str(summary))}. Data: results.csv, results.json.</p>",
        _list("Expectations not met", summary.unmet),
        _picture(pictures, "", "Error against run time, median over all cases"),
        "<h2>Methods</h2>",
        _table(summary.cells()[0], summary.cells()[1:]),
        "<h2>Cases</h2>",
        *(_case(case, rows, pictures, "" if i else " open") for i, case in enumerate(cases)),
        "<h2>What the columns and verdicts mean</h2>",
        _table(("column", "meaning"), COLUMNS.items()),
        _table(("verdict", "meaning"), VERDICTS.items()),
        "<h2>Machine, versions, settings</h2>",
        _table(("what", "which"), facts.items()),
    ]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><style>{STYLE}</style>'
    title = "<title>contactqp: error against run time</title>"
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}{title}</head><body>\n' + "\n".join(body) + "\n</body></html>\n"
    )


def _case(case: tuple[str, str, str], rows: Sequence[Row], pictures: Mapping[str, bytes], state: str) -> str:
    name, title, truth = case
    mine = [row for row in rows if row.case == name]
    lines = (list(readable(row).values()) for row in mine)
    marked = {i for i, row in enumerate(mine) if row.verdict == WRONG or row.expectations_unmet}
    parts = [
        f"<details{state}><summary>{escape(title)} ({escape(name)})</summary>",
        f"<p>Errors are measured against: {escape(truth)}.</p>",
        _picture(pictures, name, f"Error against run time: {title}"),
        _table(READABLE.values(), lines, marked),
        "</details>",
    ]
    return "\n".join(parts)


def _picture(pictures: Mapping[str, bytes], name: str, text: str) -> str:
    if name not in pictures:
        return ""
    data = base64.b64encode(pictures[name]).decode("ascii")
    return f'<p><img alt="{escape(text)}" src="data:image/png;base64,{data}"></p>'


def _list(heading: str, items: Sequence[str]) -> str:
    lines = "".join(f"<li>{escape(item)}</li>" for item in items)
    return f"<h2>{escape(heading)}</h2><ul class=wrong>{lines}</ul>" if items else ""


def _table(headings: Iterable[str], lines: Iterable[Iterable[str]], marked: Iterable[int] = ()) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    marks = set(marked)
    body = "\n".join(
        f"<tr{' class=wrong' if i in marks else ''}>" + "".join(f"<td>{escape(cell)}</td>" for cell in line) + "</tr>"
        for i, line in enumerate(lines)
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table></div>'
