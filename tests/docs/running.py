"""A page of the documentation is run from its top to its end, in one scope and one folder."""

from __future__ import annotations

import doctest
import json
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.scene.judging import Judgement, judge_all
from tests.docs.blocks import Block

RULES = set("─━ ")  # what the lines of tables are made of
OUTPUT = ("text",)
DATA = ("csv", "json", "text")


class PageRun:
    """Runs the blocks of one page; what is listed in `not_run` is only noted as `used`.

    python              runs; a text block right behind it is what it prints, without one it prints nothing
    pycon               is a doctest
    console             lines behind `$ ` run, what stands between them is printed; `$ echo $?` asks for the exit code
    sh                  lines run and exit with 0
    toml [NAME]         is a case file, loaded, and written under its name for what follows; it meets what it expects
    toml into NAME      goes to the end of that file, which is loaded and judged again
    csv|json|text NAME  is written under its name
    """

    def __init__(self, folder: Path, printed: Callable[[], str], not_run: dict[str, str]) -> None:
        self.folder, self.printed, self.not_run = folder, printed, not_run
        self.scope: dict[str, object] = {"__name__": "__main__"}
        self.used: set[str] = set()

    def run(self, blocks: list[Block]) -> None:
        for place, block in enumerate(blocks):
            after = blocks[place + 1] if place + 1 < len(blocks) else None
            shown = after if after is not None and after.follows and _is_output(after) else None
            self._one(block, blocks[place - 1] if place else None, shown)

    def _one(self, block: Block, before: Block | None, shown: Block | None) -> None:
        where = f"{block.page}, line {block.line}"
        named = f"{block.page}: {block.first_line}"
        if named in self.not_run:
            self.used.add(named)
        elif block.language == "python" and not block.words:
            exec(compile(block.text, where, "exec", dont_inherit=True), self.scope)
            printed = self.printed()
            assert same_lines(shown.text if shown is not None else "", printed), f"{where}\n{printed}"
        elif block.language == "pycon":
            self._doctest(block, where)
        elif block.language == "console":
            self._console(block, where)
        elif block.language == "sh":
            commands = _commands(block.text)
            assert commands, where
            for command in commands:
                assert self._run(command, where)[0] == 0, f"{where}: {command}"
        elif block.language == "toml":
            self._case(block)
        elif block.language in DATA and block.words:
            self._write(block)
        elif _is_output(block):
            assert block.follows, f"{where}: what prints this?"
            assert before is not None, where
            assert before.language == "python", f"{where}: what prints this?"
        else:
            raise AssertionError(f"{where}: nothing runs {block.info!r} {block.first_line!r}")

    def _doctest(self, block: Block, where: str) -> None:
        test = doctest.DocTestParser().get_doctest(block.text, self.scope, block.page, block.page, block.line)
        assert test.examples, where
        told: list[str] = []
        failed = doctest.DocTestRunner(verbose=False).run(test, out=told.append, clear_globs=False).failed
        self.scope.update(test.globs)
        assert not failed, f"{where}\n{''.join(told)}"

    def _console(self, block: Block, where: str) -> None:
        assert block.text.startswith("$ "), f"{where}: expected a command behind `$ `"
        code = 0
        for part in ("\n" + block.text).split("\n$ ")[1:]:
            command, _, shown = part.partition("\n")
            if command == "echo $?":
                assert shown.strip() == str(code), where
                continue
            code, printed = self._run(command, where)
            if command not in self.not_run:
                assert same_lines(shown, printed), f"{where}: {command}\n{printed}"

    def _run(self, command: str, where: str) -> tuple[int, str]:
        """Exit code and what is printed of a command of contactqp; others stand in the list of what is not run."""
        if command in self.not_run:
            self.used.add(command)
            return 0, ""
        words = shlex.split(command)
        assert words[0] == "contactqp", f"{where}: {command!r} is neither run nor listed with the reason why not"
        with pytest.raises(SystemExit) as ended:
            main(words[1:])
        return int(str(ended.value.code or 0)), self.printed()

    def _case(self, block: Block) -> None:
        into = block.words[:1] == ["into"]
        file = self.folder / (block.words[-1] if block.words else "case.toml")
        file.write_text((file.read_text() + "\n" if into else "") + block.text)
        scene = cq.load_scene(file)
        for judged in judge_all(scene) if scene.expect else ():
            assert isinstance(judged, Judgement), f"{block.page}, line {block.line}: {judged}"
            assert judged.met, f"{block.page}, line {block.line}: {judged.expectations}"

    def _write(self, block: Block) -> None:
        file = self.folder / block.words[0]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(block.text)
        if block.language == "json":
            json.loads(block.text)


def _is_output(block: Block) -> bool:
    return block.language in OUTPUT and not block.words


def _commands(text: str) -> list[str]:
    """One a line; a backslash goes on with the next."""
    lines = text.replace("\\\n", " ").splitlines()
    return [" ".join(line.split()) for line in lines if line.strip() and not line.startswith("#")]


def same_lines(shown: str, printed: str) -> bool:
    """Line by line, but for blank ones and the rules of tables; `...` stands for anything."""
    wanted, got = (
        "".join(f"{line.rstrip()}\n" for line in text.splitlines() if not set(line) <= RULES)
        for text in (shown, printed)
    )
    return doctest.OutputChecker().check_output(wanted, got, doctest.ELLIPSIS)
