"""Define many load cases of one problem (rows of arrays), their answers, and tables of contacts of cases and
histories.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, TypeVar, overload

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, counted, counts
from contactqp.linalg.condensation import condense
from contactqp.model.arguments import checks
from contactqp.model.arrays import Array, Indices, Mask, Vector, computes
from contactqp.model.coulomb import STATUS_WORDS
from contactqp.model.names import Units, read_names
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, is_masked, is_whole, read_array, read_matrix, read_only
from contactqp.model.solution import Answer, Candidate, Solution, Work
from contactqp.model.summary import Printed, RowsOf, Table, csv_text, number, without_rounding
from contactqp.solving.solve import begin, solve

# The most rows printed.
PRINTED_ROWS = 40


@dataclass(frozen=True)
class ContactRow:
    """One contact at one instant; forces and gaps of rounding size are 0."""

    instant: int  # its index in the history, 0 at the start
    time: float
    contact: str
    status: str  # "open", "closed", "grazing", "stick" or "slip"
    normal_force: float  # positive in compression
    friction_force: tuple[float, ...]  # (d-1,) l_T, what the body does to the obstacle; () without friction
    gap: float  # positive when open

    @property
    def cells(self) -> tuple[Any, ...]:
        """Return the row's entries in the order of `ContactTable.columns`."""
        return (
            self.instant, self.time, self.contact, self.status, self.normal_force, *self.friction_force, self.gap
        )  # fmt: skip


@dataclass(frozen=True)
class CaseRow:
    """One contact in one load case of `Solutions`; numbers are NaN if the case has no answer."""

    case: int | str  # its number, or its name
    contact: str
    status: str  # "open", "closed", "grazing", "stick", "slip" or, without an answer, "unknown"
    normal_force: float  # positive in compression
    friction_force: tuple[float, ...]  # (d-1,) l_T, what the body does to the obstacle; () without friction
    gap: float  # positive when open
    passed: bool  # the verdict on the case

    @property
    def cells(self) -> tuple[Any, ...]:
        """Return the row's entries in the order of `ContactTable.columns`."""
        return self.case, self.contact, self.status, self.normal_force, *self.friction_force, self.gap, self.passed


Row = TypeVar("Row", ContactRow, CaseRow)


@dataclass(frozen=True)
class ContactTable(Printed, RowsOf[Row], Generic[Row]):
    """The table of `History.table` or `Solutions.table`: one row for each contact at each instant or in each load case.

    `str` prints it.
    """

    columns: tuple[str, ...]  # with units, if the problem has them: "time [s]", "normal_force [N]"
    rows: tuple[Row, ...]

    def __repr__(self) -> str:
        return f"ContactTable({len(self)} rows: {', '.join(self.columns)})"

    def __str__(self) -> str:
        shown = self.rows[:PRINTED_ROWS]
        cells = tuple(
            tuple(number(cell) if isinstance(cell, float) else str(cell) for cell in row.cells) for row in shown
        )
        few = f", the first {len(shown)} shown; to_csv() has all" if len(shown) < len(self) else ""
        title = f"{len(self)} row{'' if len(self) == 1 else 's'}{few}"
        first = "#" if self.columns[0] == "instant" else self.columns[0]
        headings = (first, *(name.replace("_force", "") for name in self.columns[1:]))
        return Table(title, headings, cells).text()

    def to_dicts(self) -> list[dict[str, Any]]:
        """Return rows as plain data with one key for each column."""
        return [dict(zip(self.columns, row.cells, strict=True)) for row in self.rows]

    def to_csv(self) -> str:
        """Return comma-separated values with a header, with all digits."""
        return csv_text(self.columns, (row.cells for row in self.rows))

    def write_csv(self, file: str | Path) -> None:
        """Write `to_csv` to a file.

        Raises
        ------
        InvalidProblem
            The file cannot be written.
        """
        try:
            Path(file).write_text(self.to_csv(), encoding="utf-8", newline="\n")
        except (OSError, ValueError) as error:
            raise InvalidProblem(
                f"{file}: expected a file that can be written, got: {getattr(error, 'strerror', None) or error}"
            ) from None


