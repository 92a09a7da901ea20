"""A format from outside is read like ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from contactqp.exchange import answer_files, matrix_files
from contactqp.exchange.answer_reader import AnswerFile, AnswerReader
from contactqp.exchange.files import Ledger, MatrixFile, MatrixReader
from contactqp.exchange.files import Path as AnyPath
from contactqp.model.problem import ContactProblem


def _one(path: AnyPath) -> MatrixFile:
    return MatrixFile(np.eye(1), None, Ledger(str(path), read=["one"]))


def _answer(path: AnyPath, problem: ContactProblem) -> AnswerFile:
    return AnswerFile({"displacement": np.ones(problem.dimension)}, Ledger(str(path)))


def test_formats_are_added_and_named_among_what_is_expected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matrix_files, "READERS", list(matrix_files.READERS))
    monkeypatch.setattr(answer_files, "READERS", list(answer_files.READERS))
    matrix_files.register(MatrixReader("ones", (".one",), _one))
    answer_files.register(AnswerReader("all ones", (".answer",), _answer))
    file, answer = tmp_path / "K.one", tmp_path / "their.answer"
    file.touch()
    answer.touch()
    assert matrix_files.read_matrix(file).ledger.read == ["one"]
    wall = ContactProblem(stiffness=[[1.0]], load=[2.0], normal=[[1.0]], gap=[1.0])
    assert answer_files.read_answer(answer, wall).parts["displacement"] == [1.0]
    with pytest.raises(ValueError, match="a matrix: ones, "):
        matrix_files.read_matrix(tmp_path / "missing")
