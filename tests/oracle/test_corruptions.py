"""Wrong answers are refused every time, and the diagnosis names what went wrong; right ones pass."""

from __future__ import annotations

import pytest

import contactqp as cq
from contactqp.oracle.diagnosis.evidence import CAUSES, SYMPTOMS
from tests.oracle.corruptions import KINDS, PROBLEMS, Kind, corpus
from tests.oracle.right_answers import Base, frictional, frictionless, redundant

NAMED = [kind for kind in KINDS.values() if kind.named is not None]


@pytest.mark.slow
def test_the_corpus_is_large_and_mixed() -> None:
    assert len(KINDS) >= 40
    assert len({kind.named for kind in NAMED}) >= 25
    bases = frictionless() + frictional() + redundant()
    assert any(base.problem.ties for base in bases)
    assert any(base.name.startswith("lattice_in_corner") for base in bases), "bodies that float"
    assert any(base.name == "cantilever" for base in bases), "stiff data"
    assert any(base.name.startswith("exactly_grazing") for base in bases)
    assert sum("space" in base.name for base in bases) >= 10


@pytest.mark.sampled(48)
@pytest.mark.parametrize("name", KINDS)
def test_every_corrupted_answer_is_refused_and_its_cause_named(name: str) -> None:
    """All are refused; the cause of one is looked for, those of all in the slow test beneath."""
    judged = [(base, cq.certify(base.problem, **given)) for base, given in corpus(KINDS[name])]
    assert len(judged) == PROBLEMS
    for base, one in judged:
        assert not one.passed, base.name
        assert one.failures, base.name
    base, one = judged[0]
    _is_named(KINDS[name], base, one)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_the_cause_of_every_corrupted_answer_is_named(name: str) -> None:
    wrong = list(corpus(KINDS[name]))
    assert len(wrong) == PROBLEMS
    for base, given in wrong:
        _is_named(KINDS[name], base, cq.certify(base.problem, **given))


def _is_named(kind: Kind, base: Base, judged: cq.JudgedAnswer) -> None:
    assert all(finding.kind in (CAUSES if finding.cause else SYMPTOMS) for finding in judged.findings)
    if kind.named is not None:
        assert kind.named in [finding.kind for finding in judged.findings], (base.name, judged.diagnosis)
    assert judged.diagnosis, base.name


@pytest.mark.sampled(16)
@pytest.mark.parametrize("part", range(16))
def test_uncorrupted_answers_are_accepted(part: int) -> None:
    every = frictionless(), frictional(), redundant()
    assert all(every)
    for base in (base for kind in every for base in kind[part::16]):
        judged = cq.certify(base.problem, **base.right)
        assert judged.passed, (base.name, judged.failures)
        assert judged.findings == (), base.name
        assert judged.contacts == (), base.name
        assert judged.diagnosis == "nothing is wrong with this answer", base.name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one_contact_opened_that_pushes", "random_noise"])
def test_no_cause_is_guessed_where_none_explains_the_answer(name: str) -> None:
    """Some of these answers are right but for one value; of noise nothing is to be said but what it violates."""
    wrong = list(corpus(KINDS[name]))
    assert len(wrong) == PROBLEMS
    for base, given in wrong:
        causes = {finding.kind for finding in cq.certify(base.problem, **given).findings if finding.cause}
        assert causes <= {"one-value", "zero"}, (base.name, causes)
