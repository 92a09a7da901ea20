"""What a case can say of its answer: each quantity by its name, the kind of number it is, and what it is asked of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from contactqp.certificate.uniqueness import FORCES, POSSIBLE, SEVERAL, UNKNOWN

STATUSES = ("open", "closed", "grazing", "stick", "slip")
ONE_ANSWER = "one answer"


def uniqueness_in_words(findings: Iterable[str]) -> str:
    """A certificate's findings as the value of "uniqueness"."""
    return "; ".join(findings) or ONE_ANSWER


@dataclass(frozen=True)
class Measure:
    """One row of the vocabulary of ``quantity``."""

    meaning: str
    kinds: tuple[str, ...] = ()  # of its value, see units.KINDS; none for words
    words: tuple[str, ...] = ()  # that its value may be of; several are joined by "; ", and all must be said
    at: str | None = None  # what ``at`` names: "unknown", "contact", "support", "bar", "spring", "tie", "body"
    along: str | None = None  # what ``along`` names: a second "unknown", or an "axis"
    near: bool = False  # ``near`` is a point: the node there is meant
    component: bool = False  # ``component`` is one of COMPONENTS
    matrix: bool = False  # its value is ``rows``
    solved: bool = True  # needs a solution; otherwise read off the problem
    path: bool = False  # needs the load path, or a motion
    motion: bool = False  # needs a motion
    statics: bool = False  # means nothing in a motion
    large: bool = False  # needs large deformations
    small: bool = False  # means nothing at large deformations
    counted: bool = False  # there are several of it: ``occurrence`` says which
    event: bool = False  # ``event`` is a change of a contact, and ``occurrence`` which of several
    friction: bool = False  # needs a contact with friction
    whole_way: bool = False  # of the whole load path, not of an instant of it
    of: str = "nodes"  # the scenes that it can be asked of: "nodes", "bodies" or "both"


def _of_bodies(meaning: str, kind: str, **asked: Any) -> Measure:
    return Measure(meaning, (kind,), of="bodies", **asked)


def _of_large(meaning: str, kind: str, **asked: Any) -> Measure:
    return Measure(meaning, (kind,), large=True, **asked)


def _of_motions(meaning: str, kind: str, **asked: Any) -> Measure:
    return Measure(meaning, (kind,), motion=True, of="both", **asked)


