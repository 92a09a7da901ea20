"""What a method hands over (`Candidate`) and what a user gets (`Solution`)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Vector
from contactqp.model.floating_point import computes
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.verdicts import Certificate


@dataclass(frozen=True, eq=False)
class Candidate:
    """One method's answer to one ContactProblem, in that problem's own unknowns, believed by nobody yet."""

    displacement: Vector  # (n,)
    normal_force: Vector  # (m,) l_N, positive in compression
    tie_force: Vector  # (k,) nu
    iterations: int | None = 0  # None: the backend does not say
    claimed: bool = True  # does the method itself call this solved?
    status: str = ""  # the backend's own words
    history: tuple[float, ...] = ()  # the method's own measure of progress, one number an iteration
    friction_force: NDArray[np.float64] | None = None  # (m, d-1) l_T, of a method that enforces friction itself
    contact_status: NDArray[np.str_] | None = None  # (m,) of open, stick, slip, likewise

    @property
    def finite(self) -> bool:
        """Whether every number of it is one."""
        parts = (self.displacement, self.normal_force, self.tie_force, self.friction_force)
        return all(part is None or bool(np.all(np.isfinite(part))) for part in parts)


@dataclass(frozen=True)
class Work:
    """What a solution cost."""

    factorisations: int = 0  # of the stiffness
    back_substitutions: int = 0  # right-hand sides solved with them
    iterations: int | None = 0  # of the method; None where it does not say
    retained: int = 0  # unknowns of the problem that the method saw
    polish_corrections: int = 0  # changes of the method's contact set while polishing
    solver: str = ""  # "dense", "superlu", "pardiso", or "pyamg" where nothing is factorised
    krylov_iterations: int = 0  # of conjugate gradients, the certificate's included
    routes: tuple[str, ...] = ()  # where the first answer was refused: what was tried, one after another, and what came

    def after(self, earlier: Work) -> Work:
        """This work and what was spent on it before."""
        counts = ("factorisations", "back_substitutions", "polish_corrections", "krylov_iterations")
        sums: dict[str, Any] = {name: getattr(self, name) + getattr(earlier, name) for name in counts}
        known = self.iterations is not None and earlier.iterations is not None
        return replace(self, iterations=(self.iterations or 0) + (earlier.iterations or 0) if known else None, **sums)


@dataclass(frozen=True, eq=False)
class Raw(ReadOnly):
    """A method's answer before polish, and what the certificate says of it."""

    displacement: Vector
    normal_force: Vector
    tie_force: Vector
    claimed: bool
    status: str
    certificate: Certificate


@dataclass(frozen=True, eq=False)
class FreeMotion(ReadOnly):
    """A rigid motion that no load drives and no contact or tie resists."""

    direction: Vector  # (n,), largest component 1
    description: str

    def __str__(self) -> str:
        return self.description


@dataclass(frozen=True, eq=False)
class Final:
    """The answer that is certified: a candidate, polished or as it came, its free motions at rest."""

    displacement: Vector
    normal_force: Vector
    tie_force: Vector
    free_motions: tuple[FreeMotion, ...] = ()
    corrections: int = 0  # of the contact set
    polished: bool = False
    friction_force: NDArray[np.float64] | None = None  # (m, d-1); None: nothing rubs
    contact_status: NDArray[np.str_] | None = None  # of an approximate method; None: as the certificate measures it


@computes
@dataclass(frozen=True, eq=False)
class Solution(ReadOnly):
    """Displacement and forces of one ContactProblem, with the certificate that judged them.

    Forces are positive in compression (`normal_force` is l_N of K u + E_N' l_N + E_T' l_T + A' nu = f); gaps are
    positive when open.
    """

    problem: ContactProblem = field(repr=False)
    displacement: Vector  # (n,)
    normal_force: Vector  # (m,)
    friction_force: NDArray[np.float64] | None  # (m, d-1)
    tie_force: Vector  # (k,)
    contact_status: NDArray[np.str_]  # (m,) of open, closed, grazing, stick, slip
    free_motions: tuple[FreeMotion, ...]
    certificate: Certificate
    method: str
    seconds: float  # to the certified answer, without the certificate of the raw one
    certify_seconds: float  # of these, for the certificate
    work: Work
    raw: Raw | None = field(default=None, repr=False)  # before polish, where the answer was polished
    history: tuple[float, ...] = field(default=(), repr=False)  # of an iterative method, one number an iteration

    @property
    def gap(self) -> Vector:
        """g - E_N u, positive when open [length]."""
        return read_only(np.asarray(self.problem.gap - self.problem.normal @ self.displacement))

    @property
    def slip(self) -> NDArray[np.float64] | None:
        """E_T u - slip_origin, (m, d-1) [length], or None without tangential rows."""
        problem = self.problem
        if problem.tangent is None or problem.slip_origin is None:
            return None
        slipped = (problem.tangent @ self.displacement).reshape(problem.slip_origin.shape)
        return read_only(np.asarray(slipped - problem.slip_origin))

    @property
    def energy(self) -> float:
        """1/2 u'Ku - f'u."""
        return self.problem.energy(self.displacement)