def contact_table(history: Sequence[Solution], times: Sequence[float], time_label: str) -> ContactTable[ContactRow]:
    """Return the table of a history, whose solutions are certified by this.

    Parameters
    ----------
    history : sequence of Solution
    times : sequence of float
    time_label : str
        The heading of the column of times, with their unit.
    """
    friction = history[0].friction_force if len(history) else None
    measured = columns_of(history[0].problem.units if len(history) else Units(), friction)
    rows = (row for k, solution in enumerate(history) for row in _rows(k, float(times[k]), solution))
    return ContactTable(("instant", time_label, "contact", "status", *measured), tuple(rows))


def columns_of(units: Units, friction: Array | None) -> list[str]:
    """Return the headings of forces and gap with units; `friction` (..., d-1) is the friction force or None."""
    components = 0 if friction is None else friction.shape[-1]
    names = ["friction_force"] if components == 1 else [f"friction_force_{k + 1}" for k in range(components)]
    force, length = (f" [{unit}]" if unit else "" for unit in (units.force, units.length))
    return [*(f"{name}{force}" for name in ("normal_force", *names)), f"gap{length}"]


def _rows(instant: int, time: float, solution: Solution) -> Iterator[ContactRow]:
    clean, problem = without_rounding(solution), solution.problem
    normal, gap = clean.normal_force.tolist(), clean.gap.tolist()
    friction = [[]] * len(normal) if clean.friction_force is None else clean.friction_force.tolist()
    for i, status in enumerate(solution.contact_status):
        name = problem.contact_name(i)
        yield ContactRow(instant, time, name, str(status), normal[i], tuple(friction[i]), gap[i])


# The words of `Solution.contact_status` in the order of their codes, and that of a failed case.
STATUS = (*STATUS_WORDS, "unknown")
# The most contacts of an envelope, and failed cases, printed.
PRINTED = 20
# Numbers checked for NaN at once.
BLOCK = 2**21
# Load cases whose loads are multiplied at once.
ROWS = 32


class LoadCases:
    """Loads, gaps and coefficients of friction of many cases, one row each; by default those of the problem.

    Loads and gaps in arrays or CSR arrays of doubles are not copied, as they may be very large. A checksum of each row
    detects later changes.

    Raises InvalidProblem: no rows are given, their numbers differ, or they have a wrong shape or entry.

    Parameters
    ----------
    problem : ContactProblem
    loads : (N, n) array [force] or None
    gaps : (N, m) array [length] or None, inf where a case has no such contact
    friction : number, (N, 1) or (N, m) array, or None, coefficients of friction; a number stands for all cases
    """

    def __init__(self, problem: ContactProblem, loads: Any, gaps: Any, friction: Any) -> None:
        self.problem = problem
        given: dict[str, Any] = {}
        if loads is not None:
            given["loads"] = _read_rows("loads", loads, problem.dimension, problem.dof_name)
        if gaps is not None:
            given["gaps"] = _read_rows("gaps", gaps, problem.contacts, problem.contact_name, np.inf)
        if friction is not None:
            found = _read_friction(problem, friction)
            given |= {} if found.ndim == 0 else {"friction": found}
            self.problem = problem.replace(friction=found) if found.ndim == 0 else problem
        if not given:
            raise InvalidProblem("solve_many: expected loads, gaps or friction with one row for each case, got none")
        counted_rows = {name: rows.shape[0] for name, rows in given.items()}
        if len(set(counted_rows.values())) > 1:
            found_rows = ", ".join(f"{counted('row', count)} of {name}" for name, count in counted_rows.items())
            raise InvalidProblem(f"solve_many: expected as many rows of each, one for a case, got {found_rows}")
        self.count: int = next(iter(counted_rows.values()))
        self.loads, self.gaps = given.get("loads"), given.get("gaps")
        self.friction: Array | None = given.get("friction")
        self._digests = {name: _digests(rows) for name, rows in given.items()}

    def load(self, i: int) -> Vector:
        """Return the load of a case (n,)."""
        if self.loads is None:
            return self.problem.load
        return np.asarray(self.loads[[i]].toarray()[0] if sp.issparse(self.loads) else self.loads[i], dtype=float)

    def loaded(self) -> Indices:
        """Return the unknowns loaded in any case."""
        if self.loads is None:
            return np.flatnonzero(self.problem.load)
        if sp.issparse(self.loads):
            return np.unique(self.loads.indices).astype(np.intp)
        found = np.zeros(self.problem.dimension, dtype=bool)
        for start in range(0, self.count, ROWS):
            found |= (self.loads[start : start + ROWS] != 0).any(axis=0)
        return np.flatnonzero(found)

    def blocks(self, loaded: Indices) -> Iterator[tuple[range, Any]]:
        """Yield the numbers of some cases and their loads at these unknowns, one row if all are equal."""
        if self.loads is None:
            yield range(self.count), self.problem.load[None, loaded]
            return
        every = len(loaded) == self.problem.dimension
        for start in range(0, self.count, ROWS):
            cases = range(start, min(start + ROWS, self.count))
            rows = self.loads[start : start + ROWS]
            if sp.issparse(rows):
                yield cases, rows[:, loaded].toarray()
            else:
                yield cases, rows if every else rows[:, loaded]

    def gap(self, i: int) -> Vector:
        """Return the gaps of a case (m,)."""
        return self.problem.gap if self.gaps is None else np.asarray(self.gaps[i], dtype=float)

    def coefficients(self, i: int) -> Vector:
        """Return the coefficients of friction of a case (m,), zero without friction."""
        if self.friction is not None:
            return np.asarray(self.friction[i])
        friction = self.problem.friction
        return np.zeros(self.problem.contacts) if friction is None else friction

    def case(self, i: int) -> ContactProblem:
        """Return the problem of a case, which shares the factorisation.

        Raises
        ------
        InvalidProblem
            The arrays of the cases were changed after `solve_many` read them.
        """
        for name, digests in self._digests.items():
            if _digests(getattr(self, name)[[i]])[0] != digests[i]:
                raise InvalidProblem(f"{name}[{i}]: expected what solve_many was given, got other numbers since")
        changes: dict[str, Any] = {} if self.loads is None else {"load": self.load(i)}
        changes |= {} if self.gaps is None else {"gap": self.gap(i)}
        changes |= {} if self.friction is None else {"friction": self.friction[i]}
        return self.problem.replace(**changes)


