"""Numbers of any size and kind, given to every public function: only errors of this package leave, and no warning."""

from __future__ import annotations

import functools
import inspect
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import contactqp as cq
from benchmarks.adversary.wild import draw
from contactqp.cli import main

# Examples of each function in the slow share of the tests.
MANY = int(os.environ.get("CONTACTQP_EXAMPLES", "40"))

Draw = Callable[[Any], Any]

whole = st.integers(-3, 3).map(float)
extreme = st.sampled_from([0.0, 5e-324, 1e-308, 1e-160, 1e-20, 1e20, 1e160, 1.7e308])
unusual = st.sampled_from([np.nan, np.inf, -np.inf])
powers = st.builds(lambda sign, digits, power: sign * digits * 10.0**power, st.sampled_from([-1.0, 1.0]),
                   st.floats(1, 9.9), st.integers(-307, 307))  # fmt: skip
usual = st.floats(-10, 10, allow_subnormal=False)
finite = st.one_of(whole, usual, whole, usual, powers, extreme)
number = st.one_of(finite, finite, finite, finite, unusual)
positive = finite.map(abs)


def arrays(draw: Draw, *shape: int, of: Any = None) -> np.ndarray:
    """An array whose entries are alike, or each of its own size; now and then one of them is no number."""
    count = int(np.prod(shape))
    kind = draw(st.sampled_from(["whole", "usual", "scaled", "any"]) if of is None else st.just("of"))
    entries = {"whole": whole, "usual": usual, "scaled": usual, "any": number, "of": of}[kind]
    values = np.array(draw(st.lists(entries, min_size=count, max_size=count)), dtype=float).reshape(shape)
    if kind == "scaled":
        with np.errstate(all="ignore"):
            values = values * draw(positive)
    if count and draw(st.integers(0, 30)) == 0:
        values.flat[draw(st.integers(0, count - 1))] = draw(number)
    return values


def stiffness(draw: Draw, n: int) -> np.ndarray:
    """Symmetric and positive semidefinite as far as it is written in whole numbers and factors of any size."""
    shape = arrays(draw, n, draw(st.integers(1, n)) if n else 0, of=whole)
    own = arrays(draw, n, of=st.one_of(st.just(1.0), positive)) if draw(st.booleans()) else np.ones(n)
    diagonal = arrays(draw, n, of=st.integers(0, 2).map(float))
    with np.errstate(all="ignore"):
        return np.asarray((shape @ shape.T + np.diag(diagonal)) * own * own[:, None])


def problem_arguments(draw: Draw) -> dict[str, Any]:
    n, m, d = draw(st.integers(0, 3)), draw(st.integers(0, 3)), draw(st.integers(1, 3))
    given: dict[str, Any] = dict(
        stiffness=stiffness(draw, n), load=arrays(draw, n), normal=arrays(draw, m, n), gap=arrays(draw, m)
    )
    if d > 1:
        given |= dict(tangent=arrays(draw, m * (d - 1), n), friction=draw(st.one_of(positive, number)))
        if draw(st.booleans()):
            given["slip_origin"] = arrays(draw, m, d - 1)
    if draw(st.booleans()):
        ties = draw(st.integers(0, 2))
        given |= dict(tie=arrays(draw, ties, n), tie_value=arrays(draw, ties))
    return given


def problem(draw: Draw) -> cq.ContactProblem:
    return cq.ContactProblem(**problem_arguments(draw))


def local_problem(draw: Draw) -> cq.LocalProblem:
    m, d = draw(st.integers(0, 3)), draw(st.sampled_from([2, 3]))
    return cq.LocalProblem(stiffness(draw, d * m), arrays(draw, d * m), draw(st.one_of(positive, number)), d)


def global_problem(draw: Draw) -> cq.GlobalProblem:
    n, m, d = draw(st.integers(1, 4)), draw(st.integers(0, 2)), draw(st.sampled_from([2, 3]))
    return cq.GlobalProblem(
        stiffness(draw, n), arrays(draw, n, m * d), arrays(draw, n), arrays(draw, m * d), draw(positive), d
    )


