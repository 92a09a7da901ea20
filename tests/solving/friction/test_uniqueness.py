"""Where a frictional problem has several answers, the certificate of each of them says so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate import other_answers, uniqueness
from contactqp.certificate.critical_friction import _one_sign, of_operator
from contactqp.certificate.uniqueness import FORCES, POSSIBLE, SEVERAL, UNKNOWN
from contactqp.elements.material import Material
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import REFERENCES, Block
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg.condensation import condense
from contactqp.linalg.delassus import contact_compliance
from contactqp.solving.friction import tresca
from tests.solving.friction.problems import (
    TOUCH,
    known_answer,
    one_contact,
    pad,
    random_problem,
    rough_truss,
    two_masses,
)
from tests.solving.friction.test_several import KLARBRING, ROD


@pytest.mark.sampled(7)
@pytest.mark.parametrize(("friction", "most"), [(0.1, 1), (0.4, 1), (0.5, 1), (0.55, 3), (0.8, 3), (1.5, 3), (5.0, 3)])
def test_klarbrings_family(friction: float, most: int) -> None:
    """mu_c = W_nn/|W_nt| = 1/2: up to it every load has one answer, above it some have three."""
    rng = np.random.default_rng(1)
    counted = 0
    for _ in range(30):
        load = np.array([-1.0, rng.uniform(0.4, 0.6)]) if rng.random() < 0.5 else rng.normal(size=2)
        found = cq.equilibria(one_contact(KLARBRING, KLARBRING @ load, friction))
        counted = max(counted, len(found))
        for state in found:
            assert state.certificate.uniqueness == ((SEVERAL,) if len(found) > 1 else ()), load
            assert state.certificate.passed
    assert counted == most


def test_what_the_note_says() -> None:
    problem = one_contact(KLARBRING, (0.3, 1.25), 0.8)
    chosen = cq.solve(problem, algorithm="tresca")
    assert chosen.certificate.passed, "a state of equilibrium is no wrong answer"
    (note,) = [note for note in chosen.certificate.notes if "several" in note]
    assert note == (
        "friction: several answers exist at this load (mu = 0.8 of contact 0 is not below the critical 0.5); "
        "contactqp.equilibria lists them"
    )
    assert "several answers exist" in str(chosen.certificate)
    assert cq.solve(problem.replace(friction=0.4)).certificate.notes == ()


def test_a_continuum_of_answers_is_several() -> None:
    """At mu = mu_c and f = (-1, 1/2) all states between open and stuck are answers."""
    states = cq.equilibria(one_contact(KLARBRING, KLARBRING @ np.array([-1.0, 0.5]), 0.5))
    assert states
    for state in states:
        assert state.certificate.uniqueness == (SEVERAL,)


@pytest.mark.parametrize(
    ("friction", "free", "several"),
    [(1.0, (-0.01, -1.0), ()), (1.5, (-0.01, -1.0), ()), (1.5, (0.01, -1.0), (SEVERAL,))],
)
def test_a_rod_says_when_it_has_three_answers(
    friction: float, free: tuple[float, float], several: tuple[str, ...]
) -> None:
    states = cq.equilibria(one_contact(ROD, free, friction))
    assert len(states) == (3 if several else 1)
    for state in states:
        assert state.certificate.uniqueness == several


def test_critical_coefficient_of_a_triangle() -> None:
    """P1 triangle, corner A(0, 0) on y = 0, others clamped: mu_c = ((l+2G) + G s^2)/((l+G) s), s = (1 - x_C)/y_C."""
    lame, shear = 0.3 / (1.3 * 0.4), 1 / 2.6  # nu = 0.3, E = 1
    for s in (0.5, 1.0, 2.0):
        # grad N_A = -(y_C, 1 - x_C)/(2 area): K = area ((l+G) b b' + G |b|^2 I), with b = (1, s) up to a factor.
        b = np.array([1.0, s])
        K = (lame + shear) * np.outer(b, b) + shear * (b @ b) * np.eye(2)
        critical = ((lame + 2 * shear) + shear * s**2) / ((lame + shear) * s)
        data = dict(stiffness=K, normal=[[0.0, -1.0]], gap=[0.0], tangent=[[1.0, 0.0]])
        problem = cq.ContactProblem(**data, load=[0.1, -1.0], friction=0.99 * critical)
        found = cq.critical_friction(problem)
        assert found.single == pytest.approx([critical], rel=1e-12)
        assert found.contraction == pytest.approx(0.99, rel=1e-12)
        assert found.unique
        above = problem.replace(friction=1.01 * critical)
        assert not cq.critical_friction(above).unique
        # Just above, a load whose friction angle lies between mu_c and mu has three answers.
        three = above.replace(load=[1.005 * critical, -1.0])
        states = cq.equilibria(three)
        other = cq.equilibria(three.replace(load=[-1.005 * critical, -1.0]))
        assert {len(states), len(other)} == {1, 3}
        for state in (*states, *other):
            several = len(states if state in states else other) > 1
            assert state.certificate.uniqueness == ((SEVERAL,) if several else ())


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("poisson", "expected"), [(0.3, 1.8), (0.45, 1.2), (0.49, 1.04)])
@pytest.mark.parametrize("s", [0.5, 1.0, 1.7])
def test_critical_coefficient_of_a_triangle_of_elements(poisson: float, expected: float, s: float) -> None:
    """The same of a body of one linear element: A (0, 0), B (1, 0) and C (1 - 2 s, 2) of any modulus and thickness."""
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0 - 2.0 * s, 2.0]])
    mesh = Mesh(points, (Block(REFERENCES["tri3"], np.array([[0, 1, 2]])),), node_sets={"clamped": np.array([1, 2])})
    structure = Structure([Body(mesh, Material(3.0, poisson), "plane-strain", thickness=0.7, name="triangle")])
    K = structure.assemble([Support("triangle", "clamped", axis) for axis in (0, 1)]).K.toarray()
    ratio = 2 * poisson / (1 - 2 * poisson)  # l / G
    critical = ((ratio + 2) + s**2) / ((ratio + 1) * s)
    problem = cq.ContactProblem(K, [0.1, -1.0], [[0.0, -1.0]], [0.0], [[1.0, 0.0]], friction=0.1)
    assert cq.critical_friction(problem).single == pytest.approx([critical], rel=1e-12)
    assert critical >= 2 * np.sqrt(2 * (1 - poisson) * (1 - 2 * poisson)) * (1 - 1e-12)
    if s == 1.0:
        assert critical == pytest.approx(expected, rel=1e-12)


def _coupled(rng: np.random.Generator, m: int, floating: int = 0, factor: float = 1.0) -> cq.ContactProblem:
    n = 2 * m + int(rng.integers(0, 3))
    shape = rng.normal(size=(n, n - floating))
    return cq.ContactProblem(
        stiffness=shape @ shape.T,
        load=rng.normal(size=n),
        normal=-np.eye(2 * m, n)[::2],
        gap=0.1 * rng.normal(size=m),
        tangent=np.eye(2 * m, n)[1::2],
        friction=factor * rng.choice([0.3, 0.7, 1.5, 5.0], size=m),
        slip_origin=0.2 * rng.normal(size=m),
    )


FAMILIES = {
    "any, tied or floating": (random_problem, 40),
    "two, coupled": (lambda rng: _coupled(rng, 2), 40),
    "three, coupled": (lambda rng: _coupled(rng, 3), 40),
    "three, floating": (lambda rng: _coupled(rng, 3, 1), 40),
    "five, coupled": (lambda rng: _coupled(rng, 5), 8),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_counted_as_enumeration_counts(name: str) -> None:
    """Up to five contacts: no several answers unsaid, and none said that are not there."""
    make, count = FAMILIES[name]
    rng = np.random.default_rng(13)
    several = 0
    for _ in range(count):
        found = cq.equilibria(make(rng))
        several += len(found) > 1
        for state in found:
            displacements = set(state.certificate.uniqueness) - {FORCES}
            assert displacements == ({SEVERAL} if len(found) > 1 else set())
    assert several >= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "sizes",
    [((5, 1.0), (5, 0.02), (5, 0.01)), pytest.param(((6, 1.0), (6, 0.02), (7, 0.01)), marks=pytest.mark.slow)],
    ids=["five", "six and seven"],
)
def test_more_contacts_are_judged_for_every_load(sizes: tuple[tuple[int, float], ...]) -> None:
    """Five and more contacts: never silent where there are several; silent where friction is small."""
    rng = np.random.default_rng(3)
    silent = 0
    for m, factor in sizes:
        found = cq.equilibria(_coupled(rng, m, factor=factor))
        for state in found:
            said = set(state.certificate.uniqueness) - {FORCES}
            assert said <= {POSSIBLE}
            assert said or len(found) == 1
            silent += not said
    assert silent >= 2


def test_small_friction_is_proven_unique_in_space() -> None:
    rng = np.random.default_rng(2)
    proven = 0
    for _ in range(20):
        known = known_answer(rng, 3)
        problem = known.problem.replace(friction=0.01 * known.problem.friction)
        if not problem.frictional:
            continue
        found = cq.critical_friction(problem)
        assert found.unique == (found.kappa < 1)
        proven += found.unique
        if np.isfinite(found.kappa):
            above = problem.replace(friction=1.001 / found.kappa * problem.friction)
            assert cq.critical_friction(above).kappa == pytest.approx(1.001, rel=1e-9), "kappa grows with mu"
    assert proven >= 5


def test_kappa_of_one_contact() -> None:
    """sup mu |a| |e| / (a S a + e e/W_TT) = mu/2 sqrt(W_TT/S), S = 1 - 4/5: 2.5 mu."""
    problem = one_contact(KLARBRING, (0.3, 1.25), 0.2)
    assert cq.critical_friction(problem).kappa == pytest.approx(0.5, rel=1e-12)
    assert cq.critical_friction(problem.replace(friction=0.45)).unique, "by the determinants"


@pytest.mark.slow
def test_the_bound_for_every_load_is_never_above_the_determinants() -> None:
    """Just below kappa = 1 all determinants have one sign, and Tresca's fixed point contracts by no more than kappa."""
    rng = np.random.default_rng(0)
    nearest = np.inf
    for _ in range(40):
        p = _coupled(rng, int(rng.integers(1, 5)))
        p = p.replace(friction=0.999 / cq.critical_friction(p).kappa * p.friction)
        compliance = contact_compliance(p, condense(p)).W
        assert _one_sign(compliance, p.friction, 0.0)
        assert cq.solve(p).certificate.contraction < 1
        factors = (1.01, 1.1, 2.0, 10.0, 100.0)
        more = [factor for factor in factors if not _one_sign(compliance, factor * p.friction, 0.0)]
        nearest = min(nearest, *more, 1e3)
    assert nearest <= 1.1, "and the bound is met"


