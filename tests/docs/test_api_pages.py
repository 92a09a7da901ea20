"""Every public name has its place in the API pages, once."""

from __future__ import annotations

import re
from collections import Counter

import contactqp as cq
import contactqp.testing
from tests.docs.blocks import DOCS

DIRECTIVE = re.compile(r"^\.\. (?:py:function|autoclass|autofunction|autoexception|autodata):: ([\w.]+)", re.MULTILINE)


def documented() -> Counter[str]:
    return Counter(name for page in (DOCS / "api").glob("*.md") for name in DIRECTIVE.findall(page.read_text()))


def test_every_public_name_is_documented_once() -> None:
    public = {f"contactqp.{name}" for name in cq.__all__ if name != "__version__"}
    public |= {f"contactqp.testing.{name}" for name in contactqp.testing.__all__}
    found = documented()
    assert public - set(found) == set()
    # What public names take, return, hold or raise.
    assert set(found) - public == {
        "contactqp.analysis.load_cases.CaseRow",
        "contactqp.analysis.load_cases.ContactTable",
        "contactqp.analysis.derivatives.Derivative",
        "contactqp.analysis.derivatives.derivative",
        "contactqp.analysis.derivatives.jacobian",
        "contactqp.analysis.derivatives.pullback",
        "contactqp.analysis.history.Energies",
        "contactqp.analysis.history.Event",
        "contactqp.analysis.large.deformation.LargeHistory",
        "contactqp.analysis.large.deformation.LargeSolution",
        "contactqp.analysis.load_cases.Envelope",
        "contactqp.elements.shapes.ball",
        "contactqp.elements.shapes.cylinder",
        "contactqp.elements.shapes.disc",
        "contactqp.elements.shapes.half_disc",
        "contactqp.elements.shapes.quarter_disc",
        "contactqp.linalg.existence.Conflict",
        "contactqp.linalg.existence.DrivenMotion",
        "contactqp.model.quadratic_program.answer_of_program",
        "contactqp.model.solution.Answer",
        "contactqp.model.solution.Candidate",
        "contactqp.model.solution.FreeMotion",
        "contactqp.model.solution.Raw",
        "contactqp.model.solution.Work",
        "contactqp.oracle.foreign.judging.JudgedContact",
        "contactqp.solving.methods.Method",
        "contactqp.solving.methods.Settings",
        "contactqp.oracle.foreign.crosscheck_verdict.CrossCheck",
        "contactqp.oracle.foreign.crosscheck_verdict.PairVerdict",
        "contactqp.scene.deck.deck.Deck",
        "contactqp.solving.methods.backends.Backend",
        "contactqp.solving.methods.register",
        "contactqp.study.comparison.Comparison",
    }
    assert max(found.values()) == 1


def test_every_page_is_listed() -> None:
    listed = set((DOCS / "api" / "index.md").read_text().split("```{toctree}\n")[1].split("```")[0].split())
    assert listed == {page.stem for page in (DOCS / "api").glob("*.md")} - {"index"}