def answer_to(draw: Draw, of: cq.ContactProblem) -> dict[str, Any]:
    given = dict(
        displacement=arrays(draw, of.dimension), normal_force=arrays(draw, of.contacts), tie_force=arrays(draw, of.ties)
    )
    if of.slip_origin is not None:
        given["friction_force"] = arrays(draw, *of.slip_origin.shape)
    left_out = draw(st.sets(st.sampled_from(sorted(given))))
    return {name: value for name, value in given.items() if name not in left_out or len(left_out) > 2}


def force_on(draw: Draw, of: cq.LocalProblem) -> np.ndarray:
    return arrays(draw, of.contacts * of.dimension)


def form(draw: Draw) -> dict[str, float]:
    return draw(st.dictionaries(st.sampled_from(["x", "y", "z"]), number, min_size=1, max_size=3))


def part(draw: Draw, kinds: tuple[str, ...] = ("Spring", "Cable", "Strut", "PlasticHinge", "AtMost", "AtLeast",
                                               "Equal", "Obstacle")) -> Any:  # fmt: skip
    kind = draw(st.sampled_from(kinds))
    name = draw(st.sampled_from(["a", "b", "c", "d", "e"]))
    maybe = st.one_of(st.none(), positive)
    if kind == "Spring":
        return cq.Spring(name, draw(number), form(draw), draw(number))
    if kind in ("Cable", "Strut"):
        return getattr(cq, kind)(name, form(draw), draw(maybe), draw(number))
    if kind == "PlasticHinge":
        return cq.PlasticHinge(name, form(draw), draw(number), draw(maybe), draw(maybe), draw(positive))
    if kind == "Obstacle":
        return cq.Obstacle(name, ("x", "y"), arrays(draw, 2), draw(st.one_of(st.none(), st.just(arrays(draw, 2)))))
    return getattr(cq, kind)(name, form(draw), draw(number))


def constrained_energy(draw: Draw) -> cq.ConstrainedEnergy:
    parts = [part(draw) for _ in range(draw(st.integers(0, 3)))]
    K = draw(st.one_of(st.none(), st.just(stiffness(draw, 3))))
    return cq.ConstrainedEnergy(["x", "y", "z"], K, arrays(draw, 3), parts)


def obstacle(draw: Draw, dimension: int, kinds: tuple[str, ...] = ()) -> Any:
    """A rigid obstacle, and asked about points."""
    round_ones = {1: (), 2: ("Circle",), 3: ("Sphere", "Cylinder")}[dimension]
    kinds = kinds or ("Plane", *round_ones, *(("Paraboloid",) if dimension > 1 else ()), "SignedDistance")
    kind = draw(st.sampled_from(kinds))
    inside = draw(st.booleans())
    at, along = arrays(draw, dimension), arrays(draw, dimension)
    if kind == "Plane":
        return cq.Plane(at, along)
    if kind == "Cylinder":
        return cq.Cylinder(at, along, draw(number), inside)
    if kind == "Paraboloid":
        return cq.Paraboloid(at, along, draw(number), inside, draw(st.sampled_from(["axis", "normal"])))
    if kind == "SignedDistance":
        radius, step = draw(number), draw(st.one_of(st.none(), number))
        return cq.SignedDistance(lambda x: np.linalg.norm(x, axis=1) - radius, dimension, None, step)
    return getattr(cq, kind)(at, draw(number), inside)


def of_points(draw: Draw, kinds: tuple[str, ...], dimension: int | None = None) -> Callable[[], Any]:
    d = draw(st.sampled_from([2, 3])) if dimension is None else dimension
    one = obstacle(draw, d, kinds)
    points = arrays(draw, draw(st.integers(0, 3)), d)
    return lambda: (one.distance(points), one.normals(points))


def paired(draw: Draw) -> Callable[[], Any]:
    d = draw(st.sampled_from([1, 2, 3]))
    one, points = obstacle(draw, d), arrays(draw, draw(st.integers(0, 3)), d)
    return lambda: cq.pair(points, one)


def surface(draw: Draw, d: int, shift: int = 0) -> cq.Surface:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]) if d == 2 else np.eye(4, 3)
    facets = np.array([[0, 1], [1, 2]]) if d == 2 else np.array([[0, 1, 2], [1, 2, 3]])
    size = draw(finite)
    with np.errstate(all="ignore"):
        points = points * size + (arrays(draw, *points.shape) if draw(st.booleans()) else 0.0)
    unknowns = np.arange(points.size).reshape(points.shape) + shift
    return cq.Surface(points, facets, unknowns, thickness=draw(st.one_of(st.just(1.0), number)))


