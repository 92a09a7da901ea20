"""A format from outside is read like ours; forces and displacements that no reader takes are refused, not ignored."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from contactqp.errors import InvalidProblem
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


def _wall(friction: bool = False) -> ContactProblem:
    return ContactProblem(
        stiffness=np.diag([2.0, 4.0, 1.0]),
        load=[6.0, 0.0, 0.0],
        normal=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        gap=[1.0, 1.0],
        tangent=[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]] if friction else None,
        friction=[0.3, 0.4] if friction else None,
    )


U, FORCE = [1.0, 0.0, 0.0], [4.0, 0.0]


def _write(path: Path, kind: str, name: str, values: list[float]) -> Path:
    """Write the right displacement and values under another name."""
    if kind == "json":
        target = path / "theirs.json"
        target.write_text(json.dumps({"displacement": U, name: values}))
    elif kind == "json by name":
        target = path / "theirs.json"
        target.write_text(json.dumps({"displacement": U, name: dict(zip("ab", values, strict=True))}))
    elif kind == "npz":
        target = path / "theirs.npz"
        np.savez(target, displacement=U, **{name: values})
    else:
        target = path / "theirs"
        target.mkdir()
        np.savetxt(target / "displacement.txt", U)
        np.savetxt(target / f"{name}.txt", values)
    return target


@pytest.mark.sampled(6)
@pytest.mark.parametrize("kind", ["json", "json by name", "npz", "folder"])
@pytest.mark.parametrize(
    "name", ["lambda", "CNORMF", "normal_forces", "fn", "dual", "r_n", "friction", "tau", "impulse"]
)
def test_forces_under_a_name_that_is_not_read_are_refused(tmp_path: Path, kind: str, name: str) -> None:
    """Ignored, a wrong force would pass beside the right displacement."""
    with pytest.raises(InvalidProblem, match=r"expected forces called normal_force, friction_force or tie_force"):
        answer_files.read_answer(_write(tmp_path, kind, name, [8.0, 0.0]), _wall())


@pytest.mark.parametrize("kind", ["json", "npz", "folder"])
@pytest.mark.parametrize("name", ["gap", "status", "friction_coefficient"])
def test_what_is_no_force_of_contacts_is_ignored_and_said(tmp_path: Path, kind: str, name: str) -> None:
    found = answer_files.read_answer(_write(tmp_path, kind, name, [8.0, 0.0]), _wall())
    assert list(found.parts) == ["displacement"]
    assert any(name in line for line in found.ledger.ignored)


def test_reactions_are_those_of_contacts_unless_forces_stand_beside_them_or_they_have_other_names(
    tmp_path: Path,
) -> None:
    """Siconos calls its contact forces reactions; to other codes reactions are those of supports."""
    for number, (held, refused) in enumerate(
        (
            ({"reaction": [8.0, 0.0, 0.0, 0.0]}, True),  # two components a contact
            ({"reactions": {"contact 0": 8.0, "contact 1": 0.0}}, True),
            ({"reaction": {"0": 8.0, "1": 0.0}}, True),
            ({"reaction": {"left.x": 8.0, "right.x": 0.0}}, False),
            ({"reaction": [8.0, 0.0], "normal_force": FORCE}, False),
            ({"reaction": [8.0] * 5}, False),
        )
    ):
        file = tmp_path / f"{number}.json"
        file.write_text(json.dumps({"displacement": U} | held))
        if refused:
            with pytest.raises(InvalidProblem, match=r"reactions?: expected forces called normal_force"):
                answer_files.read_answer(file, _wall())
        else:
            assert "reaction" in answer_files.read_answer(file, _wall()).ledger.ignored
    for kind in ("npz", "folder"):
        (tmp_path / kind).mkdir()
        with pytest.raises(InvalidProblem, match=r" r: expected forces called normal_force"):
            answer_files.read_answer(_write(tmp_path / kind, kind, "r", [8.0, 0.0]), _wall())
    table = tmp_path / "theirs.csv"
    table.write_text("dof,displacement\n0,9\n1,9\n2,9\ncontact,reaction\n0,4\n1,0\n")
    with pytest.raises(InvalidProblem, match="column reaction: expected normal_force or friction_force"):
        answer_files.read_answer(table, _wall())


def test_the_coefficients_of_the_problem_are_no_forces(tmp_path: Path) -> None:
    found = answer_files.read_answer(_write(tmp_path, "npz", "friction", [0.3, 0.4]), _wall(friction=True))
    assert list(found.parts) == ["displacement"]
    with pytest.raises(InvalidProblem, match="friction: expected forces called"):
        answer_files.read_answer(_write(tmp_path, "json", "friction", [0.3, 0.5]), _wall(friction=True))


def test_displacements_under_a_name_that_is_not_read_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "theirs.json"
    file.write_text(json.dumps({"normal_force": FORCE, "displacements": [9.0, 9.0, 9.0]}))
    with pytest.raises(InvalidProblem, match="expected displacements called displacement"):
        answer_files.read_answer(file, _wall())
    table = tmp_path / "theirs.csv"
    table.write_text("contact,normal_force\n0,4\n1,0\ndof,disp\n0,9\n1,9\n2,9\n")
    with pytest.raises(InvalidProblem, match="column disp: expected displacement"):
        answer_files.read_answer(table, _wall())


def test_the_multipliers_of_a_program_under_another_name_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "theirs.json"
    file.write_text(json.dumps({"x": U, "dual": [8.0]}))
    with pytest.raises(InvalidProblem, match="expected forces called x, y, z or z_box"):
        answer_files.read_answer(file, _wall())


def test_a_file_of_a_folder_whose_name_says_another_part_is_refused(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "displacement.txt", U)
    (tmp_path / "contacts.csv").write_text("contact,normal_force\n0,8\n1,0\n")
    with pytest.raises(InvalidProblem, match=r"contacts.csv: expected a file called like what it holds"):
        answer_files.read_answer(tmp_path, _wall())


def test_an_answer_that_states_other_units_is_refused_and_not_read_in_those_of_the_problem(tmp_path: Path) -> None:
    problem = _wall().replace(units={"length": "um", "force": "kN"})
    file = tmp_path / "theirs.json"
    for length, force, refused in (
        ("µm", "kN", None),
        ("mm", "kN", "units.length: expected 'um'"),
        ("um", "N", "units.force: expected 'kN'"),
    ):
        file.write_text(json.dumps({"displacement": U, "units": {"length": length, "force": force}}))
        if refused is None:
            assert list(answer_files.read_answer(file, problem).parts) == ["displacement"]
        else:
            with pytest.raises(InvalidProblem, match=refused):
                answer_files.read_answer(file, problem)
    assert list(answer_files.read_answer(file, _wall()).parts) == ["displacement"]  # the problem names none


def test_a_table_whose_contacts_do_not_stand_first_is_told_what_does(tmp_path: Path) -> None:
    """As `contactqp run --csv` writes it, instant by instant."""
    table = tmp_path / "theirs.csv"
    table.write_text("instant,time [legs],contact,normal_force [N]\n0,1.0,tip,4\n")
    with pytest.raises(InvalidProblem, match="first line: expected dof, node, contact or tie as the first column"):
        answer_files.read_answer(table, _wall())


def test_a_residual_beside_the_multipliers_of_a_program_is_ignored_by_name(tmp_path: Path) -> None:
    """A program has no supports: what is called r counts as multipliers only where none are stated."""
    program = ContactProblem.from_qp(2 * np.eye(2), [-4.0, -2.0], G=[[1.0, 1.0]], h=[2.0])
    file = tmp_path / "answer.json"
    file.write_text(json.dumps({"x": [1.5, 0.5], "z": [1.0], "r": [0.0, 0.0]}))
    assert answer_files.read_answer(file, program).ledger.ignored == ["r"]
    file.write_text(json.dumps({"x": [1.5, 0.5], "r": [1.0]}))
    with pytest.raises(InvalidProblem, match="r: expected forces called x, y, z or z_box"):
        answer_files.read_answer(file, program)
