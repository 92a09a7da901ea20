"""One object of every public class, found again by what refers to it: a class that is new and not here fails a test."""

from __future__ import annotations

import dataclasses
import inspect
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from contactqp import testing

CASES = pathlib.Path(__file__).parent.parent / "cases"


def from_floor(points: np.ndarray) -> np.ndarray:
    return points[:, 1]


def bars() -> cq.ContactProblem:
    return cq.ContactProblem(
        stiffness=sp.csr_array([[2.1, 0.1], [0.1, 3.1]]),
        load=[10.0, 1.0],
        normal=[[1.0, 0.0], [0.0, 1.0]],
        gap=[0.1, 0.2],
        units={"length": "mm", "force": "N"},
    )


def rubbing() -> cq.ContactProblem:
    return cq.ContactProblem(
        stiffness=[[5.0, -2.0], [-2.0, 1.0]],
        load=[-1.0, -3.0],
        normal=[[-1.0, 0.0]],
        gap=[0.1],
        tangent=[[0.0, 1.0]],
        friction=0.3,
    )


def local() -> cq.LocalProblem:
    return cq.LocalProblem(delassus=[[1.0, 2.0], [2.0, 5.0]], offset=[-7.0, -17.0], friction=0.8, dimension=2)


def tied() -> cq.ContactProblem:
    return cq.ContactProblem(
        stiffness=np.diag([2.0, 3.0]), load=[1.0, 4.0], normal=[[1.0, 0.0]], gap=[0.1], tie=[[1.0, -1.0]]
    )


