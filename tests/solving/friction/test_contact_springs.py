"""The penalty method as the exact law of bodies with contact springs, against the textbook's systems."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.solving.methods.penalty import with_contact_springs, without_contact_springs
from tests.solving.friction.problems import TOUCH, random_problem, rough_truss, two_masses


def sliders(problem: cq.ContactProblem, solution: cq.Solution, tangential: float | np.ndarray) -> np.ndarray:
    """Return the sliders of a penalised solution: E_T u - l_T / beta_T, or where they stick their origin."""
    moved = (problem.tangent @ solution.displacement).reshape(problem.slip_origin.shape)
    stuck = solution.contact_status[:, None] == "stick"
    beta_T = np.broadcast_to(tangential, problem.contacts)[:, None]
    return np.where(stuck, problem.slip_origin, moved - solution.friction_force / beta_T)


def require_same(one: cq.Solution, other: cq.Solution, tolerance: float) -> None:
    """Displacements and forces, each kind relative to its largest; where there is no force, to the loads' rounding."""
    rounding = 1e-6 * np.max(abs(one.problem.load), initial=0.0)
    for part in ("displacement", "normal_force", "friction_force", "tie_force"):
        here, there = getattr(one, part), getattr(other, part)
        size = max(np.max(abs(here), initial=0.0), 0.0 if part == "displacement" else rounding)
        np.testing.assert_allclose(there, here, 0, atol=tolerance * size, err_msg=part)


