"""Print judgements as tables, and return them as plain data for JSON."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from contactqp.analysis import is_moving
from contactqp.analysis.history import History
from contactqp.analysis.large.deformation import LargeHistory
from contactqp.model.arrays import Array
from contactqp.model.solution import FIGURES_ALONE, LOCALLY, STATE, Certificate
from contactqp.model.summary import FEW_EVENTS, MOST_EVENTS, events_together, finite, without_rounding
from contactqp.scene.answers import clean_gaps, friction_along_axes
from contactqp.scene.building import NodeModel
from contactqp.scene.courses import of_contacts, print_courses, print_instants, time_label
from contactqp.scene.judging import Comparison, Failure, Judgement
from contactqp.scene.schema import is_rotation
from contactqp.scene.tables import DRAWN_AS_ZERO, MOST_ROWS, Drawn, bars, print_table, print_wrapped, shown, written

# Names in tables that differ from the keys of the JSON.
ENERGIES = {"work": "work of the loads", "impact": "taken by impact"}
# The rows of a table that are printed unless --verbose is set, so that the answer fits a screen.
FEW_ROWS, SCREEN = (8, 6, 4), 40
# Repeated empty lines between tables, which are reduced to one.
_BLANK_LINES = re.compile(r"^(?: *\n){2,}", re.MULTILINE)
# The width of a terminal that has room for columns of the method and its settings.
WIDE_ENOUGH = 120


def print_judgements(console: Console, judgements: Sequence[Judgement], verbose: bool = True) -> None:
    """Print the answer of a scene's first trial in full, and in one table the claims about the other methods.

    Unless `verbose`, long tables are cut and claims that are met are only counted.
    """
    if not judgements:
        return
    if verbose:
        _print_with_claims(console, judgements, MOST_ROWS, verbose)
        return
    text = ""
    for most in FEW_ROWS:
        with console.capture() as shown:
            _print_with_claims(console, judgements, most, verbose)
        text = _BLANK_LINES.sub("\n", shown.get())
        if text.count("\n") <= SCREEN:
            break
    console.file.write(text)


def _print_with_claims(console: Console, judgements: Sequence[Judgement], most: int, verbose: bool) -> None:
    """Print the answer of the first trial with at most `most` rows of each table, and the claims about the others."""
    print_judgement(console, judgements[0], verbose, most)
    others = judgements[1:]
    _print_comparisons(console, others, ["method", "certificate"], unmet_alone=not verbose)
    claimed = [judgement for judgement in others if judgement.expectations or judgement.published]
    for judgement in (judgement for judgement in others if judgement not in claimed):
        console.print(f"{escape(str(judgement.trial))}: {_verdict(judgement)}")
        _print_failures(console, judgement)
    refused = [one for one in judgements if not (one.expectations or one.published or one.met)]
    if refused:
        console.print(f"the case says nothing of {escape(str(refused[0].trial.method))}: its certificate decides")
    if claimed and not verbose:
        runs = f"{len(claimed)} other methods and settings" if len(claimed) > 1 else str(claimed[0].trial)
        console.print(f"by {escape(runs)}: {met_in_words(claimed)} (--verbose lists them)")


def print_case_line(console: Console, outcomes: Sequence[Judgement | Failure]) -> None:
    """Print one line for all outcomes of a case, and below it the claims that are not met."""
    judgements = [outcome for outcome in outcomes if isinstance(outcome, Judgement)]
    scene, failed = outcomes[0].scene, len(outcomes) - len(judgements)
    sentences = [_verdict_in_a_word(judgements[0]), met_in_words(judgements)] if judgements else []
    sentences += [f"{failed} of {len(outcomes)} without an answer"] if failed else []
    name = (scene.file or Path(scene.title)).stem
    console.print(f"{escape(name):32} {'; '.join(sentences)}", soft_wrap=True)
    if judgements:
        _print_failures(console, judgements[0])
    _print_comparisons(console, judgements, ["method", "certificate"], unmet_alone=True)


def met_in_words(judgements: Iterable[Judgement]) -> str:
    """Return how many claims are met, of how many: ``"8 of 8 met"``."""
    rows = [row for judgement in judgements for row in (*judgement.expectations, *judgement.published)]
    return f"{sum(row.ok for row in rows)} of {len(rows)} met" if rows else "nothing is claimed"


def print_judgement(console: Console, judgement: Judgement, verbose: bool = True, most: int = MOST_ROWS) -> None:
    """Print displacements, contact forces, the certificate's verdict, and the comparison with the claims.

    At most `most` rows of each table are printed. Courses are left out where the screen has no room.

    Parameters
    ----------
    console : Console
    judgement : Judgement
    verbose : bool, whether claims that are met are listed
    most : int, the rows of a table that are printed, at most
    """
    solution, scene = judgement.solution, judgement.scene
    how = "" if solution.method == judgement.trial.method else f" ({solution.method})"
    if scene.motion is not None:
        how = f" ({solution.method}, {len(judgement.history) - 1} steps)"
    if isinstance(judgement.history, LargeHistory):
        how = (
            f" ({len(judgement.history)} equilibria, the last at {time_label(scene)} {judgement.history.times[-1]:.6g})"
        )
    console.print(f"[bold]{escape(scene.title)}[/bold], {escape(str(judgement.trial) + how)}: {_verdict(judgement)}")
    _print_failures(console, judgement)
    length, force = scene.units.length, scene.units.force
    names = list(solution.problem.contact_names or ())
    if not isinstance(judgement.model, NodeModel):
        from contactqp.scene.body_answers import summaries

        for header, table in summaries(judgement.model, solution):
            cells = [[c if isinstance(c, str) else written(c) for c in row] for row in table]
            print_table(console, header, cells, most=most)
        for note in judgement.model.notes:
            console.print(f"[yellow]{escape(note)}[/yellow]")
    else:
        header, shown = _unknowns(judgement)
        moved = np.array([value for _, value in shown])
        _print_largest(console, header, [row for row, _ in shown], moved, [(2, moved)], most)
        clean = without_rounding(solution)
        contacts = zip(names, solution.contact_status, clean.normal_force, clean_gaps(solution), strict=True)
        rows = [[name, str(status), written(f), written(g)] for name, status, f, g in contacts]
        header = ["contact", "status", f"normal force [{force}]", f"gap [{length}]"]
        if solution.problem.frictional:
            header += [f"friction {axis} [{force}]" for axis in scene.axes]
            dragged = replace(solution, answer=replace(solution.answer, friction_force=clean.friction_force))
            vectors = friction_along_axes(judgement.model, dragged)
            vectors = np.where(abs(vectors) > DRAWN_AS_ZERO * np.linalg.norm(vectors, axis=1)[:, None], vectors, 0.0)
            rows = [[*row, *map(written, vector)] for row, vector in zip(rows, vectors, strict=True)]
        pictures = [(3, solution.normal_force), (4, clean_gaps(solution))]
        _print_largest(console, header, rows, solution.normal_force, pictures, most)
    if most > FEW_ROWS[-1]:
        print_courses(console, judgement)
    if verbose:
        print_instants(console, judgement, most)
    print_events(console, judgement.history, time_label(scene), verbose)
    energies = ", ".join(f"{ENERGIES.get(name, name)} {value:.12g}" for name, value in _energies(judgement).items())
    if energies:
        console.print(escape(f"{energies} {force}*{length}"))
        print_notes(console, judgement.history)
    claims = len(judgement.expectations) + len(judgement.published)
    _print_comparisons(console, [judgement], [], unmet_alone=claims > most)
    if claims > most:
        console.print(f"what the case claims: {met_in_words([judgement])} (--verbose lists all)")
    if solution.certificate.uniqueness:
        for note in solution.certificate.notes:
            console.print(f"[yellow]{escape(note)}[/yellow]")
    for motion in _free_motions(judgement):
        console.print(escape(f"free to move: {motion}"))


def _free_motions(judgement: Judgement) -> Iterable[str]:
    model, solution = judgement.model, judgement.solution
    if isinstance(model, NodeModel):
        return map(str, solution.free_motions)
    from contactqp.scene.body_answers import motions_in_words

    return motions_in_words(model, solution)


def _print_largest(
    console: Console,
    header: list[str],
    rows: Sequence[Sequence[str]],
    size: Array,
    pictures: Sequence[tuple[int, Array]],
    most: int,
) -> None:
    """Print at most `most` rows of a table, those of the largest `size`, in their order, and the number of all."""
    order = np.argsort(-np.nan_to_num(abs(size)), kind="stable")
    chosen = np.sort(order[:most]) if len(rows) > most else np.arange(len(rows))
    drawn = [_drawn(before, values[chosen]) for before, values in pictures]
    print_table(console, header, [rows[i] for i in chosen], drawn)
    if len(chosen) < len(rows):
        console.print(f"the {len(chosen)} largest of {len(rows)} (--verbose, --json)")


def _drawn(before: int, values: ArrayLike) -> Drawn:
    """Return a bar for each value, in front of a column."""
    return Drawn(before, lambda width, letters: bars(values, width, letters))


def _unknowns(judgement: Judgement) -> tuple[list[str], list[tuple[list[str], float]]]:
    """Return displacements, in a motion also velocities; of divided bars only those of the ends.

    Each row comes with the value of its bar in the picture, the displacement, and 0 for a rotation.
    """
    solution, scene = judgement.solution, judgement.scene
    length, ends = scene.units.length, {node.name for node in scene.nodes}
    header, columns = ["unknown", f"displacement [{length}]"], [solution.displacement]
    if is_moving(solution):
        header, columns = [*header, f"velocity [{length}/s]"], [*columns, solution.velocity]
    rows = zip(solution.problem.dof_names or (), *columns, strict=True)
    shown = [(name, row) for name, *row in rows if name.rpartition(".")[0] in ends]
    units = [(" rad", " rad/s") if is_rotation(name) else ("", "") for name, _ in shown]
    return header, [
        (
            [name, *(written(value) + unit for value, unit in zip(row, own, strict=False))],
            math.nan if own[0] else row[0],
        )
        for (name, row), own in zip(shown, units, strict=True)
    ]


def _energies(judgement: Judgement) -> dict[str, float]:
    """Return the energies of a motion or of a path with friction, empty otherwise."""
    scene = judgement.scene
    end = judgement.history.energies[-1] if scene.motion or scene.path else None
    if end is None or not (scene.motion or scene.large or judgement.solution.problem.frictional):
        return {}
    energies = {"work": end.work, "elastic": end.elastic, "dissipated": end.dissipated}
    if judgement.scene.motion is not None:
        energies |= {"kinetic": end.kinetic, "impact": end.impact, "drift": end.drift}
    return energies


def _verdict(judgement: Judgement) -> str:
    certificate = judgement.solution.certificate
    if certificate.passed:
        rest = _proven(certificate) if certificate.proven else _unproven(certificate)
        return f"[green]certificate passed[/green]{rest}"
    return "[yellow]certificate refuses[/yellow]"


def _verdict_in_a_word(judgement: Judgement) -> str:
    certificate = judgement.solution.certificate
    if not certificate.passed:
        return "[yellow]REFUSED[/yellow]"
    return f"[green]passed[/green]{', proven' if certificate.proven else _unproven(certificate)}"


def _print_failures(console: Console, judgement: Judgement) -> None:
    """Print the failures of the certificate, one per line."""
    print_wrapped(console, [f"  {failure}" for failure in judgement.solution.certificate.failures])


def _proven(certificate: Certificate) -> str:
    """Return the text on the scope of the error bounds."""
    return ", error bounds proven" + (" for the equilibrium nearby" if certificate.scope == LOCALLY else "")


def _unproven(certificate: Certificate) -> str:
    """Return the text on the basis of a verdict without bounds."""
    if certificate.basis == STATE:
        return ", not proven (friction)"
    return ", by its figures alone" if certificate.basis == FIGURES_ALONE else ""


def _print_comparisons(
    console: Console, judgements: Sequence[Judgement], before: list[str], unmet_alone: bool = False
) -> None:
    """Print two tables, with the columns `before` where there is more than one method; narrow ones method by method."""

    def kept(rows: Sequence[Comparison]) -> list[list[str | Text]]:
        return [_comparison(row) for row in rows if not (unmet_alone and row.ok)]

    header = ["expected", "value", "got", "unit", "error", "allowed", ""]
    _print_by_trial(console, before, header, [(one, kept(one.expectations)) for one in judgements])
    header = ["printed in the source", "value", "ours", "unit", "difference", "half digit", "verdict"]
    _print_by_trial(console, before, header, [(one, kept(one.published)) for one in judgements])


def _print_by_trial(
    console: Console,
    before: list[str],
    header: list[str],
    found: Sequence[tuple[Judgement, list[list[str | Text]]]],
) -> None:
    """Print rows of several methods as one table with the columns `before`, or each method's where that is too wide."""
    if not before or console.width >= WIDE_ENOUGH:
        rows = [[*_trial(one)[: len(before)], *row] for one, mine in found for row in mine]
        print_table(console, [*before, *header], rows)
        return
    room = MOST_ROWS
    for one, mine in found:
        if mine and room > 0:
            name, verdict = _trial(one)
            console.print(f"by {escape(name)}: certificate {verdict}")
            print_table(console, header, mine[:room])
        room -= len(mine)
    if room < 0:
        console.print(f"... and {-room} more rows (--json has all)")


