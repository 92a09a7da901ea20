"""contactqp: contact problems as energy minimisation with inequality constraints, every answer certified.

The public names are loaded when they are first used, so that a scene imports only what it needs. The table of
`docs/extending.md` says in which function each thing is done.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from contactqp.analysis.history import History as History
    from contactqp.analysis.impact import impact as impact
    from contactqp.analysis.large_deformation import large_deformation as large_deformation
    from contactqp.analysis.load_cases import Solutions as Solutions
    from contactqp.analysis.load_path import follow_path as follow_path
    from contactqp.analysis.many_loads import differentiable as differentiable
    from contactqp.analysis.many_loads import solve_many as solve_many
    from contactqp.analysis.motion.mass_matrix import redistributed_mass as redistributed_mass
    from contactqp.analysis.motion.motion_history import MotionHistory as MotionHistory
    from contactqp.certificate.critical_friction import CriticalFriction as CriticalFriction
    from contactqp.certificate.critical_friction import critical_friction as critical_friction
    from contactqp.certificate.local_certificate import acary_bremond_huber_error as acary_bremond_huber_error
    from contactqp.certificate.local_certificate import certify_local as certify_local
    from contactqp.certificate.local_certificate import fclib_merit_1 as fclib_merit_1
    from contactqp.certificate.local_certificate import siconos_global_error as siconos_global_error
    from contactqp.certificate.local_certificate import siconos_local_error as siconos_local_error
    from contactqp.elements.constrained_energy import ConstrainedEnergy as ConstrainedEnergy
    from contactqp.elements.constrained_energy import ConstrainedMinimum as ConstrainedMinimum
    from contactqp.elements.constrained_energy import PartState as PartState
    from contactqp.elements.deformable import ContactGroup as ContactGroup
    from contactqp.elements.deformable import ObstacleContact as ObstacleContact
    from contactqp.elements.deformable import Supported as Supported
    from contactqp.elements.energy_parts import AtLeast as AtLeast
    from contactqp.elements.energy_parts import AtMost as AtMost
    from contactqp.elements.energy_parts import Cable as Cable
    from contactqp.elements.energy_parts import Equal as Equal
    from contactqp.elements.energy_parts import Obstacle as Obstacle
    from contactqp.elements.energy_parts import PlasticHinge as PlasticHinge
    from contactqp.elements.energy_parts import Spring as Spring
    from contactqp.elements.energy_parts import Strut as Strut
    from contactqp.elements.loads import Gravity as Gravity
    from contactqp.elements.loads import PointLoad as PointLoad
    from contactqp.elements.loads import Pressure as Pressure
    from contactqp.elements.loads import Traction as Traction
    from contactqp.elements.material import Material as Material
    from contactqp.elements.mesh import Mesh as Mesh
    from contactqp.elements.mesh_files import read_mesh as read_mesh
    from contactqp.elements.mortar import pair_mortar as pair_mortar
    from contactqp.elements.node_to_segment import pair_node_to_segment as pair_node_to_segment
    from contactqp.elements.nonlinear_solid import NonlinearSolid as NonlinearSolid
    from contactqp.elements.nonlinear_truss import NonlinearTruss as NonlinearTruss
    from contactqp.elements.nonlinear_truss import UpdatedTruss as UpdatedTruss
    from contactqp.elements.obstacle import Plane as Plane
    from contactqp.elements.obstacle import SignedDistance as SignedDistance
    from contactqp.elements.pairing import Pairing as Pairing
    from contactqp.elements.pairing import pair as pair
    from contactqp.elements.pairing import pair_scalar as pair_scalar
    from contactqp.elements.round_obstacle import Circle as Circle
    from contactqp.elements.round_obstacle import Cylinder as Cylinder
    from contactqp.elements.round_obstacle import Paraboloid as Paraboloid
    from contactqp.elements.round_obstacle import Sphere as Sphere
    from contactqp.elements.shapes import box as box
    from contactqp.elements.shapes import rectangle as rectangle
    from contactqp.elements.solid import Body as Body
    from contactqp.elements.solid import Membrane as Membrane
    from contactqp.elements.structure import Structure as Structure
    from contactqp.elements.structure import Support as Support
    from contactqp.elements.structure import System as System
    from contactqp.elements.surface import Surface as Surface
    from contactqp.errors import BackendFailed as BackendFailed
    from contactqp.errors import BackendMissing as BackendMissing
    from contactqp.errors import ContactQPError as ContactQPError
    from contactqp.errors import InvalidProblem as InvalidProblem
    from contactqp.errors import NoEquilibrium as NoEquilibrium
    from contactqp.errors import NotCertified as NotCertified
    from contactqp.errors import NotConverged as NotConverged
    from contactqp.errors import SceneError as SceneError
    from contactqp.errors import SeveralEquilibria as SeveralEquilibria
    from contactqp.errors import StartWarning as StartWarning
    from contactqp.errors import TimeStepWarning as TimeStepWarning
    from contactqp.errors import Unsupported as Unsupported
    from contactqp.exchange.fclib import read_fclib as read_fclib
    from contactqp.exchange.fclib import read_fclib_guesses as read_fclib_guesses
    from contactqp.exchange.fclib import read_fclib_solution as read_fclib_solution
    from contactqp.exchange.fclib import write_fclib as write_fclib
    from contactqp.exchange.local_form import local_form_of as local_form_of
    from contactqp.exchange.problem_files import read_problem as read_problem
    from contactqp.exchange.problem_folder import write_problem as write_problem
    from contactqp.exchange.siconos import read_siconos as read_siconos
    from contactqp.model.local_problem import GlobalProblem as GlobalProblem
    from contactqp.model.local_problem import LocalProblem as LocalProblem
    from contactqp.model.local_problem import LocalSolution as LocalSolution
    from contactqp.model.problem import ContactProblem as ContactProblem
    from contactqp.model.problem import Units as Units
    from contactqp.model.solution import Certificate as Certificate
    from contactqp.model.solution import LocalCertificate as LocalCertificate
    from contactqp.model.solution import Solution as Solution
    from contactqp.oracle.diagnosis.evidence import Finding as Finding
    from contactqp.oracle.exact.exact import exact as exact
    from contactqp.oracle.exact.exact_solution import ExactSolution as ExactSolution
    from contactqp.oracle.foreign.crosscheck import crosscheck as crosscheck
    from contactqp.oracle.judged_answer import JudgedAnswer as JudgedAnswer
    from contactqp.oracle.judged_answer import certify as certify
    from contactqp.pictures.history_drawing import draw_history as draw_history
    from contactqp.scene.deck.deck import read_deck as read_deck
    from contactqp.scene.scene import Scene as Scene
    from contactqp.scene.scene import load_scene as load_scene
    from contactqp.scene.scene import run as run
    from contactqp.solving.equilibria import AssociatedDifference as AssociatedDifference
    from contactqp.solving.equilibria import associated_difference as associated_difference
    from contactqp.solving.equilibria import equilibria as equilibria
    from contactqp.solving.equilibria import existence_margin as existence_margin
    from contactqp.solving.friction.exact_enumeration import ExactEquilibrium as ExactEquilibrium
    from contactqp.solving.friction.exact_enumeration import exact_equilibria as exact_equilibria
    from contactqp.solving.methods import methods as methods
    from contactqp.solving.solve import solve as solve
    from contactqp.study.answer_pictures import draw as draw
    from contactqp.study.comparison import compare as compare

# The modules and the public names that they hold.
_NAMES = {
    "analysis.history": ["History"],
    "analysis.impact": ["impact"],
    "analysis.large_deformation": ["large_deformation"],
    "analysis.load_cases": ["Solutions"],
    "analysis.load_path": ["follow_path"],
    "analysis.many_loads": ["differentiable", "solve_many"],
    "analysis.motion.mass_matrix": ["redistributed_mass"],
    "analysis.motion.motion_history": ["MotionHistory"],
    "certificate.critical_friction": ["CriticalFriction", "critical_friction"],
    "certificate.local_certificate": [
        "acary_bremond_huber_error",
        "certify_local",
        "fclib_merit_1",
        "siconos_global_error",
        "siconos_local_error",
    ],
    "elements.constrained_energy": ["ConstrainedEnergy", "ConstrainedMinimum", "PartState"],
    "elements.deformable": ["ContactGroup", "ObstacleContact", "Supported"],
    "elements.energy_parts": ["AtLeast", "AtMost", "Cable", "Equal", "Obstacle", "PlasticHinge", "Spring", "Strut"],
    "elements.loads": ["Gravity", "PointLoad", "Pressure", "Traction"],
    "elements.material": ["Material"],
    "elements.mesh": ["Mesh"],
    "elements.mesh_files": ["read_mesh"],
    "elements.mortar": ["pair_mortar"],
    "elements.node_to_segment": ["pair_node_to_segment"],
    "elements.nonlinear_solid": ["NonlinearSolid"],
    "elements.nonlinear_truss": ["NonlinearTruss", "UpdatedTruss"],
    "elements.obstacle": ["Plane", "SignedDistance"],
    "elements.pairing": ["Pairing", "pair", "pair_scalar"],
    "elements.round_obstacle": ["Circle", "Cylinder", "Paraboloid", "Sphere"],
    "elements.shapes": ["box", "rectangle"],
    "elements.solid": ["Body", "Membrane"],
    "elements.structure": ["Structure", "Support", "System"],
    "elements.surface": ["Surface"],
    "errors": [
        "BackendFailed",
        "BackendMissing",
        "ContactQPError",
        "InvalidProblem",
        "NoEquilibrium",
        "NotCertified",
        "NotConverged",
        "SceneError",
        "SeveralEquilibria",
        "StartWarning",
        "TimeStepWarning",
        "Unsupported",
    ],
    "exchange.fclib": ["read_fclib", "read_fclib_guesses", "read_fclib_solution", "write_fclib"],
    "exchange.local_form": ["local_form_of"],
    "exchange.problem_files": ["read_problem"],
    "exchange.problem_folder": ["write_problem"],
    "exchange.siconos": ["read_siconos"],
    "model.local_problem": ["GlobalProblem", "LocalProblem", "LocalSolution"],
    "model.problem": ["ContactProblem", "Units"],
    "model.solution": ["Certificate", "LocalCertificate", "Solution"],
    "oracle.diagnosis.evidence": ["Finding"],
    "oracle.exact.exact": ["exact"],
    "oracle.exact.exact_solution": ["ExactSolution"],
    "oracle.foreign.crosscheck": ["crosscheck"],
    "oracle.judged_answer": ["JudgedAnswer", "certify"],
    "pictures.history_drawing": ["draw_history"],
    "scene.deck.deck": ["read_deck"],
    "scene.scene": ["Scene", "load_scene", "run"],
    "solving.equilibria": ["AssociatedDifference", "associated_difference", "equilibria", "existence_margin"],
    "solving.friction.exact_enumeration": ["ExactEquilibrium", "exact_equilibria"],
    "solving.methods": ["methods"],
    "solving.solve": ["solve"],
    "study.answer_pictures": ["draw"],
    "study.comparison": ["compare"],
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}
__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("contactqp")
    if name not in _HOME:
        near = [] if name.startswith("_") else importlib.import_module("difflib").get_close_matches(name, _HOME, n=1)
        cure = f"; nearest: {near[0]}" if near else ""
        raise AttributeError(f"module 'contactqp' has no attribute {name!r}{cure}")
    found = globals()[name] = getattr(importlib.import_module(f"contactqp.{_HOME[name]}"), name)
    return found


def __dir__() -> list[str]:
    return __all__