def test_redundant_contacts_share_their_forces() -> None:
    doubled = dict(normal=[[0.0, -1.0]] * 2, gap=[1e-3] * 2, tangent=[[1.0, 0.0]] * 2, slip_origin=[TOUCH] * 2)
    for friction in (0.3, 0.8):
        solution = cq.solve(rough_truss(friction, **doubled, contact_names=["left", "right"]))
        assert FORCES in solution.certificate.uniqueness
        assert any("left, right" in note for note in solution.certificate.notes)
        assert SEVERAL not in solution.certificate.uniqueness, "the displacement is unique"
    assert cq.solve(rough_truss()).certificate.uniqueness == ()


def test_a_wedged_block_holds_itself_with_any_force() -> None:
    """Between opposite walls, hanging by friction: the walls' forces are anything from mg/(2 mu) on."""
    block = cq.ContactProblem(
        stiffness=np.zeros((2, 2)),
        load=[0.0, -1.0],
        normal=[[1.0, 0.0], [-1.0, 0.0]],
        gap=[0.0, 0.0],
        tangent=[[0.0, 1.0]] * 2,
        friction=0.5,
    )
    held = cq.certify(block, [0.0, 0.0], [2.0, 2.0], [-0.5, -0.5])
    assert held.passed
    assert FORCES in held.uniqueness


