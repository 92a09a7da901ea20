"""What a run of the report found of each method: `python -m docs.generating.what_is_measured report/` makes a small
table of its results, which is kept, and the page shows that."""

from __future__ import annotations

import csv
import json
import statistics
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from docs.generating.tables import table

KEPT = Path(__file__).parent.parent / "choosing.csv"
REFERENCE = "active-set"
ANSWERED = ("right", "approximate")
Line = Mapping[str, str]


@dataclass(frozen=True)
class Measured:
    """One method over all cases of a report."""

    method: str
    cases: int  # that it was tried on
    raw: int  # answers before polish, over all values of its knob
    raw_right: int
    answers: int  # as `solve` returns them, over all values of its knob
    right: int
    approximate: int  # returned with a certificate that says how far off they are
    called_solved: int  # raw answers that the method itself calls solved
    called_wrongly: int  # of these
    time: float | None  # of its answers, median over the cases, in times of active-set on the same case


def measured(lines: Iterable[Line]) -> list[Measured]:
    """Every method that was tried, in the order of the table."""
    tried = [line for line in lines if line["verdict"] not in ("missing", "unsupported")]
    names = list(dict.fromkeys(line["method"] for line in tried))
    reference = _seconds(line for line in tried if line["method"] == REFERENCE)
    return [_measured(name, [line for line in tried if line["method"] == name], reference) for name in names]


def _measured(name: str, lines: list[Line], reference: Mapping[str, float]) -> Measured:
    raw = [line for line in lines if line["variant"] == "raw"]
    returned = [line for line in lines if line["variant"] != "raw"]
    called = [line for line in (raw or returned) if line["claimed"] == "true"]
    seconds = _seconds(returned)
    times = [seconds[case] / reference[case] for case in seconds if case in reference]
    return Measured(
        method=name,
        cases=len({line["case"] for line in lines}),
        raw=len(raw),
        raw_right=sum(line["verdict"] == "right" for line in raw),
        answers=len(returned),
        right=sum(line["verdict"] == "right" for line in returned),
        approximate=sum(line["verdict"] == "approximate" for line in returned),
        called_solved=len(called),
        called_wrongly=sum(line["flag_wrong"] == "true" for line in called),
        time=round(statistics.median(times), 1) if times else None,
    )


def _seconds(lines: Iterable[Line]) -> dict[str, float]:
    """Of each case the median over the knob of what took time and gave an answer."""
    found: dict[str, list[float]] = {}
    for line in lines:
        if line["verdict"] in ANSWERED and line["seconds"]:
            found.setdefault(line["case"], []).append(float(line["seconds"]))
    return {case: statistics.median(seconds) for case, seconds in found.items()}


def what_is_measured() -> str:
    """The table of the page, and where it comes from."""
    source, kept = read_kept()
    head = ("method", "cases", "raw answers right", "answers right", "called solved, and wrong", "time")
    rows = [
        (
            f"`{line['method']}`",
            line["cases"],
            f"{line['raw_right']} of {line['raw']}" if line["raw"] != "0" else "",
            f"{line['right']} of {line['answers']}"
            + (f", {line['approximate']} approximate" * (line["approximate"] != "0")),
            f"{line['called_wrongly']} of {line['called_solved']}" if line["called_solved"] != "0" else "",
            line["time"],
        )
        for line in kept
    ]
    return f"{source}\n\n{table(head, rows)}"


def read_kept() -> tuple[str, list[Line]]:
    """Where the kept table comes from, and its lines."""
    source, _, text = KEPT.read_text(encoding="utf-8").partition("\n")
    return source.removeprefix("# "), list(csv.DictReader(text.splitlines()))


def keep(report: Path) -> None:
    """Make the kept table of a report."""
    with open(report / "results.csv", encoding="utf-8", newline="") as file:
        lines = measured(csv.DictReader(file))
    about = json.loads((report / "results.json").read_text(encoding="utf-8"))
    machine, versions = about["machine"], about["versions"]
    named = ", ".join(f"{name} {found}" for name, found in versions.items() if found != "not installed")
    source = f"# {about['created'][:10]}, {machine['cores']} cores, {machine['python']}; {named}."
    with open(KEPT, "w", encoding="utf-8", newline="") as file:
        file.write(source + "\n")
        writer = csv.DictWriter(file, [field.name for field in fields(Measured)], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(line) for line in lines)


if __name__ == "__main__":
    keep(Path(sys.argv[1]))
