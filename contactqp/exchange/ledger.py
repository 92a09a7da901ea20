"""What became of a file on its way into a problem or an answer: nothing is dropped or assumed in silence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

KINDS = ("read", "converted", "assumed", "ignored")


@dataclass(frozen=True)
class Ledger:
    """What was read, converted, assumed and ignored of one source, a line each; readers add to it as they go."""

    source: str
    read: list[str] = field(default_factory=list)
    converted: list[str] = field(default_factory=list)  # other signs, units or orders than ours
    assumed: list[str] = field(default_factory=list)  # what the source does not say
    ignored: list[str] = field(default_factory=list)  # what it says and no problem or answer has a place for

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Kind and line, in the order of `KINDS`."""
        for kind in KINDS:
            for line in getattr(self, kind):
                yield kind, line

    def data(self) -> dict[str, object]:
        """All of it, for JSON."""
        return {"source": self.source} | {kind: list(getattr(self, kind)) for kind in KINDS}
