"""Public names say what they are, and functions with many arguments what each of these is."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import contactqp as cq
from contactqp import testing

MANY = 4
Function = ast.FunctionDef | ast.AsyncFunctionDef
PARAMETERS = re.compile(r"^Parameters\n-{10}\n(.*?)(?=\n\n?[A-Z][\w ]*\n---|\Z)", re.DOTALL | re.MULTILINE)


def public_functions(tree: ast.Module) -> Iterator[tuple[Function, ast.ClassDef | None]]:
    """Yield the public functions of a module, and the public methods with their classes."""
    for node in tree.body:
        if isinstance(node, Function) and not node.name.startswith("_"):
            yield node, None
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for one in node.body:
                if isinstance(one, Function) and (one.name in ("__init__", "__call__") or one.name[0] != "_"):
                    yield one, node


def arguments(function: Function, of_class: bool) -> list[str]:
    """Return the names of the arguments of a function, without `self` and `cls`."""
    decorators = {ast.unparse(one) for one in function.decorator_list}
    given = [*function.args.posonlyargs, *function.args.args]
    return [one.arg for one in (*given[of_class and "staticmethod" not in decorators :], *function.args.kwonlyargs)]


def documentation(function: Function, owner: ast.ClassDef | None, classes: dict[str, ast.ClassDef]) -> str:
    """Return the docstring of a function, of its class for a constructor, or of what a method overrides."""
    found = ast.get_docstring(function) or ""
    if found or owner is None:
        return found
    if function.name == "__init__":
        return ast.get_docstring(owner) or ""
    for base in (classes[name] for name in map(ast.unparse, owner.bases) if name in classes):
        overridden = [one for one in base.body if isinstance(one, Function) and one.name == function.name]
        if told := documentation((overridden or [function])[0], base, classes):
            return told
    return ""


def named(docstring: str) -> set[str]:
    """Return the names that a section of parameters has."""
    section = PARAMETERS.search(docstring)
    lines = section[1].splitlines() if section else []
    heads = [line.partition(":")[0] for line in lines if line and not line[0].isspace()]
    return {name.strip().lstrip("*") for head in heads for name in head.split(",")}


def is_told_elsewhere(function: Function) -> bool:
    """Say whether a function is an overload, or a command whose docstring is its help."""
    return any(re.search(r"overload|command|\boption|\bargument", ast.unparse(one)) for one in function.decorator_list)


def unnamed_arguments(modules: dict[str, ast.Module]) -> list[str]:
    """Return the functions with four and more arguments, one of which no section of parameters names."""
    classes = {one.name: one for tree in modules.values() for one in tree.body if isinstance(one, ast.ClassDef)}
    missing = []
    for place, tree in modules.items():
        for function, owner in public_functions(tree):
            names = arguments(function, owner is not None)
            if len(names) < MANY or is_told_elsewhere(function):
                continue
            if left := set(names) - named(documentation(function, owner, classes)):
                missing.append(f"{place}:{function.lineno}: {function.name}: {', '.join(sorted(left))}")
    return missing


def outline(tree: ast.Module) -> ast.Module:
    """Leave the functions of a module their docstrings alone: the trees of a whole package are large."""
    for node in (*tree.body, *(one for kind in tree.body if isinstance(kind, ast.ClassDef) for one in kind.body)):
        if isinstance(node, Function):
            node.body = node.body[:1]
    return tree


def test_an_argument_that_is_not_named_is_found() -> None:
    source = '''
class Base:
    def pose(self, a, b, c, d):
        """Do it.

        Parameters
        ----------
        a, b : int
        c : int
            The third, d is not named.

        Returns
        -------
        d : int
        """


class Made(Base):
    """A class."""

    def __init__(self, a, b, *, c, d=0): ...

    def pose(self, a, b, c, d): ...


def few(a, b, c): ...


def _private(a, b, c, d): ...
'''
    assert unnamed_arguments({"one.py": ast.parse(source)}) == [
        "one.py:3: pose: d",
        "one.py:21: __init__: a, b, c, d",
        "one.py:23: pose: d",
    ]


def members(kind: type) -> Iterator[tuple[str, Any]]:
    """Yield the public methods and properties that a class defines itself."""
    for name, value in vars(kind).items():
        if not name.startswith("_") and (inspect.isroutine(value) or isinstance(value, property | cached_property)):
            yield name, value


def test_public_names_have_docstrings() -> None:
    public = {name: getattr(module, name) for module in (cq, testing) for name in module.__all__}
    kinds = {name: one for name, one in public.items() if inspect.isclass(one)}
    functions = {name: one for name, one in public.items() if inspect.isfunction(one)}
    assert len(kinds) > 40
    assert len(functions) > 30
    missing = [name for name, one in (kinds | functions).items() if not one.__doc__]
    for name, kind in kinds.items():
        listed = set(re.findall(r"\w+", kind.__doc__ or ""))  # attributes may be described with their class
        missing += [f"{name}.{one}" for one, value in members(kind) if not inspect.getdoc(value) and one not in listed]
    assert missing == []
