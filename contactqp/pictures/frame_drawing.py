"""Pictures of bars, springs, beams, strings and matrices, and of the force and gap of every contact as bars.

Fields of members and the figure of members and contacts come first, the figure without geometry after them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.elements.obstacle import tangents
from contactqp.model.arrays import Array, Mask, Vector
from contactqp.model.problem import Units
from contactqp.model.solution import Solution
from contactqp.model.summary import verdict_of
from contactqp.pictures import style
from contactqp.pictures.style import LARGEST, magnification, scale_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Member:
    """One element as a line of k points.

    Attributes
    ----------
    kind : "bar", "spring", "beam", "string", "matrix", or the noun of another kind of elements
    nodes : tuple of int
        The nodes that it connects, as places in FrameFields.nodes; a single one is connected to the ground.
    path, displacement : (k, d) arrays, points along the element and their displacements [length]
    """

    kind: str
    nodes: tuple[int, ...]
    path: Array
    displacement: Array


@dataclass(frozen=True, eq=False)
class FrameContact:
    """A contact of a node with an obstacle, or of two nodes.

    Attributes
    ----------
    name : str
    nodes : tuple of int, one against an obstacle, or two
    push : (1 or 2, d) array, the force on each of the nodes by a unit contact force, -E_N [-]
    force : contact force lambda_N, positive in compression [force]
    gap, initial_gap : gap under the load and before it, positive when open [length]
    status : "open", "closed", "grazing", "stick" or "slip"
    friction : (1 or 2, d) array or None
        The friction force on each of the nodes, -E_T' l_T [force]; None without friction.
    """

    name: str
    nodes: tuple[int, ...]
    push: Array
    force: float
    gap: float
    initial_gap: float
    status: str
    friction: Array | None = None


@dataclass(frozen=True, eq=False)
class FrameFields:
    """All nodes, members and contacts of one solution; N nodes in d dimensions, d = 1, 2 or 3.

    Attributes
    ----------
    axes : tuple of str, the names of the d components among x, y, z
    nodes : tuple of str, names of the nodes
    position, displacement : (N, d) arrays [length]
    held : (N, d) array of bool, whether a support fixes each displacement
    load : (N, d) array, loads on the nodes, without those on supports and without moments [force]
    members, contacts, units
    """

    axes: tuple[str, ...]
    nodes: tuple[str, ...]
    position: Array
    displacement: Array
    held: Mask
    load: Array
    members: tuple[Member, ...]
    contacts: tuple[FrameContact, ...]
    units: Units

    @property
    def upright(self) -> bool:
        """Return whether the picture is vertical: a scene in one dimension whose axis is not x."""
        return self.axes in (("y",), ("z",))

    def flat(self, points: Array, row: float) -> Array:
        """Return points in the plane; those of one dimension are put in a row at the distance `row` beside the axis."""
        if points.shape[1] > 1:
            return points
        beside = np.full(len(points), row)
        return np.column_stack([-beside, points] if self.upright else [points, beside])


LINES: dict[str, dict[str, Any]] = {
    "bar": dict(color="#0072B2", linewidth=2.2),
    "beam": dict(color="#0072B2", linewidth=3.0),
    "spring": dict(color="#009E73", linewidth=1.6, linestyle=":"),
    "string": dict(color="#0072B2", linewidth=1.2),
    "matrix": dict(color="#56B4E9", linewidth=1.2, linestyle="-."),
}
# The style of lines for other kinds of elements.
OTHER_LINE: dict[str, Any] = dict(color="#CC79A7", linewidth=1.6)
GROUNDED = "spring to the ground"
# Markers of nodes fixed along all axes, and along one, whose line shows the free direction.
SUPPORT: dict[str, Any] = dict(color="black", linestyle="none", marker="^", markersize=9, fillstyle="none")
HELD_ALONG: dict[str, Any] = dict(color="0.45", linestyle="none", markersize=7)
ALONG = ("|", "_", "x")  # x, the second axis, the third
# Contacts that the legend lists at most, and names of nodes that are shown at most.
MOST_CONTACTS, MOST_NAMES = 12, 24
# Arrows of loads, of which more would overlap.
MOST_LOADS = 40
# Relative to the size: half the length of an obstacle's symbol, and how far the deformed line is below the undeformed.
OBSTACLE, BELOW = 0.07, 0.12
# An obstacle further than this from its node, relative to the size, is mentioned in the legend only.
DISTANT_OBSTACLE = 0.6
MARGIN = 0.12
# Width, least height, and height of title, axis and legend [inch]; and the largest ratio of height to width.
WIDTH, LEAST, TEXT, MOST_UPRIGHT = 9.0, 1.6, 1.5, 0.75
# Nodes closer than this, relative to the size, share a label.
CLOSE = 0.02


def structure_figure(fields: FrameFields, *, scale: float | None = None, title: str = "") -> Figure:
    """Draw the undeformed and the deformed members, supports, loads, and contacts with their force or gap.

    An obstacle is a symbol, drawn at `scale` times the initial gap from the undeformed node, so that the deformed node
    meets it exactly where the contact is closed. In 1D the deformed line is drawn below the undeformed one; along y
    or z they stand upright beside each other. By default displacements are magnified until they are visible; the title
    states the scale.

    Raises InvalidProblem: the scale is not positive; BackendMissing: matplotlib is not installed.
    """
    size = _size(fields)
    pairs = [(contact.initial_gap, contact.gap) for contact in fields.contacts if len(contact.nodes) == 2]
    initial_gap, gap = np.array(pairs).reshape(-1, 2).T
    scale = magnification(scale, size, fields.displacement, initial_gap, gap)
    result = style.new_figure(WIDTH, WIDTH)
    axes: Any = result.add_subplot(projection="3d") if len(fields.axes) == 3 else result.add_subplot()
    below = BELOW * size
    handles = _draw_members(axes, fields, scale, below)
    seen = [fields.flat(fields.position, 0.0), fields.flat(fields.position + scale * fields.displacement, -below)]
    handles += _draw_nodes(axes, fields, scale, below)
    for contact in fields.contacts:
        seen += _draw_partner(axes, fields, contact, scale, size)
    seen += _draw_forces(axes, fields, scale, size)
    tails, entries = _draw_loads(axes, fields, scale, size)
    seen, handles = seen + tails, handles + entries
    handles += _draw_contacts(axes, fields, scale, below)
    shape = _set_axes(axes, fields, np.concatenate(seen), size)
    result.set_size_inches(WIDTH, TEXT + 0.12 * len(handles) + max(WIDTH * min(shape, MOST_UPRIGHT), LEAST))
    result.suptitle(style.headline(title, scale_text(scale)))
    style.add_legend(result, handles, columns=2)
    return result


def _size(fields: FrameFields) -> float:
    """Return the longest side of the box around the nodes; for nodes at one place, a size that suits displacements."""
    side = float(np.ptp(fields.position, axis=0).max())
    moved = float(np.linalg.norm(fields.displacement, axis=1).max())
    return side if side > 0 else (moved / LARGEST if moved > 0 else 1.0)


def _joined(paths: Iterable[Array]) -> Array:
    """Return one line with breaks between the paths."""
    return np.concatenate([part for path in paths for part in (path, np.full((1, path.shape[1]), np.nan))])


def _draw_members(axes: Any, fields: FrameFields, scale: float, below: float) -> list[Any]:
    lines = [member for member in fields.members if len(member.nodes) > 1]
    handles = []
    if lines:
        look = dict(color=style.UNDEFORMED, linestyle="--", linewidth=1.0)
        axes.plot(*_joined(fields.flat(member.path, 0.0) for member in lines).T, gid="undeformed", **look)
        handles.append(style.line_handle("undeformed", **look))
    others = dict.fromkeys((member.kind for member in lines if member.kind not in LINES), OTHER_LINE)
    for kind, look in {**LINES, **others}.items():
        mine = [fields.flat(_deformed(member, scale), -below) for member in lines if member.kind == kind]
        if mine:
            axes.plot(*_joined(mine).T, gid=kind, **look)
            handles.append(style.line_handle(f"{kind}, deformed", **look))
    grounded = [fields.flat(_deformed(member, scale), -below) for member in fields.members if len(member.nodes) == 1]
    if grounded:
        look = dict(color=LINES["spring"]["color"], linestyle="none", marker="v", markersize=9, fillstyle="none")
        axes.plot(*np.concatenate(grounded).T, gid=GROUNDED, **look)
        handles.append(style.line_handle(GROUNDED, **look))
    return handles


def _deformed(member: Member, scale: float) -> Array:
    return member.path + scale * member.displacement


def _draw_nodes(axes: Any, fields: FrameFields, scale: float, below: float) -> list[Any]:
    """Draw nodes with their names; in 1D thin lines lead from the undeformed to the deformed row."""
    start = fields.flat(fields.position, 0.0)
    end = fields.flat(fields.position + scale * fields.displacement, -below)
    axes.plot(*end.T, color="#0072B2", linestyle="none", marker="o", markersize=3.5, gid="nodes")
    if len(fields.axes) == 1:
        axes.plot(*start.T, color=style.UNDEFORMED, linestyle="none", marker="o", markersize=3)
        axes.plot(*_joined(np.stack([start, end], axis=1)).T, color=style.UNDEFORMED, linewidth=0.5)
    if len(fields.nodes) <= MOST_NAMES:
        _draw_names(axes, fields.nodes, start, CLOSE * below / BELOW)
    handles = []
    held = {"support": fields.held.all(axis=1)}
    for axis, along in zip(fields.axes, fields.held.T, strict=True):
        held[f"held along {axis}"] = along & ~held["support"]
    for name, nodes in held.items():
        if np.any(nodes):
            look = SUPPORT if name == "support" else HELD_ALONG | dict(marker=ALONG[fields.axes.index(name[-1])])
            axes.plot(*end[nodes].T, gid=name, **look)
            handles.append(style.line_handle(name, **look))
    return handles


# Drawing order above everything else; in space matplotlib numbers artists by depth.
NAMES_IN_FRONT = 1000


def _draw_names(axes: Any, names: Iterable[str], places: Array, close: float) -> None:
    """Write the names of the nodes, those of near nodes together, in front of all lines and with a white edge."""
    from matplotlib.patheffects import withStroke

    at: dict[tuple[int, ...], list[str]] = {}
    first: dict[tuple[int, ...], list[float]] = {}
    for name, place in zip(names, places.tolist(), strict=True):
        cell = tuple(round(x / close) for x in place)
        at.setdefault(cell, []).append(name)
        first.setdefault(cell, place)
    for cell, near in at.items():
        look: dict[str, Any] = dict(zorder=NAMES_IN_FRONT, path_effects=[withStroke(linewidth=2.5, foreground="white")])
        axes.text(*first[cell], f"    {', '.join(near)}", fontsize="small", color="0.2", va="bottom", **look)


def _draw_partner(axes: Any, fields: FrameFields, contact: FrameContact, scale: float, size: float) -> list[Array]:
    """Draw the obstacle of a node, or a line between two nodes; return the points that the picture must include."""
    row = -BELOW * size
    if len(contact.nodes) == 2:
        i, j = contact.nodes
        ends = fields.flat((fields.position + scale * fields.displacement)[[i, j]], row)
        axes.plot(*ends.T, color="black", linewidth=0.8, linestyle=":", gid="pair")
        return []
    if scale * abs(contact.initial_gap) > DISTANT_OBSTACLE * size:
        return []
    out = contact.push[0]
    foot = fields.flat((fields.position[contact.nodes[0]] - scale * contact.initial_gap * out)[np.newaxis], row)[0]
    along = [[1.0, 0.0] if fields.upright else [0.0, 1.0]] if len(out) == 1 else tangents(out)
    for tangent in np.asarray(along, dtype=float):
        ends = foot + OBSTACLE * size * np.array([[-1.0], [1.0]]) * tangent
        axes.plot(*ends.T, color=style.OBSTACLE, linewidth=3.5, gid="obstacle", zorder=1.5)
    return [foot[np.newaxis]]


def _draw_forces(axes: Any, fields: FrameFields, scale: float, size: float) -> list[Array]:
    """Draw the contact and friction forces on each node as arrows that end there, and return the tails.

    Both have the same scale, so that the picture shows how steep their resultant is.
    """
    pushed = [contact for contact in fields.contacts if contact.force > 0]
    if not pushed:
        return []
    nodes = [node for contact in pushed for node in contact.nodes]
    forces = np.concatenate([contact.force * contact.push for contact in pushed])
    heads = fields.flat((fields.position + scale * fields.displacement)[nodes], -BELOW * size)
    longest = float(np.abs(forces).max())
    tails = [_draw_arrows(axes, fields, heads, forces, size, longest, gid="contact forces", color=style.PRESSURE)]
    friction = np.concatenate([np.zeros_like(c.push) if c.friction is None else c.friction for c in pushed])
    if np.any(friction):
        look: dict[str, Any] = dict(gid="friction", color=style.FRICTION)
        tails.append(_draw_arrows(axes, fields, heads, friction, size, longest, **look))
    return tails


def _draw_loads(axes: Any, fields: FrameFields, scale: float, size: float) -> tuple[list[Array], list[Any]]:
    """Draw the load on each node as an arrow that ends there; return the tails, and the entry of the legend."""
    sizes = np.linalg.norm(fields.load, axis=1)
    loaded = style.arrows_to_draw(fields.position, sizes, MOST_LOADS)
    if not len(loaded):
        return [], []
    heads = fields.flat((fields.position + scale * fields.displacement)[loaded], -BELOW * size)
    forces = fields.load[loaded]
    tails = _draw_arrows(axes, fields, heads, forces, size, float(np.abs(forces).max()), gid="loads", color=style.LOAD)
    return [tails], [style.line_handle(style.load_label(fields.load, fields.axes, fields.units), color=style.LOAD)]


def _draw_arrows(
    axes: Any, fields: FrameFields, heads: Array, forces: Array, size: float, longest: float, **look: Any
) -> Array:
    """Draw forces, the longest of this size, as arrows that end at their heads, and return their tails."""
    shafts = fields.flat(style.ARROW * size / longest * forces, 0.0)
    in_space: dict[str, Any] = dict(arrow_length_ratio=0.2)
    in_plane: dict[str, Any] = dict(angles="xy", scale_units="xy", scale=1.0, width=0.004)
    look |= in_space if shafts.shape[1] == 3 else in_plane
    axes.quiver(*(heads - shafts).T, *shafts.T, zorder=3, **look)
    return heads - shafts


def _draw_contacts(axes: Any, fields: FrameFields, scale: float, below: float) -> list[Any]:
    """Draw contact points by state; return the entries of the legend, with the force and gap of each."""
    places = fields.flat(fields.position + scale * fields.displacement, -below)
    handles = []
    for contact in fields.contacts:
        marker = style.MARKERS[contact.status]
        look: dict[str, Any] = dict(marker=marker.shape, markerfacecolor=marker.face, color="black", markersize=6)
        axes.plot(*places[list(contact.nodes)].T, linestyle="none", gid=contact.status, zorder=4, **look)
        handles.append(style.marker_handle(contact.status, contact_label(contact, fields)))
    if len(handles) > MOST_CONTACTS:
        rest = style.line_handle(f"and {len(handles) - MOST_CONTACTS} more contacts", linestyle="none")
        handles = [*handles[:MOST_CONTACTS], rest]
    if any(contact.force > 0 for contact in fields.contacts):
        largest = max(contact.force for contact in fields.contacts)
        label = f"contact force, longest arrow {style.number(largest)} {style.force_unit(fields.units)}"
        handles.append(style.line_handle(label, color=style.PRESSURE))
    frictions = [float(np.linalg.norm(c.friction, axis=1).max()) for c in fields.contacts if c.friction is not None]
    if any(frictions):
        label = f"friction, on the same scale, at most {style.number(max(frictions))} {style.force_unit(fields.units)}"
        handles.append(style.line_handle(label, color=style.FRICTION))
    return handles


def contact_label(contact: FrameContact, fields: FrameFields) -> str:
    """Return the state of a contact in words: ``"tip: closed, force 142.5 kN, gap 0 m"``."""
    force = f"force {style.number(contact.force)} {style.force_unit(fields.units)}"
    gap = f"gap {style.number(contact.gap)} {style.length_unit(fields.units)}"
    return f"{contact.name}: {contact.status}, {force}, {gap}"


def _set_axes(axes: Any, fields: FrameFields, seen: Array, size: float) -> float:
    """Set limits and labels, and return the ratio of height to width."""
    unit = style.length_unit(fields.units)
    low, high = seen.min(axis=0) - MARGIN * size, seen.max(axis=0) + MARGIN * size
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    if len(fields.axes) == 3:
        axes.set_zlim(low[2], high[2])
        axes.set_zlabel(f"{fields.axes[2]} [{unit}]")
        axes.set_proj_type("ortho")
        axes.set_box_aspect(high - low)
    else:
        axes.set_aspect("equal")
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    names = ["", *fields.axes] if fields.upright else [*fields.axes, ""]
    for axis, side, name in zip((axes.xaxis, axes.yaxis), ("bottom", "left"), names, strict=False):
        if name:
            axis.set_label_text(f"{name} [{unit}]")
        else:
            axis.set_visible(False)
            axes.spines[side].set_visible(False)
    return float((high - low)[1] / (high - low)[0]) if len(low) == 2 else MOST_UPRIGHT


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
PANEL_HEIGHT, PANEL_WIDTH = 2.4, 7.5


def solution_figure(solution: Solution, *, title: str = "") -> Figure:
    """Return a figure of normal forces, of friction with its bound, and of gaps, contact by contact.

    Parameters
    ----------
    solution : the answer; its problem's units and names are those of the figure
    title : the title of the picture; below it stand the method and its verdict
    """
    problem = solution.problem
    panels = [_normal_force, *([_friction] if solution.friction_force is not None else []), _gap]
    result = style.new_figure(PANEL_WIDTH, PANEL_HEIGHT * len(panels))
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
