"""`compare`: solve one problem by many methods; a table of errors, run times and verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, overload

from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.number_range import refuse_far_from_one
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.summary import Printed
from contactqp.study.attempt import attempt
from contactqp.study.rows import Row, as_dicts, text_table, to_csv
from contactqp.study.settings import chosen_methods, single_settings
from contactqp.study.truth import Reference, truth_of, truth_of_reference


@dataclass(frozen=True)
class Comparison(Printed, Sequence[Row]):
    """The table of `compare`, with one row for each method and value of its knob; `str` prints it."""

    rows: tuple[Row, ...]
    truth: str  # what the errors are measured against

    @overload
    def __getitem__(self, place: int) -> Row: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[Row, ...]: ...

    def __getitem__(self, place: int | slice) -> Row | tuple[Row, ...]:
        return self.rows[place]

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        return f"{text_table(self.rows)}\nerrors against: {self.truth}"

    def to_dicts(self) -> list[dict[str, Any]]:
        """Return rows as plain data; `contactqp.study.rows.COLUMNS` has the meaning of each key."""
        return as_dicts(self.rows)

    def to_csv(self) -> str:
        """Return comma-separated values with a header."""
        return to_csv(self.rows)


@own_floating_point
def compare(
    problem: ContactProblem,
    methods: Sequence[str] | None = None,
    reference: Reference | None = None,
    *,
    knobs: Mapping[str, Sequence[float]] | None = None,
) -> Comparison:
    """Solve one problem by many methods and compare every answer with the truth.

    Parameters
    ----------
    problem : ContactProblem
    methods : sequence of names, optional
        All of `contactqp.methods()` by default; those that are not installed are listed as missing.
    reference : Solution, or (displacement, normal_force[, tie_force]), optional
        The truth. By default the active-set solution, if its certificate proves it; without a truth, errors are None.
    knobs : mapping of method names to values, optional
        Values of the knobs. By default penalty and perturbation, which have no default, go through 1e1 ... 1e6 times
        the contact stiffness (`contactqp.study.settings.contact_stiffness`); the others are run as `solve` runs them.

    Returns
    -------
    Comparison
        A method that fails is a row with the reason, not an exception. Each method is called twice and the second call
        is timed, without its certificate, unless the first one takes seconds.

    Raises
    ------
    Unsupported
        There is no method of that name.
    InvalidProblem
        The reference has wrong shapes; a knob is given for a method that is not compared or has none.

    Examples
    --------
    >>> import contactqp as cq
    >>> wall = cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    >>> table = cq.compare(wall, methods=["active-set", "penalty"], knobs={"penalty": [1e8]})
    >>> [(row.method, row.verdict, f"{row.error_force:.0e}") for row in table]
    [('active-set', 'right', '0e+00'), ('penalty', 'approximate', '2e-03')]
    """
    chosen = chosen_methods(methods)
    values = dict(knobs or {})
    for name in values:
        if name not in {method.name for method in chosen if method.knob}:
            raise InvalidProblem(f"knobs: {name!r} is no compared method with a knob")
    refuse_far_from_one("compare", problem)
    if (rows := acting_rows(problem)) is not None and rows.met:
        problem, reference = rows.problem, None if reference is None else _on_acting_rows(rows, reference)
    truth = truth_of(problem, reference)
    settings = (setting for method in chosen for setting in single_settings(problem, method, values.get(method.name)))
    source = "nothing, as the active-set method proves no answer" if truth is None else truth.source
    return Comparison(tuple(attempt(problem, setting, truth) for setting in settings), source)


def _on_acting_rows(rows: ActingRows, reference: Reference) -> Reference:
    """Return a reference of the whole problem restricted to the rows that constrain something."""
    whole = truth_of_reference(rows.whole, reference)
    ties = () if whole.tie_force is None else (whole.tie_force[rows.ties],)
    return (whole.displacement, whole.normal_force[rows.contacts], *ties)