def test_a_sticking_contact_beside_a_tie_along_it_is_redundant_in_its_friction() -> None:
    tied = rough_truss(0.8, tie=[[1.0, 0.0]], tie_value=[TOUCH])
    assert FORCES in cq.solve(tied).certificate.uniqueness


def test_what_the_critical_coefficients_say_is_printed_in_words() -> None:
    data = dict(stiffness=[[5.0, -2.0], [-2.0, 1.0]], load=[-1.0, 0.65], normal=[[-1.0, 0.0]], gap=[0.0])
    several, one = (
        str(cq.critical_friction(cq.ContactProblem(**data, tangent=[[0.0, 1.0]], friction=mu))) for mu in (0.8, 0.1)
    )
    assert several.splitlines() == [
        "critical friction coefficient: 0.5, at contact 0, the least of 1 contact",
        "largest ratio of a contact's friction coefficient to its critical value: 1.6:",
        "  some load has several answers",
        "several answers are not excluded: the determinants of all combinations of open,",
        "  stick and slip are not all of one sign",
    ]
    assert "one answer to every load: the bound kappa is 0.25, below 1" in one


def test_contraction_is_that_of_the_bounds() -> None:
    """One sliding contact: mu |W_NT| / W_NN = mu/mu_c; nothing contracts where nothing slides."""
    sliding = cq.solve(one_contact(KLARBRING, (-7.0, -17.0), 0.8))
    assert sliding.certificate.contraction == pytest.approx(1.6, rel=1e-12)
    assert any("without damping it does not converge" in note for note in sliding.certificate.notes)
    assert cq.solve(one_contact(KLARBRING, (-7.0, -17.0), 0.4)).certificate.contraction == pytest.approx(0.8)
    assert cq.solve(pad(100.0)).certificate.contraction == 0.0
    assert cq.solve(two_masses(12.0)).certificate.contraction == pytest.approx(0.0, abs=1e-12)
    assert cq.solve(rough_truss(friction=0.0)).certificate.contraction is None


