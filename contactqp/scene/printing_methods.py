"""The list of methods as a table and as plain data for JSON."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console

from contactqp.scene.tables import print_table
from contactqp.solving.methods import Method


def print_methods(console: Console, methods: Iterable[Method]) -> None:
    """Every method, installed or how to install it, and what it can do."""
    rows = [
        [
            m.name,
            m.kind,
            "yes" if m.installed else m.install,
            "exact" if m.exact else "approximate",
            _abilities(m),
            m.note,
        ]
        for m in methods
    ]
    print_table(console, ["method", "kind", "installed", "answer", "can do", "note"], rows)


def _abilities(method: Method) -> str:
    yes = [
        "floating bodies" if method.semidefinite else "",
        "sparse" if method.sparse else "",
        f"friction: {method.friction}" if method.friction else "",
        f"knob: {method.knob}" if method.knob else "",
    ]
    return ", ".join(text for text in yes if text)


def method_data(method: Method) -> dict[str, Any]:
    """One method for JSON."""
    keys = (
        "name",
        "kind",
        "installed",
        "install",
        "exact",
        "semidefinite",
        "sparse",
        "friction",
        "options",
        "required",
        "knob",
        "note",
    )
    return {key: getattr(method, key) for key in keys}