def _read_rows(name: str, value: Any, width: int, name_of: Any, allowed: float = np.nan) -> Any:
    """Return rows of finite numbers, without copying doubles; `allowed` need not be finite.

    Raises
    ------
    InvalidProblem
        Another shape, no real numbers, or a number that is not finite; the message has its row and column.
    """
    if sp.issparse(value):
        kept = isinstance(value, sp.csr_array) and value.dtype == float and value.has_canonical_format
        kept = kept and bool(np.all(np.isfinite(value.data)))
    else:
        kept = isinstance(value, np.ndarray) and value.dtype == float and not is_masked(value)
    rows = value if kept else read_matrix(name, value) if sp.issparse(value) else read_array(name, value)
    if rows.ndim != 2 or rows.shape[1] != width:
        raise InvalidProblem(f"{name}: expected shape (N, {width}), a row for each case, got {rows.shape}")
    if not sp.issparse(rows):
        step = max(1, BLOCK // max(width, 1))
        for start in range(0, len(rows), step):
            block = rows[start : start + step]
            wrong = ~np.isfinite(block) & (block != allowed)
            if wrong.any():
                i, j = (int(at) for at in np.argwhere(wrong)[0])
                raise InvalidProblem(f"{name}[{start + i}]: expected finite numbers, got {block[i, j]} at {name_of(j)}")
    return rows


def _read_friction(problem: ContactProblem, friction: Any) -> Array:
    """Return one coefficient, or one row for each case (N, m)."""
    found, m = read_array("friction", friction), problem.contacts
    if found.ndim == 0:
        return found
    if found.ndim != 2 or found.shape[1] not in (1, m):
        raise InvalidProblem(
            f"friction: expected a number, shape (N, 1), a coefficient for each case, or (N, {m}), got {found.shape}"
        )
    if problem.tangent is None and np.any(found != 0):
        raise InvalidProblem("friction: a coefficient was given without tangent, the directions of slip")
    wrong = ~np.isfinite(found) | (found < 0)
    if wrong.any():
        i, j = (int(at) for at in np.argwhere(wrong)[0])
        raise InvalidProblem(f"friction[{i}]: expected coefficients that are not negative, got {found[i, j]}")
    return read_only(np.broadcast_to(found, (len(found), m)).copy())


def _digests(rows: Any) -> NDArray[np.uint64]:
    """Return a checksum for each row."""
    if sp.issparse(rows):
        parts = (rows[[i]] for i in range(rows.shape[0]))
        return np.array([_digest(part.data) ^ np.uint64(part.indices.sum()) for part in parts], dtype=np.uint64)
    return np.array([_digest(row) for row in rows], dtype=np.uint64)


def _digest(row: Vector) -> np.uint64:
    bits = np.ascontiguousarray(row, dtype=float).view(np.uint64)
    with np.errstate(over="ignore"):  # integer overflow is intended
        return np.uint64(np.dot(bits, 2 * np.arange(len(bits), dtype=np.uint64) + np.uint64(1)))


@dataclass(frozen=True, eq=False)
class Envelope(ReadOnly, Printed):
    """The largest force of each contact over all cases with an answer, and its case."""

    normal_force: Vector  # (m,), NaN if no case has an answer
    load: Indices  # (m,) the number of the case, -1 if none has an answer
    names: tuple[str, ...] = field(repr=False)

    def __str__(self) -> str:
        if len(self.load) and np.all(self.load < 0):
            return f"{counted('contact', len(self.names))}: no case has an answer"
        worst = np.argsort(-self.normal_force, kind="stable")[:PRINTED]
        rows = tuple((self.names[i], number(self.normal_force[i]), str(self.load[i])) for i in worst)
        few = f", the {len(rows)} that press most" if len(rows) < len(self.names) else ""
        return Table(f"{counted('contact', len(self.names))}{few}", ("contact", "normal", "load"), rows).text()


@checks
@computes
@dataclass(frozen=True, eq=False)
class Solutions(ReadOnly, Printed):
    """The answers of many load cases of one problem; `solutions[i]` computes the `Solution` of one.

    Forces, gaps and states are stored, one row for each case; displacements are computed on request to save memory. A
    case without certified answer has NaN in its rows, `passed` is False, `failures` has the reason, and `solutions[i]`
    raises the error of `solve`.
    """

    problem: ContactProblem = field(repr=False)
    normal_force: Array  # (N, m)
    friction_force: Array | None  # (N, m, d-1), None without tangential rows
    tie_force: Array  # (N, k)
    gap: Array  # (N, m), positive when open
    force_bound: Array  # (N, m) proven errors of the normal forces, NaN if unknown
    passed: Mask  # (N,) the verdict of each
    proven: Mask  # (N,) whether the errors of each are bounded
    failures: tuple[str, ...]  # (N,) why a case has not passed, "" if it has
    method: str
    seconds: float
    work: Work
    _status: NDArray[np.uint8] = field(repr=False)  # (N, m)
    _cases: LoadCases = field(repr=False)
    _arguments: dict[str, Any] = field(repr=False)  # options of `solve`
    _started: Mask = field(repr=False)  # (N,) whether a solution starts from the forces stored here

    def __len__(self) -> int:
        return self._cases.count

    @property
    def contact_status(self) -> NDArray[np.str_]:
        """Return (N, m) of "open", "closed", "grazing", "stick" and "slip"; "unknown" if a case has no answer."""
        return np.array(STATUS)[self._status]

    @overload
    def __getitem__(self, place: int) -> Solution: ...

    @overload
    def __getitem__(self, place: slice) -> list[Solution]: ...

    def __getitem__(self, place: int | slice) -> Solution | list[Solution]:
        """Return the solution of a case, computed again with the shared factorisation, with its full certificate."""
        if isinstance(place, slice):
            return [self[i] for i in range(len(self))[place]]
        if is_whole(place) and not self._has(place):
            raise IndexError(f"case {place} of {len(self)}")  # ends a loop over a sequence
        return self._solved(place)

    def _solved(self, place: int) -> Solution:
        """Return the solution of a case, with friction the one near the stored forces."""
        problem = self.case(place)
        if self.friction_force is None or not (problem.frictional and self._started[place]):
            found: Solution = solve(problem, self.method, **self._arguments)
            return found
        forces = self.normal_force[place], self.tie_force[place], self.friction_force[place]
        rows = problem.normal, problem.tie, problem.tangent
        outer = sum((row.T @ force.ravel() for row, force in zip(rows, forces, strict=True) if row is not None), 0.0)
        u = condense(problem).free_displacements((problem.load - outer)[:, None])[:, 0]
        u = self._held(problem, u, place)
        start = Candidate(Answer(u, forces[0], forces[2], forces[1]))
        return begin(problem, self.method, start, **self._arguments).finish()

    def _held(self, problem: ContactProblem, u: Vector, place: int) -> Vector:
        """Return a displacement moved rigidly such that stored closed or sticking contacts and ties are satisfied."""
        motions = condense(problem).rigid.motions
        if not motions.shape[1]:
            return u
        sticks, closed = self._status[place] == STATUS.index("stick"), self.normal_force[place] > 0
        rows, missed = [problem.normal[closed], problem.tie], [problem.gap[closed], problem.tie_value]
        if problem.tangent is not None and problem.slip_origin is not None:
            rows.append(problem.tangent[np.repeat(sticks, problem.slip_origin.shape[1])])
            missed.append(problem.slip_origin[sticks].ravel())
        held = sp.csr_array(sp.vstack(rows))
        moved = np.linalg.lstsq(held @ motions, np.concatenate(missed) - held @ u, rcond=None)[0]
        return np.asarray(u + motions @ moved)

    def __iter__(self) -> Iterator[Solution]:
        return (self[i] for i in range(len(self)))

    def case(self, i: int) -> ContactProblem:
        """Return the problem of a case; negative numbers count from the end.

        Raises
        ------
        InvalidProblem
            There is no such case, or its load was changed after `solve_many` read it.
        """
        if not self._has(i):
            raise InvalidProblem(f"i: expected the number of one of {counted('case', len(self))}, got {i}")
        return self._cases.case(int(i) % len(self))

    def displacement(self, i: int) -> Vector:
        """Return the displacement (n,) of a case, as accurate as that of its `Solution`."""
        return self._solved(i).displacement

    def envelope(self) -> Envelope:
        """Return the largest normal force of each contact over all cases (m,) [force], and that case."""
        m = self.problem.contacts
        names = tuple(self.problem.contact_name(i) for i in range(m))
        answered = np.flatnonzero(np.isfinite(self.normal_force).all(axis=1))
        if not answered.size:
            return Envelope(np.full(m, np.nan), np.full(m, -1), names)
        load = answered[np.argmax(self.normal_force[answered], axis=0)] if m else np.zeros(0, dtype=np.intp)
        return Envelope(self.normal_force[load, np.arange(m)], load, names)

    def table(self, names: Sequence[str] | None = None) -> ContactTable[CaseRow]:
        """Return status, normal force, friction, gap and verdict of every contact in every case, one row each.

        `names` (N,) are the names of the cases, by default their numbers.
        """
        called: Sequence[int | str] = range(len(self))
        if names is not None:
            called = read_names("names", names, len(self)) or ()
        measured = columns_of(self.problem.units, self.friction_force)
        return ContactTable(("case", "contact", "status", *measured, "passed"), tuple(self._rows(called)))

    def _rows(self, called: Sequence[int | str]) -> Iterator[CaseRow]:
        contacts = [self.problem.contact_name(j) for j in range(self.problem.contacts)]
        for i, case in enumerate(called):
            status, passed = [STATUS[k] for k in self._status[i].tolist()], bool(self.passed[i])
            force, gap = self.normal_force[i].tolist(), self.gap[i].tolist()
            friction = [[]] * len(contacts) if self.friction_force is None else self.friction_force[i].tolist()
            for j, contact in enumerate(contacts):
                yield CaseRow(case, contact, status[j], force[j], tuple(friction[j]), gap[j], passed)

    def write_csv(self, file: str | Path, names: Sequence[str] | None = None) -> None:
        """Write `table` to a file of comma-separated values; raise InvalidProblem if this fails."""
        self.table(names).write_csv(file)

    def plot(self, file: str | Path | None = None, **options: Any) -> Any:
        """Draw forces and gaps over the cases, into a file if one is given, and return the figure.

        As `contactqp.draw(self, file, ...)`.
        """
        return import_module("contactqp.study.answer_pictures").draw(self, file, **options)

    def _has(self, i: int) -> bool:
        return -len(self) <= i < len(self)

    def __repr__(self) -> str:
        return f"Solutions({self.method}, {self._verdict()})"

    def _verdict(self) -> str:
        sizes = f"{counted('case', len(self))}, {counts(contact=self.problem.contacts)}"
        proven = "" if self.proven.all() else f", {int(self.proven.sum())} proven"
        return f"{sizes}, {int(self.passed.sum())} passed{proven}"

    def __str__(self) -> str:
        failed = np.flatnonzero(~self.passed)
        lines = [f"{self.method}: {self._verdict()}; {self.seconds:.3g} s"]
        lines += [f"  case {i}: {self.failures[i]}" for i in failed[:PRINTED]]
        lines += [f"  and {len(failed) - PRINTED} more"] if len(failed) > PRINTED else []
        return "\n".join([*lines, *([str(self.envelope())] if self.problem.contacts else [])])
