"""Many load cases have the answers of `solve` one by one; one that fails, or is wrong, is named and stops no other."""

from __future__ import annotations

import pickle
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.analysis import many_loads
from contactqp.linalg.exact_algebra import dot, solutions
from contactqp.linalg.influence import NEIGHBOURS, SolvedCases

BAR = cq.ContactProblem([[157500.0]], [0.0], [[1.0]], [1e-3], units={"length": "m", "force": "kN"})


def drawn(rng: np.random.Generator, kind: str) -> tuple[cq.ContactProblem, dict[str, np.ndarray]]:
    """Draw a problem of a kind and the loads, gaps and coefficients of twelve cases."""
    n, m = 8, 5
    shape = rng.standard_normal((n, n))
    K, E = shape @ shape.T + np.eye(n), rng.standard_normal((m, n))
    data: dict[str, object] = {}
    given = dict(loads=5 * rng.standard_normal((12, n)), gaps=rng.uniform(0.0, 0.5, (12, m)))
    if kind == "ties":
        data.update(tie=rng.standard_normal((2, n)), tie_value=[0.1, -0.2])
    if kind == "redundant":
        E[-1] = E[0]
        given["gaps"][:, -1] = given["gaps"][:, 0]
    if kind == "floats":  # two springs between four masses on two stops, pressed down
        K = np.kron(np.eye(4), [[1.0, -1.0], [-1.0, 1.0]]) * np.repeat([1.0, 5.0, 2.0, 3.0], 2)
        E = np.kron(np.eye(4), [[0.0, 1.0]])
        given = dict(loads=rng.uniform(0.1, 1.0, (12, n)), gaps=rng.uniform(0.0, 0.5, (12, 4)))
    if kind == "friction":
        data.update(tangent=rng.standard_normal((m, n)), friction=0.1)
        given["friction"] = rng.uniform(0.0, 0.2, (12, m))
    if kind == "never closes":
        given["gaps"][::2, 1] = np.inf
    return cq.ContactProblem(K, np.zeros(n), E, np.zeros(len(E)), **data), given


