"""Whether a frictional problem surely has a solution."""

from __future__ import annotations

import numpy as np

from contactqp.errors import InvalidProblem, Unsupported, refuse_other
from contactqp.linalg.condensation import condense
from contactqp.linalg.frictional_rows import FrictionalRows
from contactqp.model.floating_point import own_floating_point
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.solving.friction.contact_form import ContactForm
from contactqp.solving.friction.existence_test import interior_margin
from contactqp.solving.friction.local_form import LocalForm


@own_floating_point
def existence_margin(problem: ContactProblem | LocalProblem) -> float:
    """The test of Acary, Cadoux, Lemarechal and Malick (2011): positive where a solution surely exists.

    The largest x <= 1 such that some velocity u = W y + V l + q has u_N - x >= mu |u_T| at every contact, in a scale in
    which contacts have a compliance of one and q entries of size one. Where it is positive there are forces that
    satisfy the law, whatever the coefficients of friction; the test is sufficient, not necessary.

    Raises
    ------
    InvalidProblem
        A contact problem without friction: the minimum exists where the constraints do not conflict.
    Unsupported
        Bodies float, or a local problem has joints without compliance: the theorem has neither.
    BackendMissing, BackendFailed
        Of Clarabel.

    Examples
    --------
    A block jammed between walls that close in on it has no solution:

    >>> import numpy as np
    >>> W = np.zeros((4, 4))
    >>> W[::2, ::2], W[1::2, 1::2] = [[1.0, -1.0], [-1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]
    >>> existence_margin(LocalProblem(delassus=W, offset=[-0.1, 0.0, -0.1, 0.0], friction=0.5, dimension=2)) < 0
    True
    """
    refuse_other("existence_margin", problem, ContactProblem, LocalProblem)
    form = LocalForm(problem if isinstance(problem, LocalProblem) else _local(problem))
    if np.any(form.joint_signs < 0):
        raise Unsupported("existence_margin: bodies that float, or joints without compliance (the theorem has neither)")
    return interior_margin(form)


def _local(problem: ContactProblem) -> LocalProblem:
    if not problem.frictional:
        raise InvalidProblem("existence_margin: expected a problem with friction")
    with problem.lock:
        way = condense(problem)
        return ContactForm(problem, way, FrictionalRows(problem, way)).local