def facing(draw: Draw, pairing: Callable[..., Any]) -> Callable[[], Any]:
    d = draw(st.sampled_from([2, 3]))
    slave, master = surface(draw, d), surface(draw, d, shift=12)
    options = draw(st.fixed_dictionaries({}, optional=dict(reach=number, overlap=number)))
    return lambda: pairing(slave, master, **options)


def truss(draw: Draw) -> cq.NonlinearTruss:
    d = draw(st.sampled_from([1, 2, 3]))
    size, moved = draw(finite), arrays(draw, 3, d) if draw(st.booleans()) else 0.0
    with np.errstate(all="ignore"):
        nodes = np.eye(3, d) * size + moved
    law = draw(st.sampled_from(["green", "engineering", "logarithmic", "hencky"]))
    return cq.NonlinearTruss(nodes, [[0, 1], [1, 2]], draw(number), draw(number), law)


def deformed(draw: Draw, body: Any) -> Callable[[], Any]:
    u = arrays(draw, body.dimension)
    return lambda: (body.energy(u), body.internal_force(u), body.tangent(u))


def held(draw: Draw) -> Any:
    body = truss(draw)
    return cq.Supported(body, [0, body.dimension - 1])


def deforming(draw: Draw) -> Callable[[], Any]:
    body = held(draw)
    load = arrays(draw, body.dimension)
    return lambda: cq.large_deformation(body, [load], steps=2)


def struck(draw: Draw) -> Callable[[], Any]:
    one = problem(draw)
    M, u, v = stiffness(draw, one.dimension), arrays(draw, one.dimension), arrays(draw, one.dimension)
    step = draw(number)
    scheme = draw(st.sampled_from(["moreau-jean", "newmark", "paoli-schatzman"]))
    return lambda: cq.impact(one, M, u, v, 3 * step, step, scheme, restitution=draw(st.sampled_from([0.0, 0.5])))


def solved(draw: Draw) -> Callable[[], Any]:
    one = draw(st.sampled_from([problem, problem, problem, local_problem]))(draw)
    method = draw(st.sampled_from(["active-set", "active-set", "clarabel", "lemke", "lagrange-multiplier", "penalty",
                                   "master-slave", "perturbed-lagrangian", "augmented-lagrangian"]))  # fmt: skip
    return lambda: cq.solve(one, method)


def certified(draw: Draw) -> Callable[[], Any]:
    one = problem(draw)
    given = answer_to(draw, one)
    return lambda: cq.certify(one, **given)


def followed(draw: Draw) -> Callable[[], Any]:
    one = problem(draw)
    loads = [arrays(draw, one.dimension) for _ in range(draw(st.integers(0, 3)))]
    return lambda: cq.follow_path(one, loads, events=draw(st.sampled_from([None, "exact"])))


def judged_locally(draw: Draw, function: Callable[..., Any]) -> Callable[[], Any]:
    one = local_problem(draw)
    force = force_on(draw, one)
    return lambda: function(one, force)


def about(draw: Draw, function: Callable[..., Any], *kinds: Callable[[Draw], Any]) -> Callable[[], Any]:
    one = draw(st.sampled_from(kinds or (problem,)))(draw)
    return lambda: function(one)


def siconos(draw: Draw) -> Callable[[], Any]:
    one = problem(draw)
    given = {name: arrays(draw, *shape) for name, shape in dict(
        displacement=(one.dimension,), normal_force=(one.contacts,),
        friction_force=(one.contacts, 1 if one.slip_origin is None else one.slip_origin.shape[1])).items()}  # fmt: skip
    return lambda: cq.siconos_global_error(one, **given)


def made(kind: str) -> Callable[[Draw], Callable[[], Any]]:
    def call(draw: Draw) -> Callable[[], Any]:
        one = part(draw, (kind,))
        return lambda: one.contribution()

    return call


def written(draw: Draw, folder: Path, function: Callable[..., Any]) -> Callable[[], Any]:
    one = draw(st.sampled_from([problem, local_problem] if function is cq.write_fclib else [problem]))(draw)
    place = folder / f"{draw(st.integers(0, 2**60))}.{'hdf5' if function is cq.write_fclib else 'folder'}"

    def again() -> Any:
        function(place, one)
        return cq.read_fclib(place) if function is cq.write_fclib else cq.read_problem(place)

    return again