def _trial(judgement: Judgement) -> list[str]:
    return [str(judgement.trial), "passed" if judgement.solution.certificate.passed else "refuses"]


def _comparison(row: Comparison) -> list[str | Text]:
    mark = Text("met", style="green") if row.ok else Text("NOT MET", style="red")
    if row.verdict is not None:
        mark = Text(f"{row.verdict}, as stated") if row.ok else Text(f"NOT {row.verdict}, as stated", style="red")
    return [
        row.quantity,
        shown(row.expected),
        shown(row.got),
        row.unit,
        f"{row.error:.1e}" if row.error else "0",
        f"{row.tolerance:.1e}" if row.tolerance else "0",
        mark,
    ]


def print_failure(console: Console, failure: Failure) -> None:
    """Print how far an interrupted path or motion came, without the error message."""
    history = failure.history
    if history is None or len(history) == 0:
        return
    what = time_label(failure.scene)
    instants = "1 instant" if len(history) == 1 else f"{len(history)} instants"
    console.print(escape(f"{failure.scene.title}: {instants} so far, to {what} {history.times[-1]:.12g}"))
    print_events(console, history, what)
    print_notes(console, history)


def print_events(console: Console, history: History, when: str, verbose: bool = True) -> None:
    """Print events and limit points; unless `verbose`, many events of one kind at one time share a row.

    Parameters
    ----------
    console : rich.console.Console
    history : History
    when : the head of the column of times
    verbose : whether every event has a row
    """
    few = len(history.events) if verbose else FEW_EVENTS
    told = events_together(history.events, history[-1].problem.contact_name, few)
    rows = [[kind, names, written(time)] for kind, names, time, _ in told]
    print_table(console, ["event", "contact", when], rows, most=MOST_ROWS if verbose else MOST_EVENTS)
    if isinstance(history, LargeHistory):
        points = [[point.kind, written(point.load_factor), _shape(point.smooth)] for point in history.limit_points]
        print_table(console, ["limit point", "load factor", "form"], points)


