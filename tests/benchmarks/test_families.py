"""The families of hard problems, their exact solutions and the count of silently wrong answers mean what they say."""

from __future__ import annotations

import itertools
from pathlib import Path

import flint
import numpy as np
import pytest

import contactqp as cq
from benchmarks import counting, judging, silently_wrong
from benchmarks.bricks import few_bits
from benchmarks.exact_truth import condition, find_truth
from benchmarks.problem_families import FAMILIES, family
from contactqp.linalg.rational import NoSolution, floats, matrix, null_space, number
from contactqp.oracle.exact.rational_problem import lemke

SOLVABLE = [name for name, entry in FAMILIES.items() if entry.solvable]
FREE = ("floating", "lattice_free", "lattice_in", "lifted", "stack", "summed", "pushed", "unstrained", "interference")
FLOATING = [name for name in FAMILIES if name.startswith(FREE)]


def wall() -> cq.ContactProblem:
    """A bar of 157500 pulled with 300 against a wall at 1e-3: the force is 300 - 157.5, were 1e-3 exact."""
    return cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])


@pytest.mark.sampled(32)
@pytest.mark.parametrize("name", FAMILIES)
def test_seeds_give_the_same_problem_again_and_other_seeds_another(name: str) -> None:
    one, again, other = family(name, 3), family(name, 3), family(name, 4)
    assert np.array_equal(one.load, again.load)
    assert np.array_equal(one.gap, again.gap)
    assert (one.stiffness != again.stiffness).sum() == 0
    assert one.load.shape != other.load.shape or not np.array_equal(one.load, other.load)


@pytest.mark.sampled(36)
@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("seed", range(3))
def test_a_solution_exists_exactly_where_the_family_says_so(name: str, seed: int) -> None:
    problem = family(name, seed)
    if FAMILIES[name].solvable:
        assert find_truth(problem).displacement.nrows() == problem.dimension
    else:
        with pytest.raises(NoSolution):
            find_truth(problem)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", FLOATING)
def test_floating_bodies_float_exactly_and_not_to_rounding(name: str) -> None:
    assert null_space(matrix(family(name, 0).stiffness)).ncols() > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bedded", "decaying_path"])
def test_displacements_decay_over_twenty_orders(name: str) -> None:
    truths = [floats(find_truth(problem).displacement) for problem in (family(name, seed) for seed in range(10))]
    moved = [abs(u[u != 0]) for u in truths if np.any(u)]
    assert min(np.min(u) / np.max(u) for u in moved) < 1e-20


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ["pushed_rigidly", "unstrained", "interference_removed"])
def test_answers_of_free_bodies_that_only_move_cost_next_to_no_energy(name: str) -> None:
    for problem in (family(name, seed) for seed in range(5)):
        u = floats(find_truth(problem).displacement)
        assert np.any(u)
        energy, terms = u @ (problem.stiffness @ u), abs(u) @ (abs(problem.stiffness) @ abs(u))
        assert energy <= 1e-5 * terms


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "method"),
    [
        ("pushed_rigidly", 84, "clarabel"),  # a redundant contact pushes, and is open
        ("pushed_rigidly", 31, "qpalm"),  # forces that a tie takes are 1e5 times those that strain
        ("unstrained", 120, "clarabel"),  # all but 1e-4 of the contact forces is taken by rigid motions
        ("unstrained", 156, "augmented-lagrangian uzawa"),  # a motion of 1e9 hides the strain
        ("stack_free_to_slide", 130, "active-set"),  # a tie of blocks whose stiffnesses lie 1e9 apart
        ("lifted_off_spring", 45, "piqp"),  # refined from a start that is 1e5 times as far as the solution
        ("sums_of_sizes", 3, "active-set"),  # forces on few bare unknowns, relative to those of ties
        ("separating_planes", 1, "active-set"),
        ("paired_inequalities", 10, "active-set"),
    ],
)
def test_no_bound_is_below_the_true_error(name: str, seed: int, method: str) -> None:
    if method.split()[0] not in judging.available():
        pytest.skip(f"{method} is not installed")
    report = judging.judge(name, seed, (method,))
    assert report.bounds
    assert [bound for bound in report.bounds if bound.below] == []


@pytest.mark.slow
def test_a_truth_without_forces_passes_where_the_solution_beside_it_presses_pairs_of_rows_together() -> None:
    """Forces that closed rows may share in another way were an error of the size of those that cancel."""
    report = judging.judge("paired_inequalities", 4, ("active-set",))
    assert report.truth_refused == ""
    assert report.spoiled_passed == ()
    assert report.bounds
    assert [bound for bound in report.bounds if bound.below] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [141, 405])