def test_bounds_of_contacts_that_stick_have_no_effect_and_form_no_system(monkeypatch: pytest.MonkeyPatch) -> None:
    solved, solve = [], uniqueness.contact_compliance
    monkeypatch.setattr(uniqueness, "contact_compliance", lambda *given: solved.append(given) or solve(*given))
    assert cq.solve(pad(100.0)).certificate.contraction == 0.0
    assert not solved


def test_contraction_in_space_against_the_plain_fixed_point() -> None:
    """Two coupled contacts that slide; bounds theta are put in by hand, differences of mu l_N are the Jacobian."""
    from scipy.optimize import root

    rng = np.random.default_rng(4)
    for _ in range(200):
        known = known_answer(rng, 3, m=2)
        p = known.problem
        slides = (known.normal_force > 0) & (np.linalg.norm(known.friction_force, axis=1) > 0) & (p.friction > 0)
        slip = (p.tangent @ known.displacement).reshape(2, 2) - p.slip_origin
        if np.all(slides) and np.all(np.linalg.norm(slip, axis=1) > 0.1) and not p.ties:
            break
    K, N, T = np.asarray(p.stiffness), p.normal.toarray(), p.tangent.toarray()
    if np.linalg.matrix_rank(K) < len(K):
        K = K + 1e-3 * np.eye(len(K))
        p = cq.ContactProblem(K, p.load + 1e-3 * known.displacement, N, p.gap, T, p.friction, p.slip_origin)

    def pressed(bound: np.ndarray) -> np.ndarray:
        def equations(y: np.ndarray) -> np.ndarray:
            u, force = y[: len(K)], y[len(K) :]
            s = (T @ u).reshape(2, 2) - p.slip_origin
            rubbed = bound[:, None] * s / np.linalg.norm(s, axis=1)[:, None]
            return np.r_[K @ u + N.T @ force + T.T @ rubbed.ravel() - p.load, N @ u - p.gap]

        return root(equations, np.r_[known.displacement, known.normal_force], tol=1e-13).x[len(K) :]

    at = p.friction * known.normal_force
    step = 1e-5
    change = [(pressed(at + step * e) - pressed(at - step * e)) / (2 * step) for e in np.eye(2)]
    radius = np.max(abs(np.linalg.eigvals(p.friction[:, None] * np.array(change).T)))
    certificate = cq.certify(p, known.displacement, known.normal_force, known.friction_force)
    assert certificate.passed
    assert radius > 1e-3
    assert certificate.contraction == pytest.approx(radius, rel=1e-5)


