"""The problem of a case in mathematics, with this case's sizes: only the blocks that it has.

Signs are those of the whole package: gaps g - E_N u are positive when open, λ_N is a force and positive in compression,
λ_T is what the body does to the obstacle.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from contactqp.study.report_data import CaseRecord


@dataclass(frozen=True)
class StepSymbol:
    """A symbol of the equations of impact schemes."""

    latex: str
    meaning: str
    size: str  # n, m or 1
    unit: str  # with {length} and {force}


SYMBOLS = (
    StepSymbol("h", "length of a step", "1", "s"),
    StepSymbol(r"\theta", "weight of the end of a step; 1/2 loses no energy between impacts", "1", "1"),
    StepSymbol("e", "restitution: velocity after over velocity before an impact", "1", "1"),
    StepSymbol("P_N", "impulses of the contacts in a step, positive in compression", "m", "{force}·s"),
    StepSymbol("w", "where the step would lead without stiffness and loads, made admissible", "n", "{length}"),
    StepSymbol(r"\beta", "stiffness of the penalty springs", "1", "{force}/{length}"),
)

_FORCES = r"E_N^T \lambda_N"
# The equations of each impact scheme, which lead from (u, v) to (u⁺, v⁺) in a step of h; u⁻ is a step earlier. Ties and
# friction enter as in equilibrium.
STEPS: Mapping[str, tuple[str, ...]] = {
    "moreau-jean": (
        r"M (v^+ - v) + h K (\theta u^+ + (1 - \theta) u) + E_N^T P_N = h f",
        r"u^+ = u + h (\theta v^+ + (1 - \theta) v)",
        r"E_N v^+ \le -e E_N v, \; P_N \ge 0, \; \text{complementary where a contact closes}",
    ),
    "newmark": (
        r"\frac{M (v^+ - v)}{h} + \frac{K (u + u^+)}{2} + \frac{E_N^T (\lambda_N + \lambda_N^+)}{2} = f",
        r"u^+ = u + \frac{h (v + v^+)}{2}",
    ),
    "modified-mass": (
        r"\frac{M (v^+ - v)}{h} + \frac{K (u + u^+)}{2} = f \; \text{where there is mass}",
        r"K u^+ + E_N^T \lambda_N^+ = f \; \text{at the contacts, which have none}",
    ),
    "modified-mass-central": (
        r"\frac{M (u^+ - 2 u + u^-)}{h^2} + K u = f \; \text{where there is mass}",
        r"K u^+ + E_N^T \lambda_N^+ = f \; \text{at the contacts, which have none}",
    ),
    "paoli-schatzman": (
        rf"\frac{{M (u^+ - 2 u + u^-)}}{{h^2}} + K u + {_FORCES} = f",
        r"E_N \frac{u^+ + e u^-}{1 + e} \le g",
    ),
    "penalty": (
        rf"\frac{{M (u^+ - 2 u + u^-)}}{{h^2}} + K u + {_FORCES} = f",
        r"\lambda_N = \beta \max(E_N u - g, 0)",
    ),
    "backward-euler": (
        rf"\frac{{M (v^+ - v)}}{{h}} + K u^+ + {_FORCES} = f",
        r"u^+ = u + h v^+",
    ),
    "deuflhard-krause-ertel": (
        r"w = \text{the admissible displacement nearest to } u + h v",
        rf"M (u^+ - w) + \frac{{h^2}}{{2}} \left( \frac{{K (u + u^+)}}{{2}} + {_FORCES} - f \right) = 0",
        r"v^+ = v + \frac{2 (u^+ - w)}{h}",
    ),
}


def symbols_of(scheme: str) -> Iterator[StepSymbol]:
    """Yield the symbols in the equations of a scheme; letters of words are not symbols."""
    equations = re.sub(r"\\text\{[^}]*\}", "", " ".join(STEPS.get(scheme, ())))
    tokens = set(re.findall(r"\\[a-z]+|P_N|[A-Za-z]", equations))
    yield from (symbol for symbol in SYMBOLS if symbol.latex in tokens)


# Names of blocks of an explanation that have an equation of their own.
CONDENSATION = "condensation onto the contact unknowns"
PATH, TIME, NEWTON, ROTATIONS = "load path", "time stepping", "Newton loop", "rotations"


@dataclass(frozen=True)
class Formula:
    """Equations in LaTeX, one a line, and their meaning in words."""

    name: str
    latex: str
    meaning: str = ""


@dataclass(frozen=True)
class Symbol:
    """One quantity of the problem."""

    latex: str
    meaning: str
    size: str  # in LaTeX
    unit: str


@dataclass(frozen=True)
class Formulation:
    """The symbols with their sizes, and the equations."""

    symbols: tuple[Symbol, ...]
    formulas: tuple[Formula, ...]


def formulation(case: CaseRecord) -> Formulation:
    """Return the formulation of a case from its sizes and blocks; nothing is computed."""
    blocks = {block.name: block.reason for block in case.explanation.blocks if block.included}
    return Formulation(tuple(_symbols(case, blocks)), tuple(_formulas(case, blocks)))


def _symbols(case: CaseRecord, blocks: dict[str, str]) -> Iterator[Symbol]:
    size = case.sizes
    n, m, t, k = size.unknowns, size.contacts, size.tangential_rows, size.ties
    stiffness = f"{case.force}/{case.length}"
    turning = " (rotations: rad)" if ROTATIONS in blocks else ""
    yield Symbol("u", "displacements of the free unknowns", f"n = {n}", f"{case.length}{turning}")
    kind = "tangent stiffness at the start" if NEWTON in blocks else "stiffness, symmetric, positive semi-definite"
    yield Symbol("K", f"{kind}; numbers that are not zero: {size.nonzeros}", rf"{n} \times {n}", stiffness)
    if TIME in blocks:
        yield Symbol("M", "mass", rf"{n} \times {n}", f"{case.force}·s²/{case.length}")
        yield from _step_symbols(case)
    if NEWTON in blocks:
        yield Symbol(r"\mathrm{U}", "elastic energy", "1", f"{case.force}·{case.length}")
        yield Symbol(r"\Delta", "change of u in a step of Newton", f"{n}", f"{case.length}{turning}")
    path = "; f(t) are those on the way to them, t counts it" if PATH in blocks or NEWTON in blocks else ""
    yield Symbol("f", f"loads{path}", f"{n}", case.force)
    if m:
        approach = "contact rows: how far partners approach for a unit displacement"
        yield Symbol("E_N", approach, rf"{m} \times {n}", "1")
        yield Symbol("g", "initial gaps, negative where partners overlap", f"m = {m}", case.length)
        yield Symbol(r"\lambda_N", "contact forces, positive in compression", f"{m}", case.force)
    if t:
        rows = f"tangential rows, {'one' if t == m else 'two'} for each contact"
        yield Symbol("E_T", rows, rf"(d - 1) m \times n = {t} \times {n}", "1")
        yield Symbol(r"\lambda_T", "friction forces, of the body on its partner", f"{t}", case.force)
        if TIME in blocks:
            yield Symbol("s", "velocity of slip, E_T v", f"{t}", f"{case.length}/s")
        else:
            yield Symbol("s", "slip since the start of the step, E_T u less its value there", f"{t}", case.length)
        yield Symbol(r"\mu", "coefficients of friction", f"{m}", "1")
    if k:
        yield Symbol("A, b", "ties and their values", rf"{k} \times {n}, \; k = {k}", f"1, {case.length}")
        yield Symbol(r"\nu", "tie forces", f"{k}", case.force)


def _step_symbols(case: CaseRecord) -> Iterator[Symbol]:
    """Yield the symbols that the equations of the case's impact scheme add."""
    sizes = {"n": case.sizes.unknowns, "m": case.sizes.contacts, "1": 1}
    yield Symbol("v", "velocities", f"{case.sizes.unknowns}", f"{case.length}/s")
    for symbol in symbols_of(case.scheme):
        unit = symbol.unit.format(length=case.length, force=case.force)
        yield Symbol(symbol.latex, symbol.meaning, f"{sizes[symbol.size]}", unit)


