"""The conclusion of a report: its sentence and its table are what the rows say, computed here once more."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from math import exp, log
from pathlib import Path
from typing import Any

import pytest

from contactqp.study import report_data, rows
from contactqp.study import reporting as report
from contactqp.study.answer_pictures import AnswerPictures
from contactqp.study.comparison import GENEROSITY, Timing, timed
from contactqp.study.conclusion import HEADINGS, PENALTY, UNSURE, WHICH, WRONG, conclude
from contactqp.study.rows import Row, readable
from contactqp.study.running.runner import Running
from tests.study.csv_rows import from_csv
from tests.study.statistics_examples import gave_up, right, wrong

CASES = Path(__file__).parents[2] / "cases"
BODY: dict[str, Any] = dict(unknowns=1000, linear_solve_seconds=1e-3)


def _study() -> list[Row]:
    """A small case and two bodies, by the default, a backend raw and polished, and penalties."""
    found = []
    for case, size, unit in (("small", 2, 1e-5), ("one", 1000, 1e-3), ("two", 4000, 4e-3)):
        body: dict[str, Any] = dict(unknowns=size, linear_solve_seconds=unit)
        found += [
            right(case, "active-set", 2 * unit, kind="active set", claimed=None, flag_wrong=None, **body),
            right(case, "osqp", 3 * unit, variant="polished", **body),
            wrong(case, "osqp", unit, variant="raw", **body),
            right(case, "osqp", 2 * unit, variant="raw", **body),
            *(
                right(case, "penalty", 1.5 * unit, promises_exact=False, claimed=None, flag_wrong=None, knob="penalty",
                      verdict=rows.APPROXIMATE, knob_value=value, error_judged=error, error_force=error, **body)
                for value, error in ((1e3, 1e-1), (1e5, 1e-3), (1e7, 2e-2))
            ),
        ]  # fmt: skip
    return [*found, *(gave_up(case, "sip", rows.MISSING) for case in ("small", "one", "two"))]


def test_each_method_counts_by_its_best_setting() -> None:
    lines = {line.method: line for line in conclude(_study()).lines}
    assert list(lines) == ["active-set", "osqp", "penalty"]  # right most often, then fastest; a missing one has no line
    default, backend, penalty = lines.values()
    assert (default.right, default.cases, default.claimed) == (3, 3, 0)
    assert (backend.right, backend.claimed, backend.wrong) == (3, 6, 3)
    assert (penalty.right, penalty.cases, penalty.force_error) == (0, 3, 1e-3)
    # Of bodies alone: a case of two unknowns measures calls of Python.
    assert default.linear_solves == pytest.approx(2)
    assert backend.linear_solves == pytest.approx(3)


def test_a_line_of_the_best_setting_says_of_how_many_and_a_note_that_it_is_known_only_afterwards() -> None:
    found = conclude(_study())
    named = {line.method: line.cells()[0] for line in found.lines}
    assert named["penalty"] == "penalty, best of 3"
    assert named["active-set"] == "active-set"
    assert "which one that is shows only once the right answer is known" in found.note
    assert conclude([row for row in _study() if row.method == "active-set"]).note == ""


def test_the_answers_say_what_the_lines_say() -> None:
    found = conclude(_study())
    assert found.answers == (
        (
            WHICH,
            "On 3 cases with a known answer: active-set, the default, is right in all, its contact forces within "
            "1e-13, in the time of 2 linear solves on bodies of 1000 unknowns and more. Also right wherever they were "
            "tried: osqp; none of them is faster by a tenth.",
        ),
        (
            PENALTY,
            "Penalty is off by 10 % to 0.1 % depending on its value, in the time of 1.5 linear solves (smaller error "
            "and time by the best value, known only after the answer).",
        ),
        (
            WRONG,
            "Of 6 raw answers that methods called solved, 3 are wrong by more than 100 times the tolerance asked: "
            "osqp 3 of 6; no answer that the certificate passed is wrong.",
        ),
    )
    assert found.sentence == " ".join(answer for _, answer in found.answers)
    assert GENEROSITY == 100


def test_who_is_wrong_is_nobody_only_where_the_certificate_is_right_too() -> None:
    calm = [row for row in _study() if not row.flag_wrong]
    (answer,) = (text for question, text in conclude(calm).answers if question == WRONG)
    assert answer == (
        "Nobody: none of the 3 raw answers that methods called solved is wrong by more than 100 times the tolerance "
        "asked; no answer that the certificate passed is wrong."
    )
    passed = [*calm, wrong("one", "osqp", 1.0, verdict=rows.WRONG, flag_wrong=False, **BODY)]
    (answer,) = (text for question, text in conclude(passed).answers if question == WRONG)
    assert answer.startswith("None of the")
    assert answer.endswith("; 1 answer that the certificate passed is wrong.")


def test_a_penalty_of_one_value_has_one_error() -> None:
    stiffest = [row for row in _study() if row.method != "penalty" or row.knob_value == 1e5]
    assert dict(conclude(stiffest).answers)[PENALTY] == "Penalty is off by 0.1 %, in the time of 1.5 linear solves."
    assert PENALTY not in dict(conclude([row for row in _study() if row.method != "penalty"]).answers)


def test_where_a_backend_is_right_in_all_and_faster_it_is_named_with_its_time() -> None:
    faster = [
        replace(row, seconds=row.seconds / 3) if row.method == "osqp" and row.variant == "polished" else row
        for row in _study()
    ]
    assert "osqp; osqp is faster, in the time of 1 linear solves." in conclude(faster).sentence
    assert "osqp; osqp is faster, in the time of 1 linear solves." in conclude(faster, 0.0).sentence
    # On a busy machine nobody is.
    assert f"osqp{UNSURE}." in conclude(faster, 1e3).sentence


def test_no_method_is_called_faster_within_the_scatter_of_times() -> None:
    """Osqp takes 1.5 and the default 2 linear solves, and both scatter by 20 %."""
    scattered = [
        replace(row, seconds=row.seconds / 2 if row.method == "osqp" and row.variant == "polished" else row.seconds)
        for row in _study()
        if row.seconds is not None
    ]
    assert "osqp is faster, in the time of 1.5 linear solves." in conclude(scattered).sentence
    scattered = [replace(row, seconds_spread=0.2) for row in scattered]
    assert "osqp; none of them is faster by more than times scatter here." in conclude(scattered).sentence


def test_times_of_the_smallest_cases_are_called_overhead() -> None:
    only = [row for row in _study() if row.case == "small"]
    assert "where nearly all of it is overhead" in conclude(only).sentence
    slow = [replace(row, unknowns=1, seconds=9e-3) for row in only]
    assert "in the time of 900 linear solves on bodies of 1 unknown and more, where" in conclude(slow).sentence
    assert "overhead" not in conclude(_study()).sentence


def test_a_default_that_misses_a_case_is_not_called_right_in_all() -> None:
    spoiled = [
        wrong(row.case, row.method, 1.0, **BODY) if row.method == "active-set" and row.case == "two" else row
        for row in _study()
    ]
    found = conclude(spoiled)
    assert "active-set, the default, is right in 2 of 3" in found.sentence
    assert found.lines[0].method == "osqp"
    assert found.lines[1].cells()[:2] == ("active-set", "67 % of 3")


def test_times_have_the_mean_of_their_spreads_beside() -> None:
    body: dict[str, Any] = dict(unknowns=1000, linear_solve_seconds=1e-3)
    found = conclude(
        [right(case, "osqp", 2e-3, seconds_spread=spread, **body) for case, spread in (("a", 0.1), ("b", 0.3))]
    )
    assert found.lines[0].spread == pytest.approx(0.2)
    assert found.lines[0].cells()[3] == "2 ± 20 %"


def test_where_no_answer_is_known_nobody_is_wrong() -> None:
    motion = right("motion", "active-set", 1.0, kind="active set", error_judged=None, error_force=None)
    assert conclude([*_study(), motion]) == conclude(_study())
    assert conclude([motion]).lines == ()


def test_nearly_all_is_not_all() -> None:
    many = [right(str(i), "osqp", 1.0) for i in range(399)] + [wrong("last", "osqp", 1.0)]
    assert conclude(many).lines[0].cells()[1] == "99 % of 400"
    assert conclude(many).lines[0].cells()[2] == "1 % of 400"


def test_before_anything_is_found_it_says_so() -> None:
    assert conclude([]).sentence == "No answer is known yet that others could be held against."
    assert conclude([]).cells() == [HEADINGS]
    untimed = [right("one", "active-set", None, kind="active set", unknowns=1000)]  # type: ignore[arg-type]
    assert conclude(untimed).lines[0].linear_solves is None


def test_the_median_of_rounds_is_told_with_their_spread() -> None:
    row = timed(right("a", "osqp", 9.0), [Timing((1.0, 3.0)), Timing((2.0, 2.0))])
    assert (row.seconds, row.repeats, row.seconds_spread) == (2.0, 4, 0.25)
    assert readable(row)["seconds"] == "2e+03 ± 25 %"
    alone = timed(row, [Timing((5.0,), warm=False)])
    assert (alone.seconds, alone.repeats, alone.seconds_spread) == (5.0, 0, None)
    assert "±" not in readable(timed(row, [Timing((1.0, 1.1))]))["seconds"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of three small cases."""
    folder = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(report, "missing_packages", lambda: "no page")
        patched.setattr(report_data, "answer_pictures", lambda _: AnswerPictures(why_not="no pictures"))
        report.write_report(
            [CASES / f"{name}.toml" for name in ("bar_wall", "two_bars", "truss_floor")],
            folder,
            methods=["active-set", "osqp", "clarabel", "penalty", "augmented-lagrangian"],
            running=Running(jobs=0),
            brief=True,
        )
    return folder


