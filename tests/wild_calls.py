"""A call of every public function, constructor and method that takes arguments, which works as it stands.

A name that is new and not here fails a test, and so does an argument: each is replaced by every wild value.
"""

from __future__ import annotations

import inspect
import pathlib
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import contactqp as cq
from contactqp import testing
from tests import public_objects as given

ALGORITHMS = ("tresca", "newton", "nsgs", "ppa", "admm", "enumeration", "associated")
CARRIED = "carries what it is given"
ANSWER = "an answer: functions of this package make it"
# What no user calls, and why.
NOT_CALLED: dict[str, str] = {
    **{kind.__name__: CARRIED for kind in given.errors()},
    **dict.fromkeys(
        ("AssociatedDifference", "Certificate", "ConstrainedMinimum", "CriticalFriction", "ExactEquilibrium",
         "ExactSolution", "Finding", "History", "JudgedAnswer", "LocalCertificate", "LocalSolution", "MotionHistory",
         "Pairing", "PartState", "Solution", "Solutions", "System", "testing.ExactAnswer", "testing.ExactProblem",
         "testing.GalleryProblem",
         "testing.SolverReport", "testing.SolverVerdict"), ANSWER),
    **{f"{part}.state": "called with the energy's own answer" for part in
       ("AtLeast", "AtMost", "Equal", "Obstacle", "Spring", "Cable", "Strut", "PlasticHinge")},
    **{f"Body.{name}": "called with the blocks of the body's own mesh" for name in
       ("element_stiffness", "integration", "node_blocks", "stiffness_rule")},
    **{f"Mesh.{name}": "called with the mesh's own facets" for name in
       ("facets_of", "facets_within", "find_facets", "places")},
    **{f"NonlinearTruss.{name}": "called with the truss's own blocks and forces" for name in ("assembled", "summed")},
    "differentiable": "a bridge to packages that these tests do without",
    "Scene.model_copy": "pydantic's own",
    "Scene.model_post_init": "pydantic's own",
    **{f"Scene.{name}": "called by blocks, with names and quantities that the scene has checked" for name in
       ("body", "displacements", "element", "obstacle", "point", "value")},
}  # fmt: skip


@dataclass(frozen=True)
class Call:
    """A function and arguments that it takes."""

    function: Callable[..., Any]
    arguments: dict[str, Any]


def mesh() -> cq.Mesh:
    return cq.rectangle(1.0, 1.0, (1, 1))


def body() -> cq.Body:
    return given.block().solid("block")


def side(first: int = 0, up: bool = True) -> cq.Surface:
    """A segment of unit length, whose normal points down, or up at y = -0.1."""
    points = np.array([[0.0, 0.0], [1.0, 0.0]]) if up else np.array([[1.0, -0.1], [0.0, -0.1]])
    return cq.Surface(points, np.array([[0, 1]]), first + np.arange(4).reshape(2, 2))


def truss() -> cq.NonlinearTruss:
    return cq.NonlinearTruss([[-1, 0], [0, 0.2], [1, 0]], [[0, 1], [1, 2]], modulus=100.0, area=1.0)


def in_space() -> cq.LocalProblem:
    return cq.LocalProblem(np.eye(3), [-1.0, 0.5, 0.0], 0.3, 3)


def chain() -> cq.ContactProblem:
    return cq.ContactProblem(
        np.diag([2.0, 2.0, 1.0]) - np.eye(3, k=1) - np.eye(3, k=-1), [0.0, 0.0, 1.0], [[0.0, 0.0, 1.0]], [0.1]
    )