def _shape(smooth: bool) -> str:
    return "smooth" if smooth else "corner: a contact closes or opens"


def print_notes(console: Console, history: History) -> None:
    """Print the notes of a history."""
    for note in history.notes:
        console.print(f"[yellow]{escape(note)}[/yellow]")


def judgement_data(judgement: Judgement | Failure) -> dict[str, Any]:
    """Return one trial in full, for JSON; numbers are in the scene's units."""
    if isinstance(judgement, Failure):
        return {
            "title": judgement.scene.title,
            "method": judgement.trial.method,
            "met": False,
            "failure": judgement.message,
            "code": judgement.code,
        }
    solution, scene = judgement.solution, judgement.scene
    certificate = solution.certificate
    names = list(solution.problem.contact_names or ())
    return {
        "case": str(scene.file) if scene.file else None,
        "title": scene.title,
        "units": {"length": scene.units.length, "force": scene.units.force},
        "method": judgement.trial.method,
        "engine": judgement.trial.engine,
        "solved_by": solution.method,
        "knobs": {name: str(knob) for name, knob in judgement.trial.knobs.items()},
        "met": judgement.met,
        "seconds": solution.seconds,
        "energy": finite(solution.energy),
        "displacement": _named(solution.problem.dof_names, solution.displacement),
        "normal_force": _named(names, solution.normal_force),
        "gap": _named(names, solution.gap),
        "contact_status": dict(zip(names, map(str, solution.contact_status), strict=True)),
        "tie_force": _named([tie.name for tie in scene.ties], solution.tie_force),
        "certificate": {
            "passed": bool(certificate.passed),
            "proven": bool(certificate.proven),
            "basis": certificate.basis,
            "scope": certificate.scope,
            "failures": [str(failure) for failure in certificate.failures],
            "uniqueness": list(certificate.uniqueness),
            "notes": list(certificate.notes),
        },
        **_body_data(judgement),
        **_friction_data(judgement),
        **_energy_data(judgement),
        **large_data(judgement.history),
        **_history_data(judgement),
        "events": [{"kind": e.kind, "contact": names[e.contact], "time": e.time} for e in judgement.history.events],
        "expectations": [_comparison_data(row) for row in judgement.expectations],
        "published": [_comparison_data(row) for row in judgement.published],
    }