def _of(table: Sequence[dict[str, str]], method: str) -> list[dict[str, str]]:
    return [row for row in table if row["method"] == method]


@pytest.mark.slow
def test_the_table_is_that_of_the_rows_of_results_csv(folder: Path) -> None:
    table = list(csv.DictReader((folder / "results.csv").read_text().splitlines()))
    told = json.loads((folder / "results.json").read_text())["conclusion"]
    assert {line["method"] for line in told["methods"]} == {row["method"] for row in table}
    assert len(told["methods"]) == 5
    for line in told["methods"]:
        mine = _of(table, line["method"])
        usual = [row for row in mine if row["variant"] in ("", "polished")]
        right_ones = [r for r in usual if r["error_judged"] and float(r["error_judged"]) <= float(r["error_allowed"])]
        solved = {row["case"]: row for row in sorted(right_ones, key=lambda row: -float(row["seconds"]))}
        assert (line["right"], line["cases"]) == (len(solved), 3)
        if len(solved) == 3:
            ratios = [float(row["seconds"]) / float(row["linear_solve_seconds"]) for row in solved.values()]
            mean = exp(sum(log(ratio + 1) for ratio in ratios) / 3) - 1
            assert line["linear_solves"] == pytest.approx(mean)
            assert line["force_error"] == max(float(row["error_force"]) for row in solved.values())
        raw = [row for row in mine if row["variant"] == "raw"] or mine
        if line["method"] in ("osqp", "clarabel"):
            assert line["claimed"] == sum(row["claimed"] == "true" for row in raw) > 0
            assert line["wrong"] == sum(row["flag_wrong"] == "true" for row in raw)


