"""One thing that is wrong with an answer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A kind for programs and a sentence for people.

    A cause explains the whole answer: with it undone the answer is right, or nearer to right by two digits at least.
    Any other finding says what is violated and guesses nothing.
    """

    kind: str
    text: str
    cause: bool = False

    def __str__(self) -> str:
        return self.text