def test_the_truth_passes_however_far_a_body_moves_freely(seed: int) -> None:
    """Its strain is 1e-9, and eps of the 8 and 328 that it has moved freely is no part of that."""
    report = judging.judge("unstrained", seed, ("active-set",))
    assert (report.truth, report.truth_refused) == ("exact", "")
    assert [outcome.verdict for outcome in report.outcomes] == ["right"]
    assert report.bounds
    assert not any(bound.below for bound in report.bounds)


@pytest.mark.slow
def test_strain_that_is_nothing_beside_the_load_makes_no_answer_wrong() -> None:
    """The load acts where the contact does: contact forces strain 1e-8 of what they are worth where they act."""
    report = judging.judge("pushed_rigidly", 12, ("lagrange-multiplier",))
    assert [outcome.verdict for outcome in report.outcomes] == ["right"]


@pytest.mark.slow
def test_the_families_are_as_different_as_the_issue_asks() -> None:
    everything = [family(name, seed) for name in SOLVABLE for seed in range(10)]
    gaps = np.concatenate([abs(p.gap[p.gap != 0]) for p in everything])
    diagonals = [p.stiffness.diagonal() for p in everything]
    spread = [values.max() / values.min() for values in diagonals if np.all(values > 0)]
    assert gaps.min() < 1e-10
    assert gaps.max() > 1e2
    assert max(spread) > 1e10
    assert any(p.contacts > p.dimension for p in everything)
    assert any(p.ties for p in everything)


def test_few_bits_make_sums_exact() -> None:
    small, large = few_bits(np.array([1 / 3, 1e12 / 7]))
    assert (small + large) - large == small


def test_the_exact_force_of_a_bar_at_a_wall() -> None:
    truth = find_truth(wall())
    gap = (1e-3).as_integer_ratio()
    assert truth.force[0, 0] == 300 - 157500 * flint.fmpq(*gap)
    assert truth.displacement[0, 0] == flint.fmpq(*gap)


def test_wrong_guesses_do_not_change_the_truth() -> None:
    problem = family("chain_walls", 1)
    alone = find_truth(problem)
    for guess in ([], list(range(problem.contacts)), [0]):
        assert find_truth(problem, [np.array(guess, dtype=int)]).force == alone.force


def test_errors_are_relative_in_the_energy() -> None:
    truth = find_truth(wall())
    u, force = truth.rounded()
    assert truth.errors(u, force).worst < 1e-15
    assert truth.errors(u, 1.1 * force).force == pytest.approx(0.1)
    assert truth.errors(0.5 * u, force).energy == pytest.approx(0.5)
    assert truth.errors(u, -force).force == pytest.approx(2.0)
    assert truth.errors(u * np.nan, force).worst == np.inf


def test_redundant_forces_are_compared_through_their_resultant() -> None:
    problem = cq.ContactProblem(stiffness=[[2.0]], load=[3.0], normal=[[1.0], [1.0]], gap=[0.5, 0.5])
    truth = find_truth(problem)
    assert not truth.unique_forces
    assert truth.errors(np.array([0.5]), np.array([0.25, 1.75])).worst == 0
    assert truth.errors(np.array([0.5]), np.array([2.0, 2.0])).force == pytest.approx(1.0)


def test_a_motion_that_nothing_drives_is_no_error_and_a_driven_one_no_solution() -> None:
    pair = dict(stiffness=[[1.0, -1.0], [-1.0, 1.0]], normal=[[1.0, 0.0]], gap=[5.0])
    truth = find_truth(cq.ContactProblem(load=[1.0, -1.0], **pair))
    assert truth.free == 1
    assert truth.errors(np.array([0.5, -0.5]), np.zeros(1)).worst == 0
    with pytest.raises(NoSolution):
        find_truth(cq.ContactProblem(load=[1.0, -2.0], **pair))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(20))
def test_lemke_against_enumeration(seed: int) -> None:
    rng = np.random.default_rng(seed)
    B, q = rng.integers(-3, 4, (4, 3)).astype(float), rng.integers(-4, 5, 4).astype(float)
    M = B @ B.T
    try:
        z = np.array([number(x) for x in lemke(matrix(M), matrix(q).transpose(), 200)[0]])
    except NoSolution:
        assert not any(_complementary(M, q, np.array(set_, dtype=bool)) for set_ in itertools.product([0, 1], repeat=4))
        return
    w = q + M @ z
    assert np.all(z >= 0)
    assert np.all(w >= -1e-12)
    assert abs(w @ z) < 1e-12


