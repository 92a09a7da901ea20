"""Problems, answers and verdicts cannot be changed, share no array with their maker, and are read as plain numbers."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg.condensation import condense
from contactqp.model.problem_data import read_only
from tests.examples import truss
from tests.public_objects import solid

K = np.array([[2.0, -1.0], [-1.0, 2.0]])
PLANE: dict[str, Any] = dict(
    stiffness=K, load=[1.0, 3.0], normal=[[0.0, 1.0]], gap=[0.1], tangent=[[1.0, 0.0]], friction=0.3, slip_origin=[0.0]
)
LOCAL: dict[str, Any] = dict(delassus=np.diag([2.0, 1.0]), offset=[-3.0, 0.5], friction=0.4, dimension=2)


def arrays(holder: Any, seen: set[int] | None = None, path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """All arrays that can be reached from an object of the package: by attributes, properties, and in tuples."""
    seen = set() if seen is None else seen
    if id(holder) in seen:
        return
    seen.add(id(holder))
    if isinstance(holder, np.ndarray):
        yield path, holder
    elif sp.issparse(holder):
        for part in ("data", "indices", "indptr"):
            yield f"{path}.{part}", getattr(holder, part)
    elif isinstance(holder, (tuple, list)):
        for i, part in enumerate(holder):
            yield from arrays(part, seen, f"{path}[{i}]")
    elif type(holder).__module__.startswith("contactqp") and not isinstance(holder, type):
        for name in [name for name in dir(holder) if not name.startswith("_")]:
            value = getattr(holder, name)
            if not callable(value):
                yield from arrays(value, seen, f"{path}.{name}")


def sparse_plane() -> cq.ContactProblem:
    rows = dict(stiffness=sp.coo_array(K), normal=sp.csc_array([[0.0, 1.0]]), tie=sp.csr_array((0, 2)))
    return cq.ContactProblem(**PLANE | rows)


FLOOR = cq.Plane([0.0, -0.1], [0.0, 1.0])
EDGE: dict[str, Any] = dict(
    points=np.array([[0.0, 0.0], [1.0, 0.0]]), facets=np.array([[0, 1]]), unknowns=np.arange(4).reshape(2, 2)
)


def side(**changes: Any) -> cq.Surface:
    return cq.Surface(**EDGE | changes)


def arch(**changes: Any) -> cq.Supported:
    bars = dict(nodes=[[-1, 0], [0, 0.2], [1, 0]], bars=[[0, 1], [1, 2]], modulus=100.0, area=1.0) | changes
    return cq.Supported(cq.NonlinearTruss(**bars), held=[0, 1, 4, 5])


def held_block() -> cq.System:
    block = cq.Body(cq.rectangle(2.0, 1.0, (2, 1), "quad4"), cq.Material(1.0, 0.3, 1.0), "plane-strain", name="block")
    supports = [cq.Support("block", "bottom", axis) for axis in ("x", "y")]
    return cq.Structure([block]).assemble(supports, [cq.Pressure("block", "top", 0.1)])


HOLDERS: dict[str, Callable[[], Any]] = {
    "dense": lambda: cq.ContactProblem(**PLANE),
    "sparse": sparse_plane,
    "replaced": lambda: sparse_plane().replace(load=[0.0, 1.0], gap=[0.2], friction=0.1),
    "some contacts": lambda: sparse_plane().with_contacts(np.array([0])).with_ties(np.zeros(0, dtype=int)),
    "local": lambda: cq.LocalProblem(**LOCAL),
    "global": lambda: cq.GlobalProblem.of(sparse_plane()),
    "solution": lambda: cq.solve(sparse_plane()),
    "free motions": lambda: cq.solve(cq.ContactProblem(np.zeros((1, 1)), [0.0], [[1.0]], [0.1])),
    "solution of a backend": lambda: cq.solve(truss(), "clarabel"),
    "local solution": lambda: cq.solve(cq.LocalProblem(**LOCAL)),
    "judged": lambda: cq.certify(truss(), normal_force=[1.0]),
    "step of a path": lambda: cq.follow_path(sparse_plane(), [[1.0, 3.0]], steps=3)[2],
    "exact step of a path": lambda: cq.follow_path(sparse_plane(), [[1.0, 3.0]], events="exact")[1],
    "path": lambda: cq.follow_path(sparse_plane(), [[1.0, 3.0]], steps=3),
    "motion": lambda: cq.impact(truss(), np.ones(2), np.zeros(2), np.zeros(2), 0.1, 0.05),
    "large deformation": lambda: cq.large_deformation(arch(), [[0.0, -0.01]], steps=2),
    "body on supports": lambda: arch(),
    "solid": lambda: solid().body,
    "surface": lambda: side(),
    "pairing": lambda: cq.pair(side(), FLOOR),
    "obstacle contact": lambda: cq.ObstacleContact([[0.0, 0.2]], FLOOR),
    "structure": lambda: held_block().structure,
    "system": held_block,
    "plane": lambda: cq.Plane(np.zeros(2), np.array([0.0, 1.0])),
    "circle": lambda: cq.Circle(np.zeros(2), 1.0),
    "cylinder": lambda: cq.Cylinder(np.zeros(3), np.array([0.0, 0.0, 1.0]), 1.0),
    "paraboloid": lambda: cq.Paraboloid(np.zeros(2), np.array([0.0, 1.0]), 1.0),
    "traction": lambda: cq.Traction("block", "top", np.zeros(2)),
    "point load": lambda: cq.PointLoad("block", np.array([0, 1]), np.zeros(2)),
    "bounds": lambda: cq.Obstacle("wall", ("a", "b"), np.array([0.1, 0.2])),
    "critical": lambda: cq.critical_friction(sparse_plane().replace(tie=sp.csr_array((0, 2)))),
    "exact": lambda: cq.exact(truss()),
    "instant of a motion": lambda: cq.impact(truss(), np.ones(2), np.zeros(2), np.zeros(2), 0.1, 0.05)[1],
}


@pytest.mark.sampled(44)
@pytest.mark.parametrize("kind", HOLDERS)
@pytest.mark.parametrize("way", ["made", "copied", "deeply copied", "pickled"])
def test_no_array_can_be_written(kind: str, way: str) -> None:
    holder = HOLDERS[kind]()
    ways = {"copied": copy.copy, "deeply copied": copy.deepcopy, "pickled": lambda it: pickle.loads(pickle.dumps(it))}
    found = dict(arrays(ways[way](holder) if way in ways else holder))
    assert found
    assert [path for path, array in found.items() if array.flags.writeable] == []


@pytest.mark.sampled(3)
@pytest.mark.parametrize("part", ["data", "indices", "indptr"])
@pytest.mark.parametrize("matrix", ["stiffness", "normal", "tangent", "tie"])
def test_a_sparse_matrix_of_a_problem_cannot_be_changed_in_place(matrix: str, part: str) -> None:
    problem = cq.ContactProblem(**PLANE | dict(stiffness=sp.csr_array(K), tie=[[1.0, -1.0]]))
    held = getattr(problem, matrix)
    array = getattr(held, part)
    with pytest.raises(ValueError, match="read-only"):
        array *= 3
    with pytest.raises(ValueError, match="read-only"):
        held[held.nonzero()] = 7.0


def test_a_problem_shares_no_array_with_its_maker() -> None:
    made = {
        "stiffness": sp.csc_array(K),
        "load": np.array([1.0, 3.0]),
        "normal": sp.csr_array([[0.0, 1.0]]),
        "gap": np.array([0.1]),
        "tangent": sp.csr_array([[1.0, 0.0]]),
        "friction": np.array([0.3]),
        "slip_origin": np.zeros((1, 1)),
        "tie": sp.csr_array([[1.0, -1.0]]),
        "tie_value": np.array([0.0]),
        "near_null_space": np.ones((2, 1)),
    }
    problem = cq.ContactProblem(**made)  # type: ignore[arg-type]
    for name, value in made.items():
        mine = getattr(problem, name)
        pairs = (
            [(value, mine)]
            if isinstance(value, np.ndarray)
            else [(getattr(value, part), getattr(mine, part)) for part in ("data", "indices", "indptr")]
        )
        for theirs, ours in pairs:
            assert theirs.flags.writeable
            assert not np.shares_memory(theirs, ours), name


def test_neither_does_what_pairs_and_deforms() -> None:
    points, height = np.array([[0.0, 0.001], [1.0, 0.001]]), np.array([0.1, 0.2])
    bars, made = np.array([[0, 1], [1, 2]]), {name: value.copy() for name, value in EDGE.items()}
    mine = [points, height, bars, *made.values()]
    theirs = [
        cq.pair(points, FLOOR, unknowns=made["unknowns"]),
        cq.pair_scalar(points, height),
        cq.pair(side(**made), FLOOR),
        cq.ObstacleContact(points, FLOOR, unknowns=made["unknowns"]),
        cq.Obstacle("wall", ("a", "b"), height),
        arch(bars=bars).body,
    ]
    for holder in theirs:
        found = list(arrays(holder))
        assert found, type(holder)
        for path, array in found:
            assert not any(np.shares_memory(array, own) for own in mine), (type(holder), path)
    assert all(own.flags.writeable for own in mine)


PLACE, ALONG, NODES = np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([0, 1])
OBSTACLES: dict[str, Callable[[Any, Any], Any]] = {
    "plane": cq.Plane,
    "sphere": lambda place, _: cq.Sphere(place, 1.0),
    "cylinder": lambda place, axis: cq.Cylinder(place, axis, 1.0),
    "paraboloid": lambda place, axis: cq.Paraboloid(place, axis, 1.0),
}


@pytest.mark.parametrize("form", [np.array, list])
@pytest.mark.parametrize("kind", OBSTACLES)
def test_an_obstacle_stays_where_it_was_made(kind: str, form: Callable[[Any], Any]) -> None:
    place, axis = form(PLACE), form(ALONG)
    obstacle = OBSTACLES[kind](place, axis)
    points = np.full((1, obstacle.dimension), 2.0)
    before = obstacle.distance(points)
    place[:], axis[:] = [5.0, 6.0, 7.0], [1.0, 1.0, 0.0]
    assert obstacle.distance(points) == before


def test_loads_and_supports_stay_what_they_were_and_a_structure_has_the_bodies_of_its_start() -> None:
    system, force, nodes = held_block(), np.array([0.25, -0.5]), NODES.copy()
    block = system.structure.body("block")
    loads = [cq.Traction("block", "top", force), cq.PointLoad("block", nodes, force), cq.Gravity("block", force)]
    before = [load.forces(block) for load in loads]
    support, bodies = cq.Support("block", nodes, 0), [block]
    structure = cq.Structure(bodies)
    force *= 2
    nodes += 1
    bodies.append(block)
    for load, forces in zip(loads, before, strict=True):
        assert np.array_equal(load.forces(block), forces)
    assert np.flatnonzero(~np.isnan(structure.prescribed([support]))).tolist() == [0, 2]
    assert structure.size == block.size


def test_what_a_problem_says_of_its_rows_cannot_be_changed() -> None:
    problem = cq.ContactProblem(**PLANE | dict(tie=[[0.0, 0.0]]))
    with pytest.raises(ValueError, match="read-only"):
        problem.idle_rows()[1][:] = False


def test_a_solution_shares_no_array_with_what_is_solved_next() -> None:
    problem = sparse_plane()
    first = cq.solve(problem)
    kept = {path: array.copy() for path, array in arrays(first)}
    assert kept
    for factor in (2.0, -1.0, 0.5):
        cq.solve(problem.replace(load=factor * problem.load), warm_start=first)
    assert all(np.array_equal(kept[path], array) for path, array in arrays(first))


def test_a_view_of_what_can_be_written_to_is_copied() -> None:
    whole = np.arange(4.0)
    part = read_only(whole[1:3])
    whole[:] = 7.0
    assert part.tolist() == [1.0, 2.0]
    alone = np.arange(4.0)
    assert read_only(alone) is alone


MASKED = np.ma.masked_array([1.0, 3.0], mask=[False, True])
NO_NUMBERS: dict[str, Any] = {
    "word": "0.3",
    "words": ["0.3"],
    "bytes": b"0.3",
    "object": object(),
    "nothing": [None],
    "dictionary": {"friction": 0.3},
    "complex": 0.3 + 0j,
    "complex in an array of objects": np.array([0.3j], dtype=object),
    "words in an array of objects": np.array(["0.3"], dtype=object),
    "date": np.array(["2020-01-01"], dtype="datetime64[D]"),
    "duration": np.array([3], dtype="timedelta64[s]"),
    "masked": np.ma.masked_array([0.3], mask=[True]),
    "masked, nothing masked": np.ma.masked_array([0.3]),
    "masked in a list": [np.ma.masked],
}


@pytest.mark.sampled(5)
@pytest.mark.parametrize("kind", NO_NUMBERS)
@pytest.mark.parametrize("door", ["problem", "replace", "local", "global"])
def test_a_coefficient_of_friction_is_a_number(kind: str, door: str) -> None:
    value = NO_NUMBERS[kind]
    doors: dict[str, Callable[[], Any]] = {
        "problem": lambda: cq.ContactProblem(**PLANE | dict(friction=value)),
        "replace": lambda: cq.ContactProblem(**PLANE).replace(friction=value),
        "local": lambda: cq.LocalProblem(**LOCAL | dict(friction=value)),
        "global": lambda: cq.GlobalProblem(K, np.eye(2), [0.0, 0.0], [0.0, 0.0], value, 2),
    }
    with pytest.raises(cq.InvalidProblem, match=r"^friction: expected (real )?numbers, got ") as caught:
        doors[door]()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "value", [0, 0.25, Fraction(1, 4), Decimal("0.25"), np.float32(0.25), np.array([Fraction(1, 4)])]
)
def test_every_real_number_is_a_coefficient(value: Any) -> None:
    assert cq.ContactProblem(**PLANE | dict(friction=value)).friction == float(np.ravel(value)[0])


DOORS: dict[str, Callable[[Any], Any]] = {
    "stiffness": lambda _: cq.ContactProblem(**PLANE | dict(stiffness=np.ma.masked_array(K))),
    "stiffness in rows": lambda _: cq.ContactProblem(**PLANE | dict(stiffness=[np.ma.masked_array(row) for row in K])),
    "load": lambda a: cq.ContactProblem(**PLANE | dict(load=a)),
    "normal": lambda a: cq.ContactProblem(**PLANE | dict(normal=a[None])),
    "gap": lambda a: cq.ContactProblem(**PLANE | dict(gap=a[:1])),
    "tangent": lambda a: cq.ContactProblem(**PLANE | dict(tangent=a[None])),
    "slip_origin": lambda a: cq.ContactProblem(**PLANE | dict(slip_origin=a[:1])),
    "tie": lambda a: cq.ContactProblem(**PLANE | dict(tie=a[None])),
    "tie_value": lambda a: cq.ContactProblem(**PLANE | dict(tie=[[1.0, 0.0]], tie_value=a[:1])),
    "near_null_space": lambda a: cq.ContactProblem(**PLANE | dict(near_null_space=a[:, None])),
    "replace load": lambda a: cq.ContactProblem(**PLANE).replace(load=a),
    "replace gap": lambda a: cq.ContactProblem(**PLANE).replace(gap=a[:1]),
    "delassus": lambda _: cq.LocalProblem(**LOCAL | dict(delassus=np.ma.masked_array(np.eye(2)))),
    "offset": lambda a: cq.LocalProblem(**LOCAL | dict(offset=a)),
    "offset by contacts": lambda a: cq.LocalProblem(**LOCAL | dict(offset=a[None])),
    "displacement": lambda a: cq.certify(cq.ContactProblem(**PLANE), a, [0.0], [0.0]),
    "normal_force": lambda a: cq.certify(cq.ContactProblem(**PLANE), [0.0, 0.0], a[:1], [0.0]),
    "friction_force": lambda a: cq.certify(cq.ContactProblem(**PLANE), [0.0, 0.0], [0.0], a[:1]),
    "pressure_area": lambda a: cq.certify(truss(), normal_force=[1.0], pressure_area=a[:1]),
    "force": lambda a: cq.certify_local(cq.LocalProblem(**LOCAL), a),
    "loads": lambda a: cq.follow_path(cq.ContactProblem(**PLANE), [a]),
    "loads, second": lambda a: cq.follow_path(cq.ContactProblem(**PLANE), [[1.0, 0.0], a]),
    "energy": lambda a: cq.ContactProblem(**PLANE).energy(a),
    "internal_force": lambda a: arch().internal_force(a),
    "force of a truss": lambda a: arch().body.internal_force(np.ma.concatenate([a, a, a])),
    "force of a solid": lambda a: solid().internal_force(np.ma.concatenate([a, a, a, a])),
    "restrict": lambda a: arch().restrict(np.ma.concatenate([a, a, a])),
    "points of pair": lambda a: cq.pair(a[None], FLOOR),
    "rows of points of pair": lambda a: cq.pair([a], FLOOR),
    "unknowns of pair": lambda a: cq.pair([[0.0, 0.0]], FLOOR, unknowns=a[None].astype(int)),
    "points of pair_scalar": lambda a: cq.pair_scalar(a[None], [0.1]),
    "obstacle_height": lambda a: cq.pair_scalar([[0.0], [1.0]], a),
    "obstacle_height, a function": lambda a: cq.pair_scalar([[0.0], [1.0]], lambda _: a),
    "unknowns of pair_scalar": lambda a: cq.pair_scalar([[0.0], [1.0]], [0.1, 0.1], unknowns=a.astype(int)),
    "normal_force of pressure": lambda a: cq.pair(side(), FLOOR).pressure(a),
    "points of a surface": lambda a: side(points=np.ma.stack([a, 2 * a])),
    "facets": lambda a: side(facets=(a[None] % 2).astype(int)),
    "bars": lambda a: arch(bars=np.ma.stack([a % 2, a % 2]).astype(int)),
    "modulus": lambda a: arch(modulus=a),
    "a point of a plane": lambda a: cq.Plane(a, [0.0, 1.0]),
    "a centre": lambda a: cq.Circle(a, 1.0),
    "lower": lambda a: cq.Obstacle("wall", ("a", "b"), lower=a),
    "upper": lambda a: cq.Obstacle("wall", ("a", "b"), upper=a),
    "penalty": lambda a: cq.solve(truss(), "penalty", penalty=a[:1]),
    "perturbation": lambda a: cq.solve(truss(), "perturbed-lagrangian", perturbation=a[:1]),
    "reference": lambda a: cq.compare(truss(), ["active-set"], reference=(a, [1.0])),
    "mass": lambda a: cq.impact(truss(), a, np.zeros(2), np.zeros(2), 0.1, 0.05),
    "start": lambda a: cq.impact(truss(), np.ones(2), a, np.zeros(2), 0.1, 0.05),
    "velocity": lambda a: cq.impact(truss(), np.ones(2), np.zeros(2), a, 0.1, 0.05),
    "load in time": lambda a: cq.impact(truss(), np.ones(2), np.zeros(2), np.zeros(2), 0.1, 0.05, load=lambda _: a),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("mask", [True, False])
def test_masked_arrays_are_refused_wherever_arrays_are_read(door: str, mask: bool) -> None:
    with pytest.raises(cq.InvalidProblem, match="a masked array") as caught:
        DOORS[door](MASKED if mask else np.ma.masked_array([1.0, 3.0]))
    assert "\n" not in str(caught.value)


COUNTS: dict[str, Callable[[Any], Any]] = {
    "steps": lambda count: cq.follow_path(truss(), [truss().load], steps=count),
    "steps of a deformation": lambda count: cq.large_deformation(arch(), [[0.0, -0.01]], steps=count),
    "max_iter": lambda count: cq.solve(truss(), "osqp", max_iter=count),
    "dimension": lambda count: cq.pair([[0.0, 0.0]], FLOOR, dimension=count),
    "dimension of a local problem": lambda count: cq.LocalProblem(**LOCAL | dict(dimension=count)),
    "dimension of a distance": lambda count: cq.SignedDistance(lambda x: x[:, 0], count),
}
NUMBERS: dict[str, Callable[[Any], Any]] = {
    "tolerance": lambda value: cq.solve(truss(), tolerance=value),
    "time_limit": lambda value: cq.solve(truss(), time_limit=value),
    "tolerance of a verdict": lambda value: cq.certify(truss(), normal_force=[1.0], tolerance=value),
    "tolerance of a local verdict": lambda value: cq.certify_local(cq.LocalProblem(**LOCAL), [0.0, 0.0], None, value),
    "duration": lambda value: cq.impact(truss(), np.ones(2), np.zeros(2), np.zeros(2), value, 0.05),
    "time_step": lambda value: cq.impact(truss(), np.ones(2), np.zeros(2), np.zeros(2), 0.1, value),
    "penalty": lambda value: cq.solve(truss(), "penalty", penalty=value),
    "penalties": lambda value: cq.solve(truss(), "penalty", penalty=[value]),
    "lower": lambda value: cq.Obstacle("wall", ("a",), lower=value),
    "uppers": lambda value: cq.Obstacle("wall", ("a",), upper=[value]),
    "bound": lambda value: cq.AtMost("most", {"w": 1.0}, value),
    "radius": lambda value: cq.Circle([0.0, 0.0], value),
    "thickness": lambda value: side(thickness=value),
    "held": lambda value: cq.Supported(arch().body, held={0: value, 1: 0.0}),
    "step": lambda value: cq.SignedDistance(lambda x: x[:, 0], 2, step=value),
}
NO_NUMBER = ("1", b"1", np.datetime64("2020-01-01"), np.timedelta64(3, "s"), 1 + 0j, object(), [None], {"a": 1})


@pytest.mark.sampled(20)
@pytest.mark.parametrize("door", [*COUNTS, *NUMBERS])
@pytest.mark.parametrize("value", NO_NUMBER, ids=lambda value: type(value).__name__)
def test_what_is_no_number_is_refused_in_one_line(door: str, value: Any) -> None:
    """A duration was one: NumPy counts it among the integers."""
    with pytest.raises(cq.InvalidProblem) as caught:
        (COUNTS | NUMBERS)[door](value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["stiffness", "normal", "tangent", "tie", "near_null_space", "load", "tie_value"])
def test_rows_of_different_lengths_are_refused(name: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=f"^{name}: expected real numbers, got list") as caught:
        cq.ContactProblem(**PLANE | {name: [[1.0, 0.0], [1.0]]})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["data", "indices", "indptr"])
def test_arrays_of_a_matrix_that_are_exchanged_are_refused(name: str) -> None:
    """What is read-only can be exchanged as a whole: what was computed for the old arrays would answer for the new."""
    stiffness = sp.csr_array([[2.0, -1], [-1, 2.0]])
    problem = cq.ContactProblem(stiffness, [1.0, 3.0], [[0, 1.0]], [0.1], tangent=[[1.0, 0]], friction=0.3)
    found = cq.solve(problem)
    setattr(problem.stiffness, name, getattr(problem.stiffness, name).copy())
    asked: list[Callable[[], Any]] = [
        lambda: cq.solve(problem),
        lambda: problem.replace(load=[1.0, 1.0]),
        lambda: cq.certify(problem, found.displacement, found.normal_force, found.friction_force),
        lambda: cq.impact(problem, [1.0, 1.0], [0.0, 0.0], [0.0, 0.0], 0.1, 0.1),
        lambda: cq.follow_path(problem, [problem.load]),
        lambda: cq.equilibria(problem),
        lambda: condense(problem),
    ]
    for question in asked:
        with pytest.raises(cq.InvalidProblem, match="other arrays than the problem was made with"):
            question()