CALLS: dict[str, Callable[[Draw], Callable[[], Any]]] = {
    "AssociatedDifference": lambda draw: about(draw, cq.associated_difference),
    "ConstrainedEnergy": lambda draw: constrained_energy(draw).solve,
    "ContactProblem": lambda draw: functools.partial(cq.ContactProblem, **problem_arguments(draw)),
    "Circle": lambda draw: of_points(draw, ("Circle",), 2),
    "Cylinder": lambda draw: of_points(draw, ("Cylinder",), 3),
    "GlobalProblem": lambda draw: functools.partial(global_problem, draw),
    "LocalProblem": lambda draw: functools.partial(local_problem, draw),
    "NonlinearTruss": lambda draw: deformed(draw, truss(draw)),
    "ObstacleContact": lambda draw: about(draw, lambda one: one),
    "Paraboloid": lambda draw: of_points(draw, ("Paraboloid",)),
    "Plane": lambda draw: of_points(draw, ("Plane",), draw(st.sampled_from([1, 2, 3]))),
    "SignedDistance": lambda draw: of_points(draw, ("SignedDistance",)),
    "Sphere": lambda draw: of_points(draw, ("Sphere",), 3),
    "Supported": lambda draw: deformed(draw, held(draw)),
    "UpdatedTruss": lambda draw: deformed(draw, cq.UpdatedTruss(truss(draw))),
    "acary_bremond_huber_error": lambda draw: judged_locally(draw, cq.acary_bremond_huber_error),
    "certify": certified,
    "certify_local": lambda draw: judged_locally(draw, cq.certify_local),
    "compare": lambda draw: about(draw, lambda one: cq.compare(one, ["active-set", "penalty"])),
    "critical_friction": lambda draw: about(draw, cq.critical_friction),
    "equilibria": lambda draw: about(draw, cq.equilibria, problem, local_problem),
    "exact": lambda draw: about(draw, cq.exact),
    "exact_equilibria": lambda draw: about(draw, cq.exact_equilibria),
    "existence_margin": lambda draw: about(draw, cq.existence_margin, problem, local_problem),
    "fclib_merit_1": lambda draw: judged_locally(draw, cq.fclib_merit_1),
    "follow_path": followed,
    "impact": struck,
    "large_deformation": deforming,
    "local_form_of": lambda draw: about(draw, cq.local_form_of, problem, global_problem, local_problem),
    "pair": paired,
    "pair_mortar": lambda draw: facing(draw, cq.pair_mortar),
    "pair_node_to_segment": lambda draw: facing(draw, cq.pair_node_to_segment),
    "redistributed_mass": lambda draw: about(
        draw, lambda one: cq.redistributed_mass(stiffness(draw, one.dimension), one)
    ),
    "siconos_global_error": siconos,
    "siconos_local_error": lambda draw: judged_locally(draw, cq.siconos_local_error),
    "solve": solved,
    **{kind: made(kind) for kind in ("Spring", "Cable", "Strut", "PlasticHinge", "AtMost", "AtLeast", "Equal",
                                     "Obstacle")},
}  # fmt: skip


def ask_everything(answer: Any) -> None:
    """Read every property of an object of this package, and call its public methods that need no argument."""
    if isinstance(answer, tuple | list):
        for one in answer:
            ask_everything(one)
    if not type(answer).__module__.startswith("contactqp"):
        return
    for name in dir(type(answer)):
        if name.startswith("_"):
            continue
        try:
            value = getattr(answer, name)
            if callable(value) and not inspect.isclass(value) and not _needs_arguments(value):
                value()
        except cq.ContactQPError:
            pass


def _needs_arguments(function: Any) -> bool:
    return any(
        one.default is one.empty and one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD)
        for one in inspect.signature(function).parameters.values()
    )


def only_errors_of_this_package_leave(name: str, draw: Draw) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            ask_everything(CALLS[name](draw)())
        except cq.ContactQPError as error:
            ask_everything(getattr(error, "solution", None))