def test_foreign_and_large_answers_are_still_certified(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = one_contact(KLARBRING, (0.3, 1.25), 0.8)
    wrong = cq.certify(problem, [1.0, 2.0], [0.3], [0.1])
    assert not wrong.passed
    assert wrong.uniqueness == (SEVERAL,), "that is a property of the problem"
    assert cq.certify(problem, [np.nan, 0.0], [0.0], [0.0]).uniqueness == (UNKNOWN,)
    monkeypatch.setattr("contactqp.certificate.critical_friction.MOST_CONTACTS", 0)
    skipped = cq.solve(problem, algorithm="tresca").certificate
    assert skipped.uniqueness == (UNKNOWN,)
    assert skipped.notes == ("uniqueness was not examined: 1 contact, at most 0 are examined",)
    with pytest.raises(cq.Unsupported, match="at most 0"):
        cq.critical_friction(problem)
    with pytest.raises(cq.InvalidProblem, match="with friction"):
        cq.critical_friction(pad(1.0, friction=0.0))


def test_the_findings_survive_changes_of_units_and_rows() -> None:
    """Critical coefficients and kappa are numbers without unit; the rows of contact i may be scaled by r_i."""
    rng = np.random.default_rng(6)
    for _ in range(10):
        p = _coupled(rng, 3)
        d, r = 10.0 ** rng.uniform(-3, 3, p.dimension), 10.0 ** rng.uniform(-3, 3, 3)
        other = cq.ContactProblem(
            stiffness=p.stiffness * np.outer(d, d) * 1e9,
            load=p.load * d,
            normal=p.normal.toarray() * d * r[:, None],
            gap=p.gap * r,
            tangent=p.tangent.toarray() * d * r[:, None],
            friction=p.friction,
        )
        here, there = cq.critical_friction(p), cq.critical_friction(other)
        assert there.single == pytest.approx(here.single, rel=1e-8)
        assert there.kappa == pytest.approx(here.kappa, rel=1e-6)
        assert there.unique == here.unique


def test_compliances_whose_inverse_leaves_the_floats_are_no_contraction():
    with np.errstate(over="ignore"):  # as in every public function
        found = of_operator(np.diag([1e-300, 1e300, 1.0, 1.0]), np.array([0.5, 0.5]), 2, floats=False)
    assert found.kappa == np.inf


def test_other_answers_are_looked_for_once_a_problem_and_anew_for_another_load(monkeypatch: pytest.MonkeyPatch) -> None:
    """Klarbring's contact has three answers at one load and one at another; all share their stiffness and rows."""
    looked, look = [], other_answers._several_answers

    def counted(problem: cq.ContactProblem, condensation: Any, doubtful: float) -> bool | None:
        if doubtful == other_answers.DOUBTFUL:
            looked.append(problem)
        return look(problem, condensation, doubtful)

    monkeypatch.setattr(other_answers, "_several_answers", counted)
    data = dict(stiffness=[[5.0, -2.0], [-2.0, 1.0]], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]])
    several = cq.ContactProblem(**data, load=[-1.0, 0.65], friction=0.8)
    assert [one.certificate.uniqueness for one in cq.equilibria(several)] == [("several answers",)] * 3
    assert len(looked) == 1
    for load in ([-1.0, 0.2], [-1.0, 0.65]):
        found = {one.certificate.uniqueness for one in cq.equilibria(several.replace(load=load))}
        assert found == ({("several answers",)} if load[1] == 0.65 else {()})
    assert len(looked) == 3