NUMBER = r"(\d+(?:\.\d+)?(?:e[+-]\d+)?)"


def _off(printed: str) -> float:
    """An error as the sentence writes it: ``"9 %"`` or ``"1e-06"``."""
    return float(printed.removesuffix(" %")) * (0.01 if printed.endswith("%") else 1.0)


class _Method:
    """What the rows of results.csv say of one method, by its fastest right setting of each case, else the best one."""

    def __init__(self, table: Sequence[dict[str, str]], name: str) -> None:
        mine = _of(table, name)
        usual = [row for row in mine if row["variant"] in ("", "polished") and row["condensed"] != "no"]
        cases = {row["case"]: [r for r in usual if r["case"] == row["case"]] for row in mine}
        right_ones = {
            case: [r for r in of if r["error_judged"] and float(r["error_judged"]) <= float(r["error_allowed"])]
            for case, of in cases.items()
        }
        self.name, self.exact = name, mine[0]["promises_exact"] == "true"
        self.right, self.cases = sum(map(bool, right_ones.values())), len(cases)
        best = [
            min(right_ones[case], key=lambda r: float(r["seconds"]))
            if right_ones[case]
            else min(of, key=lambda r: float(r["error_judged"] or "inf"))
            for case, of in cases.items()
        ]
        ratios = [float(r["seconds"]) / float(r["linear_solve_seconds"]) for r in best]
        self.time = exp(sum(log(ratio + 1) for ratio in ratios) / len(ratios)) - 1
        self.spread = sum(float(r["seconds_spread"]) for r in best) / len(best)
        self.error = max(float(r["error_force"]) for r in best)
        self.worst = max(float(r["error_force"]) for r in usual if r["error_force"])
        own = [row for row in mine if row["variant"] == "raw"] or mine
        self.claimed = sum(row["claimed"] == "true" for row in own) if self.exact else 0
        self.wrong = sum(row["flag_wrong"] == "true" for row in own) if self.exact else 0


