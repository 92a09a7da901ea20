"""Convert quadratic programs in the form and signs of qpsolvers to contact problems and back.

    minimise    1/2 x'P x + q'x
    subject to  G x <= h,   l <= C x <= u,   A x = b,   lb <= x <= ub

is the contact problem with K = P, f = -q. Its contacts are, in this order, the rows of G, the finite sides of the
ranges (upper before lower, range by range), the finite lower bounds and the finite upper bounds; its ties are the rows
of A, the ranges with l = u and the bounds with lb = ub. A lower side is the contact -C_i x <= -l_i. The multipliers are
the forces: z = l_N of the rows of G, y = nu of those of A, and z_box of qpsolvers is l_N of an upper bound less that of
the lower one. Contacts and ties are named by kind and number, or by the name of their range or unknown: "row 3", "range
4 upper", "lower 7", "tie 0", "range 5", "fixed 2"; "range limit upper", "lower x7".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.errors import ContactQPError, InvalidProblem
from contactqp.model.arrays import Vector, refuse_places_outside
from contactqp.model.names import read_names
from contactqp.model.problem_data import BUCKLED, read_array

Problem = TypeVar("Problem")
Rows = list[tuple[Any, Vector]]  # rows and their limits, block by block
Names = tuple[list[str], list[str]]  # of contacts and of ties
# The first words of the names of contacts and ties made of bounds, before the unknown.
LOWER, UPPER, FIXED = "lower", "upper", "fixed"


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """A quadratic program with the arguments of `qpsolvers.Problem`; missing ones are None.

    Attributes
    ----------
    P : (n, n) array or sparse matrix
    q : (n,) array
    G, h : (m, n) matrix and (m,) array, or None
    A, b : (k, n) matrix and (k,) array, or None
    lb, ub : (n,) arrays, or None, infinite where an unknown has no bound
    """

    P: Any
    q: Vector
    G: Any = None
    h: Vector | None = None
    A: Any = None
    b: Vector | None = None
    lb: Vector | None = None
    ub: Vector | None = None


def given_program(P: Any, q: Any, *others: Any) -> QuadraticProgram:
    """Return the program given by the arguments of `ContactProblem.from_qp`, or by a `qpsolvers.Problem` as P.

    Raises InvalidProblem: there is no q.
    """
    if q is not None:
        return QuadraticProgram(P, q, *others)
    names = [part.name for part in fields(QuadraticProgram)]
    if not all(hasattr(P, name) for name in names):
        raise InvalidProblem("from_qp: q: expected an array, got None")
    return QuadraticProgram(*(getattr(P, name) for name in names))


def contact_data(
    given: QuadraticProgram,
    C: Any = None,
    l: ArrayLike | None = None,  # noqa: E741
    u: ArrayLike | None = None,
    dof_names: Sequence[str] | None = None,
    range_names: Sequence[str] | None = None,
    **unknown: Any,
) -> dict[str, Any]:
    """Return the arguments of `ContactProblem` for a program with ranges; see `ContactProblem.from_qp`.

    Raises InvalidProblem: an unknown argument, a matrix without its right-hand side or vice versa, wrong shapes, a
    lower side above the upper one, or a wrong number of names.

    Parameters
    ----------
    given : P, q, G, h, A, b, lb, ub
    C : (r, n) matrix, optional
        Rows of ranges l <= C x <= u.
    l, u : (r,) arrays, optional
        Their sides; without one it is infinite.
    dof_names, range_names : sequences of str, optional
        Names of the unknowns (n,) and of the ranges (r,).
    **unknown
        Refused.
    """
    if unknown:
        raise InvalidProblem(
            f"from_qp: unknown {sorted(unknown)}; ranges are given as C, l, u, names as dof_names, range_names"
        )
    load = -_finite("q", read_array("q", given.q).ravel())
    n = len(load)
    _refuse_other_than_square(given.P, n)
    contacts, ties = [_given("G", given.G, "h", given.h, n)], [_given("A", given.A, "b", given.b, n)]
    names = [f"row {i}" for i in range(contacts[0][0].shape[0])], [f"tie {i}" for i in range(ties[0][0].shape[0])]
    ranges = _given("C", C, "u" if l is None else "l", u if l is None else l, n)[0]
    sides, of_ranges = _sides("l", l, "u", u, ranges.shape[0]), read_names("range_names", range_names, ranges.shape[0])
    _add_ranges(ranges, *sides, of_ranges or range(ranges.shape[0]), contacts, ties, names)
    unknowns = read_names("dof_names", dof_names, n)
    _add_bounds(*_sides("lb", given.lb, "ub", given.ub, n), unknowns or range(n), contacts, ties, names)
    normal, gap = (sp.vstack([rows for rows, _ in contacts]), np.concatenate([limit for _, limit in contacts]))
    tie, value = (sp.vstack([rows for rows, _ in ties]), np.concatenate([limit for _, limit in ties]))
    named = dict(dof_names=unknowns, contact_names=names[0], tie_names=names[1])
    return dict(stiffness=given.P, load=load, normal=normal, gap=gap, tie=tie, tie_value=value) | named


def _finite(name: str, values: Any) -> Any:
    """Return an array or sparse matrix, by the name that it has in a program, if its entries are finite numbers."""
    entries = values.tocoo() if sp.issparse(values) else values
    wrong = np.flatnonzero(~np.isfinite(entries.data if sp.issparse(values) else entries))
    if len(wrong):
        place = [entries.row[wrong[0]], entries.col[wrong[0]]] if sp.issparse(values) else [wrong[0]]
        value = (entries.data if sp.issparse(values) else entries)[wrong[0]]
        raise InvalidProblem(f"{name}: expected finite numbers, got {value} at {[int(i) for i in place]}")
    return values


def _given(matrix: str, rows: Any, vector: str, limit: ArrayLike | None, n: int) -> tuple[Any, Vector]:
    """Return rows and their limits, without any row where neither was given."""
    if rows is None and limit is None:
        return sp.csr_matrix((0, n)), np.zeros(0)
    if rows is None or limit is None:
        missing, there = (matrix, vector) if rows is None else (vector, matrix)
        raise InvalidProblem(f"{missing}: expected beside {there}, got None")
    read, values = _matrix(matrix, rows), read_array(vector, limit).ravel()
    _finite(matrix, read)
    if np.isnan(values).any():
        raise InvalidProblem(f"{vector}: expected numbers, got nan at [{int(np.argmax(np.isnan(values)))}]")
    if read.shape[1] != n:
        raise InvalidProblem(f"{matrix}: expected {n} columns, one for each entry of q, got {read.shape[1]}")
    if len(values) != read.shape[0]:
        raise InvalidProblem(
            f"{vector}: expected {read.shape[0]} entries, one for each row of {matrix}, got {len(values)}"
        )
    if vector == "b":
        _finite("b", values)
    if vector == "h" and (values == -np.inf).any():
        raise InvalidProblem(f"h: expected a number or inf, got -inf at [{int(np.argmax(values == -np.inf))}]")
    return read, values


def of_program(make: Callable[..., Problem], given: QuadraticProgram, **ranges: Any) -> Problem:
    """Return what `make` makes of the contact data of a program, by the keywords of `contact_data`.

    Raises InvalidProblem; where the matrix is refused, by the name of P instead of that of a stiffness K.
    """
    try:
        problem: Any = make(**contact_data(given, **ranges))
    except InvalidProblem as refused:
        refused.args = (_of_program(str(refused)),)
        raise
    if (computed := getattr(problem, "_computed", None)) is not None:
        computed.of_stiffness.of_program = True
    return problem  # type: ignore[no-any-return]


@contextmanager
def in_own_words() -> Iterator[None]:
    """Let errors about a program name its P, as its user does, where those of a contact problem name a stiffness K."""
    try:
        yield
    except ContactQPError as error:
        if error.args and isinstance(error.args[0], str):
            error.args = (_of_program(error.args[0]), *error.args[1:])
        raise


# What errors say of contact problems, and how they say it of programs.
_WORDS = (
    ("the load drives a rigid motion that no contact or tie holds back", "q falls along what no row or bound limits"),
    ("; hold it by a support, a tie or a contact, or check the sign of the load", "; bound it, or check the sign of q"),
    ("a regular stiffness", "a regular P"),
    ("the stiffness", "P"),
    (BUCKLED, ""),
)


def _of_program(text: str) -> str:
    if text.startswith("stiffness: "):
        text = text.replace("stiffness: ", "P: ", 1).replace("K[", "P[").replace("z'Kz", "z'Pz")
    for of_contact, of_program in _WORDS:
        text = text.replace(of_contact, of_program)
    return text


def _refuse_other_than_square(P: Any, n: int) -> None:
    """Raise InvalidProblem, by the names of a program, unless P is a matrix of finite numbers for n entries of q."""
    read = _finite("P", _matrix("P", P))
    if read.shape[0] != read.shape[1] or (np.ndim(P) < 2 and not sp.issparse(P)):
        raise InvalidProblem(f"P: expected a square matrix, got shape {P.shape if sp.issparse(P) else np.shape(P)}")
    if read.shape[0] != n:
        raise InvalidProblem(f"q: expected {read.shape[0]} entries, one for each row of P, got {n}")


def _matrix(name: str, rows: Any) -> Any:
    """Return rows of real numbers of any kind as a CSR matrix; one row may come as a vector."""
    if sp.issparse(rows):
        refuse_places_outside(name, rows)
        found = sp.csr_matrix(rows) if rows.ndim == 2 else sp.csr_matrix(rows.toarray()[None, :])
        return sp.csr_matrix((read_array(name, found.data), found.indices, found.indptr), shape=found.shape)
    dense = np.atleast_2d(read_array(name, rows))
    if dense.ndim > 2:
        raise InvalidProblem(f"{name}: expected a matrix, got an array of shape {dense.shape}")
    return sp.csr_matrix(dense)


def _sides(lower: str, least: Any, upper: str, most: Any, count: int) -> tuple[Vector, Vector]:
    """Return lower and upper sides (count,), infinite where none was given."""
    sides = []
    for name, values, none in ((lower, least, -np.inf), (upper, most, np.inf)):
        read = np.full(count, none) if values is None else read_array(name, values).ravel()
        if len(read) != count:
            raise InvalidProblem(f"{name}: expected {count} entries, got {len(read)}")
        if np.any(np.isnan(read)) or np.any(read == -none):
            i = int(np.argmax(np.isnan(read) | (read == -none)))
            raise InvalidProblem(f"{name}: expected a number or {none}, got {read[i]} at {i}")
        sides.append(read)
    if np.any(sides[0] > sides[1]):
        i = int(np.argmax(sides[0] > sides[1]))
        raise InvalidProblem(f"{lower}: expected at most {upper}, got {sides[0][i]:g} above {sides[1][i]:g} at {i}")
    return sides[0], sides[1]


def _add_ranges(
    rows: Any, least: Vector, most: Vector, called: Sequence[str | int], contacts: Rows, ties: Rows, names: Names
) -> None:
    """Add ranges l <= C x <= u: ties where the sides are equal, contacts of their finite sides elsewhere.

    Parameters
    ----------
    rows : (p, n) sparse matrix
    least, most : (p,) arrays
    called : names or numbers of the ranges
    contacts, ties, names
        What the rows and their names are added to.
    """
    fixed = least == most
    ties.append((rows[np.flatnonzero(fixed)], most[fixed]))
    names[1].extend(f"range {called[i]}" for i in np.flatnonzero(fixed).tolist())
    number = np.repeat(np.arange(len(least)), 2)
    sign = np.tile([1.0, -1.0], len(least))
    limit = np.column_stack([most, -least]).ravel()
    taken = np.isfinite(limit) & ~np.repeat(fixed, 2)
    contacts.append((sp.diags(sign[taken]) @ rows[number[taken]], limit[taken]))
    words = {1.0: UPPER, -1.0: LOWER}
    names[0].extend(
        f"range {called[i]} {words[s]}" for i, s in zip(number[taken].tolist(), sign[taken].tolist(), strict=True)
    )


def _add_bounds(
    least: Vector, most: Vector, called: Sequence[str | int], contacts: Rows, ties: Rows, names: Names
) -> None:
    """Add bounds lb <= x <= ub: ties where they are equal, contacts elsewhere, the lower ones first.

    Parameters
    ----------
    least, most : (n,) arrays
    called : names or numbers of the unknowns
    contacts, ties, names
        What the rows and their names are added to.
    """
    unit = sp.identity(len(least), format="csr")
    fixed = least == most
    ties.append((unit[np.flatnonzero(fixed)], most[fixed]))
    names[1].extend(f"{FIXED} {called[j]}" for j in np.flatnonzero(fixed).tolist())
    for word, sign, values in ((LOWER, -1.0, least), (UPPER, 1.0, most)):
        taken = np.flatnonzero(np.isfinite(values) & ~fixed)
        contacts.append((sign * unit[taken], sign * values[taken]))
        names[0].extend(f"{word} {called[j]}" for j in taken.tolist())


def quadratic_program(problem: Any) -> QuadraticProgram:
    """Return the quadratic program of a frictionless problem; see `ContactProblem.to_qp`."""
    G, h = problem.normal, problem.gap
    bound = _bounds_of(problem)
    lb, ub = np.full(problem.dimension, -np.inf), np.full(problem.dimension, np.inf)
    for i, (side, j) in bound.items():
        (lb if side == LOWER else ub)[j] = -h[i] if side == LOWER else h[i]
    rows = np.setdiff1d(np.arange(problem.contacts), np.array(sorted(bound), dtype=int))
    return QuadraticProgram(
        problem.stiffness,
        -problem.load,
        G[rows] if len(rows) else None,
        h[rows] if len(rows) else None,
        problem.tie if problem.ties else None,
        problem.tie_value if problem.ties else None,
        lb if np.any(np.isfinite(lb)) else None,
        ub if np.any(np.isfinite(ub)) else None,
    )


def answer_of_program(
    problem: Any, x: Vector, y: Vector | None = None, z: Vector | None = None, z_box: Vector | None = None
) -> dict[str, Vector]:
    """Return displacement, normal_force and tie_force of an answer in the form and signs of qpsolvers.

    Raises InvalidProblem: a vector has another length.

    Parameters
    ----------
    problem : ContactProblem, as `from_qp` makes it
    x : (n,) array
    y : (k,) array, optional
        Multipliers of the ties; those of fixed bounds at the end may be left out where `z_box` holds them.
    z : (m,) array, optional
        Multipliers of the contacts that are not bounds, in their order.
    z_box : (n,) array, optional
        Multipliers of the bounds: positive for an upper bound, negative for a lower one. An entry where there is no
        such bound has no place in the answer, and the balance of forces then misses it.
    """
    bound = _bounds_of(problem)
    rows = np.setdiff1d(np.arange(problem.contacts), np.array(sorted(bound), dtype=int))
    fixed = _fixed_at_the_end(problem)
    counts = {"x": (x, [problem.dimension]), "y": (y, [problem.ties, problem.ties - len(fixed)])}
    counts |= {"z": (z, [len(rows)]), "z_box": (z_box, [problem.dimension])}
    for name, (values, lengths) in counts.items():
        if values is not None and len(values) not in lengths:
            raise InvalidProblem(f"{name}: expected {' or '.join(map(str, lengths))} values, got {len(values)}")
    answer = {"displacement": x}
    if z is not None or z_box is not None:
        force = answer["normal_force"] = np.zeros(problem.contacts)
        force[rows] = 0.0 if z is None else z
        for i, (side, j) in bound.items():
            pushed = 0.0 if z_box is None else float(z_box[j])
            force[i] = max(pushed if side == UPPER else -pushed, 0.0)
    if y is not None or fixed:
        of_bounds = np.zeros(problem.dimension) if z_box is None else z_box
        given = np.zeros(problem.ties - len(fixed)) if y is None else y
        answer["tie_force"] = given if len(given) == problem.ties else np.concatenate([given, of_bounds[fixed]])
    return answer


def without_place(problem: Any, z_box: Vector) -> list[int]:
    """Return the unknowns at which z_box has the force of a bound that the program does not have."""
    bounds, fixed = set(_bounds_of(problem).values()), _fixed_at_the_end(problem)
    sides = [UPPER if force > 0 else LOWER for force in z_box]
    pushed = np.flatnonzero(z_box).tolist()
    return [j for j in pushed if (sides[j], j) not in bounds and j not in fixed]


def _fixed_at_the_end(problem: Any) -> list[int]:
    """Return the unknowns of trailing ties that fix one unknown each, as bounds with lb = ub do."""
    rows, found = problem.tie, []
    for k in range(problem.ties - 1, -1, -1):
        start, end = rows.indptr[k], rows.indptr[k + 1]
        if end != start + 1 or rows.data[start] != 1.0:
            break
        found.append(int(rows.indices[start]))
    return found[::-1]


def _bounds_of(problem: Any) -> dict[int, tuple[str, int]]:
    """Return side and unknown of each contact that stands for a bound, recognised by its name and row."""
    found = {}
    rows = problem.normal
    for i, name in enumerate(problem.contact_names or ()):
        side, _, unknown = name.partition(" ")
        start, end = rows.indptr[i], rows.indptr[i + 1]
        if side not in (LOWER, UPPER) or end != start + 1:
            continue
        sign, j = -1.0 if side == LOWER else 1.0, int(rows.indices[start])
        if unknown in (str(j), problem.dof_name(j)) and rows.data[start] == sign:
            found[i] = side, j
    return found
