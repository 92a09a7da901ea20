"""The page on extending says where things are: its list of rooms is the contract's, and the files it names exist."""

from __future__ import annotations

import importlib
import re
import tomllib

from tests.docs.blocks import ROOT

PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
# Files that the page has a reader write.
TO_BE_WRITTEN = {
    "contactqp/solving/methods/every_set.py",
    "contactqp/exchange/triplets.py",
    "contactqp/elements/nitsche.py",
}


def test_the_rooms_are_those_of_the_contract_from_the_top() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    listed = [name.removesuffix(".py") for name in re.findall(r"^\| `(\w+(?:\.py)?)/?` \|", PAGE, re.MULTILINE)]
    assert listed == [room for room in contracts[0]["layers"] if room != "__main__"]


def test_every_file_that_it_names_exists() -> None:
    named = set(re.findall(r"`((?:contactqp|tests|benchmarks)/[\w/]+(?:\.py)?)`?", PAGE))
    assert len(named) > 15
    assert {name for name in named - TO_BE_WRITTEN if not (ROOT / name).exists()} == set()


def test_every_name_that_it_says_is_there() -> None:
    names = set(re.findall(r"`(contactqp(?:\.\w+)+)`", PAGE))
    assert len(names) >= 8
    for name in names:
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute), name