@pytest.mark.sampled(10)
@pytest.mark.parametrize("algorithm", ["tresca", "enumeration"])
@pytest.mark.parametrize("beta", [1e3, 1e5, 1e6])
@pytest.mark.parametrize(("friction", "origin"), [(0.3, TOUCH), (0.3, 2e-3), (0.8, TOUCH), (5.0, 0.0)])
def test_truss_on_springs(friction: float, origin: float, beta: float, algorithm: str) -> None:
    problem = rough_truss(friction, origin)
    textbook = cq.solve(problem, "penalty", penalty=beta)
    exact = cq.solve(with_contact_springs(problem, beta), algorithm=algorithm)
    assert exact.certificate.passed
    found = without_contact_springs(problem, exact)
    require_same(textbook, found, 1e-12)
    assert found.problem is problem
    assert found.contact_status.tolist() == textbook.contact_status.tolist()
    assert found.method == f"penalty by {exact.method}"
    np.testing.assert_allclose(found.certificate.penetration, textbook.certificate.penetration, 1e-9)
    # The sliders are the unknowns that were added.
    at = sliders(problem, found, beta)
    np.testing.assert_allclose(at[0, 0], exact.displacement[-1], 1e-12)
    np.testing.assert_allclose(exact.displacement[2], 1e-3, 1e-12)
    if found.contact_status[0] == "stick":
        np.testing.assert_allclose(at[0, 0], origin, 1e-12, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("count", [15, pytest.param(40, marks=pytest.mark.slow)])
def test_random_problems_on_springs_of_two_stiffnesses(count: int) -> None:
    """The textbook's answers pass as exact answers of the bodies on springs, and are among those that are known."""
    rng = np.random.default_rng(2)
    counts = {"passed": 0, "known": 0, "none": 0}
    for _ in range(count):
        problem = random_problem(rng)
        beta, beta_T = 10.0 ** rng.uniform(0, 3, (2, problem.contacts))
        springs = with_contact_springs(problem, beta, beta_T)
        known = cq.equilibria(springs)
        try:
            found = cq.solve(problem, "penalty", penalty=beta, tangential_penalty=beta_T)
        except cq.NotConverged:
            assert not known
            counts["none"] += 1
            continue
        far = problem.normal @ found.displacement - found.normal_force / beta
        u = np.concatenate([found.displacement, far, sliders(problem, found, beta_T)[:, 0]])
        certificate = cq.certify(springs, u, found.normal_force, found.friction_force, found.tie_force)
        assert certificate.passed, certificate
        counts["passed"] += 1
        if known:
            near = min(known, key=lambda s: np.linalg.norm(s.displacement[: problem.dimension] - found.displacement))
            # The stiffness on springs is rounded when it is added up: n eps kappa (Golub and Van Loan, section 2.7).
            rounding = problem.dimension * np.finfo(float).eps * _condition(problem, found, beta, beta_T)
            require_same(without_contact_springs(problem, near), found, max(1e-10, rounding))
            counts["known"] += 1
    assert counts["passed"] >= count - 2, counts
    assert counts["known"] == counts["passed"], counts


def _condition(problem: cq.ContactProblem, found: cq.Solution, beta: np.ndarray, beta_T: np.ndarray) -> float:
    """Of the penalised system in the combination of open, stick and slip that was found."""
    K, normal, tangent, tie = (
        np.asarray(part.toarray() if sp.issparse(part) else part)
        for part in (problem.stiffness, problem.normal, problem.tangent, problem.tie)
    )
    for i, state in enumerate(found.contact_status):
        if state == "open":
            continue
        pushed = normal[i] + (state == "slip") * problem.friction[i] * np.sign(found.friction_force[i, 0]) * tangent[i]
        K = (
            K
            + beta[i] * np.outer(pushed, normal[i])
            + (state == "stick") * beta_T[i] * np.outer(tangent[i], tangent[i])
        )
    return float(np.linalg.cond(np.block([[K, tie.T], [tie, np.zeros((len(tie), len(tie)))]])))


def test_another_stiffness_is_another_answer() -> None:
    """The comparison can fail."""
    problem = rough_truss(5.0)
    textbook = cq.solve(problem, "penalty", penalty=1e5)
    for wrong in ((1.001e5, None), (1e5, 1.001e5), (1e5, 2e5)):
        other = without_contact_springs(problem, cq.solve(with_contact_springs(problem, *wrong)))
        with pytest.raises(AssertionError):
            require_same(textbook, other, 1e-9)


# Example 2.19 with penalty 1e4: (pull [N], d1, d2 [m], friction on 1 and 2 [N]) at its corners, as exact decimals.
CORNERS = [
    (2.6773125, 2.04375e-5, 2.4525e-4, 0.204375, 2.4525),
    (7.848, 4.905e-4, 5.886e-3, 4.905, 2.4525),
    (12.0, 4.6425e-3, 1.419e-2, 4.905, 2.4525),
    (6.645375, 4.601625e-3, 1.36995e-2, 4.49625, -2.4525),
    (0.0, 3.9975e-3, 6.45e-3, -1.545, -2.4525),
]


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 4, 7])
@pytest.mark.parametrize("way", ["penalty", "perturbed-lagrangian", "contact springs"])
def test_two_masses_loaded_and_unloaded(way: str, steps: int) -> None:
    """The slip origin of a step is where the sliders of the step before are; the states do not depend on the steps."""
    origin, before = np.zeros((2, 1)), 0.0
    for pull, d1, d2, friction1, friction2 in CORNERS:
        for force in np.linspace(before, pull, steps + 1)[1:]:
            problem = two_masses(float(force), origin)
            if way == "contact springs":
                solution = without_contact_springs(problem, cq.solve(with_contact_springs(problem, 1e4)))
            else:
                solution = cq.solve(problem, way, **{"penalty" if way == "penalty" else "perturbation": 1e4})
            origin = sliders(problem, solution, 1e4)
        before = pull
        np.testing.assert_allclose(solution.displacement[:2], [d1, d2], 1e-12)
        np.testing.assert_allclose(solution.friction_force[:, 0], [friction1, friction2], 1e-11)
        np.testing.assert_allclose(solution.normal_force, [19.62, 9.81], 1e-12)


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("pull", "status"),
    [
        (2.6773125 * (1 - 1e-9), "stick stick"),
        (2.6773125 * (1 + 1e-9), "stick slip"),
        (2.787, "stick slip"),
        (7.848 * (1 - 1e-9), "stick slip"),
        (7.848 * (1 + 1e-9), "slip slip"),
    ],
)
def test_where_the_masses_on_springs_begin_to_slide(pull: float, status: str) -> None:
    """2.6773125 N and 7.848 N, not the 2.787 N and 7.878 N that the chapter reads off a grid of 99 intervals."""
    assert " ".join(cq.solve(two_masses(pull), "penalty", penalty=1e4).contact_status) == status
    rigid = 2.4525, 7.3575
    assert " ".join(cq.solve(two_masses(pull), "lagrange-multiplier").contact_status) == (
        "slip slip" if pull > rigid[1] else "stick slip"
    )


