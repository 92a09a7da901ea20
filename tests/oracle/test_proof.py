"""Every step of the exact proof refuses what is wrong by the least that can be, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from flint import fmpq

import contactqp as cq
from benchmarks.problem_families import FAMILIES, family
from contactqp.linalg import rational
from contactqp.linalg.rational import (
    NoSolution,
    column,
    fractions,
    is_semidefinite,
    matrix,
    null_space,
    row_basis,
    solve_any,
    zeros,
)
from contactqp.oracle.exact.rational_equilibrium import Combination, balance, balanced, settle, system_of
from contactqp.oracle.exact.rational_problem import (
    STATEMENTS,
    Family,
    RationalAnswer,
    RationalProblem,
    lemke,
    of_floats,
    status,
    wrong,
)
from tests.examples import truss

LEAST = fmpq(1, 10**40)


def rough() -> tuple[RationalProblem, RationalAnswer]:
    """Two nodes on springs: one slips on a rough floor that it is pressed against, one hangs on a tie over it."""
    problem = cq.ContactProblem(
        stiffness=np.diag([2.0, 4.0, 8.0]),
        load=[1.0, -3.0, -1.0],
        normal=[[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
        gap=[0.25, 2.0],
        tangent=[[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        friction=[0.25, 0.0],
        tie=[[0.0, 0.0, 1.0]],
        tie_value=[-0.5],
    )
    data = of_floats(problem)
    # l_N = 3 - 4/4, l_T = 2/4, u_x = (1 - 1/2) / 2, nu = -1 + 8/2.
    u, push = column([0.25, -0.25, -0.5]), column([2.0, 0.0])
    return data, RationalAnswer(u, push, column([0.5, 0.0]), column([3.0]))


def statements(data: RationalProblem, answer: RationalAnswer) -> set[str]:
    return {one.statement for one in wrong(data, answer)}


def moved(part: object, place: int, by: fmpq = LEAST) -> object:
    other = part + zeros(part.nrows(), 1)  # type: ignore[attr-defined]
    other[place, 0] = other[place, 0] + by
    return other


def test_the_right_answer_is_proven() -> None:
    data, answer = rough()
    assert statements(data, answer) == set()
    assert status(data, answer) == ("slip", "open")
    assert len(STATEMENTS) == 7


@pytest.mark.parametrize(
    ("part", "place", "by", "fails"),
    [
        ("displacement", 0, LEAST, {"equilibrium"}),
        ("displacement", 1, -LEAST, {"equilibrium", "penetration", "complementarity"}),
        ("displacement", 1, LEAST, {"equilibrium", "complementarity"}),
        ("displacement", 2, LEAST, {"equilibrium", "tie"}),
        ("normal_force", 0, LEAST, {"equilibrium", "slip direction"}),
        ("normal_force", 0, -LEAST, {"equilibrium", "cone", "slip direction"}),
        ("normal_force", 1, LEAST, {"equilibrium", "complementarity"}),
        ("normal_force", 1, -LEAST, {"equilibrium", "complementarity", "tension"}),
        ("friction_force", 0, LEAST, {"equilibrium", "cone", "slip direction"}),
        ("friction_force", 0, -LEAST, {"equilibrium", "slip direction"}),
        ("friction_force", 0, fmpq(-1), {"equilibrium", "slip direction"}),
        ("friction_force", 1, LEAST, {"equilibrium", "cone"}),
        ("tie_force", 0, LEAST, {"equilibrium"}),
    ],
)
def test_what_is_off_by_ever_so_little_is_refused(part: str, place: int, by: fmpq, fails: set[str]) -> None:
    data, answer = rough()
    assert statements(data, replace(answer, **{part: moved(getattr(answer, part), place, by)})) == fails


def test_a_slip_across_its_friction_in_space_is_refused() -> None:
    pad = cq.ContactProblem(
        np.diag([2.0, 2.0, 0.0]),
        [0.3, 0.4, -1.0],
        [[0.0, 0.0, -1.0]],
        [0.0],
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        0.25,
    )
    data = replace(of_floats(pad), f=column([0.0, 0.0, 0.0]))
    along, across = (fmpq(3, 20), fmpq(4, 20)), (fmpq(4, 20), fmpq(3, 20))
    for force, fine in ((along, True), (across, False), (tuple(-x for x in along), False)):
        answer = RationalAnswer(column([fmpq(3), fmpq(4), fmpq(0)]), column([1.0]), column(force), zeros(0, 1))
        assert ("slip direction" not in statements(data, answer)) is fine


def test_a_wrong_set_is_corrected_and_a_wrong_displacement_not_held() -> None:
    data = of_floats(truss())
    right = settle(data, [(0,)], 0)
    assert right.way == "the proposed set"
    corrected = settle(data, [()], 0)
    assert corrected.way == "the proposed set, corrected 1 times"
    assert corrected.answer.normal_force == right.answer.normal_force
    assert balanced(data, right.answer.displacement) is not None
    assert balanced(data, moved(right.answer.displacement, 0)) is None  # type: ignore[arg-type]
    assert balance(data, moved(right.answer.displacement, 1)) is None  # type: ignore[arg-type]


def test_a_set_in_tension_is_not_held() -> None:
    lifted = of_floats(truss(load=[60.0, 100.0]))
    solved = system_of(lifted, Combination((0,))).solve()
    assert solved is not None
    assert solved[1][0, 0] < 0
    assert balanced(lifted, solved[0]) is None
    assert list(settle(lifted, [(0,)], 0).answer.normal_force.entries()) == [0]


def test_printed_matrices_of_floating_bodies_are_no_matter_of_rational_numbers() -> None:
    problem = next(p for p in (family("printed_floating", seed) for seed in range(20)) if p.rigid_change > 0)
    with pytest.raises(cq.Unsupported, match="printed"):
        cq.exact(problem)


@pytest.mark.sampled(54)
@pytest.mark.parametrize("name", [name for name in FAMILIES if name != "printed_floating"])
@pytest.mark.parametrize("seed", [101, 102])
def test_families_of_hard_problems_against_an_independent_way(name: str, seed: int) -> None:
    """Without any proposal Lemke's method in rational numbers finds the same, or proves that there is nothing."""
    problem = family(name, seed)
    if not FAMILIES[name].solvable:
        with pytest.raises(cq.NoEquilibrium, match="proven in rational numbers"):
            cq.exact(problem)
        return
    answer, alone = cq.exact(problem), settle(of_floats(problem), [], 2000)
    assert alone.way.startswith("Lemke")
    assert list(answer.normal_force) == fractions(alone.answer.normal_force)
    assert list(answer.displacement) == fractions(alone.answer.displacement)


