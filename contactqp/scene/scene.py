"""A case that has been checked, and the contact problem that it states."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from contactqp.errors import SceneError
from contactqp.model.problem import ContactProblem
from contactqp.scene.checking import check
from contactqp.scene.models import build
from contactqp.scene.schema import SceneData
from contactqp.scene.wording import first_error


class Scene(SceneData):
    """A case: bodies, supports, ties, contacts, loads, and what is known of the answer. Frozen and checked when made.

    Raises
    ------
    SceneError
        A key is unknown, missing or wrong, or the parts do not fit each other; one line with the key's path.
    """

    def __init__(self, /, **keys: Any) -> None:
        try:
            super().__init__(**keys)
        except ValidationError as error:
            raise SceneError(first_error(error, type(self), keys)) from None
        check(self)

    def problem(self) -> ContactProblem:
        """The contact problem on the free unknowns, in the scene's units.

        Raises
        ------
        InvalidProblem, SceneError
            The numbers are no contact problem; of bodies: a mesh, a side or a pair that is no good, and which.
        BackendMissing
            A mesh file that needs meshlane, which is not installed.
        """
        return build(self).problem