def calls(folder: pathlib.Path) -> dict[str, Call]:
    """Calls by their names; what they write lies in `folder`."""
    problem, rubbing, local, tied, _ = given.objects()["problems"]
    solution = given.objects()["solutions"][0]
    assembled = given.block().assemble([cq.Support("block", "bottom", 1)])
    u8, u6, u2 = np.zeros(8), np.zeros(6), np.zeros(2)
    free = cq.Supported(truss(), held=[0, 1, 4, 5])
    floor = cq.ObstacleContact([[0, 0.2]], cq.Plane([0, -0.1], [0, 1]))
    apex = cq.ObstacleContact([[0, 0.2]], cq.Plane([0, -0.1], [0, 1]), [[2, 3]], 6)
    group = cq.ContactGroup([floor])
    pairing = cq.pair(side(), cq.Plane([0.0, -0.1], [0.0, 1.0]))
    updated = cq.UpdatedTruss(truss())
    solid = cq.NonlinearSolid(body())
    scene = given.CASES / "bar_wall.toml"
    cq.write_fclib(folder / "local.hdf5", local, cq.solve(local))
    cq.write_fclib(folder / "guess.hdf5", local, cq.solve(local))
    cq.write_problem(folder / "problem", problem)
    text = folder / "local.dat"
    text.write_text("2 1  0 2 2  2 2  1 0.5 0.25 3   -1 -2   0.7")
    mesh_file = folder / "mesh.inp"
    mesh_file.write_text(MESH)
    deck_file = folder / "deck.inp"
    deck_file.write_text(MESH + DECK)
    deck_results = folder / "deck.dat"
    deck_results.write_text(RESULTS)
    judged = given.objects()["judged"][1]
    known = testing.problem("truss-over-floor")
    answer = dict(displacement=solution.displacement, normal_force=solution.normal_force)
    of_local = dict(problem=local, force=np.zeros(local.contacts * 2))
    energy = cq.ConstrainedEnergy(["w"], [[2.0]], [3.0])
    structure, heavy = given.block(), cq.Body(mesh(), cq.Material(1.0, 0.0, 2.0), "plane-strain", name="block")
    dense = cq.Structure([heavy])
    bottom, pressure = cq.Support("block", "bottom", 1), cq.Pressure("block", "top", 1.0)
    edge = dict(points=[[0.0, 0.0], [1.0, 0.0]], facets=[[0, 1]], unknowns=[[0, 1], [2, 3]])
    plain = tomllib.loads(scene.read_text())
    plain = {key: plain[key] for key in plain.keys() - {"expect", "published", "remarks", "study"}}
    history = given.objects()["history"]

    table: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
        "AtLeast": (cq.AtLeast, dict(name="least", form={"w": 1.0}, bound=1.0)),
        "AtMost": (cq.AtMost, dict(name="most", form={"w": 1.0}, bound=1.0)),
        "Equal": (cq.Equal, dict(name="equal", form={"w": 1.0}, bound=1.0)),
        "Obstacle": (cq.Obstacle, dict(name="wall", unknowns=("w",), lower=-8.0)),
        "Spring": (cq.Spring, dict(name="spring", stiffness=2.0, elongation={"w": 1.0})),
        "Cable": (cq.Cable, dict(name="cable", elongation={"w": 1.0}, stiffness=8.0)),
        "Strut": (cq.Strut, dict(name="strut", elongation={"w": 1.0}, stiffness=8.0)),
        "PlasticHinge": (cq.PlasticHinge, dict(name="hinge", rotation={"w": 1.0}, capacity=5.0, stiffness=100.0)),
        "ConstrainedEnergy": (cq.ConstrainedEnergy, dict(unknowns=["w"], stiffness=[[2.0]], load=[3.0])),
        "ConstrainedEnergy.read": (energy.read, dict(solution=energy.solve().solution)),
        "ConstrainedEnergy.solve": (energy.solve, {}),
        "Membrane": (cq.Membrane, dict(mesh=mesh(), tension=1.0)),
        "Body": (cq.Body, dict(mesh=mesh(), material=cq.Material(1.0, 0.0), model="plane-strain")),
        "Body.rigid_motions": (body().rigid_motions, {}),
        "Body.surface": (body().surface, dict(name="top")),
        "Circle": (cq.Circle, dict(centre=[0.0, 0.0], radius=1.0)),
        "Sphere": (cq.Sphere, dict(centre=[0.0, 0.0, 0.0], radius=1.0)),
        "Cylinder": (cq.Cylinder, dict(point=[0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0], radius=1.0)),
        "Paraboloid": (cq.Paraboloid, dict(apex=[0.0, 0.0], axis=[0.0, 1.0], radius=1.0)),
        "Plane": (cq.Plane, dict(point=[0.0, 0.0], normal=[0.0, 1.0])),
        "SignedDistance": (cq.SignedDistance, dict(function=given.from_floor, dimension=2)),
        "ContactGroup": (cq.ContactGroup, dict(parts=[floor])),
        "ObstacleContact": (cq.ObstacleContact, dict(points=[[0.0, 0.2]], obstacle=cq.Plane([0.0, 0.0], [0.0, 1.0]))),
        "ContactProblem": (cq.ContactProblem, dict(stiffness=[[5.0, -2.0], [-2.0, 1.0]], load=[-1.0, -3.0],
            normal=[[-1.0, 0.0]], gap=[0.1], tangent=[[0.0, 1.0]], friction=0.3)),
        "ContactProblem.from_qp": (cq.ContactProblem.from_qp, dict(P=np.eye(2), q=[1.0, 1.0], G=[[1.0, 0.0]], h=[1.0],
            A=[[1.0, 1.0]], b=[0.0], lb=[-5.0, -5.0], ub=[5.0, 5.0])),
        "ContactProblem.replace": (rubbing.replace, dict(load=[0.0, 0.0], gap=[0.2])),
        "ContactProblem.energy": (problem.energy, dict(displacement=u2)),
        "ContactProblem.contact_name": (problem.contact_name, dict(i=0)),
        "ContactProblem.dof_name": (problem.dof_name, dict(j=0)),
        "ContactProblem.tie_name": (tied.tie_name, dict(i=0)),
        "ContactProblem.with_contacts": (problem.with_contacts, dict(contacts=np.array([1]))),
        "ContactProblem.with_ties": (tied.with_ties, dict(ties=np.array([0]))),
        "GlobalProblem": (cq.GlobalProblem, dict(matrix=np.eye(2), directions=np.eye(2), load=[0.0, 1.0],
            offset=[0.0, 0.0], friction=0.3, dimension=2)),
        "GlobalProblem.of": (cq.GlobalProblem.of, dict(problem=rubbing)),
        "LocalProblem": (cq.LocalProblem, dict(delassus=np.eye(2), offset=[-1.0, 0.5], friction=0.3, dimension=2)),
        "LocalProblem.contact_name": (local.contact_name, dict(i=0)),
        "LocalProblem.with_offsets": (local.with_offsets, dict(offset=[-1.0, 0.5], bilateral_offset=np.zeros(0))),
        "Gravity": (cq.Gravity, dict(body="block", acceleration=[0.0, -10.0])),
        "Gravity.forces": (cq.Gravity("block", [0.0, -1.0]).forces, dict(body=heavy)),
        "Traction": (cq.Traction, dict(body="block", side="top", value=[0.0, -1.0])),
        "Traction.forces": (cq.Traction("block", "top", [0.0, -1.0]).forces, dict(body=body())),
        "Pressure": (cq.Pressure, dict(body="block", side="top", value=1.0)),
        "Pressure.forces": (cq.Pressure("block", "top", 1.0).forces, dict(body=body())),
        "PointLoad": (cq.PointLoad, dict(body="block", nodes="top", force=[0.0, -1.0])),
        "PointLoad.forces": (cq.PointLoad("block", "top", [0.0, -1.0]).forces, dict(body=body())),
        "Support": (cq.Support, dict(body="block", nodes="bottom", axis=1)),
        "Material": (cq.Material, dict(modulus=1.0, poisson=0.2)),
        "Material.constitutive": (cq.Material(1.0, 0.2).constitutive, dict(model="plane-strain")),
        "Material.stress_matrix": (cq.Material(1.0, 0.2).stress_matrix, dict(model="plane-strain")),
        "Mesh": (cq.Mesh, dict(points=mesh().points, blocks=mesh().blocks)),
        "Mesh.mapped": (mesh().mapped, dict(map_points=lambda x: 2 * x)),
        "Mesh.nearest": (mesh().nearest, dict(point=[0.0, 0.0])),
        "Mesh.nodes": (mesh().nodes, dict(name="top")),
        "Mesh.number": (mesh().number, dict(node=0)),
        "Mesh.side": (mesh().side, dict(name="top")),
        "Mesh.with_node_sets": (mesh().with_node_sets, dict(node_sets={"a": [0]})),
        "Mesh.with_sides": (mesh().with_sides, dict(sides={"a": mesh().sides["top"]})),
        "NonlinearSolid": (cq.NonlinearSolid, dict(body=body())),
        "NonlinearTruss": (cq.NonlinearTruss, dict(nodes=[[0.0, 0.0], [1.0, 0.0]], bars=[[0, 1]],
            modulus=1.0, area=1.0)),
        "UpdatedTruss": (cq.UpdatedTruss, dict(truss=truss())),
        "Supported": (cq.Supported, dict(body=truss(), held=[0, 1, 4, 5])),
        "Supported.contact": (free.contact, dict(geometry=apex)),
        "Supported.restrict": (free.restrict, dict(load=u6)),
        "Structure": (cq.Structure, dict(bodies=[body()])),
        "Structure.assemble": (structure.assemble, dict(supports=[bottom], loads=[pressure])),
        "Structure.mass": (dense.mass, {}),
        "System.mass": (dense.assemble([bottom]).mass, {}),
        "Structure.prescribed": (structure.prescribed, dict(supports=[bottom])),
        "Structure.body": (structure.body, dict(name="block")),
        "Structure.solid": (structure.solid, dict(name="block")),
        "Structure.first": (structure.first, dict(name="block")),
        "Structure.surface": (structure.surface, dict(body="block", side="top")),
        "Structure.displacements": (structure.displacements, dict(name="block", displacement=u8)),
        "Surface": (cq.Surface, edge),
        "System.expand": (assembled.expand, dict(displacement=np.zeros(6))),
        "System.support_forces": (assembled.support_forces, dict(displacement=u8)),
        "System.problem": (assembled.problem, dict(pairings=[])),
        "System.free_contacts": (assembled.free_contacts, dict(pairings=[])),
        "Pairing.per_area": (pairing.per_area, dict(force=np.zeros(2))),
        "Pairing.pressure": (pairing.pressure, dict(normal_force=np.zeros(2))),
        "Units": (cq.Units, dict(length="m", force="N")),
        **{f"{kind}.{method}": (getattr(one, method), arguments)
           for kind, one in (("History", history), ("MotionHistory", given.objects()["motion"]))
           for method, arguments in (("plot", {}), ("table", {}), ("write_csv", dict(file=folder / "history.csv")))},
        "MotionHistory.resume": (given.objects()["motion"].resume, dict(duration=0.1)),
        "JudgedAnswer.findings_within": (judged.findings_within, dict(operations=1e5)),
        "JudgedAnswer.table": (judged.table, {}),
        "Solution.plot": (solution.plot, {}),
        **{f"Solutions.{name}": (getattr(given.objects()["cases"], name), dict(i=0))
           for name in ("case", "displacement")},
        **{f"Solutions.{name}": (getattr(given.objects()["cases"], name), arguments)
           for name, arguments in (("plot", {}), ("table", {}), ("write_csv", dict(file=folder / "cases.csv")))},
        "Solution.derivative": (solution.derivative, dict(of="gap", with_respect_to="load", direction=np.ones(2))),
        "ExactSolution.derivative": (given.objects()["exact"][0].derivative, dict(of="gap", with_respect_to="load",
            direction=np.ones(2))),
        "Solution.jacobian": (solution.jacobian, dict(of="displacement", with_respect_to="gap")),
        "Solution.pullback": (solution.pullback, dict(of="gap", weights=np.ones(2), with_respect_to="stiffness")),
        **{f"Solution.{name}": (getattr(solution, name), {"unknown" if name == "at" else "contact": 0})
           for name in ("at", "force_at", "friction_at", "gap_at", "status_at")},
        **{f"{name}.{method}": (getattr(one, method), dict(points=points))
           for name, one, points in (
               ("Circle", cq.Circle([0.0, 0.0], 1.0), [[2.0, 0.0]]),
               ("Sphere", cq.Sphere([0.0, 0.0, 0.0], 1.0), [[2.0, 0.0, 0.0]]),
               ("Cylinder", cq.Cylinder([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 1.0), [[2.0, 0.0, 0.0]]),
               ("Paraboloid", cq.Paraboloid([0.0, 0.0], [0.0, 1.0], 1.0), [[0.0, 2.0]]),
               ("Plane", cq.Plane([0.0, 0.0], [0.0, 1.0]), [[0.0, 2.0]]),
               ("SignedDistance", cq.SignedDistance(given.from_floor, 2), [[0.0, 2.0]]))
           for method in ("distance", "normals")},
        **{f"{name}.{method}": (getattr(one, method), dict(displacement=u) | extra)
           for name, one, u in (("ContactGroup", group, u2), ("ObstacleContact", floor, u2))
           for method, extra in (("state", {}), ("positions", {}), ("curvature", dict(normal_force=[1.0])),
                                 ("slip_since", dict(anchor=floor.positions(u2))))},
        **{f"{name}.{method}": (getattr(one, method), dict(displacement=u))
           for name, one, u, methods in (
               ("NonlinearSolid", solid, u8, "cauchy_stress energy internal_force tangent"),
               ("NonlinearTruss", truss(), u6, "axial_force energy internal_force positions strain stress tangent"),
               ("UpdatedTruss", updated, u6, "almansi_strain area cauchy_stress current_modulus energy internal_force "
                                             "length tangent"),
               ("Supported", free, u2, "energy expand internal_force support_forces tangent"))
           for method in methods.split()},
        "Scene": (cq.Scene, plain),
        "acary_bremond_huber_error": (cq.acary_bremond_huber_error, of_local),
        "fclib_merit_1": (cq.fclib_merit_1, dict(problem=in_space(), force=np.zeros(3))),
        "siconos_local_error": (cq.siconos_local_error, of_local),
        "certify_local": (cq.certify_local, of_local),
        "siconos_global_error": (cq.siconos_global_error, dict(problem=rubbing, displacement=u2,
            normal_force=[0.0], friction_force=[[0.0]])),
        "associated_difference": (cq.associated_difference, dict(problem=rubbing)),
        "box": (cq.box, dict(lengths=(1.0, 1.0, 1.0), divisions=(1, 1, 1))),
        "rectangle": (cq.rectangle, dict(width=1.0, height=1.0, divisions=(1, 1))),
        "certify": (cq.certify, dict(problem=problem, **answer)),
        "compare": (cq.compare, dict(problem=problem, methods=["active-set"])),
        "critical_friction": (cq.critical_friction, dict(problem=rubbing)),
        "crosscheck": (cq.crosscheck, dict(path=deck_file, results=deck_results, reference="exact",
            error_tolerance=1e-2, time_limit=10.0, folder=folder / "run")),
        "draw": (cq.draw, dict(answer=solution)),
        "draw_history": (cq.draw_history, dict(history=history, file=folder / "history.svg")),
        "equilibria": (cq.equilibria, dict(problem=rubbing)),
        "exact": (cq.exact, dict(problem=problem)),
        "exact_equilibria": (cq.exact_equilibria, dict(problem=rubbing)),
        "existence_margin": (cq.existence_margin, dict(problem=rubbing)),
        "follow_path": (cq.follow_path, dict(problem=problem, loads=[[10.0, 1.0]], steps=2)),
        "impact": (cq.impact, dict(problem=problem, mass=np.eye(2), displacement=[0.0, 0.0], velocity=[1.0, 0.0],
            duration=0.2, time_step=0.05)),
        "large_deformation": (cq.large_deformation, dict(body=free, loads=[[0.0, -0.1]], steps=1)),
        "load_scene": (cq.load_scene, dict(path=scene)),
        "local_form_of": (cq.local_form_of, dict(problem=rubbing)),
        "pair": (cq.pair, dict(points=[[0.0, 0.5]], obstacle=cq.Plane([0.0, 0.0], [0.0, 1.0]))),
        "pair_mortar": (cq.pair_mortar, dict(slave=side(), master=side(4, up=False))),
        "pair_node_to_segment": (cq.pair_node_to_segment, dict(slave=side(), master=side(4, up=False))),
        "pair_scalar": (cq.pair_scalar, dict(points=[[0.0, 0.0], [1.0, 0.0]], obstacle_height=[0.5, 0.1])),
        "read_deck": (cq.read_deck, dict(path=deck_file)),
        "read_fclib": (cq.read_fclib, dict(path=folder / "local.hdf5")),
        "read_fclib_guesses": (cq.read_fclib_guesses, dict(path=folder / "guess.hdf5")),
        "read_fclib_solution": (cq.read_fclib_solution, dict(path=folder / "local.hdf5")),
        "read_mesh": (cq.read_mesh, dict(path=mesh_file)),
        "read_problem": (cq.read_problem, dict(path=folder / "problem")),
        "read_siconos": (cq.read_siconos, dict(path=text)),
        "redistributed_mass": (cq.redistributed_mass, dict(mass=np.eye(3), problem=chain())),
        "run": (cq.run, dict(scene=cq.load_scene(scene))),
        "solve": (cq.solve, dict(problem=problem)),
        "solve_many": (cq.solve_many, dict(problem=rubbing, loads=[[-1.0, -3.0]], gaps=[[0.2]], friction=0.1)),
        "write_fclib": (cq.write_fclib, dict(path=folder / "again.hdf5", problem=local)),
        "write_problem": (cq.write_problem, dict(folder=folder / "written", problem=problem)),
        "testing.problem": (testing.problem, dict(name="truss-over-floor")),
        "testing.problems": (testing.problems, dict(kind="redundant", count=1)),
        "testing.check_solver": (testing.check_solver, dict(solver=given.solves, problems=[known])),
        "testing.assert_contact_solution": (testing.assert_contact_solution, dict(problem=problem, **answer)),
        "testing.assert_multipliers": (testing.assert_multipliers, dict(problem=problem,
            normal_force=solution.normal_force)),
    }  # fmt: skip
    return {name: Call(*one) for name, one in table.items()}


