"""Quadratic programs in qpsolvers' form become contact problems and come back, multipliers and all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp

import contactqp as cq

P = [[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]
PROGRAM: dict[str, Any] = dict(
    P=P,
    q=[1.0, -4.0, 0.5],
    G=[[1.0, 1.0, 0.0]],
    h=[0.7],
    A=[[0.0, 1.0, 1.0]],
    b=[1.0],
    lb=[-0.1, -np.inf, 0.3],
    ub=[np.inf, 0.4, 2.0],
)


def test_contacts_stand_in_order_and_are_called_after_what_they_are() -> None:
    problem = cq.ContactProblem.from_qp(
        **PROGRAM, C=[[1.0, 0.0, -1.0], [2.0, 0.0, 0.0], [0.0, 3.0, 0.0]], l=[-1.0, 1.0, -np.inf], u=[5.0, 1.0, 9.0]
    )
    ranges = ("range 0 upper", "range 0 lower", "range 2 upper")
    assert problem.contact_names == ("row 0", *ranges, "lower 0", "lower 2", "upper 1", "upper 2")
    assert problem.ties == 2  # the row of A, and the range whose sides are equal
    assert problem.gap.tolist() == [0.7, 5.0, 1.0, 9.0, 0.1, -0.3, 0.4, 2.0]
    assert problem.normal.toarray()[2].tolist() == [-1.0, 0.0, 1.0]
    assert problem.load.tolist() == [-1.0, 4.0, -0.5]


def test_forces_are_the_multipliers_of_qpsolvers() -> None:
    import qpsolvers

    arrays = {name: np.array(value) for name, value in PROGRAM.items()}
    theirs = qpsolvers.solve_problem(qpsolvers.Problem(**arrays), "daqp")
    problem = cq.ContactProblem.from_qp(**PROGRAM)
    solution = cq.solve(problem)
    force = dict(zip(problem.contact_names or (), solution.normal_force, strict=True))
    assert solution.displacement == pytest.approx(theirs.x, abs=1e-7)
    assert force["row 0"] == pytest.approx(theirs.z[0], abs=1e-6)
    assert solution.tie_force == pytest.approx(theirs.y, abs=1e-6)
    box = [force.get(f"upper {j}", 0.0) - force.get(f"lower {j}", 0.0) for j in range(3)]
    assert box == pytest.approx(theirs.z_box, abs=1e-6)
    assert max(map(abs, box)) > 0.1


def test_what_came_from_a_program_goes_back_as_it_was() -> None:
    program = cq.ContactProblem.from_qp(**PROGRAM).to_qp()
    for name, value in PROGRAM.items():
        found = getattr(program, name)
        found = found.toarray() if sp.issparse(found) else found
        assert np.array_equal(np.asarray(found), np.asarray(value)), name


def test_rows_that_only_look_like_bounds_stay_rows() -> None:
    problem = cq.ContactProblem.from_qp(P, np.ones(3), G=[[0.0, 2.0, 0.0]], h=[1.0])
    program = problem.to_qp()
    assert program.G.shape == (1, 3)
    assert program.ub is None


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (dict(h=None), "h: expected beside G"),
        (dict(G=None), "G: expected beside h"),
        (dict(G=[[1.0, 1.0]]), "G: expected 3 columns"),
        (dict(h=[1.0, 2.0]), "h: expected 1 entries"),
        (dict(lb=[0.0, 3.0, 0.3]), "lb: expected at most ub"),
        (dict(lb=[np.inf, 0.0, 0.0]), "lb: expected a number or -inf"),
        (dict(ub=[1.0, 1.0]), "ub: expected 3 entries"),
        (dict(D=[[1.0]]), "from_qp: unknown"),
        (dict(C=[[1.0, 0.0, 0.0]]), "u: expected beside C"),
    ],
)
def test_what_is_no_program_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=message):
        cq.ContactProblem.from_qp(**(PROGRAM | changed))


def test_a_problem_of_qpsolvers_is_taken_as_it_is() -> None:
    plain = {name: PROGRAM.get(name) for name in ("P", "q", "G", "h", "A", "b", "lb", "ub")}
    arrays = {name: None if value is None else np.array(value) for name, value in plain.items()}
    read = cq.ContactProblem.from_qp(qpsolvers.Problem(**arrays))
    told = cq.ContactProblem.from_qp(**plain)
    np.testing.assert_array_equal(read.normal.toarray(), told.normal.toarray())
    np.testing.assert_array_equal(read.gap, told.gap)
    assert (read.contact_names, read.ties) == (told.contact_names, told.ties)
    with pytest.raises(cq.InvalidProblem, match="from_qp: q: expected an array, got None"):
        cq.ContactProblem.from_qp(np.eye(2))


def test_friction_is_no_quadratic_program() -> None:
    problem = cq.ContactProblem(np.eye(2), [1.0, 1.0], [[0.0, 1.0]], [0.1], tangent=[[1.0, 0.0]], friction=0.3)
    with pytest.raises(cq.Unsupported, match="not a quadratic program"):
        problem.to_qp()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"q": [np.inf, 0.0]}, r"q: expected finite numbers, got inf at \[0\]"),
        ({"G": [[0.0, np.nan]]}, r"G: expected finite numbers, got nan at \[0, 1\]"),
        ({"h": [np.nan]}, r"h: expected numbers, got nan at \[0\]"),
    ],
)
def test_numbers_of_a_program_are_refused_by_their_names_in_it(changed: dict[str, Any], message: str) -> None:
    """An infinite q was told of as a load of the other sign, and a row of G as "normal"."""
    program = {"P": np.eye(2), "q": [1.0, 0.0], "G": [[1.0, 0.0]], "h": [1.0]}
    with pytest.raises(cq.InvalidProblem, match=message):
        cq.ContactProblem.from_qp(**(program | changed))


def test_an_indefinite_program_is_refused_without_a_word_of_structures():
    curved = [[2.0, 1.0, 1.0], [1.0, 2.0, -1.9], [1.0, -1.9, 2.0]]
    with pytest.raises(cq.InvalidProblem, match=r"^P: expected positive semidefinite") as refused:
        cq.ContactProblem.from_qp(curved, np.ones(3), lb=np.zeros(3))
    assert "buckling" not in str(refused.value)
    with pytest.raises(cq.InvalidProblem, match="beyond its buckling load"):
        cq.ContactProblem(curved, np.ones(3), np.eye(3), np.zeros(3))