@pytest.mark.sampled(36)
@pytest.mark.parametrize("name", CALLS)
@settings(max_examples=8, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_only_errors_of_this_package_leave(name: str, data: st.DataObject) -> None:
    only_errors_of_this_package_leave(name, data.draw)


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
@settings(max_examples=MANY, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_only_errors_of_this_package_leave_many_times(name: str, data: st.DataObject) -> None:
    only_errors_of_this_package_leave(name, data.draw)


def crushed() -> Any:
    mesh = cq.rectangle(1, 1, (1, 1))
    solid = cq.NonlinearSolid(cq.Body(mesh, cq.Material(1.0, 0.0), "plane-strain"))
    return cq.large_deformation(cq.Supported(solid, [0, 1, 2, 3]), [[0, -5e4, -5e4, -1e5]], steps=2)


BARE = cq.ContactProblem([[0.0]], [-1.0], [[-2.0]], [1.0], tangent=[[0.0]], friction=0.0)
NEVER = cq.ContactProblem([[1.0]], [2.0], [[1.0]], [np.inf])
outside = sp.csr_array(np.eye(2))
outside.indices = np.array([0, 7], dtype=np.int32)
THROWN: dict[str, Callable[[], Any]] = {
    "tangents without friction, nothing stiff": lambda: cq.solve(BARE),
    "a force at a contact that never closes": lambda: cq.certify(NEVER, [2.0], [-1.0]).findings,
    "friction on what is not stiff": lambda: (
        cq.certify(
            cq.ContactProblem([[0.0]], [0.0], [[-0.002], [2.0]], [0.0, 2.0], tangent=[[1.0], [1.0]], friction=1.0),
            [1.0],
            [0.0, 1.0],
        ).findings
    ),
    "a gap beside one of 1e20": lambda: cq.solve(
        cq.ContactProblem(
            [[9.0, -7, 2], [-7, 6, -2], [2, -2, 1]], [4.5, 2.5, 4.5], [[-1.5, 3, 2.5], [1.5, -3, -2.5]], [1e20, -5e-324]
        ),
        "cvxpy",
    ),
    "a crushed element": crushed,
    "a modulus below all": lambda: cq.Material(5e-324, 0.3),
    "a modulus above all": lambda: cq.Material(1e300, 0.3),
    "a limit of time beyond doubles": lambda: cq.solve(NEVER, time_limit=10**400),
    "the other kind of problem": lambda: cq.acary_bremond_huber_error(BARE, [0.0, 0.0]),  # type: ignore[arg-type]
    "rows as words": lambda: cq.ContactProblem.from_qp(np.eye(2), [1.0, 1.0], G=[["a", "b"]], h=[1.0]),
    "rows of three sides": lambda: cq.ContactProblem.from_qp(np.eye(2), [1.0, 1.0], G=np.ones((1, 1, 2)), h=[1.0]),
    "a row beyond the last unknown": lambda: cq.ContactProblem(np.eye(2), [1, 1], outside, [1.0, 1.0]),
    "a stiffness beyond the last unknown": lambda: cq.ContactProblem(outside, [1, 1], np.eye(2), [1.0, 1.0]),
    "a program's row beyond the last unknown": lambda: cq.ContactProblem.from_qp(np.eye(2), [1, 1], outside, [1, 1]),
    "a stiffness of 1e12 unknowns": lambda: cq.ContactProblem(sp.coo_array((2**40, 2**40)), [1.0], [[1.0]], [1.0]),
    "names without an end": lambda: cq.ContactProblem([[1.0]], [1.0], [[1.0]], [1.0], dof_names=range(10**12)),
    "a contact that is none": lambda: NEVER.replace(contact_names=["wall"]).contact_name(7),
    "a unit that is a number": lambda: cq.Units(length=5),  # type: ignore[arg-type]
    "a half float": lambda: cq.solve(NEVER, time_limit=np.float16(9)),
    "a title with half of a character": lambda: cq.draw(cq.solve(NEVER), title="\udcff"),
    "a picture of the largest double": lambda: cq.draw(
        cq.solve(cq.ContactProblem([[1.0]], [0.0], [[1.0]], [1.7976931348623157e308]))
    ),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", THROWN)
def test_what_was_thrown_at_it_from_outside(what: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            THROWN[what]()
        except cq.ContactQPError as error:
            said = str(error)
        else:
            said = ""
    assert "\n" not in said


@pytest.mark.sampled(5)
@pytest.mark.parametrize("unit", [1.0, 2.0, 3.0, 128.0, 1e-12])
def test_unknowns_without_stiffness_have_the_same_answer_in_every_unit_of_a_contact(unit: float) -> None:
    tied = cq.ContactProblem(
        np.zeros((2, 2)), [2.0, 2.0], [[unit, 0.0]], [unit], tangent=[[-unit, 2 * unit]], friction=1.0,
        tie=[[1.0, 1.0], [1.0, 0.0]], tie_value=[-1.0, 1.0],
    )  # fmt: skip
    assert cq.solve(tied).certificate.passed
    assert cq.certify(tied, [1.0, -2.0], [0.0], [[0.0]], [2.0, 0.0]).passed
    assert not cq.certify(tied, [1.0, -2.0], [1e-3 / unit], [[0.0]], [2.0, 0.0]).passed
    pressed = cq.ContactProblem([[0.0]], [-1.0], [[-0.001 * unit]], [0.001 * unit], tangent=[[0.0]], friction=0.5)
    assert cq.solve(pressed).normal_force == pytest.approx([1e3 / unit], rel=1e-12)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("unit", [1.0, 1e13, 1e15, 1e18])
def test_absence_is_not_claimed_where_tangents_alone_touch_an_unknown(unit: float) -> None:
    problem = cq.ContactProblem(
        np.zeros((2, 2)), [0.0, 3e4], [[0.0, unit]], [0.0], tangent=[[-unit, 0.0]], friction=0.3
    )
    assert cq.solve(problem).normal_force == pytest.approx([3e4 / unit], rel=1e-12)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("unit", [1.0, 1e8, 1e12, 1e15, 1e100])
def test_rows_in_far_apart_units_have_the_same_answer(unit: float) -> None:
    problem = cq.ContactProblem(
        [[8.0, 0], [0, 0]], [0, -2.0], [[0, 1000 * unit], [0, -1], [-1, 2]], [0.001 * unit, 0.003, 0.001],
        tangent=[[2 * unit, unit], [1, 2], [0, 1]], friction=0.3,
    )  # fmt: skip
    assert cq.solve(problem).displacement == pytest.approx([0.006, -0.003], rel=1e-9)


def test_a_tangent_of_zeros_has_no_unit() -> None:
    problem = cq.ContactProblem([[0.0]], [0.0], [[-1e-100], [2.0]], [1e-100, 1.0], tangent=[[0.0], [1.0]], friction=0.5)
    assert cq.solve(problem).certificate.passed


def test_answers_with_gaps_that_never_close_and_diverged_ones_are_written(tmp_path: Path) -> None:
    problem = cq.ContactProblem(np.eye(2), [-1.0, 0.0], np.eye(2), [np.inf, 2.0])
    cq.write_problem(tmp_path / "right", problem, cq.solve(problem))
    assert _checked(tmp_path / "right") == 0
    cq.write_problem(tmp_path / "diverged", problem, {"displacement": [np.nan, 1.0]})
    assert _checked(tmp_path / "diverged") == 1
    (tmp_path / "file").write_text("")
    with pytest.raises(cq.InvalidProblem, match="expected a folder"):
        cq.write_problem(tmp_path / "file", problem)


def _checked(folder: Path) -> int:
    """The exit code of `contactqp check`."""
    with pytest.raises(SystemExit) as ended:
        main(["check", str(folder), str(folder / "answer.json")])
    return int(ended.value.code or 0)


def test_derivatives_whose_signs_leave_the_range_of_doubles_are_refused_in_words() -> None:
    """Rows from 1e33 to 1e108 beside stiffnesses from 1e-94 to 1e136: linprog refused what signs became."""
    with np.errstate(all="ignore"):
        problem = cq.ContactProblem(**draw(np.random.default_rng([77, 497])))
    solution = cq.solve(problem)
    for of in ("displacement", "slip", "normal_force"):
        rate = solution.derivative(of, with_respect_to="load", direction=np.ones(problem.dimension))
        assert rate.value is None
        assert rate.reason


def test_a_motion_with_a_row_of_zeros_is_drawn() -> None:
    problem = cq.ContactProblem([[1.0]], [-1.0], [[0.0], [1.0]], [0.0, 2.0])
    motion = cq.impact(problem, [[1.0]], [0.0], [0.0], 0.3, 0.1)
    assert motion.problem is not None
    assert motion.problem.contacts == motion.normal_forces.shape[1] == 2
    motion.plot()