def _formulas(case: CaseRecord, blocks: dict[str, str]) -> Iterator[Formula]:
    if TIME in blocks:
        yield from _motion(case, blocks)
    elif NEWTON in blocks:
        yield from _large(case, blocks)
    else:
        yield from _static(case, blocks)
    yield from _contact_law(case, "g(u)" if NEWTON in blocks else "g - E_N u")
    if CONDENSATION in blocks:
        yield Formula(
            "Condensation",
            r"\bar{K} = K_{cc} - K_{ci} K_{ii}^{-1} K_{ic}, \quad \bar{f} = f_c - K_{ci} K_{ii}^{-1} f_i",
            f"c are the unknowns that rows touch, i the others, which one factorisation{_condensed_matrix(blocks)} "
            f"eliminates: {blocks[CONDENSATION]}",
        )


def _condensed_matrix(blocks: dict[str, str]) -> str:
    """Return which matrix is condensed: that of the steps where they have one of their own."""
    return " of the matrix of a step" if TIME in blocks or NEWTON in blocks else ""


def _static(case: CaseRecord, blocks: dict[str, str]) -> Iterator[Formula]:
    load = "f(t)" if PATH in blocks else "f"
    transposed = "f(t)^T" if PATH in blocks else "f^T"
    where = rf"u \in \mathbb{{R}}^{{{case.sizes.unknowns}}}"
    energy = rf"\underset{{{where}}}{{\min}} \; \frac{{1}}{{2}} u^T K u - {transposed} u"
    if case.sizes.tangential_rows:
        meaning = (
            "friction is not a minimisation: each step minimises this with the friction, or the bound of it, of the "
            "step before, until they agree"
        )
        yield Formula("Energy", energy, meaning)
    else:
        yield Formula("Energy", energy, "the energy is least among all displacements that the constraints allow")
    yield from _constraints(case)
    balance = "the first of the Karush-Kuhn-Tucker conditions"
    if case.sizes.tangential_rows:
        balance = "the balance of forces; with friction it is not the condition of a minimum"
    yield Formula("Equilibrium", f"K u {_forces(case)} = {load}", balance)
    if PATH in blocks:
        yield Formula("Load path", "f = f(t)", blocks[PATH])