# Their names are known to what collects tests, which need not make the objects of the calls.
COLLECTING = (
    *(f"solve: {method}" for method in ("penalty", "perturbed-lagrangian", "augmented-lagrangian", "cvxpy")),
    *(f"solve: {algorithm}" for algorithm in ALGORITHMS),
    "solve: cones", "solve: local", "ContactProblem.from_qp", "ContactProblem.replace", "History.plot",
    "MotionHistory.plot", "Solutions.plot", "Solution.plot", "compare", "exact", "exact_equilibria", "follow_path",
    "impact", "large_deformation", "run", "solve_many", "ConstrainedEnergy.solve", "associated_difference",
)  # fmt: skip


@cache
def options() -> dict[str, tuple[Call, list[str]]]:
    """Calls of functions that collect options, by function and what is special, each with names of options."""
    problem, rubbing, local, _, _ = given.objects()["problems"]
    history, solution, motion = (given.objects()[name] for name in ("history", "solutions", "motion"))
    space = cq.ContactProblem(np.diag([3.0, 2, 2]), [-3.0, 2, 1], [[-1.0, 0, 0]], [0.0],
                              tangent=[[0.0, 1, 0], [0, 0, 1]], friction=0.5)  # fmt: skip
    free = cq.Supported(truss(), held=[0, 1, 4, 5])
    scene = cq.load_scene(given.CASES / "bar_wall.toml")
    energy = cq.ConstrainedEnergy(["w"], [[2.0]], [3.0])
    program = dict(P=np.eye(2), q=[1.0, 1.0], C=[[1.0, 1.0]], l=[-1.0], u=[1.0])
    common = ["method", "algorithm", "tolerance", "penalty", "max_iter", "time_limit"]
    moved = dict(problem=problem, mass=np.eye(2), displacement=[0.0, 0.0], velocity=[1.0, 0.0], duration=0.2,
                 time_step=0.1)  # fmt: skip
    table: dict[str, tuple[Callable[..., Any], dict[str, Any], list[str]]] = {
        **{f"solve: {method}": (cq.solve, dict(problem=problem, method=method, **needed), names)
           for method, needed, names in (
               ("penalty", dict(penalty=1e4), ["penalty", "tangential_penalty"]),
               ("perturbed-lagrangian", {}, ["perturbation"]),
               ("augmented-lagrangian", {}, ["penalty", "tangential_penalty", "update"]),
               ("cvxpy", {}, ["solver"]))},
        **{f"solve: {algorithm}": (cq.solve, dict(problem=rubbing, algorithm=algorithm), ["max_iter", "condense"])
           for algorithm in ALGORITHMS},
        "solve: cones": (cq.solve, dict(problem=space, method="osqp", algorithm="aclm"), ["facets", "polygon"]),
        "solve: local": (cq.solve, dict(problem=local), ["warm_start", "condense", "time_limit"]),
        "ContactProblem.from_qp": (cq.ContactProblem.from_qp, program, ["C", "l", "u", "range_names"]),
        "ContactProblem.replace": (rubbing.replace, {}, ["stiffness", "load", "normal", "gap", "tangent", "friction",
            "slip_origin", "tie", "tie_value", "dof_names", "contact_names", "units", "near_null_space"]),
        "History.plot": (history.plot, {}, ["title", "time_unit"]),
        "MotionHistory.plot": (motion.plot, {}, ["title", "time_unit"]),
        "Solutions.plot": (given.objects()["cases"].plot, {}, ["title", "scale"]),
        "Solution.plot": (solution[0].plot, {}, ["title", "contacts", "scale"]),
        "compare": (cq.compare, dict(problem=problem, methods=["penalty"]), ["penalty"]),
        "exact": (cq.exact, dict(problem=problem), ["gap", "load", "stiffness"]),
        "exact_equilibria": (cq.exact_equilibria, dict(problem=rubbing), ["gap", "friction"]),
        "follow_path": (cq.follow_path, dict(problem=rubbing, loads=[[-1.0, -3.0]], steps=2), common),
        "impact": (cq.impact, moved, [*common, "restitution"]),
        "large_deformation": (cq.large_deformation, dict(body=free, loads=[[0.0, -0.1]], steps=1), common),
        "run": (cq.run, dict(scene=scene), common),
        "solve_many": (cq.solve_many, dict(problem=problem, loads=[[10.0, 1.0]]), common),
        "ConstrainedEnergy.solve": (energy.solve, {}, common),
        "associated_difference": (cq.associated_difference, dict(problem=rubbing), ["tolerance", "max_iter"]),
    }  # fmt: skip
    return {name: (Call(function, arguments), names) for name, (function, arguments, names) in table.items()}


