"""Pictures of an answer without geometry: the force and the gap of every contact as bars."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.model.arrays import Vector
from contactqp.model.solution import Solution
from contactqp.model.summary import verdict_of
from contactqp.pictures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Colours of contact states, of Okabe and Ito (2008).
STATES = {
    "open": "0.75",
    "grazing": "#E69F00",
    "closed": "#0072B2",
    "stick": "#0072B2",
    "slip": "#D55E00",
    "unknown": "#CC79A7",
}
# Up to so many contacts each has a bar with its name; more have lines over their numbers.
NAMED = 30
# Letters of a name that are shown.
LETTERS = 24
HEIGHT, WIDTH = 2.4, 7.5


def solution_figure(solution: Solution, *, title: str = "") -> Figure:
    """Return a figure of normal forces, of friction with its bound, and of gaps, contact by contact.

    Parameters
    ----------
    solution : Solution
        The answer; its problem's units and names are those of the figure.
    title : str
        The title of the picture; below it stand the method and its verdict.
    """
    problem = solution.problem
    panels = [_normal_force, *([_friction] if solution.friction_force is not None else []), _gap]
    result = style.new_figure(WIDTH, HEIGHT * len(panels))
    axes = result.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
    for axis, panel in zip(axes, panels, strict=True):
        panel(axis, solution)
        axis.axhline(0.0, color="0.3", linewidth=0.8)
    if problem.contacts <= NAMED:
        names = [style.plain(problem.contact_name(i), LETTERS) for i in range(problem.contacts)]
        turned = dict(rotation=45, ha="right", rotation_mode="anchor") if len("".join(names)) > 60 else {}
        axes[-1].set_xticks(range(problem.contacts), names, **turned)
    else:
        axes[-1].set_xlabel("contact")
    result.suptitle(style.headline(title, f"{solution.method}: {verdict_of(solution.certificate)}"))
    style.add_legend(result, _handles(solution), columns=len(STATES))
    return result


def _bars(axis: Any, values: Vector, colours: list[str]) -> None:
    place = np.arange(len(values))
    if len(values) <= NAMED:
        axis.bar(place, values, color=colours, width=0.7)
        axis.set_xlim(-0.5 - max(0, 3 - len(values)), len(values) - 0.5 + max(0, 3 - len(values)))
    else:
        axis.vlines(place, 0.0, values, color=colours, linewidth=max(0.5, 300 / len(values)))


def _colours(solution: Solution) -> list[str]:
    return [STATES[str(status)] for status in solution.contact_status]


def _normal_force(axis: Any, solution: Solution) -> None:
    _bars(axis, solution.normal_force, _colours(solution))
    axis.set_ylabel(f"normal force [{style.force_unit(solution.problem.units)}]")


def _friction(axis: Any, solution: Solution) -> None:
    """Draw |l_T|, signed in the plane, within its bound mu l_N."""
    problem, friction = solution.problem, solution.friction_force
    assert friction is not None
    assert problem.friction is not None
    size = friction[:, 0] if friction.shape[1] == 1 else np.linalg.norm(friction, axis=1)
    bound = problem.friction * np.maximum(solution.normal_force, 0.0)
    _bars(axis, size, _colours(solution))
    signs = (1.0, -1.0) if friction.shape[1] == 1 else (1.0,)
    for sign in signs:
        axis.plot(np.arange(len(bound)), sign * bound, "_", color="black", markersize=14 if len(bound) <= NAMED else 2)
    axis.set_ylabel(f"friction [{style.force_unit(problem.units)}]")


def _gap(axis: Any, solution: Solution) -> None:
    """Draw the gaps that are numbers; where all have closed, beside the widest that was open."""
    before = solution.problem.gap[np.isfinite(solution.problem.gap)]
    gap = np.where(np.isfinite(solution.gap), solution.gap, np.nan)
    _bars(axis, gap, _colours(solution))
    low, high = float(np.nanmin(gap, initial=0.0)), float(np.nanmax(np.append(gap, before), initial=0.0))
    if high > low:
        axis.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    axis.set_ylabel(f"gap [{style.length_unit(solution.problem.units)}]")


def _handles(solution: Solution) -> list[Any]:
    from matplotlib.patches import Patch

    status = [str(one) for one in solution.contact_status]
    found = [
        Patch(color=colour, label=style.count_label(name, status.count(name)))
        for name, colour in STATES.items()
        if name in status
    ]
    if solution.friction_force is not None:
        found.append(style.line_handle("bound, mu times the normal force", linestyle="none", marker="_", color="black"))
    return found
