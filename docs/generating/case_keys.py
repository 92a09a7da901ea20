"""The keys of a case file, block by block, from the schema that checks them and the comments beside its fields."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
import tokenize
from collections.abc import Iterator
from io import StringIO

from contactqp.analysis.motion.schemes import SCHEMES
from contactqp.scene.blocks.element import Measure
from contactqp.scene.claims import QUANTITIES
from contactqp.scene.fields import Block
from contactqp.scene.scene import Scene
from contactqp.scene.schema import OBSTACLES
from contactqp.scene.schema_bodies import SHAPES
from contactqp.scene.units import KINDS
from docs.generating.tables import table

# The types of `contactqp.scene.fields` in words: what has a dimension, and bounds.
KIND_OF_FIELD = {
    "Length": "length",
    "PositiveLength": "length > 0",
    "NotNegativeLength": "length >= 0",
    "Area": "area > 0",
    "Inertia": "second moment of area > 0",
    "Modulus": "modulus > 0",
    "Stiffness": "stiffness > 0",
    "KnobStiffness": "stiffness",
    "Tension": "tension > 0",
    "Mass": "mass > 0",
    "Density": "density >= 0",
    "Poisson": "number between -1 and 0.5",
    "Grading": "number >= 1",
    "Pressure": "pressure",
    "PositiveForce": "force > 0",
    "PureForce": "force",
    "Acceleration": "acceleration",
    "Force": "force or moment",
    "Factor": "number or length",
    "TieValue": "length or angle",
    "Time": "time",
    "PositiveTime": "time > 0",
    "Velocity": "velocity",
    "Number": "number",
    "FrictionCoefficient": "number >= 0",
    "Vector": "list of numbers",
    "Forces": "list of forces",
    "LineForces": "list of forces per length",
    "Tractions": "list of pressures",
    "Velocities": "list of velocities or angular velocities",
    "Displacements": "list of lengths or angles",
    "Point": "list of lengths",
    "Name": "text",
    "NodeName": "text",
    "BodyName": "text",
    "Text": "text",
    "QuantityName": "a [quantity](#what-can-be-claimed)",
    "TwoNames": "list of 2 texts",
    "Corner": "table of factors by the names of loads",
    "Divisions": "whole number >= 1",
    "Axis": 'one of "x", "y", "z"',
    "str": "text",
    "bool": "true or false",
    "int": "whole number",
    "Fraction": "number",
    "Quantity": "number with its unit",
}
PLURAL = re.compile(r"^(text|number|length|acceleration)\b")


def case_keys() -> str:
    """A table for each block, then the vocabularies."""
    found = blocks()
    names = {block.__name__ for block in found}
    sections = [_section(block, names) for block in found]
    return "\n\n".join([*sections, *_vocabularies()])


def blocks() -> list[type[Block]]:
    """The scene and every table in it, in the order in which they are met."""
    found: list[type[Block]] = [Scene]
    for block in found:
        for field in block.model_fields.values():
            found += [kind for kind in _blocks_in(field.annotation) if kind not in found]
    return found


def _blocks_in(annotation: object) -> Iterator[type[Block]]:
    if isinstance(annotation, type) and issubclass(annotation, Block):
        yield annotation
    for part in getattr(annotation, "__args__", ()):
        yield from _blocks_in(part)


def _section(block: type[Block], names: set[str]) -> str:
    title = "The file" if block is Scene else _title(block.__name__)
    about = inspect.cleandoc(block.__doc__ or "").split("\n\nRaises")[0]
    rows = [
        (f"`{key}`", _in_words(annotation, names), _default(block, key), comment)
        for key, (annotation, comment) in _fields(block).items()
    ]
    about = about.replace("::\n", ":\n").replace("\n    corners", "\n\n    corners")
    return f"## {title}\n\n{about}\n\n{table(('key', 'value', 'default', 'meaning'), rows)}"


def _title(name: str) -> str:
    """PointMass is "Point mass"."""
    words = re.findall(r"[A-Z][a-z]*", name)
    return " ".join([words[0], *(word.lower() for word in words[1:])])


def _fields(block: type[Block]) -> dict[str, tuple[str, str]]:
    """The annotation of every key as it stands in the source, and the comment behind it, inherited keys first."""
    found: dict[str, tuple[str, str]] = {}
    for base in reversed(block.__mro__):
        if issubclass(base, Block) and base is not Block:
            found |= _own_fields(base)
    return {key: found[key] for key in block.model_fields}


def _own_fields(block: type[Block]) -> dict[str, tuple[str, str]]:
    source = textwrap.dedent(inspect.getsource(block))
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    tokens = tokenize.generate_tokens(StringIO(source).readline)
    comments = {token.start[0]: token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT}
    return {
        node.target.id: (ast.unparse(node.annotation), _comment(comments.get(node.end_lineno or node.lineno, "")))
        for node in definition.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }


def _comment(text: str) -> str:
    """Comments to linters are none to readers."""
    return "" if text.startswith(("type:", "noqa")) else text


def _in_words(annotation: str, names: set[str]) -> str:
    """`tuple[fields.Length, ...] | None` is "list of length"."""
    text = annotation.removesuffix(" | None")
    if text.startswith("Annotated["):
        tree = ast.parse(text, mode="eval").body
        assert isinstance(tree, ast.Subscript)
        assert isinstance(tree.slice, ast.Tuple)
        text = ast.unparse(tree.slice.elts[0])
    if text.startswith("Literal["):
        return "one of " + text.removeprefix("Literal[").removesuffix("]").replace("'", '"')
    if text.startswith("tuple["):
        inside = text.removeprefix("tuple[").removesuffix("]").removesuffix(", ...")
        return "list of " + PLURAL.sub(r"\1s", _in_words(inside, names))
    if " | " in text:
        return " or ".join(_in_words(part, names) for part in text.split(" | "))
    name = text.removeprefix("fields.")
    if name in names:
        return f"[{_title(name).lower()}](#{_title(name).lower().replace(' ', '-')})"
    return KIND_OF_FIELD[name]


def _default(block: type[Block], key: str) -> str:
    field = block.model_fields[key]
    if field.is_required():
        return "**needed**"
    value = field.default
    if value in (None, (), ""):
        return ""
    return f"`{value!s}`" if not isinstance(value, Block) else "metre and newton"


def _vocabularies() -> list[str]:
    quantities = [
        (f"`{name}`", measure.meaning, _value(measure), "nodes, bodies" if measure.of == "both" else measure.of)
        for name, measure in QUANTITIES.items()
    ]
    shapes = [
        (f"`{name}`", _listed(keys.required), _listed(keys.optional), str(keys.divisions))
        for name, keys in SHAPES.items()
    ]
    obstacles = [(f"`{name}`", _listed(needed), _listed(more)) for name, (needed, more) in OBSTACLES.items()]
    schemes = [(f"`{name}`", _listed(kind.knobs)) for name, kind in SCHEMES.items()]
    units = [(kind.name, f"`{kind.example}`") for kind in KINDS.values()]
    return [
        "## What can be claimed\n\n" + table(("quantity", "meaning", "value", "scenes of"), quantities),
        "## Shapes\n\n" + table(("kind", "needs, beside element", "may have", "divisions"), shapes),
        "## Obstacles by kind\n\n" + table(("kind", "needs", "may have"), obstacles),
        "## Schemes of a motion\n\n" + table(("scheme", "knobs"), schemes),
        "## Kinds of numbers\n\n" + table(("kind", "such as"), units),
    ]


def _value(measure: Measure) -> str:
    return " or ".join(measure.kinds) or "; ".join(f"`{word}`" for word in measure.words)


def _listed(keys: tuple[str, ...]) -> str:
    return ", ".join(f"`{key}`" for key in keys)