def tresca_problems(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Counts of the sliding bounds of every convex problem that is solved from now on; 0 is that without friction."""
    solved: list[int] = []
    convex, first = tresca._Run._convex_answer, tresca._Run._without_friction
    monkeypatch.setattr(tresca._Run, "_without_friction", lambda self: solved.append(0) or first(self))
    monkeypatch.setattr(
        tresca._Run, "_convex_answer", lambda self, *given: solved.append(given[1]) or convex(self, *given)
    )
    return solved


def test_the_only_answer_is_tried_before_tresca_problems_are_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    """One problem without friction suggests the combination; asked for by name the iteration takes its steps."""
    whole, solved = cq.solve(rough_truss(), algorithm="tresca"), tresca_problems(monkeypatch)
    found = cq.solve(rough_truss())
    assert solved == [0]
    assert found.certificate.passed
    assert not found.certificate.uniqueness
    assert np.allclose(found.displacement, whole.displacement, rtol=1e-15, atol=0)
    assert np.allclose(found.friction_force, whole.friction_force, rtol=1e-15, atol=0)
    solved.clear()
    cq.solve(rough_truss(), algorithm="tresca")
    assert solved == [0, 1]


def test_where_several_answers_may_exist_the_iteration_chooses(monkeypatch: pytest.MonkeyPatch) -> None:
    steep = cq.ContactProblem([[2.0, -1.9], [-1.9, 2.0]], [0.5, -1.0], [[0.0, -1.0]], [0.0], [[1.0, 0.0]], 3.0)
    assert not cq.critical_friction(steep).unique
    chosen, solved = cq.solve(steep, algorithm="tresca"), tresca_problems(monkeypatch)
    found = cq.solve(steep)
    assert len(solved) > 1
    assert np.array_equal(found.normal_force, chosen.normal_force)


@pytest.mark.parametrize(("short", "claimed"), [(0.0, "several answers"), (1e-10, "several answers possible")])
def test_a_block_near_its_limit_has_several_answers_only_at_the_limit(short: float, claimed: str) -> None:
    """At mu W it may rest or have slid any way; below by the smallest part it rests, and that alone."""
    weight, mu = 128.0, 0.5
    load = [mu * weight * (1 - short), -weight]
    block = cq.ContactProblem(np.zeros((2, 2)), load, [[0.0, -1.0]], [0.0], tangent=[[1.0, 0.0]], friction=mu)
    assert claimed in cq.solve(block).certificate.uniqueness
    (exact,) = cq.exact_equilibria(block)
    assert ("one of a continuum" in repr(exact)) == (short == 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 0, 3])
def test_answers_that_rounding_hides_are_not_solved_one_by_one(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With conditions of 1e12 the signs of hundreds of combinations may hold: in rational numbers these took 50 s."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(14, 14)) * 10.0 ** rng.uniform(-3, 3, 14)
    normal, tangent = rng.normal(size=(2, 5, 14))
    u, force, K = rng.normal(size=14), rng.uniform(1, 2, 5), A @ A.T
    K = (K + K.T) / 2
    load = K @ u + normal.T @ force
    problem = cq.ContactProblem(
        K, load, normal, normal @ u, tangent=tangent, friction=np.full(5, 0.6), slip_origin=tangent @ u
    )
    exact, asked = other_answers._exact_motions, list[int]()
    monkeypatch.setattr(other_answers, "_exact_motions", lambda *given: asked.append(24**3) or exact(*given))
    assert cq.solve(problem).certificate.uniqueness == (POSSIBLE,)
    assert sum(asked) <= other_answers.EXACT_OPERATIONS


def test_differences_of_answers_are_those_of_each_pair() -> None:
    """Two answers that differ, one that is the same up to rounding, and one whose rounding leaves it open."""
    problem = two_masses(0.5)
    system = other_answers._Systems(problem, condense(problem), 1e-9)
    y = np.zeros(system._slope.shape[1])
    force, off = np.eye(len(y))[0], np.zeros((problem.contacts, 2))
    here = other_answers._Found(y, off, True, 1.0)
    there = other_answers._Found(y + force, off, True, 1.0)
    beside = other_answers._Found(y + 1e-15 * force, off + 1e-12, True, 1.0)
    unsure = other_answers._Found(y + 1e-3 * force, off + 1e9, True, 1.0)
    assert system.apart(here, [here, there, beside, unsure]) == [False, True, False, None]


def test_the_note_says_why_no_bound_covers_the_bodies() -> None:
    """Six weights on a rough floor, held by nothing else or by springs with each contact twice."""
    n = 6
    weights, up, along = np.tile([0.1, -1.0], n), np.eye(2 * n)[1::2], np.eye(2 * n)[::2]
    loose = cq.ContactProblem(np.zeros((2 * n, 2 * n)), weights, -up, np.zeros(n), along, friction=0.3)
    assert "(contacts alone hold a body, which no bound covers" in str(cq.solve(loose).certificate.notes)
    normal, tangent = np.repeat(-up, 2, axis=0), np.repeat(along, 2, axis=0)
    sprung = cq.ContactProblem(5.0 * np.eye(2 * n), weights, normal, np.zeros(2 * n), tangent, friction=0.3)
    assert "(rows of contacts depend on each other, which no bound covers" in str(cq.solve(sprung).certificate.notes)