def test_ranks_that_a_prime_hides_are_found_out() -> None:
    prime = 2**61 - 1
    hidden = matrix(np.eye(2))
    hidden[0, 0] = fmpq(prime)
    assert null_space(hidden).ncols() == 0
    assert len(row_basis(hidden)) == 2
    found = solve_any(hidden, column([1.0, 1.0]))
    assert found is not None
    assert found[1]
    assert found[0].entries() == [fmpq(1, prime), 1]


def test_a_contradiction_is_told_from_a_choice() -> None:
    rows = matrix([[1.0, 1.0], [2.0, 2.0]])
    assert solve_any(rows, column([1.0, 3.0])) is None
    found = solve_any(rows, column([1.0, 2.0]))
    assert found is not None
    assert not found[1]


def test_definiteness_is_exact() -> None:
    singular = [[1.0, -1.0], [-1.0, 1.0]]
    assert is_semidefinite(matrix(singular))
    assert is_semidefinite(matrix(np.zeros((2, 2))))
    barely = matrix(singular)
    barely[0, 0] = barely[0, 0] - LEAST
    assert not is_semidefinite(barely)
    barely[0, 0] = barely[0, 0] + 2 * LEAST
    assert is_semidefinite(barely)  # floats cannot tell; the minors do
    tiny = matrix([[1.0, 0.0], [0.0, 0.0]])
    tiny[1, 1] = fmpq(1, 10**400)  # no double
    assert is_semidefinite(tiny)
    tiny[0, 1] = tiny[1, 0] = fmpq(1, 10**199)
    assert not is_semidefinite(tiny)


@pytest.mark.parametrize("wall", [0.0, 1e-15, 1e-9, -1e-15])
def test_definiteness_of_bodies_that_hardly_anything_holds_is_decided_by_their_softest_motion(
    monkeypatch, wall
) -> None:
    """A chain of thirty springs, of halves so that sums are exact, on a wall of next to nothing, or of less."""
    k = np.array([wall, *np.random.default_rng(5).integers(1, 9, 29) / 2])
    K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    exact = matrix(K)
    exact[0, 0] = fmpq(int(2 * k[1]), 2) + fmpq(*float(wall).as_integer_ratio())
    minors, sizes = rational._minors_prove, []
    monkeypatch.setattr(rational, "_minors_prove", lambda a: [sizes.append(a.nrows()), minors(a)][1])
    assert is_semidefinite(exact) == (wall >= 0)
    assert max(sizes, default=0) <= 1
    assert minors(exact) == (wall > 0)


def test_a_stiffness_that_rounding_made_indefinite_is_refused() -> None:
    third = np.array([[1.0, 1 / 3], [1 / 3, 1 / 9]])
    third[1, 1] = np.nextafter(third[1, 0] ** 2, 0)
    problem = cq.ContactProblem(third, [1.0, 1.0], [[1.0, 0.0]], [0.0])
    with pytest.raises(cq.Unsupported, match="not positive semidefinite as it stands"):
        cq.exact(problem)


def test_lemke_on_an_empty_and_on_an_infeasible_problem() -> None:
    assert lemke(zeros(0, 0), zeros(0, 1), 10) == ([], 0)
    with pytest.raises(NoSolution):
        lemke(zeros(1, 1), column([-1.0]), 10)


def test_the_least_member_of_a_family() -> None:
    # x = (c, 2 - c), c >= 3/2: the nearest to zero is at the edge; without the edge at c = 1.
    start, ways = column([0.0, 2.0]), matrix([[1.0], [-1.0]])
    at_edge = Family(start, ways, column([-1.5]), matrix([[1.0]]))
    assert at_edge.least().entries() == [fmpq(3, 2)]
    assert at_edge.ranges([0, 1]) == [(fractions(column([1.5]))[0], None), (None, fractions(column([0.5]))[0])]
    assert Family(start, ways, column([5.0]), matrix([[1.0]])).least().entries() == [1]
    with pytest.raises(NoSolution):
        Family(start, ways, column([-1.0, -1.0]), matrix([[1.0], [-1.0]])).least()


def test_rational_numbers_of_thousands_of_unknowns_are_refused_at_once() -> None:
    chain = sp.diags([-np.ones(1999), 3 * np.ones(2000), -np.ones(1999)], [-1, 0, 1]).tocsr()
    problem = cq.ContactProblem(chain, np.ones(2000), sp.identity(2000, format="csr")[::100], np.ones(20))
    with pytest.raises(cq.Unsupported, match="2020 unknowns, contacts and ties, too many for rational numbers"):
        cq.exact(problem, enclose=False)