def _complementary(M: np.ndarray, q: np.ndarray, closed: np.ndarray) -> bool:
    z = np.zeros(len(q))
    z[closed] = np.linalg.lstsq(M[np.ix_(closed, closed)], -q[closed], rcond=None)[0]
    w = q + M @ z
    return bool(np.all(z >= -1e-9) and np.all(w >= -1e-9) and abs(w @ z) < 1e-9)


def test_the_condition_number_leaves_scale_and_rigid_motions_out() -> None:
    scaled = cq.ContactProblem(stiffness=np.diag([1e-6, 1e6]), load=[0.0, 0.0], normal=[[1.0, 0.0]], gap=[1.0])
    assert condition(scaled, 0) == pytest.approx(1.0)
    free = cq.ContactProblem(stiffness=[[1.0, -1.0], [-1.0, 1.0]], load=[0.0, 0.0], normal=[[1.0, 0.0]], gap=[1.0])
    assert condition(free, 1) == pytest.approx(1.0)


@pytest.mark.slow
def test_the_energy_of_a_rigid_motion_is_nothing_exactly() -> None:
    truths = [find_truth(family("interference_removed", seed)) for seed in range(20)]
    nothing = [truth for truth in truths if truth.size == 0]
    assert nothing
    assert all(np.isfinite(truth.size) for truth in truths)
    assert all(truth.force_size == 1.0 and truth.representable < 1e-12 for truth in nothing)


def test_spoiled_answers_are_spoiled() -> None:
    truth = find_truth(wall())
    errors = {name: truth.errors(u, force).worst for name, u, force in judging.spoiled(truth, np.random.default_rng(0))}
    assert errors.pop("truth") < 1e-15
    assert errors["forces x 1.001"] == pytest.approx(1e-3)
    assert errors["flipped sign"] == pytest.approx(2.0)
    assert errors["ignored contact"] > 0.5
    assert errors["penalty 1e+02"] == pytest.approx(1 / 101)


def test_a_wrong_answer_that_passes_fails_the_count() -> None:
    wrong = judging.Outcome("osqp", "wrong", 0.5, True, False, 0.0)
    bound = judging.Bounded("force_error", "osqp", 1e-9, 1e-3, 1e-3)
    report = judging.Report("chain_walls", 0, "exact", outcomes=(wrong,), bounds=(bound,), spoiled_passed=(("x", 1.0),))
    said = "\n".join(counting.failures([report], ["osqp"]))
    for failure in ("1 answers wrong", "1 bounds below", "1 spoiled answers passed", "osqp: 0 of 1"):
        assert failure in said


@pytest.mark.parametrize(("method", "fails"), [("active-set", True), ("osqp", False), ("clarabel", True)])
def test_right_answers_that_are_refused_fail_the_count(method: str, fails: bool) -> None:
    """One refusal of two hundred is too many for the default, half a per cent is not for a backend, and two are."""
    refused = {"active-set": 1, "osqp": 2, "clarabel": 3}[method]
    outcomes = [("refused", True)] * refused + [("right", False)] * (200 - refused)
    reports = [
        judging.Report(
            "chain_walls", i, "exact", outcomes=(judging.Outcome(method, verdict, 0.0, False, needlessly, 0.0),)
        )
        for i, (verdict, needlessly) in enumerate(outcomes)
    ]
    said = "\n".join(counting.failures(reports, [method]))
    assert ("right answers refused" in said) == fails


def test_rounding_of_a_bound_is_no_violation_and_more_is() -> None:
    assert not judging.Bounded("force_error", "", 1.0, 1.0 + 1e-15, 1.0 + 1e-15).below
    assert judging.Bounded("force_error", "", 1.0, 1.0 + 1e-13, 1.0 + 1e-13).below
    assert judging.Bounded("force_error", "", 1e-12, 1.1e-12, 1.1e-12).below


@pytest.mark.parametrize(("rounding", "compared"), [(judging.EPS, 1), (1e3 * judging.EPS, 1), (1e6 * judging.EPS, 0)])
def test_bounds_are_compared_where_the_error_is_above_the_rounding_of_the_displacement(
    rounding: float, compared: int
) -> None:
    bound = judging.Bounded("energy_error", "osqp", 1e-7, 1.5e-11, 1.5e-11, rounding=rounding)
    report = judging.Report("chain_walls", 0, "exact", bounds=(bound,))
    assert sum(map(len, counting.ratios([report]).values())) == compared
    assert any("energy_error" in line for line in counting.failures([report], [])) == bool(compared)


