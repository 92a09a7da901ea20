"""What attempts share whose method is shown the problem as it is, with all its unknowns."""

from __future__ import annotations

from contactqp.model.solution import Candidate


class WholeAttempt:
    """The part of an attempt that hands out its candidate: nothing is to be expanded."""

    candidate: Candidate

    @property
    def expanded(self) -> Candidate:
        """The candidate in the unknowns of the problem."""
        return self.candidate

    @property
    def start(self) -> Candidate:
        """What another load may start from."""
        return self.candidate