def refuted(sentence: str, table: Sequence[dict[str, str]]) -> list[str]:
    """What a conclusion says that the rows of a report of small cases do not: numbers, who is right, who is faster."""
    methods = {name: _Method(table, name) for name in dict.fromkeys(row["method"] for row in table)}
    default, wrong = methods["active-set"], []
    head = re.search(rf"^On (\d+) cases .*? contact forces within {NUMBER}, in the time of {NUMBER} linear", sentence)
    assert head is not None, sentence
    if int(head[1]) != len({row["case"] for row in table}):
        wrong.append("cases")
    if float(head[2]) != pytest.approx(max(default.error, 1.1e-16), rel=0.5):
        wrong.append("error of the default")
    if float(head[3]) != pytest.approx(default.time, rel=0.06):
        wrong.append("time of the default")
    if ("is right in all" in sentence) != (default.right == default.cases):
        wrong.append("default right in all")
    others = [m for m in methods.values() if m.exact and m is not default and m.right == m.cases]
    also = re.search(r"Also right wherever they were tried: ([^;]*); (.*?)\. ", sentence)
    assert also is not None, sentence
    if set(also[1].split(", ")) != {method.name for method in others}:
        wrong.append("who else is right")
    fastest = min(others, key=lambda method: method.time)
    is_faster = default.time > max(1.1, 1 + default.spread + fastest.spread) * fastest.time
    told = "faster" if UNSURE.strip("; ") in also[2] else also[2]  # a busy machine claims no order
    if told != "faster" and (
        told.startswith(f"{fastest.name} is faster") != is_faster or ("none of them" in told) == is_faster
    ):
        wrong.append("who is faster")
    for method in (method for method in methods.values() if not method.exact):
        said = re.search(
            rf"(?i){method.name} is off by (\S+(?: %)?) to (\S+(?: %)?) depending .*? {NUMBER} linear", sentence
        )
        if said is None or _off(said[1]) != pytest.approx(method.worst, rel=0.5):
            wrong.append(f"worst of {method.name}")
        elif _off(said[2]) != pytest.approx(method.error, rel=0.5) or float(said[3]) != pytest.approx(
            method.time, rel=0.06
        ):
            wrong.append(f"best of {method.name}")
    counts = [int(n) for n in re.findall(r"(\d+) (?:raw answers|are wrong)|(?<=one of the )(\d+)", sentence)[0] if n]
    if counts[0] != sum(method.claimed for method in methods.values()):
        wrong.append("claimed")
    if ("Nobody" in sentence) != (sum(method.wrong for method in methods.values()) == 0):
        wrong.append("silently wrong")
    return wrong


@pytest.mark.slow
def test_the_sentence_says_what_the_rows_of_results_csv_say(folder: Path) -> None:
    table = list(csv.DictReader((folder / "results.csv").read_text().splitlines()))
    sentence = json.loads((folder / "results.json").read_text())["conclusion"]["sentence"]
    assert refuted(sentence, table) == []
    for said, instead, what in (
        (r"On 3 cases", "On 4 cases", "cases"),
        (r"in the time of \S+ linear solves on", "in the time of 0.5 linear solves on", "time of the default"),
        (r"contact forces within \S+,", "contact forces within 1e-10,", "error of the default"),
        (r"tried: [^,]*, ", "tried: ", "who else is right"),
        (
            r"; none of them is faster by [^.]*|; \S+ is faster[^.]*|; which of them[^.]*",
            "; osqp is the order of the day",
            "who is faster",
        ),
        (r"off by \S+( %)? to", "off by 90 % to", "worst of penalty"),
        (r"the \d+ raw answers|Of \d+ raw answers", "the 7 raw answers", "claimed"),
    ):
        spoiled = re.sub(said, instead, sentence, count=1)
        assert spoiled != sentence, said
        assert what in refuted(spoiled, table), what
    slow = [
        row | {"seconds": str(100 * float(row["seconds"]))} if row["method"] == "active-set" else row for row in table
    ]
    assert {"time of the default"} <= set(refuted(sentence, slow))
    assert "none of them" not in sentence or "who is faster" in refuted(sentence, slow)


@pytest.mark.slow
def test_the_terminal_ends_with_the_same_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    result = report.ReportResult(report_data.summarise(from_csv((folder / "results.csv").read_text()), ()),
                                 from_csv((folder / "results.csv").read_text()), (), ())  # fmt: skip
    monkeypatch.setattr(report, "write_report", lambda *_, **__: result)
    assert report.report([], str(tmp_path)) == 0
    out = capsys.readouterr().out
    found = conclude(result.rows)
    table, *_ = out.split("\n\n")
    names = [line.split()[0].strip(",") for line in table.splitlines() if "%" in line]
    assert names == [line.method for line in found.lines]
    assert max(map(len, out.splitlines()[:-1])) <= 80  # the last one names files
    assert found.answers
    for question, answer in found.answers:
        assert f"{question} {answer}" in " ".join(out.split())


@pytest.mark.slow
def test_times_of_brief_reports_come_in_rounds(folder: Path) -> None:
    table = from_csv((folder / "results.csv").read_text())
    assert len(table) > 20
    assert all(row.repeats >= 2 and row.seconds_spread is not None for row in table)
    assert all(row.linear_solve_seconds and row.linear_solve_seconds > 0 for row in table)


@pytest.mark.slow
def test_the_machine_is_told_with_its_threads_and_load(folder: Path) -> None:
    told = json.loads((folder / "results.json").read_text())
    assert {"platform", "processor", "cores", "python"} <= set(told["machine"])
    assert "threads" in told["linear_algebra"]
    assert set(told["load"]) == {"at_start", "at_end", "threads_for_times"}
    assert told["command"].startswith("contactqp report")