MESH = """\
*NODE
1, 0., 0.
2, 1., 0.
3, 1., 1.
4, 0., 1.
*ELEMENT, TYPE=CPE4, ELSET=E
1, 1, 2, 3, 4
"""
DECK = """\
*MATERIAL, NAME=STEEL
*ELASTIC
210000., 0.3
*SOLID SECTION, ELSET=E, MATERIAL=STEEL
*STEP
*STATIC
*END STEP
"""
RESULTS = """
 displacements (vx,vy,vz) for set ALL and time  0.1000000E+01

         1  0.000000E+00  0.000000E+00  0.000000E+00
         2  0.000000E+00  0.000000E+00  0.000000E+00
         3  0.000000E+00  0.000000E+00  0.000000E+00
         4  0.000000E+00  0.000000E+00  0.000000E+00
"""


def names() -> Iterator[str]:
    """Names of all public functions, constructors and methods that take arguments."""
    for module, prefix in ((cq, ""), (testing, "testing.")):
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.isclass(value):
                if parameters(value):
                    yield prefix + name
                yield from (f"{prefix}{name}.{method}" for method in methods(value))
            elif callable(value) and parameters(value):
                yield prefix + name


def methods(kind: type) -> list[str]:
    """Names of the public methods that take arguments, without those that a class inherits from other packages."""
    found = []
    for name in dir(kind):
        home = next((base for base in kind.__mro__ if name in vars(base)), object)
        value = getattr(kind, name)
        own = home.__module__.startswith("contactqp") and not name.startswith("_")
        if own and callable(value) and not inspect.isclass(value) and not isinstance(value, type):
            static = isinstance(inspect.getattr_static(kind, name), (staticmethod, classmethod))
            if parameters(value)[0 if static else 1 :]:
                found.append(name)
    return found


def parameters(function: Any) -> list[str]:
    try:
        return list(inspect.signature(function).parameters)
    except ValueError:  # an exception's own constructor
        return ["args"]
