"""`ContactProblem`, `contactqp.solve` and `solve()` in a docstring lead to where these are documented.

Docstrings name classes by the modules that hold them, too; readers know them by their public names.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.parsers.rst import roles
from sphinx import addnodes

import contactqp
import contactqp.testing

HOMES = (contactqp, contactqp.testing)


def setup(app: Any) -> dict[str, bool]:
    roles.register_local_role("code-or-name", _code_or_name)
    app.connect("missing-reference", _public)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def public_name(text: str) -> str | None:
    """The full name of what is meant, if it is public: a small letter alone is no name, but `solve()` is."""
    prefix, _, name = text.removesuffix("()").rpartition(".")
    meant = prefix in ("cq", *(home.__name__ for home in HOMES)) or (
        not prefix and (name[:1].isupper() or text.endswith("()"))
    )
    home = next((home for home in HOMES if name in home.__all__), None)
    return f"{home.__name__}.{name}" if meant and home is not None else None


def _code_or_name(
    role: str, rawtext: str, text: str, line: int, inliner: Any, options: Any = None, content: Any = None
) -> tuple[list[nodes.Node], list[nodes.system_message]]:
    del role, line, options, content
    shown = nodes.literal(rawtext, text)
    target = public_name(text)
    if target is None:
        return [shown], []
    place = inliner.document.settings.env.docname
    link = addnodes.pending_xref("", shown, refdomain="py", reftype="obj", reftarget=target, refdoc=place)
    return [link], []


def _public(app: Any, environment: Any, node: Any, shown: nodes.Node) -> nodes.Node | None:
    """contactqp.model.problem.ContactProblem is contactqp.ContactProblem."""
    name = str(node.get("reftarget", "")).rpartition(".")[2]
    target = public_name(f"contactqp.{name}")
    if node.get("refdomain") != "py" or target is None or node["reftarget"] == target:
        return None
    domain = environment.get_domain("py")
    return domain.resolve_xref(environment, node["refdoc"], app.builder, node["reftype"], target, node, shown)
