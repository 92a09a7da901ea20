"""Docstrings name classes by the modules that hold them; readers know them by their public names."""

from __future__ import annotations

from typing import Any

from docutils import nodes

import contactqp
import contactqp.testing


def setup(app: Any) -> dict[str, bool]:
    app.connect("missing-reference", _public)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _public(app: Any, environment: Any, node: Any, shown: nodes.Node) -> nodes.Node | None:
    """contactqp.problem.ContactProblem is contactqp.ContactProblem."""
    name = str(node.get("reftarget", "")).rpartition(".")[2]
    home = next((home for home in (contactqp, contactqp.testing) if name in home.__all__), None)
    if node.get("refdomain") != "py" or home is None or node["reftarget"] == f"{home.__name__}.{name}":
        return None
    domain = environment.get_domain("py")
    return domain.resolve_xref(
        environment, node["refdoc"], app.builder, node["reftype"], f"{home.__name__}.{name}", node, shown
    )