@cache
def objects() -> dict[str, Any]:
    """Objects as the public functions return and take them; every other one hangs on one of these."""
    problem, rough, known = bars(), rubbing(), testing.problem("truss-over-floor")
    solution, path = cq.solve(problem), [[-1.0, -3.0], [-1.0, 3.0]]
    history = cq.follow_path(problem, loads=[[10.0, 1.0], [0.0, 1.0]], steps=4)
    wrong = cq.certify(problem, displacement=[0.1, 0.3], normal_force=[9.0, -0.5])
    assert wrong.findings
    assert wrong.contacts
    arch = cq.NonlinearTruss([[-1, 0], [0, 0.2], [1, 0]], [[0, 1], [1, 2]], modulus=100.0, area=1.0)
    floor = cq.ObstacleContact([[0, 0.2]], cq.Plane([0, -0.1], [0, 1]))
    free = cq.Supported(arch, held=[0, 1, 4, 5])
    edge = dict(points=np.array([[0.0, 0.0], [1.0, 0.0]]), facets=np.array([[0, 1]]))
    side = cq.Surface(**edge, unknowns=np.arange(4).reshape(2, 2))
    hinge = cq.PlasticHinge("hinge", {"t": 1.0}, capacity=5.0, stiffness=100.0)
    springs = (
        cq.Cable("cable", {"w": 1.0}, 8.0, slack=0.1),
        cq.Strut("strut", {"w": 1.0}, 8.0),
        cq.Spring("spring", 2.0, {"w": 1.0}),
    )
    limits = (
        cq.AtMost("most", {"w": 1.0}, 9.0),
        cq.AtLeast("least", {"w": 1.0}, -9.0),
        cq.Obstacle("wall", ("w",), -8),
    )
    energy = cq.ConstrainedEnergy(["w"], [[2.0]], [3.0], parts=[*springs, *limits])
    return {
        "problems": (problem, rough, local(), tied(), cq.GlobalProblem.of(rough)),
        "part": problem.with_contacts(np.array([1])),
        "summed": problem._with_load_sum(problem.load, 2 * problem.load),
        "tie left out": tied().with_ties(np.array([0])),
        "solutions": (solution, cq.solve(rough), cq.solve(local()), cq.solve(tied())),
        "cases": cq.solve_many(problem, loads=[[10.0, 1.0], [0.0, 1.0]]),
        "backend": cq.solve(problem, method="clarabel"),
        "penalty": cq.solve(problem, method="penalty", penalty=1e4),
        "judged": (cq.certify(problem, solution.displacement, solution.normal_force), wrong),
        "history": history,
        "rubbing": cq.follow_path(rough, loads=path, steps=3),
        "exact events": cq.follow_path(rough, loads=path, events="exact"),
        "motion": cq.impact(
            problem, mass=np.eye(2), displacement=[0.0, 0.0], velocity=[1.0, 0.0], duration=0.2, time_step=0.05
        ),
        "large": cq.large_deformation(free, [[0.0, -1.0]], floor, steps=2),
        "exact": (cq.exact(problem), *cq.exact_equilibria(rough)),
        "several": cq.equilibria(rough),
        "critical": cq.critical_friction(rough),
        "associated": cq.associated_difference(rough),
        "margin": cq.existence_margin(rough),
        "local form": cq.local_form_of(rough),
        "comparison": cq.compare(problem, methods=["active-set", "lemke"]),
        "methods": cq.methods(),
        "scene": cq.load_scene(CASES / "bar_wall.toml"),
        "run": cq.run(cq.load_scene(CASES / "bar_wall.toml")),
        "gallery": (known, testing.check_solver(solves, problems=[known])),
        "energies": (energy.solve(), cq.ConstrainedEnergy(["t"], [[10.0]], [6.0], parts=[hinge]).solve()),
        "equal": cq.Equal("equal", {"w": 1.0}, 0.5),
        "surface": side,
        "pairing": cq.pair(side, cq.Plane([0.0, -0.1], [0.0, 1.0])),
        "obstacles": (
            cq.Circle([0.0, 0.0], 1.0),
            cq.Sphere([0.0, 0.0, 0.0], 1.0),
            cq.Cylinder([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 1.0),
            cq.Paraboloid([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 1.0),
            cq.SignedDistance(from_floor, 2),
        ),
        "bodies": (
            free,
            cq.UpdatedTruss(arch),
            solid(),
            block(),
            membrane(),
            cq.Support("block", "top", 0, 0.0),
            *loads(),
        ),
        "contacts": cq.ContactGroup([floor]),
        "errors": tuple(example(kind) for kind in sorted(errors(), key=lambda kind: kind.__name__)),
    }


def block() -> cq.Structure:
    steel = cq.Material(1.0, poisson=0.0)
    return cq.Structure([cq.Body(cq.rectangle(1.0, 1.0, (1, 1)), steel, "plane-strain", name="block")])


def membrane() -> cq.Membrane:
    return cq.Membrane(cq.rectangle(1.0, 1.0, (1, 1)), 2.0, name="sheet")


def loads() -> tuple[Any, ...]:
    """One of every kind, and the system that they act on."""
    acting = (
        cq.Traction("block", "top", [0.0, -1.0]),
        cq.Pressure("block", "top", 1.0),
        cq.PointLoad("block", "top", [0.0, -1.0]),
    )
    return (*acting, cq.Gravity("block", [0.0, -10.0]), block().assemble([cq.Support("block", "bottom", 1)], acting))


def solid() -> cq.NonlinearSolid:
    return cq.NonlinearSolid(block().solid("block"))


def solves(problem: cq.ContactProblem) -> Any:
    found = cq.solve(problem)
    return found.displacement, found.normal_force


def errors() -> set[type[BaseException]]:
    """The public exceptions and warnings."""
    public = [getattr(cq, name) for name in cq.__all__]
    return {kind for kind in public if isinstance(kind, type) and issubclass(kind, BaseException)}


def example(kind: type[BaseException]) -> BaseException:
    """An exception with something in every attribute that its constructor has."""
    given = {"solution": cq.solve(bars()), "history": [1.0, 0.5], "candidate": "answer", "proof": np.array([1.0])}
    own = inspect.isfunction(kind.__init__)
    names = [name for name in inspect.signature(kind.__init__).parameters if own and name in given]
    return kind("what came, what was expected", **{name: given[name] for name in names})


def parts(value: Any, seen: dict[int, Any] | None = None, where: str = "") -> Iterator[tuple[str, Any]]:
    """An object, and all that its public attributes and entries lead to, with the way there."""
    seen = {} if seen is None else seen
    if id(value) in seen or isinstance(value, (str, bytes, int, float, type(None))) or len(seen) > 100_000:
        return
    seen[id(value)] = value
    yield where, value
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from parts(one, seen, f"{where}[{key!r}]")
    elif _own(value):
        for name in public(value):
            try:
                one = getattr(value, name)
            except (cq.ContactQPError, TypeError, ValueError):
                continue  # what this one does not have
            yield from parts(one, seen, f"{where}.{name}")
    if isinstance(value, (tuple, list, cq.History)):
        for i, one in enumerate(value):
            yield from parts(one, seen, f"{where}[{i}]")


def public(value: Any) -> list[str]:
    """Names of the attributes that are data."""
    names = [name for name in dir(value) if not name.startswith("_") and not name.startswith("model_")]
    data = [name for name in names if isinstance(inspect.getattr_static(value, name), cached_property)]
    return data + [name for name in names if not inspect.isroutine(inspect.getattr_static(value, name))]


def _own(value: Any) -> bool:
    return type(value).__module__.partition(".")[0] == "contactqp"


def content(value: Any) -> Any:
    """What an object is made of, to be compared with `==`."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tolist() if value.dtype == object else value.tobytes()
    if sp.issparse(value):
        return value.format, content(value.toarray())
    if isinstance(value, Mapping):
        return {key: content(one) for key, one in value.items()}
    if isinstance(value, partial):
        return content(value.func), content(value.args), content(value.keywords)
    if isinstance(value, BaseException):
        return type(value), value.args, content(value.__dict__)
    if isinstance(value, cq.Scene):
        return value
    if _own(value):
        return type(value), content(state(value))
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [content(one) for one in value]
    return value


def state(value: Any) -> Any:
    """What is pickled of an object, apart from what is computed when it is looked at."""
    if isinstance(value, cq.History):
        computed = ("times", "events", "energies", "notes", "limit_points", "snaps", "velocities")
        return [*value, *(getattr(value, name, None) for name in computed)]
    kept = value.__getstate__()
    if dataclasses.is_dataclass(value) and isinstance(kept, dict):
        fields = {field.name for field in dataclasses.fields(value)}
        return {name: one for name, one in kept.items() if name in fields}
    return kept
