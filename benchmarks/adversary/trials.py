"""One trial: something drawn by the grammar, judged; the same again for the same seed and number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks.adversary.files import Files
from benchmarks.adversary.grammar import Sentence, draw, floating
from benchmarks.adversary.judging import Finding, Judge, judge_frictionless, judge_units
from benchmarks.adversary.judging_friction import judge_friction
from benchmarks.adversary.large import judge_large
from benchmarks.adversary.shrinking import shrunk
from benchmarks.adversary.wild import judge_wild
from benchmarks.bricks import Generator
from benchmarks.friction_families import Posed
from contactqp.solving.methods import find
from contactqp.solving.methods.method import QUADRATIC_PROGRAM

# What is drawn, and how often; large ones by numbers of their own, so that the other trials stay what they were.
KINDS = {"frictionless": 0.4, "plane": 0.15, "space": 0.1, "wild": 0.15, "files": 0.2, "large": 0.04}
# Kinds of which nothing is shrunk.
WHOLE = ("wild", "files", "large")
# Beside the default method, of these so many; those without friction that promise exact answers.
METHODS = ("lemke", "lagrange-multiplier", "master-slave", "clarabel", "piqp", "osqp", "daqp", "proxqp", "highs",
           "augmented-lagrangian", "cvxpy", "scs", "qpalm")  # fmt: skip
ALGORITHMS = ("tresca", "aclm", "newton", "nsgs", "admm", "lagrange-multiplier", "augmented-lagrangian")
OTHERS = 2


@dataclass(frozen=True)
class Trial:
    """What a trial was about and what it found."""

    kind: str
    words: tuple[str, ...]
    judgements: int
    exact: bool
    findings: tuple[Finding, ...]


@cache
def files() -> Files:
    return Files()


def trial(seed: int, number: int, kinds: tuple[str, ...] = tuple(KINDS)) -> Trial:
    """Draw, judge."""
    rng, kind = _begin(seed, number, kinds)
    if kind in WHOLE:
        judge = Judge(None, number)  # type: ignore[arg-type]  # there is no problem of the grammar
        of_kind = files().judge if kind == "files" else {"wild": judge_wild, "large": judge_large}[kind]
        of_kind(judge, rng)
        return Trial(kind, (), judge.judgements, False, tuple(judge.findings))
    sentence, ask = _question(rng, kind)
    judge = Judge(sentence.posed, number)
    ask(judge)
    if kind == "frictionless":
        aside, ask_aside = _aside(seed, number)
        beside = Judge(aside.posed, number)
        ask_aside(beside)
        judge.judgements += beside.judgements
        judge.findings += [replace(one, what=f"{ASIDE}{one.what}") for one in beside.findings]
    return Trial(kind, sentence.words, judge.judgements, judge.exact, tuple(judge.findings))


# Beside every problem without friction one that floats is solved in other units, drawn by numbers of its own, so that
# trials stay what they were: few of the others show where units decide.
ASIDE = "floating: "


def _aside(seed: int, number: int) -> tuple[Sentence, Callable[[Judge], None]]:
    sentence = floating(np.random.default_rng([seed, number, 2]))
    return sentence, lambda judge: judge_units(judge, judge.ask("solve plain", lambda: cq.solve(judge.posed.plain)))


def _begin(seed: int, number: int, kinds: tuple[str, ...]) -> tuple[Generator, str]:
    rng, others = np.random.default_rng([seed, number]), [kind for kind in kinds if kind != "large"]
    if not others or ("large" in kinds and np.random.default_rng([seed, number, 1]).random() < KINDS["large"]):
        return rng, "large"
    weights = np.array([KINDS[kind] for kind in others])
    return rng, str(rng.choice(others, p=weights / weights.sum()))


def _question(rng: Generator, kind: str) -> tuple[Sentence, Callable[[Judge], None]]:
    sentence = draw(rng, kind)
    if kind == "frictionless":
        installed = [method.name for method in cq.methods() if method.installed and method.name in METHODS]
        others = rng.choice(installed, OTHERS, replace=False).tolist()
        methods = [("active-set", {}), *((name, _options(rng, name)) for name in others)]
        return sentence, lambda judge: judge_frictionless(judge, methods)
    algorithms = ["default", *rng.choice(ALGORITHMS, OTHERS, replace=False).tolist()]
    return sentence, lambda judge: judge_friction(judge, algorithms)


def _options(rng: Generator, method: str) -> dict[str, Any]:
    """Now and then a method is shown the whole problem, stopped early, or not polished: an answer that is refused."""
    options: dict[str, Any] = {}
    if rng.random() < 0.3:
        options["condense"] = bool(rng.random() < 0.5)
    if find(method).kind == QUADRATIC_PROGRAM and rng.random() < 0.4:
        options |= dict(polish=False, tolerance=float(10.0 ** -rng.integers(2, 10)))
    return options


# A question that has ended a process, or hung, would do so again.
NOT_ASKED_AGAIN = ("hang", "memory")


def write_smallest(seed: int, number: int, kinds: tuple[str, ...], finding: Finding, folder: Path) -> Path:
    """Shrink the problem of a trial to the smallest that shows a finding of its kind; write it with its command.

    Of wild numbers, files, large bodies and what hangs the command alone is written, which shows the finding again.
    """
    rng, kind = _begin(seed, number, kinds)
    target = folder / f"{finding.kind}-{seed}-{number}"
    command = f"python -m benchmarks.adversary --seed {seed} --trial {number}"
    command += "".join(f" --kind {one}" for one in kinds if kinds != tuple(KINDS))
    if kind in WHOLE or finding.kind in NOT_ASKED_AGAIN:
        target.mkdir(parents=True, exist_ok=True)
        (target / "finding.txt").write_text(f"{finding.what}: {finding.text}\n{kind}\n{command}\n")
        return target
    sentence, ask = _aside(seed, number) if finding.what.startswith(ASIDE) else _question(rng, kind)
    what = finding.what.removeprefix(ASIDE)

    def still(posed: Posed) -> bool:
        judge = Judge(posed, number)
        ask(judge)
        return any(one.kind == finding.kind and one.what == what for one in judge.findings)

    def safely(posed: Posed) -> bool:
        try:
            return still(posed)
        except Exception:  # noqa: BLE001  what cannot be judged shows nothing
            return False

    smallest = shrunk(sentence.posed, safely)
    cq.write_problem(target, smallest.problem)
    words = " ".join(word for word in sentence.words if word)
    (target / "finding.txt").write_text(f"{finding.what}: {finding.text}\n{words}\n{command}\ncontactqp run {target}\n")
    return target