# Stresses in the order of contactqp.elements.solid, and the equivalent one.
COMPONENTS = ("xx", "yy", "zz", "xy", "yz", "zx", "von-mises")
_WAY: dict[str, Any] = {"path": True, "whole_way": True}
_POINT: dict[str, Any] = {"counted": True, "whole_way": True}
_READ_OFF: dict[str, Any] = {"solved": False, "small": True}
QUANTITIES = {
    "displacement": Measure("displacement or rotation of an unknown", ("length", "angle"), at="unknown"),
    "normal force": Measure("force of a contact, positive in compression", ("force",), at="contact"),
    "total normal force": Measure("sum of the normal forces of all contacts", ("force",)),
    "gap": Measure("gap of a contact, positive when open", ("length",), at="contact"),
    "status": Measure(
        "open, closed or grazing; with friction open, stick, slip or grazing", words=STATUSES, at="contact"
    ),
    "uniqueness": Measure(
        "what the certificate says of other answers under the same load, with friction",
        words=(ONE_ANSWER, FORCES, SEVERAL, POSSIBLE, UNKNOWN),
        of="both",
        statics=True,
        small=True,
    ),
    "friction force": Measure(
        "component of lambda_T along an axis: what the node does to what it touches, along its own slip",
        ("force",),
        at="contact",
        along="axis",
        friction=True,
    ),
    "slip": Measure(
        "component along an axis of the slip that a scene without a path makes from slip_origin",
        ("length",),
        at="contact",
        along="axis",
        friction=True,
        statics=True,
        small=True,
    ),
    "tie force": Measure("multiplier nu of a tie, K u + A' nu = f", ("force", "moment"), at="tie"),
    "reaction": Measure("force of a support on the body", ("force", "moment"), at="support", statics=True),
    "bar force": Measure("axial force, positive in tension", ("force",), at="bar"),
    "spring force": Measure("force of a spring, positive in tension", ("force",), at="spring"),
    "energy": Measure(
        "1/2 u'Ku - f'u, of bodies on all unknowns with the prescribed ones; elastic energy - f'u where it is large",
        ("energy",),
        of="both",
    ),
    "elastic energy": Measure(
        "1/2 u'Ku on a load path or in a motion, by penalty methods with friction that of contact springs too; at "
        "large deformations that of all bars",
        ("energy",),
        path=True,
        of="both",
    ),
    "work of the loads": Measure("since the path or motion set out", ("energy",), path=True, of="both"),
    "dissipated energy": Measure("by friction since the path or motion set out", ("energy",), path=True, of="both"),
    "kinetic energy": _of_motions("1/2 v'Mv", "energy"),
    "total energy": _of_motions("kinetic and elastic energy", "energy"),
    "impact energy": _of_motions("taken by normal forces since the motion set out", "energy"),
    "energy drift": _of_motions("what the scheme has made of energy since then", "energy"),
    "velocity": Measure("velocity of an unknown", ("velocity",), at="unknown", motion=True),
    "total momentum": _of_motions("of all that moves, along an axis", "momentum", along="axis"),
    "momentum": _of_motions("of a bar, point mass or body along an axis", "momentum", at="moving part", along="axis"),
    "contact impulse": _of_motions("normal forces of a contact times the steps they acted", "momentum", at="contact"),
    "free motions": Measure(
        "number of rigid motions that nothing drives and nothing holds",
        ("number",),
        of="both",
        statics=True,
        small=True,
    ),
    "closing load factor": Measure(
        "load factor at which a contact closes", ("number",), at="contact", statics=True, **_WAY
    ),
    "closing load": Measure(
        "load on `along` when it closes", ("force",), at="contact", along="unknown", statics=True, **_WAY
    ),
    "event time": Measure(
        "pseudo-time of an event, in a motion its time; a side closes with its first node and opens with its last",
        ("number", "time"),
        at="contact",
        event=True,
        of="both",
        **_WAY,
    ),
    "event load": Measure(
        "load on `along` at an event of a contact",
        ("force",),
        at="contact",
        along="unknown",
        event=True,
        statics=True,
        **_WAY,
    ),
    "events": Measure("number of events of a contact, of all kinds", ("number",), at="contact", **_WAY),
    "stiffness": Measure("entry of K at two unknowns", ("stiffness",), at="unknown", along="unknown", **_READ_OFF),
    "tie matrix": Measure("the rows A of the ties, in the scene's units", ("number",), matrix=True, **_READ_OFF),
    "tie rank": Measure("number of independent ties", ("number",), **_READ_OFF),
    "reduced stiffness": Measure("T'KT on the masters", ("stiffness",), matrix=True, **_READ_OFF),
    "reduced load": Measure("T'(f - K b) on the masters", ("force",), matrix=True, **_READ_OFF),
    "load factor": _of_large("what the loads are multiplied by where it is asked", "number"),
    "load": _of_large("load on an unknown where it is asked", "force", at="unknown"),
    "limit load factor": _of_large("load factor at a limit point, where it is greatest or least", "number", **_POINT),
    "limit load": _of_large("load on an unknown at a limit point", "force", at="unknown", **_POINT),
    "limit displacement": _of_large("displacement of an unknown at a limit point", "length", at="unknown", **_POINT),
    "limit points": _of_large("number of limit points of the path", "number", whole_way=True),
    "snap-through load factor": _of_large("load factor at which load control jumps", "number", **_POINT),
    "snap-through load": _of_large("load on an unknown where load control jumps", "force", at="unknown", **_POINT),
    "snap-throughs": _of_large("number of jumps on the path", "number", whole_way=True),
    "node displacement": _of_bodies(
        "displacement of the node of a body at `near`, along an axis",
        "length",
        at="body",
        along="axis",
        near=True,
    ),
    "node velocity": _of_bodies(
        "velocity of the node at `near`, along an axis", "velocity", at="body", along="axis", near=True, motion=True
    ),
    "stress": _of_bodies(
        "stress at the node at `near`, averaged over its elements, tension positive",
        "stress",
        at="elastic body",
        near=True,
        component=True,
    ),
    "contact force": _of_bodies(
        "sum of the normal forces of a contact, each along its own normal, positive in compression",
        "force",
        at="contact",
    ),
    "contact resultant": _of_bodies(
        "sum of the normal forces of a contact as vectors, on the body or the slave, along an axis",
        "force",
        at="contact",
        along="axis",
    ),
    "friction resultant": _of_bodies(
        "sum of lambda_T of a contact as vectors along an axis: what the body or the slave does to what it touches",
        "force",
        at="contact",
        along="axis",
        friction=True,
    ),
    "friction traction": _of_bodies(
        "lambda_T per area at the contact's node at `near`, along an axis; projected as pressures are",
        "pressure",
        at="contact",
        along="axis",
        near=True,
        friction=True,
    ),
    "stick half-width": _of_bodies(
        "largest distance from `near`, the centre, to a node that sticks",
        "length",
        at="contact",
        near=True,
        friction=True,
    ),
    "sticking contacts": _of_bodies("number of nodes of a contact that stick", "number", at="contact", friction=True),
    "peak pressure": _of_bodies(
        "largest pressure at the nodes of a contact: forces projected onto its side",
        "pressure",
        at="contact",
    ),
    "contact pressure": _of_bodies(
        "pressure at the contact's node at `near`: forces projected onto its side",
        "pressure",
        at="contact",
        near=True,
    ),
    "contact half-width": _of_bodies(
        "largest distance from `near`, the centre, to a node that presses", "length", at="contact", near=True
    ),
    "closed contacts": _of_bodies("number of nodes of a contact that press", "number", at="contact"),
    "node gap": _of_bodies(
        "gap of the contact's node at `near`, positive when open", "length", at="contact", near=True
    ),
    "support force": _of_bodies(
        "sum of the forces of a support on the body, along the support's axis", "force", at="support", statics=True
    ),
}
