"""Ansys's binary files, on the example that comes with the reader: a beam of 40 solid elements and its vibrations."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.exchange import ansys
from contactqp.exchange.answer_files import read_answer
from contactqp.exchange.matrix_files import read_matrix
from tests.cli.test_cli import run


def examples() -> Path | None:
    if importlib.util.find_spec("ansys") is None or importlib.util.find_spec("ansys.mapdl.reader") is None:
        return None
    return Path(str(importlib.util.find_spec("ansys.mapdl.reader").origin)).parent / "examples"


EXAMPLES = examples()
needs_reader = pytest.mark.skipif(EXAMPLES is None, reason="ansys-mapdl-reader is not installed")

# Mass, and the frequencies that Ansys found, by the reader itself, which may warn of what it imports.
BY_THE_READER = """
import sys, warnings
warnings.simplefilter("ignore")
import numpy as np
from ansys.mapdl.reader.full import FullFile
from ansys.mapdl.reader.rst import Result
unknowns, _, mass = FullFile(sys.argv[1]).load_km(sort=False)
held = {tuple(one) for one in FullFile(sys.argv[1]).const.tolist()}
free = np.array([tuple(one) not in held for one in unknowns.tolist()])
half = mass.tocsr()[free][:, free].toarray()
whole = half + half.T - np.diag(half.diagonal())
result = Result(sys.argv[2])
place = dict(zip(result.mesh.nnum.tolist(), result.mesh.nodes[:, 2].tolist()))
fixed = np.array([place[node] for node, _ in held])
apart = np.array([np.min(abs(fixed - place[node])) for node in unknowns[free, 0].tolist()])
np.savez(sys.argv[3], mass=whole, hertz=result.time_values, apart=apart)
"""


@pytest.fixture(scope="module", autouse=True)
def _each_file_once():
    """What the reader's process finds in the two examples, kept: it takes seconds, and copies hold the same."""
    if EXAMPLES is None:
        yield
        return
    known, read = {}, ansys._read
    whole = {(EXAMPLES / name).read_bytes() for name in ("file.full", "file.rst")}

    def once(path, kind):
        content = Path(path).read_bytes()
        if content not in whole:
            return read(path, kind)
        if (content, kind) not in known:
            known[content, kind] = read(path, kind)
        return known[content, kind]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ansys, "_read", once)
        yield


@pytest.fixture(scope="module")
def stiffness():
    return read_matrix(EXAMPLES / "file.full")


def beam(folder: Path, stiffness) -> cq.ContactProblem:
    """A folder with the stiffness, a load at one node and a wall above another."""
    shutil.copy(EXAMPLES / "file.full", folder)
    (folder / "load.csv").write_text("dof,load\n41.y,100\n")
    (folder / "contacts.csv").write_text("contact,dof,coefficient,gap\nwall,41.y,1,1e-6\nfloor,42.y,-1,1e-6\n")
    n, labels = stiffness.matrix.shape[0], stiffness.labels
    load, normal = np.zeros(n), np.zeros((2, n))
    load[labels.index("41.y")] = 100
    normal[0, labels.index("41.y")], normal[1, labels.index("42.y")] = 1, -1
    rows = dict(normal=normal, gap=[1e-6, 1e-6], contact_names=["wall", "floor"])
    return cq.ContactProblem(stiffness=stiffness.matrix, load=load, dof_names=labels, **rows)


