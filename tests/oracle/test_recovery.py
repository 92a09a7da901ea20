"""What is not given is recovered from what is; right answers pass that way and wrong ones do not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pytest

import contactqp as cq
from benchmarks.problem_families import FAMILIES, family
from tests.examples import CANTILEVER_FORCE, cantilever, truss, two_bars
from tests.solving.friction.problems import known_answer
from tests.solving.friction.space import several

WELL_POSED = sorted(name for name, one in FAMILIES.items() if one.well_posed and one.solvable)
SEEDS = [range(1), pytest.param(range(1, 4), marks=pytest.mark.slow)]


def _certified(name: str, seeds: range) -> Iterator[tuple[cq.ContactProblem, dict[str, np.ndarray]]]:
    """Members of a family with their right parts; not those whose answer no doubles hold."""
    for seed in seeds:
        problem = family(name, seed)
        with suppress(cq.NotCertified):
            solution = cq.solve(problem)
            yield problem, {"displacement": solution.displacement, "normal_force": solution.normal_force}


@pytest.mark.sampled(76)
@pytest.mark.parametrize("seeds", SEEDS, ids=["one", "more"])
@pytest.mark.parametrize("name", WELL_POSED)
def test_displacements_alone_or_forces_alone_of_a_right_answer_pass(name: str, seeds: range) -> None:
    certified = list(_certified(name, seeds))
    assert certified
    for problem, right in certified:
        for part, values in right.items():
            judged = cq.certify(problem, **{part: values})
            assert judged.passed, (part, judged.failures)
            assert part not in judged.recovered
            assert any("recovered" in note for note in judged.notes)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 57])
def test_of_dependent_contacts_and_ties_those_act_that_the_displacement_closes(seed: int) -> None:
    """Forces are 1e7 times what they strain: pushed across the rounding of a gap they would do 1e-12 of the energy."""
    problem = family("printed_floating", seed)
    right = cq.solve(problem)
    judged = cq.certify(problem, displacement=right.displacement)
    assert judged.passed, judged.failures
    assert judged.energy_error is not None
    assert judged.energy_error < 1e-12
    assert judged.answer.normal_force == pytest.approx(right.normal_force, rel=1e-9, abs=1e-9)
    shifted = right.displacement * (1 + 1e-6 * (np.arange(problem.dimension) % 2))
    assert not cq.certify(problem, displacement=shifted).passed


@pytest.mark.sampled(76)
@pytest.mark.parametrize("seeds", SEEDS, ids=["one", "more"])
@pytest.mark.parametrize("name", WELL_POSED)
def test_displacements_alone_or_forces_alone_of_a_wrong_answer_fail(name: str, seeds: range) -> None:
    rng, count = np.random.default_rng(5), 0
    for problem, right in _certified(name, seeds):
        for part, values in right.items():
            if not np.any(values):
                continue
            spoiled = values * (1 + 1e-4 * rng.normal(size=len(values)))
            assert not cq.certify(problem, **{part: spoiled}).passed, part
            count += 1
    assert count


@pytest.mark.slow
def test_the_force_of_a_stiff_beam_is_recovered_from_its_displacement() -> None:
    """Equilibrium at the tip alone multiplies the rounding of u by 1e8: the force is off by several per cent."""
    problem = cantilever()
    judged = cq.certify(problem, cq.solve(problem).displacement)
    assert judged.passed
    assert judged.answer.normal_force[0] == pytest.approx(CANTILEVER_FORCE, rel=1e-6)


@pytest.mark.sampled(14)
@pytest.mark.parametrize("seed", range(12))
def test_frictional_answers_from_displacements(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for known in (known_answer(rng, 2), known_answer(rng, 3), several(seed, ties=seed % 2)):
        problem = known.problem
        assert cq.certify(problem, **known.answer()).passed
        alone = cq.certify(problem, known.displacement)
        assert alone.passed, alone.failures
        if known.friction_force.size + problem.contacts + problem.ties <= problem.dimension:  # independent rows
            assert alone.answer.friction_force == pytest.approx(known.friction_force, abs=1e-7)
        if problem.ties:
            assert cq.certify(problem, known.displacement, known.normal_force, known.friction_force).recovered == (
                "tie_force",
            )
        without = cq.certify(problem, known.displacement, known.normal_force, tie_force=known.tie_force)
        assert without.passed, without.failures


@pytest.mark.sampled(8)
@pytest.mark.parametrize("seed", range(12))
def test_frictional_answers_from_forces(seed: int) -> None:
    known = several(seed, ties=seed % 2)
    judged = cq.certify(known.problem, normal_force=known.normal_force, friction_force=known.friction_force)
    assert judged.passed, judged.failures
    assert judged.answer.displacement == pytest.approx(known.displacement, abs=1e-9)
    spoiled = 1.001 * known.normal_force
    assert not cq.certify(known.problem, normal_force=spoiled, friction_force=known.friction_force).passed


def _slider(origin: float) -> cq.ContactProblem:
    """A bar that only friction holds along itself: its left end sticks at 0.5, its right end slips from `origin`."""
    return cq.ContactProblem(
        stiffness=[[8.0, 0.0, -8.0, 0.0], [0.0, 8.0, 0.0, 0.0], [-8.0, 0.0, 8.0, 0.0], [0.0, 0.0, 0.0, 8.0]],
        load=[-1.0, -4.0, 4.0, -4.0],
        normal=[[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]],
        gap=[0.0, 0.0],
        tangent=[[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        friction=0.5,
        slip_origin=[0.5, origin],
    )


@pytest.mark.slow
def test_forces_alone_put_a_floating_body_where_it_sticks() -> None:
    """Closing contacts says nothing of where a body lies along them: their stick and the way of their slip do."""
    judged = cq.certify(_slider(0.5), normal_force=[4.0, 4.0], friction_force=[1.0, 2.0])
    assert judged.passed, judged.failures
    assert judged.answer.displacement == pytest.approx([0.5, 0.0, 0.75, 0.0])
    six = {"normal_force": [4.0, 4.0], "friction_force": [1.0, 1.99999]}
    assert cq.certify(_slider(0.5), **six, tolerance=1e-4, error_tolerance=1e-4).passed
    assert not cq.certify(_slider(0.5), **six).passed
    # From 1.0 the right end would have slipped against its friction.
    assert not cq.certify(_slider(1.0), normal_force=[4.0, 4.0], friction_force=[1.0, 2.0]).passed
    assert not cq.certify(_slider(0.5), normal_force=[4.0, 4.0], friction_force=[-1.0, 2.0]).passed


def test_no_forces_put_a_floating_body_out_of_its_obstacle() -> None:
    wall = cq.ContactProblem(
        stiffness=[[8.0, -8.0, 0.0], [-8.0, 8.0, 0.0], [0.0, 0.0, 8.0]],
        load=[-1.0, 1.0, 0.0],
        normal=[[1.0, 0.0, 0.0]],
        gap=[-0.5],
        tangent=[[0.0, 0.0, 1.0]],
        friction=0.5,
    )
    judged = cq.certify(wall, normal_force=[0.0], friction_force=[0.0])
    assert judged.passed, judged.failures
    assert judged.answer.displacement == pytest.approx([-0.5, -0.375, 0.0])


@pytest.mark.slow
def test_friction_missing_of_a_node_that_touches_twice_is_shared_within_the_law() -> None:
    """A node that sticks at two rows: half of the friction of 2.4 at each exceeds what the first can hold."""
    problem = cq.ContactProblem(
        stiffness=[[8.0, 0.0], [0.0, 8.0]],
        load=[2.4, -8.0],
        normal=[[0.0, -1.0], [0.0, -1.0]],
        gap=[0.0, 0.0],
        tangent=[[1.0, 0.0], [1.0, 0.0]],
        friction=[0.5, 0.25],
    )
    judged = cq.certify(problem, [0.0, 0.0], [2.0, 6.0])
    assert judged.passed, judged.failures
    assert abs(judged.answer.friction_force.sum() - 2.4) < 1e-9
    assert not cq.certify(problem, [0.0, 0.0], [0.0, 8.0]).passed  # 2.0 is all that these can hold


def test_a_displacement_with_a_supported_tangent_is_judged_where_it_is_wrong() -> None:
    """What holds the touching contacts where they are was asked of a row of zeros, too: Unsupported was raised."""
    held = cq.ContactProblem(stiffness=[[8.0]], load=[4.0], normal=[[1.0]], gap=[0.25], tangent=[[0.0]], friction=0.5)
    assert cq.certify(held, [0.25]).passed
    assert not cq.certify(held, [0.25 * (1 - 1e-7)]).passed


def test_a_displacement_that_touches_nothing_is_judged() -> None:
    known = several(0)
    lifted = cq.certify(known.problem, known.displacement + 5.0 * (np.arange(known.problem.dimension) % 3 == 0))
    assert not lifted.passed
    assert lifted.penetration == 0


def test_friction_is_not_recovered_from_normal_forces() -> None:
    known = several(0)
    with pytest.raises(cq.InvalidProblem, match="friction_force: the problem has friction, and without displacement"):
        cq.certify(known.problem, normal_force=known.normal_force)


def test_dependent_contacts_share_their_resultant_without_tension() -> None:
    problem = truss(normal=[[0.0, -1.0], [0.0, -1.0]], gap=[1e-3, 1e-3], contact_names=None)
    right = cq.solve(problem)
    judged = cq.certify(problem, right.displacement)
    assert judged.passed
    assert np.all(judged.answer.normal_force >= 0)
    assert judged.answer.normal_force.sum() == pytest.approx(right.normal_force.sum(), rel=1e-12)
    assert any("shared without tension" in note for note in judged.notes)


def test_what_equilibrium_cannot_explain_is_lack_of_equilibrium() -> None:
    problem = truss()
    u = cq.solve(problem).displacement * [1.01, 1.0]
    judged = cq.certify(problem, u)
    assert judged.equilibrium > 1e-3
    assert judged.penetration == 0


def test_a_recovered_tension_is_seen() -> None:
    problem = truss(load=[60.0, 100.0])
    K = problem.stiffness
    held = np.array([(60.0 + K[0, 1] * 1e-3) / K[0, 0], -1e-3])
    judged = cq.certify(problem, held)
    assert judged.tension > 0.1
    assert judged.equilibrium < 1e-12


def test_values_that_are_not_finite_recover_nothing_and_fail() -> None:
    judged = cq.certify(two_bars(), [np.nan, 0.0])
    assert not judged.passed
    assert judged.recovered == ()
    assert any("not finite" in note for note in judged.notes)
    assert judged.failures == ("displacement: nan at unknown 0",)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [0.0, 4.0])
@pytest.mark.parametrize("friction", [None, 0.5])
def test_rows_that_constrain_nothing_have_no_force(stiffness: float, friction: float | None) -> None:
    rubs = {} if friction is None else dict(tangent=[[0.0, 1.0]] * 3, friction=friction)
    problem = cq.ContactProblem(
        [[stiffness, 0.0], [0.0, 1.0]], [3.0, 0.0], [[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]], [0.0, 0.5, np.inf],
        tie=[[0.0, 0.0]], tie_value=[0.0], **rubs,
    )  # fmt: skip
    judged = cq.certify(problem, displacement=[0.5, 0.0])
    assert judged.passed
    assert judged.answer.normal_force == pytest.approx([0.0, 3.0 - 0.5 * stiffness, 0.0])
    assert not cq.certify(problem, displacement=[0.6, 0.0]).passed
    force = judged.answer.normal_force
    assert cq.certify(problem, normal_force=force, friction_force=judged.answer.friction_force).passed


def test_a_displacement_that_no_row_would_hold_still_gets_forces() -> None:
    """Two contacts along the sum of the unknowns, under a load along their difference: neither acts."""
    problem = cq.ContactProblem(np.eye(2), [1.0, -1.0], [[1.0, 1.0], [1.0, 1.0]], [1.0, 2.0])
    assert not cq.certify(problem, [0.0, 0.0]).passed
    assert cq.certify(problem, [1.0, -1.0]).passed


def printed(values: np.ndarray, digits: int = 7) -> np.ndarray:
    return np.array([float(f"{value:.{digits - 1}e}") for value in values.ravel()]).reshape(values.shape)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "seeds"),
    [(1e2, range(2)), *((one, range(2, 12)) for one in (0.3, 1e2, 1e4))],
)
def test_parts_of_an_answer_with_friction_that_are_printed_with_seven_digits_are_right(
    friction: float, seeds: range
) -> None:
    """Half of them were refused at coefficients of 100: contacts that stick were left to slip by what was cut off, and
    normal forces were known from the displacement to the coefficient times that.
    """
    spoiled = 0
    for seed in seeds:
        problem = _random_frictional(seed, friction)
        right = cq.solve(problem)
        assert right.certificate.passed
        parts = {name: getattr(right, name) for name in ("displacement", "normal_force", "friction_force")}
        for names in ([*parts], ["normal_force", "friction_force"], ["displacement"]):
            given = {name: printed(parts[name]) for name in names}
            assert cq.certify(problem, **given, tolerance=1e-5, error_tolerance=1e-4).passed, (seed, names)
            wrong = given | {names[-1]: given[names[-1]] * 1.001}
            if np.any(wrong[names[-1]] != given[names[-1]]):
                spoiled += 1
                assert not cq.certify(problem, **wrong, tolerance=1e-5, error_tolerance=1e-4).passed, (seed, names)
    assert spoiled > len(seeds)


def _random_frictional(seed: int, friction: float) -> cq.ContactProblem:
    """Bodies of four to nine unknowns, pressed onto one or two contacts in a plane or in space."""
    rng = np.random.default_rng([seed, 7])
    dimension, contacts = int(rng.integers(2, 4)), int(rng.integers(1, 3))
    n = contacts * dimension + int(rng.integers(2, 4))
    shape, rows = rng.normal(size=(n, n + 2)), np.linalg.qr(rng.normal(size=(n, n)))[0]
    normal, gap = rows[:contacts], 0.1 * rng.random(contacts) * (rng.random(contacts) < 0.6)
    load = 10 * rng.normal(size=n) + 30 * normal.sum(axis=0)
    tangent = rows[contacts : contacts * dimension]
    return cq.ContactProblem(shape @ shape.T + 0.1 * np.eye(n), load, normal, gap, tangent=tangent, friction=friction)


NEARLY_PARALLEL = (
    cq.ContactProblem(
        [[19.0, -9.0], [-9.0, 10.0]],
        [-0.6328999586534809, -40.45090016011851],
        [[-0.009953916334641573, -0.6435537012486696], [-0.010361996041001643, -0.6440118639234462],
         [-0.009953929255216706, -0.6435536922087101], [0.009963816126000167, 0.6435599955107253]],
        [0.0, 1.7645976899132552e-07, -1.5024596204556614e-18, 0.001],
    ),
    [-3.755335379499643e-04, 5.808426421869409e-06],
    [0.0, 0.0, 62.860859219660234, 0.0],
)  # fmt: skip
CLAMPED = (
    cq.ContactProblem(
        [[1168.0, 3328.0, -4.0, 64.0], [3328.0, 21760.0, 10.0, -2560.0], [-4.0, 10.0, 0.0908203125, -3.5],
         [64.0, -2560.0, -3.5, 1680.0]],
        np.zeros(4),
        [[-0.38567482516304824, 0.3942395953109438, 0.3464074190947525, 0.17799682690759314],
         [-0.38567504189762875, 0.3942393918470201, 0.34640754462489387, 0.17799667240426248],
         [0.38567637295168544, -0.39423606333931926, -0.34639926556703154, -0.17799143418933977]],
        [0.0, -7.804435598589086e-19, -0.001],
    ),
    [-87.63443499078596, 17.72631292681642, -131.85559586414033, 27.466483046231517],
    [3.821944761511320e09, 0.0, 3.822035933833875e09],
)  # fmt: skip


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("problem", "u", "force"), [NEARLY_PARALLEL, CLAMPED])
def test_nearly_dependent_rows_do_not_share_what_rounding_leaves_of_a_displacement(
    problem: cq.ContactProblem, u: list[float], force: list[float]
) -> None:
    """The numbers are those of the solution in rational numbers, rounded; its forces fit the displacement too."""
    judged = cq.certify(problem, u)
    assert judged.passed
    np.testing.assert_allclose(judged.answer.normal_force, force, rtol=1e-6)
    assert any("those of the solution" in note for note in judged.notes)
    assert not cq.certify(problem, np.array(u) * (1 + 1e-4)).passed
    assert not cq.certify(problem, np.array(u) * np.append(np.ones(len(u) - 1), 1 + 1e-4)).passed


def test_a_force_that_least_squares_leave_of_none_is_none() -> None:
    """On the motion that the ties alone hold nothing else acts, and there 1e-15 was out of balance."""
    problem = cq.ContactProblem(
        [[8.0, 8, 0, 8], [8, 16, 0, 8], [0, 0, 0, 0], [8, 8, 0, 8]],
        [0.0, 2.0, -6.0, 0.0],
        [[3.0, -2.0, 2.0, 3.0], [0.0, 1.0, -3.0, 0.0]],
        [1.375, -2.0625],
        tie=[[-2.0, 2.0, 2.0, 1.0], [-2.0, -1.0, 2.0, -1.0]],
        tie_value=[-0.5, 0.75],
    )
    judged = cq.certify(problem, [0.625, 0.0, 0.6875, -0.625])
    assert judged.passed
    assert judged.answer.tie_force.tolist() == [0.0, 0.0]
    assert judged.answer.normal_force == pytest.approx([0.0, 2.0], abs=1e-14)


@pytest.mark.slow
def test_forces_alone_put_a_body_where_contacts_without_force_leave_one_place() -> None:
    """Three contacts and the tie meet in one point of the motions that the pushing contact leaves."""
    problem = cq.ContactProblem(
        np.diag([0.0, 0.0, 0.0, 9.0]),
        [-4.5, 1.5, -6.0, 23.0],
        [[-3.0, 0.0, -3.0, 2.0], [-3.0, 3.0, 1.0, -3.0], [0.0, -1.0, 1.0, -2.0], [-3.0, -2.0, -3.0, 2.0]],
        [5.875, -4.25, -5.125, 2.625],
        tie=[[-1.0, 1.0, -2.0, 2.0]],
        tie_value=[7.5],
    )
    judged = cq.certify(problem, None, [1.0, 0.0, 0.0, 0.0], tie_force=[1.5])
    assert judged.passed
    assert judged.answer.displacement == pytest.approx([0.625, 1.625, -1.25, 2.0], abs=1e-12)
    assert not cq.certify(problem, None, [1.0 + 1e-6, 0.0, 0.0, 0.0], tie_force=[1.5]).passed


@pytest.mark.slow
def test_friction_that_takes_back_its_push_has_no_part_in_what_is_shared() -> None:
    """Contact 1 pushes along its own tangent: with a coefficient of one an edge of its cone exerts nothing."""
    problem = cq.ContactProblem(
        np.zeros((2, 2)),
        [-1.375, -0.125],
        [[-3.0, 2.0], [0.0, -1.0]],
        [-1.25, 1.75],
        [[-1.0, 2.0], [0.0, -1.0]],
        [0.25, 1.0],
        slip_origin=[[-2.25], [1.75]],
    )
    judged = cq.certify(problem, [-0.75, -1.75])
    assert judged.passed
    assert np.all(np.isfinite(judged.answer.friction_force))
    assert not cq.certify(problem, [-0.75, -1.75], [0.5, 0.5], [0.125, 0.375]).passed