def _body_data(judgement: Judgement) -> dict[str, Any]:
    if isinstance(judgement.model, NodeModel):
        return {}
    from contactqp.scene.body_answers import summary_data

    return summary_data(judgement.model, judgement.solution)


def _friction_data(judgement: Judgement) -> dict[str, Any]:
    """Return lambda_T of each contact along the axes, and along the rows E_T; nothing without friction."""
    solution, scene, model = judgement.solution, judgement.scene, judgement.model
    if not solution.problem.frictional:
        return {}
    data: dict[str, Any] = {}
    if isinstance(model, NodeModel):
        vectors = friction_along_axes(model, solution)
        names = solution.problem.contact_names or ()
        data["friction_force"] = {name: _named(scene.axes, row) for name, row in zip(names, vectors, strict=True)}
        components = np.asarray(solution.friction_force).reshape(len(names), -1)
        data["friction_components"] = {
            name: [finite(float(part)) for part in row] for name, row in zip(names, components, strict=True)
        }
    return data


def _energy_data(judgement: Judgement) -> dict[str, Any]:
    """Return energies and notes, and velocities at the end of a motion."""
    energies, solution = _energies(judgement), judgement.solution
    data: dict[str, Any] = {"energies": energies, "notes": list(judgement.history.notes)} if energies else {}
    if is_moving(solution):
        data |= {"time": solution.time, "velocity": _named(solution.problem.dof_names, solution.velocity)}
    return data


