"""|x| in a docstring is an absolute value: reStructuredText would take it for a substitution."""

from __future__ import annotations

import re
from typing import Any

LITERAL = re.compile(r"(`[^`]*`)")


def setup(app: Any) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", _escape_bars, priority=900)  # after numpydoc: no section is read any more
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _escape_bars(app: Any, what: str, name: str, member: Any, options: Any, lines: list[str]) -> None:
    del app, what, name, member, options
    lines[:] = escaped(lines)


def escaped(lines: list[str]) -> list[str]:
    """The lines, every bar escaped that is in no `literal`, no literal block and no example."""
    done: list[str] = []
    literal: int | None = None  # the indentation of the text that announced a literal block
    for line in lines:
        indentation = len(line) - len(line.lstrip())
        if literal is not None and line.strip() and indentation <= literal:
            literal = None
        plain = literal is None and not line.lstrip().startswith((">>>", "..."))
        done.append(_outside_literals(line) if plain else line)
        if plain and line.rstrip().endswith("::"):
            literal = indentation
    return done


def _outside_literals(line: str) -> str:
    parts = LITERAL.split(line)
    return "".join(part if k % 2 else part.replace("|", r"\|") for k, part in enumerate(parts))