@needs_reader
def test_stiffness_and_shapes_are_those_of_the_vibrations_that_ansys_found(tmp_path, stiffness):
    """K phi = (2 pi f)^2 M phi holds only where K, the names of unknowns and the displacements belong together.

    The vibrations are of the free beam: equations of nodes next to the end that the stiffness is held at say nothing.
    """
    files = [str(EXAMPLES / name) for name in ("file.full", "file.rst")]
    subprocess.run([sys.executable, "-c", BY_THE_READER, *files, str(tmp_path / "m.npz")], check=True)
    known = np.load(tmp_path / "m.npz")
    n = stiffness.matrix.shape[0]
    problem = cq.ContactProblem(
        stiffness=stiffness.matrix, load=np.zeros(n), normal=np.zeros((0, n)), gap=[], dof_names=stiffness.labels
    )
    found = read_answer(EXAMPLES / "file.rst", problem)
    shape = found.parts["displacement"]
    pull, inertia = stiffness.matrix @ shape, (2 * np.pi * known["hertz"][-1]) ** 2 * known["mass"] @ shape
    away = known["apart"] > 0.6  # elements are half a metre long
    assert np.count_nonzero(away) > 700
    pull, inertia = pull[away], inertia[away]
    assert np.linalg.norm(pull - inertia) < 1e-6 * np.linalg.norm(pull)
    assert np.linalg.norm(pull - 1.01 * inertia) > 1e-3 * np.linalg.norm(pull)
    assert "the last of 6 sets of results is the one" in found.ledger.assumed
    assert any("63 names that the problem does not have" in line for line in found.ledger.ignored)


@needs_reader
def test_a_full_file_with_contacts_by_name_is_a_problem_and_is_judged(capsys, tmp_path, stiffness):
    problem = beam(tmp_path, stiffness)
    solution = cq.solve(problem)
    assert solution.normal_force[0] > 1
    read = cq.read_problem(tmp_path)
    assert abs(read.stiffness - sp.csc_array(stiffness.matrix)).max() == 0
    assert read.load.tolist() == problem.load.tolist()
    answer = {name: float(x) for name, x in zip(problem.dof_names, solution.displacement, strict=True)}
    (tmp_path / "u.json").write_text(json.dumps({"displacement": answer}))
    code, out, _ = run(capsys, "check", tmp_path, tmp_path / "u.json")
    assert code == 0
    assert "63 unknowns that are held were left out" in out
    (tmp_path / "u.json").write_text(json.dumps({"displacement": answer | {"41.y": 2e-6}}))
    code, out, _ = run(capsys, "check", tmp_path, tmp_path / "u.json")
    assert code == 1
    assert "wall" in out
    code, out, _ = run(capsys, "check", tmp_path, EXAMPLES / "file.rst")  # shapes of vibration are no static answer
    assert code == 1


@needs_reader
def test_a_load_vector_of_zeros_is_not_taken_for_the_load(tmp_path, stiffness):
    beam(tmp_path, stiffness)
    (tmp_path / "load.csv").unlink()
    with pytest.raises(cq.InvalidProblem, match=r"load: expected load \(f\), which is not assumed"):
        cq.read_problem(tmp_path)


@needs_reader
@pytest.mark.parametrize("name", ["file.full", "file.rst"])
def test_a_damaged_file_is_one_line_even_where_its_reader_crashes(tmp_path, name):
    data = bytearray((EXAMPLES / name).read_bytes())
    problem = cq.ContactProblem(stiffness=[[1.0]], load=[1.0], normal=[[1.0]], gap=[0.0], dof_names=["1.x"])
    read = read_matrix if name == "file.full" else lambda file: read_answer(file, problem)
    broken = {
        "empty": b"",
        "cut": data[: len(data) // 2],
        "text": b"stiffness\n" * 100,
        "swapped": np.frombuffer(data[: len(data) // 4 * 4], "<i4").byteswap().tobytes(),
        "pointers": bytes(data[:412]) + b"\x7f" * 2000 + bytes(data[2412:]),
    }
    for fault, content in broken.items():
        file = tmp_path / f"{fault}{Path(name).suffix}"
        file.write_bytes(content)
        with pytest.raises((cq.InvalidProblem, cq.Unsupported), match=f"{fault}.*expected") as refused:
            read(file)
        assert "\n" not in str(refused.value)


def test_without_the_reader_the_pip_command_is_said(capsys, monkeypatch, tmp_path):
    head = np.zeros(102, "<i4")
    head[[0, 2]] = 100, 4
    (tmp_path / "a.full").write_bytes(head.tobytes())
    monkeypatch.setattr(ansys.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(cq.BackendMissing, match=r"pip install ansys-mapdl-reader"):
        read_matrix(tmp_path / "a.full")
    (tmp_path / "load.csv").write_text("dof,load\n")
    code, _, err = run(capsys, "check", tmp_path, tmp_path)
    assert code == 3
    assert err.count("\n") == 1