def test_names_sparse_stiffness_and_contacts_that_cannot_slide() -> None:
    problem = rough_truss(0.3, 0.0, tangent=[[0.0, 0.0]])
    springs = with_contact_springs(problem, 1e6)
    assert springs.dof_names == ("1.x", "1.z", "floor: normal spring", "floor: slider")
    assert springs.contact_names == ("floor",)
    found = without_contact_springs(problem, cq.solve(springs))
    require_same(cq.solve(problem, "penalty", penalty=1e6), found, 1e-12)
    assert found.friction_force[0, 0] == 0.0
    sparse = with_contact_springs(problem.replace(stiffness=sp.csc_array(problem.stiffness)), 1e6)
    assert sp.issparse(sparse.stiffness)
    np.testing.assert_array_equal(sparse.stiffness.toarray(), springs.stiffness)


@pytest.mark.parametrize(("pull", "slides"), [((1.0, 2.0), False), ((3.0, 4.0), True)])
def test_in_space_springs_return_radially(pull: tuple[float, float], slides: bool) -> None:
    """One node on springs of 10 over a floor with beta = 30: l_N = 3/4 of 8; stuck, 3/4 of the pull; else mu l_N."""
    problem = cq.ContactProblem(
        stiffness=10.0 * np.eye(3),
        load=[*pull, -8.0],
        normal=[[0.0, 0.0, -1.0]],
        gap=[0.0],
        tangent=np.eye(3)[:2],
        friction=0.5,
        dof_names=["x", "y", "z"],
    )
    springs = with_contact_springs(problem, 30.0)
    assert springs.dof_names[-2:] == ("contact 0: slider 1", "contact 0: slider 2")
    direction = np.array(pull) / np.hypot(*pull)
    size = 3.0 if slides else 0.75 * np.hypot(*pull)
    assert slides == (0.75 * np.hypot(*pull) > 3.0)
    u = np.r_[(np.array(pull) - size * direction) / 10.0, -0.2]
    slider = u[:2] - size * direction / 30.0
    answer = dict(normal_force=[6.0], friction_force=[size * direction])
    right = cq.certify(springs, np.r_[u, 0.0, slider], **answer)
    assert right.passed
    assert not cq.certify(springs, np.r_[u, 0.0, slider + 1e-6], **answer).passed
    assert not cq.certify(springs, np.r_[u, 0.0, slider], normal_force=[6.0], friction_force=[[size, 0.0]]).passed


def test_what_has_no_springs_is_refused() -> None:
    with pytest.raises(cq.InvalidProblem, match="tangential rows"):
        with_contact_springs(cq.ContactProblem([[1.0]], [1.0], [[1.0]], [0.0]), 1.0)
    for wrong in (0.0, -1.0, np.nan, [1.0, 2.0]):
        with pytest.raises(cq.InvalidProblem, match="contact springs: penalty: expected a positive"):
            with_contact_springs(rough_truss(), wrong)
        with pytest.raises(cq.InvalidProblem, match="contact springs: tangential_penalty: expected a positive"):
            with_contact_springs(rough_truss(), 1.0, wrong)
