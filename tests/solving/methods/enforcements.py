"""The five classical enforcements, called by name."""

from __future__ import annotations

import scipy.sparse as sp

from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.augmented_lagrangian import solve_augmented_lagrangian
from contactqp.solving.methods.lagrange_multiplier import solve_lagrange_multiplier, solve_perturbed_lagrangian
from contactqp.solving.methods.master_slave import solve_master_slave
from contactqp.solving.methods.method import Settings
from contactqp.solving.methods.penalty import solve_penalty

EXACT = {
    "master-slave": (solve_master_slave, {}),
    "lagrange-multiplier": (solve_lagrange_multiplier, {}),
    "augmented, default": (solve_augmented_lagrangian, {}),
    "augmented, 0": (solve_augmented_lagrangian, {"penalty": 0.0}),
    "augmented, 10": (solve_augmented_lagrangian, {"penalty": 10.0}),
}
PENALISED = {
    "penalty": (solve_penalty, "penalty"),
    "perturbed-lagrangian": (solve_perturbed_lagrangian, "perturbation"),
}
UP_TO_1E8 = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8)


def answer(name: str, problem: ContactProblem, **changes: object) -> Candidate:
    solve, options = EXACT[name]
    return solve(problem, Settings(options=options, **changes))


def penalised(name: str, problem: ContactProblem, stiffness: object) -> Candidate:
    solve, option = PENALISED[name]
    return solve(problem, Settings(options={option: stiffness}))


def sparse(problem: ContactProblem) -> ContactProblem:
    return problem.replace(stiffness=sp.csc_array(problem.stiffness))