def _motion(case: CaseRecord, blocks: dict[str, str]) -> Iterator[Formula]:
    yield Formula(
        "Motion", rf"M \dot{{v}} + K u {_forces(case)} = f, \quad \dot{{u}} = v", "with impacts, where velocities jump"
    )
    yield from _constraints(case)
    if case.scheme in STEPS:
        yield Formula(f"One step of h by {case.scheme}", "\n".join(STEPS[case.scheme]), blocks[TIME])


def _large(case: CaseRecord, blocks: dict[str, str]) -> Iterator[Formula]:
    where = rf"u \in \mathbb{{R}}^{{{case.sizes.unknowns}}}"
    yield Formula(
        "Energy",
        rf"\Pi(u) = \mathrm{{U}}(u) - f(t)^T u, \quad {where}",
        "the elastic energy U is not quadratic; equilibria are its stationary points, stable or not",
    )
    if case.sizes.contacts:
        yield Formula(
            "Contact",
            rf"g(u) \ge 0, \quad g(u) \in \mathbb{{R}}^{{{case.sizes.contacts}}}",
            "gaps now; E_N(u) is how fast they close",
        )
    forces = _forces(case).replace("E_N", "E_N(u)").replace("E_T", "E_T(u)")
    yield Formula("Equilibrium", rf"\frac{{\partial U}}{{\partial u}} {forces} = f(t)", blocks.get(PATH, ""))
    yield Formula(
        "One step of Newton",
        r"\underset{\Delta}{\min} \; \frac{1}{2} \Delta^T K(u) \Delta - \left( f(t) - "
        r"\frac{\partial U}{\partial u} \right)^T \Delta \quad \text{with} \quad E_N(u) \Delta \le g(u)",
        blocks[NEWTON],
    )


def _constraints(case: CaseRecord) -> Iterator[Formula]:
    size = case.sizes
    if size.contacts:
        rows = rf"E_N \in \mathbb{{R}}^{{{size.contacts} \times {size.unknowns}}}"
        yield Formula("Contact", rf"E_N u \le g, \quad {rows}", "no gap is negative")
    if size.ties:
        rows = rf"A \in \mathbb{{R}}^{{{size.ties} \times {size.unknowns}}}"
        yield Formula("Ties", f"A u = b, \\quad {rows}", "unknowns that move together")


def _contact_law(case: CaseRecord, gap: str) -> Iterator[Formula]:
    size = case.sizes
    if size.contacts:
        yield Formula(
            "Signorini",
            rf"\lambda_N \ge 0, \quad {gap} \ge 0, \quad \lambda_{{N,i}} ({gap})_i = 0",
            "contacts push and never pull, and only where the gap is closed",
        )
    if size.tangential_rows:
        yield Formula(
            "Coulomb",
            r"\lVert \lambda_{T,i} \rVert \le \mu_i \lambda_{N,i}, \quad "
            r"s_i \ne 0 \; \Rightarrow \; \lambda_{T,i} = \mu_i \lambda_{N,i} \frac{s_i}{\lVert s_i \rVert}",
            "a contact sticks within the cone and slips on it; friction on the body acts against the slip",
        )


def _forces(case: CaseRecord) -> str:
    """Return the forces of the constraints in the equilibrium, in LaTeX."""
    size = case.sizes
    parts = [r"E_N^T \lambda_N"] * (size.contacts > 0) + [r"E_T^T \lambda_T"] * (size.tangential_rows > 0)
    return "".join(f"+ {part} " for part in [*parts, *[r"A^T \nu"] * (size.ties > 0)])