@pytest.fixture(params=[False, True])
def small_too(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small problems are solved by influence functions as well."""
    if request.param:
        monkeypatch.setattr(many_loads, "FEWEST_UNKNOWNS", 0)


@pytest.mark.sampled(9)
@pytest.mark.usefixtures("small_too")
@pytest.mark.parametrize("problems", [1, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["plain", "ties", "redundant", "floats", "friction", "never closes"])
def test_each_case_has_the_answer_of_its_own_problem(kind: str, problems: int) -> None:
    rng, seen = np.random.default_rng(27), 0
    for _ in range(problems):
        problem, given = drawn(rng, kind)
        many = cq.solve_many(problem, **given)
        assert many.passed.all()
        for i in range(12):
            changes = dict(load=given["loads"][i], gap=given["gaps"][i])
            changes |= {"friction": given["friction"][i]} if kind == "friction" else {}
            alone = cq.solve(problem.replace(**changes))
            near = dict(rel=1e-9, abs=1e-9 * np.max(abs(alone.normal_force), initial=1.0))
            assert problem.normal.T @ many.normal_force[i] == pytest.approx(
                problem.normal.T @ alone.normal_force, **near
            )
            if kind != "redundant":
                assert many.normal_force[i] == pytest.approx(alone.normal_force, **near)
                assert many.contact_status[i].tolist() == alone.contact_status.tolist()
            assert many.tie_force[i] == pytest.approx(alone.tie_force, **near)
            assert many.gap[i] == pytest.approx(alone.gap, rel=1e-9, abs=1e-9)
            assert many.displacement(i) == pytest.approx(alone.displacement, rel=1e-9, abs=1e-9)
            if kind == "friction":
                assert many.friction_force[i] == pytest.approx(alone.friction_force, **near)
            seen += int(np.count_nonzero(alone.normal_force))
    assert seen > 10 * problems


@pytest.mark.sampled(8)
@pytest.mark.usefixtures("small_too")
@pytest.mark.parametrize("unit", [2.0**-30, 1e-9, 1.0, 1e9])
def test_the_bar_and_the_wall_for_many_loads_in_any_units(unit: float) -> None:
    bar = cq.ContactProblem([[157500.0 / unit]], [0.0], [[1.0]], [1e-3 * unit])
    loads = np.linspace(0.0, 600.0, 31)[:, None]
    many = cq.solve_many(bar, loads=loads)
    assert many.passed.all()
    assert many.normal_force[:, 0] == pytest.approx(np.maximum(loads[:, 0] - 157.5, 0.0), rel=1e-13, abs=1e-13)
    assert many.gap[:, 0] == pytest.approx(np.maximum(1e-3 - loads[:, 0] / 157500.0, 0.0) * unit, abs=1e-17 * unit)
    worst = many.envelope()
    assert (worst.load.tolist(), worst.normal_force.tolist()) == ([30], pytest.approx([442.5]))


def test_gaps_and_loads_may_be_given_alone_or_sparse() -> None:
    gaps = np.array([[0.0], [1e-3], [1.0]])
    pressed = BAR.replace(load=[300.0])
    assert cq.solve_many(pressed, gaps=gaps).normal_force.ravel() == pytest.approx([300.0, 142.5, 0.0])
    sparse = cq.solve_many(BAR, loads=sp.csr_array([[300.0], [0.0], [157.5]]))
    assert sparse.normal_force.ravel() == pytest.approx([142.5, 0.0, 0.0], abs=1e-12)
    assert sparse.contact_status.ravel().tolist() == ["closed", "open", "grazing"]
    assert [one.normal_force.tolist() for one in sparse[:2]] == [pytest.approx([142.5]), [0.0]]
    rough = cq.ContactProblem(np.eye(2), [1.0, 1.0], [[1.0, 0.0]], [0.0], tangent=[[0.0, 1.0]])
    slid = cq.solve_many(rough, friction=np.array([[0.0], [0.5], [2.0]]))
    assert slid.friction_force.ravel() == pytest.approx([0.0, 0.5, 1.0])
    assert slid.contact_status.ravel().tolist() == ["closed", "slip", "stick"]
    assert cq.solve_many(rough, loads=[[2.0, 5.0]], friction=0.25).friction_force.ravel() == pytest.approx([0.5])


def test_one_that_fails_stops_no_other() -> None:
    mass = cq.ContactProblem([[0.0]], [0.0], [[1.0]], [0.5], contact_names=["floor"])
    many = cq.solve_many(mass, loads=[[1.0], [-1.0], [2.0]])
    assert many.passed.tolist() == [True, False, True]
    assert "the load drives a rigid motion" in many.failures[1]
    assert np.isnan(many.normal_force[1, 0])
    assert many.contact_status[1].tolist() == ["unknown"]
    assert many.normal_force[[0, 2], 0].tolist() == [1.0, 2.0]
    assert many.envelope().load.tolist() == [2]
    assert "case 1: the load drives" in str(many)
    with pytest.raises(cq.NoEquilibrium):
        many[1]
    none = cq.solve_many(mass, loads=[[-1.0]])
    assert none.envelope().load.tolist() == [-1]
    empty = cq.solve_many(mass, loads=np.zeros((0, 1)))
    for nothing in (none, empty):
        assert str(nothing.envelope()) == "1 contact: no case has an answer"
        assert "nan" not in str(nothing)


def test_bad_arguments_are_one_clear_error() -> None:
    loads = np.ones((600, 1))
    loads[517] = np.nan
    indefinite = cq.ContactProblem([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0], [[1.0, 0.0]], [0.0])
    for call, message in (
        (lambda: cq.solve_many(BAR, loads=loads), r"loads\[517\]: expected finite numbers, got nan at unknown 0"),
        (lambda: cq.solve_many(BAR), "expected loads, gaps or friction with one row for each case"),
        (lambda: cq.solve_many(BAR, friction=0.0), "expected loads, gaps or friction with one row for each case"),
        (lambda: cq.solve_many(BAR, loads=[1.0, 2.0]), r"loads: expected shape \(N, 1\), a row for each case"),
        (lambda: cq.solve_many(BAR, loads=[[1.0]], gaps=[[1.0], [2.0]]), "1 row of loads, 2 rows of gaps"),
        (lambda: cq.solve_many(BAR, gaps=[[1.0], [-np.inf]]), r"gaps\[1\]: expected finite numbers, got -inf"),
        (lambda: cq.solve_many(BAR, loads=[[1.0]], friction=[0.3]), r"friction: expected a number, shape \(N, 1\)"),
        (lambda: cq.solve_many(BAR, friction=[[0.3]]), "friction: a coefficient was given without tangent"),
        (lambda: cq.solve_many(BAR, loads=[[1.0]], warm_start=None), "expected no warm_start"),
        (lambda: cq.solve_many(BAR, load=[[1.0]]), "no argument is called 'load' .do you mean 'loads'"),
        (lambda: cq.solve_many(BAR, gap=[[1.0]]), "no argument is called 'gap' .do you mean 'gaps'"),
        (lambda: cq.solve_many(indefinite, loads=[[1.0, 2.0]], penalty=1.0), "unknown option 'penalty'"),
        (lambda: cq.solve_many(BAR, loads=[[1.0]])["a"], "i: expected a whole number, got 'a'"),
    ):
        with pytest.raises(cq.InvalidProblem, match=message):
            call()
    with pytest.raises(IndexError):
        cq.solve_many(BAR, loads=[[1.0]])[1]


def test_loads_that_are_changed_later_are_noticed() -> None:
    loads = np.array([[300.0], [400.0]])
    many = cq.solve_many(BAR, loads=loads)
    loads[1] = 500.0
    assert many[0].normal_force.tolist() == pytest.approx([142.5])
    with pytest.raises(cq.InvalidProblem, match=r"loads\[1\]: expected what solve_many was given"):
        many.displacement(1)


def test_answers_are_pickled_and_printed() -> None:
    many = cq.solve_many(BAR, loads=[[300.0], [400.0]])
    again = pickle.loads(pickle.dumps(many))
    assert again.normal_force.tolist() == many.normal_force.tolist()
    assert again[1].normal_force.tolist() == many[1].normal_force.tolist()
    assert repr(many) == "Solutions(active-set, 2 cases, 1 contact, 2 passed)"
    assert str(many).splitlines()[-1].split() == ["contact", "0", "242.5", "1"]
    told: list[str] = []
    cq.solve_many(BAR, loads=[[300.0]], progress=told.append)
    assert told


def plate(cells: int, unit: float = 1.0, apart: float = 1.0, friction: float = 0.0) -> cq.ContactProblem:
    """A strip of plane-strain elements over a floor, held at its top; units of its unknowns that far apart."""
    steel = cq.Material(1.0 / unit, 0.3)
    body = cq.Body(cq.rectangle(2.0, 1.0, (2 * cells, cells)), steel, "plane-strain", name="block")
    structure = cq.Structure([body])
    system = structure.assemble([cq.Support("block", "top", axis) for axis in range(2)])
    floor = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, -1e-3], [0.0, 1.0]))
    problem = system.problem([floor], friction=friction)
    scale = sp.diags(np.where(np.arange(problem.dimension) % 2, apart, 1.0))
    rubs = dict(tangent=problem.tangent @ scale, friction=friction) if friction else {}
    return cq.ContactProblem(
        scale @ problem.stiffness @ scale, problem.load, problem.normal @ scale, problem.gap, **rubs
    )


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("unit", "apart", "friction"), [
    (1.0, 1.0, 0.3), (2.0**40, 1.0, 0.3), (1e-9, 1.0, 0.05), (1.0, 1e-3, 0.7)
])  # fmt: skip
def test_influence_functions_prove_equilibria_with_friction(unit: float, apart: float, friction: float) -> None:
    """In any order of the cases; where several answers are possible a solution is that of the forces."""
    problem, rng = plate(12, unit, apart, friction), np.random.default_rng(5)
    m, along = problem.contacts, np.asarray(problem.tangent.sum(axis=0)).ravel()
    push = np.zeros((40, problem.dimension))
    push[:, problem.normal.indices] = -rng.uniform(0.0, 4e-3, (40, m)) / unit * apart
    push += np.linspace(-1e-3, 1e-3, 40)[:, None] * along / unit
    many = cq.solve_many(problem, loads=push)
    assert many.work.routes == ("influence functions: 40 of 40 cases",)
    assert many.proven.all()
    words = set()
    for i in range(0, 40, 4):
        largest = np.max(many.normal_force[i])
        one = many[i]
        assert one.certificate.passed
        assert one.normal_force == pytest.approx(many.normal_force[i], abs=1e-11 * largest)
        assert one.friction_force == pytest.approx(many.friction_force[i], abs=1e-11 * largest)
        assert np.all(abs(many.normal_force[i] - one.normal_force) <= many.force_bound[i])
        assert np.all(abs(many.friction_force[i] - one.friction_force)[:, 0] <= many.force_bound[i])
        assert np.all(many.force_bound[i] <= 1e-6 * largest)
        assert one.contact_status.tolist() == many.contact_status[i].tolist()
        words |= set(one.contact_status.tolist())
    assert words >= {"open", "slip"}
    mixed = rng.permutation(40)
    assert cq.solve_many(problem, loads=push[mixed]).normal_force == pytest.approx(many.normal_force[mixed], rel=1e-12)
    rough = np.linspace(0.0, friction, 40)[:, None]
    varied = cq.solve_many(problem.replace(load=push[7]), friction=rough)
    assert varied.work.routes[0].endswith("of 40 cases")
    assert varied[31].normal_force == pytest.approx(varied.normal_force[31], abs=1e-11 * np.max(varied.normal_force))


@pytest.mark.sampled(5)
@pytest.mark.parametrize(("unit", "apart"), [(1.0, 1.0), (2.0**40, 1.0), (1e-9, 1.0), (1.0, 1e-3), (1e6, 1e3)])
def test_influence_functions_prove_forces_that_solve_finds_too(unit: float, apart: float) -> None:
    problem, rng = plate(12, unit, apart), np.random.default_rng(5)
    push = np.zeros((40, problem.dimension))
    push[:, problem.normal.indices] = -rng.uniform(0.0, 4e-3, (40, problem.contacts)) / unit * apart
    many = cq.solve_many(problem, loads=push)
    assert many.passed.all()
    assert many.proven.all()
    assert many.work.routes == ("influence functions: 40 of 40 cases",)
    closed = 0
    for i in range(0, 40, 5):
        alone = cq.solve(problem.replace(load=push[i]))
        largest = np.max(alone.normal_force)
        assert many.normal_force[i] == pytest.approx(alone.normal_force, abs=1e-11 * largest)
        assert np.all(abs(many.normal_force[i] - alone.normal_force) <= many.force_bound[i])
        assert np.all(many.force_bound[i] <= 1e-6 * largest)
        assert many.gap[i] == pytest.approx(alone.gap, rel=1e-9, abs=1e-15)
        assert many.contact_status[i].tolist() == alone.contact_status.tolist()
        closed += int(np.sum(alone.contact_status == "closed"))
    assert closed > 20
    sparse = cq.solve_many(problem, loads=sp.csr_array(push))
    assert sparse.normal_force == pytest.approx(many.normal_force, rel=1e-12)
    gaps = problem.gap + rng.uniform(0.0, 1e-3, (20, problem.contacts))
    wider = cq.solve_many(problem.replace(load=push[0]), gaps=gaps)
    assert wider.work.routes == ("influence functions: 20 of 20 cases",)
    alone = cq.solve(problem.replace(load=push[0], gap=gaps[7]))
    assert wider.normal_force[7] == pytest.approx(alone.normal_force, abs=1e-11 * np.max(alone.normal_force))


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("unit", [2.0**-40, 1.0, 1e9])
def test_bodies_that_contacts_alone_hold_are_proven_together(friction: float, unit: float) -> None:
    """A block on a floor, that rests against a wall where it is smooth, under its weight and a push of each case."""
    steel = cq.Material(1.0 / unit, 0.3)
    body = cq.Body(cq.rectangle(2.0, 1.0, (24, 12)), steel, "plane-strain", name="block")
    structure, rng = cq.Structure([body]), np.random.default_rng(8)
    pairs = [cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, -1e-3], [0.0, 1.0]))]
    if not friction:
        pairs.append(cq.pair(structure.surface("block", "left"), cq.Plane([-1e-3, 0.0], [1.0, 0.0])))
    problem = structure.assemble([]).problem(pairs, **({"friction": friction} if friction else {}))
    push = np.zeros((24, problem.dimension))
    push[:, 1::2] = -1e-6 / unit * (1 + rng.random((24, 1)))
    push[:, 0::2] = -1e-7 / unit * (1 + rng.random((24, 1)))
    push += 1e-7 / unit * rng.standard_normal(push.shape)
    many = cq.solve_many(problem, loads=push)
    route = many.work.routes[0].split()
    assert (many.passed.all(), many.proven.all(), route[0]) == (True, True, "influence")
    assert int(route[2]) >= 20
    for i in range(0, 24, 6):
        alone, one, largest = cq.solve(problem.replace(load=push[i])), many[i], np.max(many.normal_force[i])
        for other in (alone, one):
            assert other.normal_force == pytest.approx(many.normal_force[i], abs=1e-11 * largest)
            assert np.all(abs(many.normal_force[i] - other.normal_force) <= many.force_bound[i] + 1e-14 * largest)
            assert other.contact_status.tolist() == many.contact_status[i].tolist()
            assert other.gap == pytest.approx(many.gap[i], abs=1e-12)
            if friction:
                assert other.friction_force == pytest.approx(many.friction_force[i], abs=1e-11 * largest)
    # What nothing holds is left to `solve`, which says so.
    lifted = cq.solve_many(problem, loads=np.vstack([push, -push[:1]]))
    assert lifted.passed.tolist() == [True] * 24 + [False]
    assert "drives" in lifted.failures[24] or "held" in lifted.failures[24]


@pytest.mark.slow
def test_no_bound_is_below_the_true_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many_loads, "FEWEST_UNKNOWNS", 0)
    rng, seen = np.random.default_rng(1), 0
    for _ in range(10):
        shape = rng.integers(-3, 4, (5, 5)).astype(float)
        K = shape @ shape.T + np.eye(5)
        problem = cq.ContactProblem(K, np.zeros(5), rng.integers(-2, 3, (3, 5)).astype(float), [0.125, 0.25, 0.5])
        loads = rng.integers(-9, 10, (6, 5)).astype(float)
        many = cq.solve_many(problem, loads=loads)
        for i in np.flatnonzero(np.isfinite(many.force_bound).all(axis=1)):
            true = np.array([float(force) for force in cq.exact(problem.replace(load=loads[i])).normal_force])
            assert np.all(abs(many.normal_force[i] - true) <= many.force_bound[i])
            seen += np.count_nonzero(true)
    assert seen > 40


@pytest.mark.parametrize(
    ("seed", "problems"), [(0, 1), *(pytest.param(seed, 6, marks=pytest.mark.slow) for seed in range(4))]
)
def test_no_bound_with_friction_is_below_the_true_error(
    seed: int, problems: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against Fractions: an equilibrium is within the bounds, with ties and coefficients of each contact, too."""
    monkeypatch.setattr(many_loads, "FEWEST_UNKNOWNS", 0)
    rng, seen, rubs = np.random.default_rng(seed), 0, set()
    for _ in range(problems):
        shape = rng.integers(-3, 4, (8, 8)).astype(float)
        rows = rng.integers(-2, 3, (7, 8)).astype(float)
        rows[~rows.any(axis=1), 0] = 1.0
        problem = cq.ContactProblem(
            shape @ shape.T + 2 * np.eye(8), np.zeros(8), rows[:3], [0.125, 0.25, 0.5], rows[3:6],
            rng.integers(0, 5, 3) / 8, [[0.5], [0.0], [-0.25]], tie=rows[6:], tie_value=[0.25],
        )  # fmt: skip
        loads = rng.integers(-9, 10, (6, 8)).astype(float)
        many = cq.solve_many(problem, loads=loads)
        for i in np.flatnonzero(np.isfinite(many.force_bound).all(axis=1)):
            near = []
            for one in cq.exact_equilibria(problem.replace(load=loads[i])):
                normal, drag = ([float(x) for x in np.ravel(part)] for part in (one.normal_force, one.friction_force))
                off = np.hypot(many.normal_force[i] - normal, many.friction_force[i, :, 0] - drag)
                near.append(bool(np.all(off <= many.force_bound[i])))
            assert sum(near) == 1
            seen += np.count_nonzero(many.normal_force[i])
            rubs |= set(many.contact_status[i].tolist())
    assert seen > 4 * problems
    assert rubs >= {"open", "slip"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_what_sticks_in_space_is_proven_and_no_bound_is_below_the_true_error(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against Fractions: forces on open and sticking contacts solve a linear system, and meet the law there."""
    monkeypatch.setattr(many_loads, "FEWEST_UNKNOWNS", 0)
    rng, found, seen = np.random.default_rng(seed), 0, set()
    for _ in range(6):
        shape, rows = rng.integers(-3, 4, (9, 9)).astype(float), rng.integers(-2, 3, (7, 9)).astype(float)
        rows[:2] += 3 * np.eye(2, 9)
        K, N, T, A = shape @ shape.T + 2 * np.eye(9), rows[:2] * 4.0, rows[2:6], rows[6:]
        mu, origin, gap = np.array([2.0, 8.0]), np.array([[0.5, 0.0], [-0.25, 0.25]]), [0.125, 0.25]
        problem = cq.ContactProblem(K, np.zeros(9), N, gap, T, mu, origin, tie=A, tie_value=[0.25])
        loads = rng.integers(-9, 10, (12, 9)).astype(float)
        loads[6:] += rng.integers(0, 9, (6, 2)) @ N
        loads[0] = 0.0  # nothing slips in the first case
        many = cq.solve_many(problem, loads=loads)
        found += int(many.work.routes[0].split()[2]) if many.work.routes else 0
        for i in np.flatnonzero(np.isfinite(many.force_bound).all(axis=1)):
            status = many.contact_status[i].tolist()
            if "slip" in status:
                continue
            held = [j for j, word in enumerate(status) if word == "stick"]
            along = [2 * j + k for j in held for k in range(2)]
            E = np.vstack([N[held], T[along], A])
            right = [*loads[i], *np.array(gap)[held], *origin.ravel()[along], 0.25]
            system = np.block([[K, E.T], [E, np.zeros((len(E), len(E)))]])
            exact = solutions(
                [list(map(Fraction, [*row, b])) for row, b in zip(system, right, strict=True)], 9 + len(E)
            )
            u, forces = exact.point[:9], exact.point[9:]
            normal, drag = np.zeros(2), np.zeros((2, 2))
            for place, j in enumerate(held):
                push = forces[place]
                pair = forces[len(held) + 2 * place : len(held) + 2 * place + 2]
                assert push > 0
                assert pair[0] ** 2 + pair[1] ** 2 < (Fraction(mu[j]) * push) ** 2
                normal[j], drag[j] = push, pair
            opened = [Fraction(gap[j]) - dot(list(map(Fraction, N[j])), u) for j in range(2) if j not in held]
            assert all(one > 0 for one in opened)
            off = np.hypot(many.normal_force[i] - normal, np.linalg.norm(many.friction_force[i] - drag, axis=1))
            assert np.all(off <= many.force_bound[i])
            seen |= set(status)
    assert found > 5
    assert seen == {"open", "stick"}


@pytest.mark.slow
def test_a_block_in_space_that_sticks_is_proven_and_one_that_slips_is_solved(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(many_loads, "FEWEST_UNKNOWNS", 0)
    block = cq.Body(cq.box((2.0, 2.0, 1.0), (6, 6, 3)), cq.Material(1e4, 0.3), "3d", name="block")
    structure = cq.Structure([block])
    system = structure.assemble([cq.Support("block", "top", axis) for axis in range(3)])
    floor = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0, -1e-4], [0.0, 0.0, 1.0]))
    problem, rng = system.problem([floor], friction=1.5), np.random.default_rng(1)
    push = np.zeros((24, problem.dimension))
    push[:, problem.normal.indices] = -rng.uniform(0.5, 0.7, (24, problem.contacts))
    push[:, problem.tangent.indices] += rng.uniform(-0.02, 0.02, (24, len(problem.tangent.indices)))
    push[7] = 0.0  # nothing touches
    many = cq.solve_many(problem, loads=push)
    assert many.work.routes == ("influence functions: 24 of 24 cases",)
    assert many.proven.all()
    for i in (0, 3, 7, 23):
        alone = cq.solve(problem.replace(load=push[i]))
        off = np.hypot(
            many.normal_force[i] - alone.normal_force,
            np.linalg.norm(many.friction_force[i] - alone.friction_force, axis=1),
        )
        assert np.all(off <= many.force_bound[i])
        assert many.contact_status[i].tolist() == alone.contact_status.tolist()
        assert many[i].certificate.passed
        assert many.displacement(i) == pytest.approx(alone.displacement, abs=1e-12 * np.max(abs(alone.displacement)))
    push[:, problem.tangent.indices] += 2.0
    slides = cq.solve_many(problem, loads=push[:3])
    assert slides.passed.all()
    assert not slides.work.routes
    assert "slip" in slides.contact_status[0]
    assert capfd.readouterr() == ("", "")


def test_what_is_close_to_another_set_is_left_to_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many_loads, "FEWEST_UNKNOWNS", 0)
    bars = cq.ContactProblem(np.diag([2.0, 4.0]), [0.0, 0.0], np.eye(2), [1.0, 1.0])
    loads = np.array([[2.0, 8.0], [2.0 + 1e-12, 8.0], [3.0, 8.0], [0.0, 0.0]])
    many = cq.solve_many(bars, loads=loads)
    assert many.passed.all()
    assert many.work.routes == ("influence functions: 2 of 4 cases",)
    assert many.contact_status[0].tolist() == ["grazing", "closed"]
    assert many.normal_force[2:].ravel() == pytest.approx([1.0, 4.0, 0.0, 0.0])


def test_functions_that_are_not_accurate_are_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chain of bars, two of them 1e12 times as stiff: what its end feels of the first is lost in its factors."""
    monkeypatch.setattr(many_loads, "FEWEST_UNKNOWNS", 0)
    k = np.array([1.0, 1e12, 1e12, 1.0])
    K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    chain = cq.ContactProblem(K, np.zeros(4), [[0.0, 0.0, 0.0, 1.0]], [0.1])
    many = cq.solve_many(chain, loads=np.outer(np.arange(1.0, 5.0), [0.0, 0.0, 0.0, 1.0]))
    for i in range(4):
        alone = cq.solve(chain.replace(load=[0.0, 0.0, 0.0, i + 1.0]))
        assert many.normal_force[i] == pytest.approx(alone.normal_force, rel=1e-9)
    assert many.work.routes == ("influence functions: 0 of 4 cases",)


@pytest.mark.slow
def test_the_table_of_load_cases_has_a_row_for_every_contact_of_every_case(tmp_path):
    problem, given = drawn(np.random.default_rng(7), "friction")
    many = cq.solve_many(problem, **given)
    table = many.table()
    assert len(table) == 12 * problem.contacts
    for i in (0, 5, 11):
        for j, row in enumerate(table[i * problem.contacts : (i + 1) * problem.contacts]):
            assert (row.case, row.contact, row.status) == (i, problem.contact_name(j), many.contact_status[i, j])
            assert (row.normal_force, row.gap) == (many.normal_force[i, j], many.gap[i, j])
            assert row.friction_force == tuple(many.friction_force[i, j])
    many.write_csv(tmp_path / "cases.csv")
    header, first, *more = (tmp_path / "cases.csv").read_text().splitlines()
    assert header == "case,contact,status,normal_force,friction_force,gap,passed"
    assert first.split(",")[0] == "0"
    assert float(first.split(",")[3]) == many.normal_force[0, 0]
    assert len(more) == len(table) - 1
    assert str(table).splitlines()[1].split() == ["case", "contact", "status", "normal", "friction", "gap", "passed"]


def test_load_cases_are_called_by_their_names_and_one_without_an_answer_is_unknown(tmp_path):
    floating = cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [0.0, 0.0], [[0.0, 1.0]], [0.1])
    many = cq.solve_many(floating, loads=[[1.0, 0.0], [-1.0, 0.0]])
    pressed, pulled = many.table(["pressed", "pulled"])
    assert (pressed.case, pressed.normal_force, pressed.passed) == ("pressed", 1.0, True)
    assert (pulled.case, pulled.status, pulled.passed) == ("pulled", "unknown", False)
    assert np.isnan(pulled.normal_force)
    for names, said in ((["a"], "expected 2 names, got 1"), (["a", "a"], "distinct names"), (3, "a sequence")):
        with pytest.raises(cq.InvalidProblem, match=said):
            many.write_csv(tmp_path / "cases.csv", names)
    with pytest.raises(cq.InvalidProblem, match="expected a file that can be written"):
        many.write_csv(tmp_path / "no" / "cases.csv")


def test_a_case_begins_with_the_states_of_the_nearest_of_the_last_cases() -> None:
    solved = SolvedCases()
    assert solved.nearest(np.zeros(1)) is None
    for load in range(NEIGHBOURS + 2):
        solved.keep(np.array([float(load)]), np.array([load % 7], dtype=np.int8))
    assert solved.nearest(np.array([50.2])).tolist() == [50 % 7]
    assert solved.nearest(np.array([-1.0])).tolist() == [2]  # the first two were given up


def test_many_cases_of_two_unknowns_are_proven_together() -> None:
    """Two bars and a gap between them: max(0, k2/(k1 + k2) (f - k1 g)) passes it, of a load f on the first."""
    k1, k2, gap = 157500.0, 315000.0, 1e-3
    bars = cq.ContactProblem([[k1, 0.0], [0.0, k2]], [0.0, 0.0], [[1.0, -1.0]], [gap])
    forces = np.linspace(0, 600, many_loads.MANY_CASES)
    many = cq.solve_many(bars, loads=np.column_stack([forces, 0 * forces]))
    assert many.work.routes == (f"influence functions: {len(forces)} of {len(forces)} cases",)
    assert many.proven.all()
    exact = np.maximum(0.0, k2 / (k1 + k2) * (forces - k1 * gap))
    np.testing.assert_allclose(many.normal_force[:, 0], exact, atol=1e-12 * exact.max())
    assert np.all(abs(many.normal_force[:, 0] - exact) <= many.force_bound[:, 0] + 1e-13 * exact.max())
    assert cq.solve_many(bars, loads=many[1].problem.load[None]).work.routes == ()