def _history_data(judgement: Judgement) -> dict[str, Any]:
    """Return the forces of contacts at every instant of a path or a motion, and on a path their statuses.

    The normal force is that of each contact of the scene, summed over its nodes; friction and status are those of each
    contact of the problem. A motion has no statuses, as they would need a certificate of every step.
    """
    history = judgement.history
    if len(history) < 2:
        return {}
    forces = {contact: [finite(float(x)) for x in force] for contact, force in of_contacts(judgement, history)}
    times = [float(t) for t in history.times]
    data: dict[str, Any] = {"over": time_label(judgement.scene), "at": times, "normal_force": forces}
    names, friction = judgement.solution.problem.contact_names or (), history.friction_forces
    if friction is not None:
        data["friction_force"] = {name: friction[:, i].tolist() for i, name in enumerate(names)}
    if judgement.scene.motion is None:
        statuses = np.array([solution.contact_status for solution in history])
        data["contact_status"] = {name: statuses[:, i].tolist() for i, name in enumerate(names)}
    return {"history": data}


def large_data(history: History) -> dict[str, Any]:
    """Return load factors, limit points and snaps of a large deformation."""
    if not isinstance(history, LargeHistory):
        return {}
    return {
        "load_factors": [float(t) for t in history.times],
        "stable": [bool(stable) for stable in history.stable],
        "limit_points": [
            {"kind": point.kind, "load_factor": point.load_factor, "after": point.after, "smooth": point.smooth}
            for point in history.limit_points
        ],
        "snap_throughs": [{"above": snap.low, "load_factor": snap.high} for snap in history.snaps],
    }


def _comparison_data(row: Comparison) -> dict[str, Any]:
    return asdict(row) | {"error": finite(row.error)}


def _named(names: Iterable[str] | None, values: Iterable[float]) -> dict[str, float | None]:
    return {name: finite(value) for name, value in zip(names or (), values, strict=True)}