def test_a_displacement_that_hardly_strains_has_a_large_rounding() -> None:
    """One rounding of a motion of 1e6 that brings a spring of 1 to its stop, stretched by 1e-3."""
    K = [[1.0, -1.0], [-1.0, 1.0]]
    problem = cq.ContactProblem(K, [2.0**-10, 0.0], [[0.0, 1.0]], [2.0**20])
    truth = find_truth(problem)
    errors = truth.errors(*truth.rounded())
    assert errors.energy == 0
    assert errors.rounding == pytest.approx(judging.EPS * 2 * np.sqrt(2) * 2.0**30, rel=1e-6)


FEW = ["chain_walls", "floating_stack", "beam_stops", "duplicated_rows", "driven_away"]
FEW += ["bedded", "decaying_path", "pushed_rigidly", "unstrained", "interference_removed", "stack_free_to_slide"]
FEW += ["printed_floating", "far_gap", "scaled_contact"]


@pytest.mark.sampled(10)
@pytest.mark.parametrize("name", FEW)
def test_nothing_wrong_passes_on_a_few(name: str) -> None:
    report = judging.judge(name, 0, ("active-set", "osqp", "penalty"))
    assert report.truth == ("exact" if FAMILIES[name].solvable else "none")
    assert {o.verdict for o in report.outcomes} <= {"right", "refused"}
    assert report.outcomes[0].verdict == "right"
    assert not report.spoiled_passed


@pytest.mark.slow
def test_the_report_is_written_and_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reports = [judging.judge("chain_walls", seed, ("active-set", "clarabel")) for seed in range(2)]
    lines = "\n".join(counting.text(reports, ["active-set", "clarabel"], 1.0))
    assert "chain_walls" in lines
    assert "too easy" in lines
    monkeypatch.chdir(tmp_path)
    silently_wrong.write(reports, tmp_path / "out.json")
    assert '"family": "chain_walls"' in (tmp_path / "out.json").read_text()


def test_truths_are_rounded_to_the_nearest_float() -> None:
    assert floats(find_truth(wall()).displacement)[0] == 1e-3


@pytest.mark.slow
def test_a_start_that_is_exact_measures_no_contraction() -> None:
    """Corrections of 1e-32 follow corrections of 1e-32: the quotient says nothing of the refinement."""
    assert judging.judge("interference_removed", 173, ("active-set",)).outcomes[0].verdict == "right"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "method"),
    [
        ("interference_removed", 132, "daqp"),  # forces of 1e-41, refinement's noise, on bodies that nothing loads
        ("interference_removed", 169, "qpalm"),
        ("interference_removed", 218, "active-set"),  # loads of 1e-30, their neighbours' rounding
        ("pushed_rigidly", 319, "active-set"),
        ("printed_floating", 34, "active-set"),  # twelve digits resist a rotation by 6e-14 of the stiffness
        ("printed_floating", 92, "proxqp"),  # 4e5 times as far as the solution
    ],
)
def test_no_bound_is_below_the_error_where_noise_and_lost_digits_meet(name: str, seed: int, method: str) -> None:
    report = judging.judge(name, seed, (method,))
    assert report.truth == "exact"
    assert report.bounds
    assert not [bound for bound in report.bounds if bound.below]
    assert not report.truth_refused
    assert not report.spoiled_passed


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ["linear_programs", "staged_programs"])
def test_answers_of_programs_that_cost_more_are_wrong(name: str) -> None:
    """Where K sees nothing energies tell: a way that carries more, and forces where they are unique."""
    judged = compared = 0
    for seed in range(8):
        problem = family(name, seed)
        truth = find_truth(problem)
        u, force = truth.rounded()
        if truth.program is None:
            continue
        judged += 1
        assert truth.errors(u, force).worst <= 1e-12
        dear = u - 0.1 * problem.load / np.max(abs(problem.load))
        assert truth.errors(dear, force).cost > 1e-3
        assert (truth.errors(u, 1.001 * force).force > 1e-6) <= (truth.unique_forces and np.any(force > 0))
        compared += truth.errors(u, 1.001 * force).force > 1e-6
    assert judged
    assert compared or name == "linear_programs"  # whose ties repeat
