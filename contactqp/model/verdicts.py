"""Verdicts as data: what an answer violates, how far it is from the truth, and what a certificate says of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Vector
from contactqp.model.problem_data import ReadOnly

# What a verdict rests on.
BOUNDS, STATE, FIGURES_ALONE = "bounds", "state", "figures"


FIGURES = ("equilibrium", "balance", "penetration", "tension", "complementarity", "cone", "slip_direction", "tie")


@dataclass(frozen=True, eq=False)
class Nothing(ReadOnly):
    """The forces and lengths up to which an answer has none at an unknown or in a row."""

    force: Vector  # (n,) at unknowns [force]
    normal: Vector  # (m,) in the normal rows [length]
    tangent: Vector  # (m (d-1),) in the tangential rows [length]
    tie: Vector  # (k,) in the ties [length]


@dataclass(frozen=True, eq=False)
class Answer(ReadOnly):
    """Somebody's displacement and forces, of the right shapes."""

    displacement: Vector  # (n,)
    normal_force: Vector  # (m,)
    friction_force: NDArray[np.float64] | None  # (m, d-1)
    tie_force: Vector  # (k,)

    def finite(self) -> bool:
        parts = (self.displacement, self.normal_force, self.tie_force, self.friction_force)
        return all(part is None or bool(np.all(np.isfinite(part))) for part in parts)


@dataclass(frozen=True, eq=False)
class Violations(ReadOnly):
    """Every figure for every unknown, contact, tie, so that the worst can be named; all at least 0."""

    equilibrium: Vector  # (n,) |residual_j| / F_j (Oettli and Prager 1964)
    residual: Vector  # (n,) f - K u - E_N'l_N - E_T'l_T - A'nu [force]
    penetration: Vector  # (m,) (E_N u - g)+ as a gap
    tension: Vector  # (m,) (-l_N)+ as a force
    complementarity: Vector  # (m,) min(gap, l_N), each in its own measure
    cone: Vector  # (m,) (|l_T| - mu l_N)+ as a force
    slip_direction: Vector  # (m,) min(|s|, |l_T - mu l_N s/|s||), each in its own measure
    tie: Vector  # (k,) |A u - b| / (|A||u| + |b|)
    slip_measure: Vector  # (m,) |s| / |L| of the tangential rows, 0 without friction
    turned: Vector  # (m,) by how much rounding a displacement to doubles turns friction that opposes its slip [force]
    lengths: Vector  # (m,) L of the normal rows [length]
    tangential_lengths: Vector  # (m,) that of the tangential rows
    gap: Vector  # (m,) g - E_N u [length]
    gap_measure: Vector  # (m,) |gap| / L, 0 where the gap is nothing
    force_measure: Vector  # (m,) |l_N| as a force
    meeting: Vector  # (n,) F [force]
    intrinsic_size: float  # S of problem and answer [square root of energy]
    nothing: Nothing  # forces and lengths up to which there are none


@dataclass(frozen=True, eq=False)
class Certificate(ReadOnly):
    """What is violated (dimensionless, the worst contact or unknown), and how far the answer is from the truth.

    `passed` says that every figure is at most `tolerance` and every bound that could be had at most `error_tolerance`
    (`force_bound` relative to the largest contact force); `proven` says that energy and force error could be bounded,
    and not only estimated, as those of bodies too large to factorise.

    With friction, `natural_map` measures Signorini's and Coulomb's law as one equation. It enters the verdict with four
    times the tolerance, up to which the other figures imply it: it refuses nothing that they pass.
    `uniqueness` is empty where this is found to be the only answer, and enters no verdict: an answer among several is
    right. "several answers": others exist at this load; "several answers possible": none of the tests excludes them
    (friction is above a critical coefficient, or contacts are too many for more than a sufficient bound); "forces not
    unique": redundant contacts may share the force differently; "not examined": `notes` say why. `contraction` is the
    factor by which Tresca's fixed point changes the error of its bounds around this answer.

    `basis` is what the verdict rests on. "bounds": the bounds on the error, without friction. "state": with friction,
    the answer of its own combination of open, stick and slip, to which `distance` was measured. "figures": the figures
    alone, because neither could be had; `notes` or `reasons` say why.
    """

    equilibrium: float  # componentwise backward error
    balance: float  # of the forces on every rigid motion of the bodies
    penetration: float
    tension: float
    complementarity: float
    cone: float
    slip_direction: float
    tie: float
    natural_map: (
        float | None
    )  # contact and friction as one equation (`contactqp.certificate.coulomb_residual`); None without friction
    energy_error: float | None  # >= |u - u*|_K / |u*|_K, absolute where |u*|_K vanishes
    force_error: float | None  # >= |l - l*|_W / |l*|_W, absolute where l* vanishes
    force_bound: Vector | None  # (m,) >= |l_i - l_i*| [force]
    reasons: tuple[str, ...]  # why a bound is None
    grazing: tuple[int, ...]  # contacts whose gap and force both vanish
    failures: tuple[str, ...]  # what failed, where, by how much
    notes: tuple[str, ...]
    uniqueness: tuple[str, ...]  # with friction, what speaks against this being the only answer
    contraction: float | None  # from 1 on, Tresca's fixed point cycles without damping; None beyond 100 closed contacts
    tolerance: float
    error_tolerance: float
    passed: bool
    proven: bool
    basis: str  # "bounds", "state" or "figures"
    distance: float | None = None  # from the answer of its own combination, relative; None unless `basis` is "state"
    violations: Violations | None = field(
        repr=False, default=None
    )  # contact by contact; None where the answer is not finite

    def __str__(self) -> str:
        verdict = "passed" if self.passed else "REFUSED"
        lines = [f"{verdict}{', proven' if self.proven else ', not proven'}"]
        if self.basis == STATE and self.distance is not None:
            lines.append(f"  {self.distance:.3g} away from the answer of its own combination of open, stick and slip")
        lines += [f"  {failure}" for failure in self.failures]
        lines += [f"  no bound: {reason}" for reason in self.reasons]
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class LocalCertificate(ReadOnly):
    """What forces violate, the worst contact, and the published errors; `passed` if none is beyond `tolerance`."""

    natural_map: float  # `scaled_natural_map`, each contact scaled to a compliance of one
    siconos_error: float  # `published_errors.siconos_local_error`, W and q as given; no part of the verdict
    penetration: float  # (-u_N)+ as a velocity
    tension: float  # (-r_N)+ as a force
    complementarity: float  # min(u_N, r_N), each in its own measure
    cone: float  # (|r_T| - mu r_N)+ as a force
    slip_direction: float  # min(|u_T|, |r_T + mu r_N u_T/|u_T||), each in its own measure
    joints: float  # |V'r + R l + s| / (|V|'|r| + |R||l| + |s|)
    failures: tuple[str, ...]
    uniqueness: tuple[
        str, ...
    ]  # with friction, what speaks against these being the only forces; no part of the verdict
    notes: tuple[str, ...]
    tolerance: float
    passed: bool
    slip_measure: Vector = field(repr=False)  # (m,) |u_T| as a velocity
    force_measure: Vector = field(repr=False)  # (m,) r_N as a force

    @property
    def basis(self) -> str:
        """What the verdict rests on: the figures alone."""
        return "figures"

    def __str__(self) -> str:
        lines = ["passed" if self.passed else "REFUSED", f"  natural map {self.natural_map:.3g}"]
        return "\n".join(
            [*lines, *(f"  {text}" for text in self.failures), *(f"  note: {text}" for text in self.notes)]
        )
