"""Fields of a dataclass are described by the comments behind them: those become its section "Attributes"."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
import tokenize
from io import StringIO
from typing import Any

SECTIONS = ("Attributes", "Parameters")
ARRAYS = {
    "Vector": "array",
    "NDArray[np.float64]": "array",
    "NDArray[np.int64]": "array of int",
    "NDArray[np.str_]": "array of str",
    "NDArray[np.bool_]": "array of bool",
    "V": "array",
    "F": "array or None",
}


def setup(app: Any) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", _add_fields, priority=100)  # before numpydoc reads the sections
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _add_fields(app: Any, what: str, name: str, member: Any, options: Any, lines: list[str]) -> None:
    del app, name, options
    if what != "class" or not dataclasses.is_dataclass(member) or any(line in SECTIONS for line in lines):
        return
    described = field_comments(member)
    if described:
        lines += ["", "Attributes", "----------"]
        for field, (kind, comment) in described.items():
            lines += [f"{field} : {kind}", f"    {comment}"]


def field_comments(kind: type) -> dict[str, tuple[str, str]]:
    """The public fields of a dataclass, those of its bases first: annotation, and the comment on the field's lines."""
    found: dict[str, tuple[str, str]] = {}
    for base in reversed(kind.__mro__):
        if dataclasses.is_dataclass(base):
            found |= _own_field_comments(base)
    return found


def _own_field_comments(kind: type) -> dict[str, tuple[str, str]]:
    source = textwrap.dedent(inspect.getsource(kind))
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    tokens = tokenize.generate_tokens(StringIO(source).readline)
    comments = {token.start[0]: token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT}
    found = {}
    for node in definition.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id[0] != "_":
            lines = range(node.lineno, (node.end_lineno or node.lineno) + 1)
            comment = " ".join(comments[line] for line in lines if line in comments)
            found[node.target.id] = (_in_words(ast.unparse(node.annotation)), comment)
    return found


def _in_words(annotation: str) -> str:
    """`Vector | None` is "array or None"."""
    return " or ".join(ARRAYS.get(kind, kind) for kind in annotation.split(" | "))
