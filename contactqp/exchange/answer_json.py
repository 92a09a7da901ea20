"""Answers in JSON: an object whose keys are the parts, each a list or an object of values by name.

    {"displacement": {"tip.x": 1e-3}, "normal_force": [142.5], "friction_force": [[0.5, 0.0]], "tie_force": [2.0]}

What `contactqp run CASE --method M --json` prints is one, alone in a list; its friction_force is along the axes of the
case, and its friction_components, along the rows of E_T, are what is read. null is NaN. The answer to a quadratic
program may come as x, y, z and z_box, with qpsolvers' signs.
"""

from __future__ import annotations

import json
from codecs import BOM_UTF8
from typing import Any

from contactqp.errors import InvalidProblem
from contactqp.exchange.answer_reader import (
    AnswerFile,
    AnswerReader,
    answer_of_names,
    names_of,
    part_called,
    places,
    real_array,
    refuse_unit,
    vector,
)
from contactqp.exchange.refusal import Ledger, Path, one_line, read_text, wrong
from contactqp.model.problem import ContactProblem

NAME = "JSON"
COMPONENTS = "friction_components"
EXPECTED = "a JSON file with displacement and normal_force"


def read_json_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """The one answer in a JSON file, alone or as the only one in a list.

    Raises
    ------
    InvalidProblem
        No JSON, no part of an answer in it, a key twice, values that are no numbers, names that are not the problem's.
    """
    data = load_json(path, EXPECTED)
    if isinstance(data, list):
        if len(data) != 1 or not isinstance(data[0], dict):
            got = "a list of numbers" if not any(isinstance(one, dict) for one in data) else f"{len(data)} in a list"
            cure = "; one is printed by contactqp run CASE --method M --json" if len(data) > 1 else ""
            raise wrong(path, "content", 'one answer, such as {"displacement": [...]}', got + cure)
        data = data[0]
    if not isinstance(data, dict):
        raise wrong(path, "content", EXPECTED, type(data).__name__)
    of_program = answer_of_names(path, problem, data)
    if of_program is not None:
        return of_program
    ledger, parts, named, tie_names = Ledger(str(path)), {}, set(), None
    for key, values in data.items():
        part = part_called(key) if key != COMPONENTS else "friction_force"
        refuse_unit(path, key)
        if part == "friction_force" and key != COMPONENTS and _along_axes(values):
            if COMPONENTS not in data:
                raise wrong(path, key, "one or two components a contact, along the rows of E_T", "vectors along axes")
            part = None
        if part is None or values is None:
            ledger.ignored.append(f"{key:.60}")
            continue
        if part in parts:
            raise wrong(path, key, "every part once", f"{part} twice")
        if isinstance(values, dict):
            found = real_array(path, key, list(values.values()))
            if part == "tie_force":
                tie_names = tuple(values)
            else:
                found = found[places(path, key, list(values), names_of(problem, part), ledger)]
            named.add(part)
        elif isinstance(values, list):
            found = real_array(path, key, values)
        else:
            raise wrong(path, key, "a list, or values by name", f"{values!r:.40}")
        parts[part] = vector(path, part, found)
        ledger.read.append(f"{part}: {len(found)} values {'by name' if part in named else 'in order'}")
    if not parts:
        raise wrong(path, "content", EXPECTED, f"the keys {', '.join(data)!s:.100}")
    return AnswerFile(parts, ledger, frozenset(named), tie_names)


def _along_axes(values: Any) -> bool:
    return isinstance(values, dict) and any(isinstance(one, dict) for one in values.values())


def load_json(path: Path, expected: str) -> Any:
    """What a JSON file holds.

    Raises
    ------
    InvalidProblem
        No such file, no JSON, a key twice in one object.
    """
    text = read_text(path, expected)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for k, key in enumerate(keys) if key in keys[:k])
            raise wrong(path, f"{twice:.60}", "every key once", "it twice")
        return found

    try:
        return json.loads(text, object_pairs_hook=once)
    except InvalidProblem:
        raise
    except RecursionError:
        raise wrong(path, "content", expected, "JSON nested beyond reading") from None
    except ValueError as error:
        raise wrong(path, "content", "JSON", one_line(error)) from None


def is_json_answer(head: bytes) -> bool:
    """Whether first bytes begin an object, alone or as the first in a list."""
    return head.removeprefix(BOM_UTF8).replace(b"[", b" ", 1).lstrip()[:1] == b"{"


READER = AnswerReader(NAME, (".json",), read_json_answer, known=is_json_answer)
