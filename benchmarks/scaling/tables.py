"""The measured figures and the model's as tables of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from benchmarks.scaling.model import Measured, forecasts, measured, processor_ratio, run_ratio, same_multigrid_ratio

GIB = 2**30


def tables(found: Mapping[str, Any]) -> dict[str, str]:
    """Each by its name."""
    kinds = [name for name in ("strong", "weak", "large") if found.get(name)]
    return {
        **{name: "\n".join(_runs(found[name])) for name in kinds},
        **{f"{name} memory": "\n".join(_memory(found[name])) for name in kinds},
        "messages": "\n".join(_messages(found["strong"])),
        "answers": "\n".join(_answers(found["differences"])),
        "taken": "\n".join(_taken(measured(found))),
        "model": "\n".join(_model(measured(found))),
    }


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---:|" * len(head)
    for row in rows:
        yield "| " + " | ".join(row) + " |"


def _median(values: Iterable[float]) -> float:
    ordered = sorted(values)
    return ordered[len(ordered) // 2]


def _runs(runs: Sequence[Any]) -> Iterator[str]:
    head = (
        "ranks", "unknowns", "contacts (closed)", "build", "set-up", "active set", "certificate", "sets", "steps",
        "linear: set-up", "solve", "steps", "contact / linear", "with build", "of processor time", "same multigrid",
        "with build", "load",
    )  # fmt: skip
    rows = []
    for run in runs:
        of_contact = {
            name: _median(one[name] for one in run["contact"]) for name in ("set_up", "active_set", "certificate")
        }
        of_linear = {name: _median(one[name] for one in run["linear"]) for name in ("set_up", "solve")}
        contact, linear = run["contact"][0], run["linear"][0]
        rows.append(
            (
                str(run["ranks"]),
                f"{run['unknowns']:,}",
                f"{run['contacts']:,} ({contact['closed']:,})",
                f"{run['build']:.1f} s",
                *(f"{value:.1f} s" for value in of_contact.values()),
                str(contact["sets"]),
                str(contact["steps"]),
                *(f"{value:.1f} s" for value in of_linear.values()),
                str(linear["steps"]),
                f"{run_ratio(run):.2f}",
                f"{run_ratio(run, run['build']):.2f}",
                f"{processor_ratio(run):.2f}" if "processor" in contact else "",
                f"{same_multigrid_ratio(run):.2f}",
                f"{same_multigrid_ratio(run, run['build']):.2f}",
                f"{run['load_before']:.0f}",
            )
        )
    yield from _table(head, rows)


def _memory(runs: Sequence[Any]) -> Iterator[str]:
    head = ("ranks", "unknowns", "peak of each rank", "above an empty rank, an unknown", "peak / (one rank's / ranks)")
    one = {run["unknowns"]: max(run["contact_peak"]) for run in runs if run["ranks"] == 1}
    rows = []
    for run in runs:
        peaks, n = run["contact_peak"], run["unknowns"]
        above = sum(peak - empty for peak, empty in zip(peaks, run["empty_peak"], strict=True)) * 2**20 / n
        share = f"{max(peaks) * run['ranks'] / one[n]:.2f}" if n in one else ""
        rows.append(
            (
                str(run["ranks"]),
                f"{n:,}",
                ", ".join(f"{p / 1024:.2f}" for p in peaks) + " GiB",
                f"{above:,.0f} B",
                share,
            )
        )
    yield from _table(head, rows)


def _messages(runs: Sequence[Any]) -> Iterator[str]:
    """PETSc counts a message and its bytes twice, where it is sent and where it comes: halved here."""
    head = ("ranks", "event", "calls", "messages", "bytes", "reductions", "flops an unknown")
    rows = []
    for run in runs:
        for name, event in run["linear"][0]["per_step"].items():
            rows.append(
                (
                    str(run["ranks"]),
                    name,
                    f"{max(event['count']):.1f}",
                    f"{max(event['numMessages']) / 2:.1f}",
                    f"{max(event['messageLength']) / 2:,.0f}",
                    f"{max(event['numReductions']):.1f}",
                    f"{sum(event['flops']) / run['unknowns']:,.0f}",
                )
            )
    yield from _table(head, rows)


def _answers(differences: Sequence[Any]) -> Iterator[str]:
    head = ("unknowns", "ranks", "displacement", "contact forces")
    yield from _table(
        head,
        [
            (f"{d['unknowns']:,}", f"{d['ranks']} and 1", f"{d['displacement']:.1e}", f"{d['normal_force']:.1e}")
            for d in differences
        ],
    )


def _taken(of: Measured) -> Iterator[str]:
    said = (
        ("f, flops an unknown and a step", f"{of.flops:,.0f}"),
        ("m, messages a neighbour and a step", f"{of.messages:.1f}"),
        ("s, bytes a neighbour and a step over N^(2/3)", f"{of.surface:,.0f}"),
        ("r, times that all ranks meet in a step of contact", f"{of.meetings:.1f}"),
        (f"steps of the linear problem with {of.steps_size:,.0f} unknowns", f"{of.steps:.0f}"),
        ("their growth, steps ~ n^g: g", f"{of.growth:.2f}"),
        ("u, set-up of the multigrid, in steps", f"{of.set_up:.0f}"),
        ("c, contact over linear", f"{of.contact:.2f}"),
        ("memory, bytes an unknown", f"{of.memory:,.0f}"),
        ("memory of an empty rank", f"{of.empty / 2**20:,.0f} MiB"),
        ("nonzeros an unknown", f"{of.nonzeros:.1f}"),
        ("contacts over n^(2/3)", f"{of.contacts:.2f}"),
    )
    yield "| taken from the measurements | value |"
    yield "|:---|---:|"
    for name, value in said:
        yield f"| {name} | {value} |"


def _model(of: Measured) -> Iterator[str]:
    head = (
        "unknowns", "nodes", "a rank", "memory a node", "of it surfaces", "a step", "of it messages", "steps", "linear",
        "contact", "file on rank 0", "what breaks",
    )  # fmt: skip
    yield from _table(
        head,
        [
            (
                f"10^{len(str(f.unknowns)) - 1}",
                str(f.nodes),
                f"{f.per_rank:,.0f}",
                f"{f.memory / GIB:,.0f} GiB",
                f"{f.surface / GIB:,.1f} GiB",
                f"{1e3 * f.step:,.2f} ms",
                f"{100 * f.communication / f.step:.0f} %",
                f"{f.steps:.0f}",
                f"{f.linear:,.1f} s",
                f"{f.contact:,.1f} s",
                f"{f.file / GIB:,.1f} GiB",
                "; ".join(f.breaks) or "nothing",
            )
            for f in forecasts(of)
        ],
    )
