"""Mutated files of every format are judged or refused in one line; benchmarks/fuzz_readers.py goes on to thousands."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from codecs import BOM_UTF8
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fuzz_readers import JUDGED, REFUSED, outcome, run_format
from benchmarks.mutations import MUTATIONS, bomb, mutate
from benchmarks.valid_files import SLOW, Seed, seeds
from contactqp.errors import InvalidProblem, SceneError
from tests.cli.test_cli import run

# Mutated files of each of 40 formats, from which one on; more than so many are refused, and than so many judged.
FEW = (0, 2, 50, 2)
MANY = [pytest.param(6 * k, 6, 150, 10, marks=pytest.mark.slow) for k in range(6)]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    root = tmp_path_factory.mktemp("seeds")
    return root, {seed.name: seed for seed in seeds(root)}


@pytest.mark.slow
def test_every_valid_file_is_judged(written):
    root, known = written
    assert len(known) >= 30
    for name, seed in known.items():
        if not name.startswith(SLOW):
            assert outcome(seed, root / name) == JUDGED, name


# Matrices, tables and results that other programs print as text.
PRINTED = ("matrix-K.mtx", "answer-job.dat", "answer-job.frd", "answer-u.mtx", "matrix-sti", "matrix-dof",
           "matrix-abaqus", "matrix-K.rsa", "siconos-local", "siconos-global", "answer-a.csv", "answer-a.json",
           "case-toml", "dof-map", "contacts-csv", "quadratic-program.qps", "deck-plane", "deck-plane-results",
           "mesh-inp")  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", PRINTED)
def test_windows_text_is_read_as_any_other_and_utf_16_is_named(written, name):
    """A mark of UTF-8 and CR LF change nothing; what is in UTF-16 says how to save it."""
    root, known = written
    seed, file = known[name], root / name / known[name].mutated
    plain = file.read_bytes()
    try:
        windows = plain.replace(b"\n", b"\r\n")
        for text in (windows, BOM_UTF8 + plain, BOM_UTF8 + windows):
            file.write_bytes(text)
            assert outcome(seed, root / name) == JUDGED
        for mark, code in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be")):
            file.write_bytes(mark + plain.decode().encode(code))
            with pytest.raises((InvalidProblem, SceneError), match=r"UTF-16: save it as UTF-8|expected \*NODE"):
                seed.ask(root / name)
    finally:
        file.write_bytes(plain)


@pytest.mark.slow
@pytest.mark.parametrize(("first", "each", "refused", "judged"), [FEW, *MANY])
def test_mutated_files_are_judged_or_refused(written, first, each, refused, judged):
    root, known = written
    odd, counts = [], {JUDGED: 0, REFUSED: 0}
    for name, seed in known.items():
        if name.startswith(SLOW):
            continue
        for number, what, said in run_format(seed, root / name, range(first, first + each)):
            if said in counts:
                counts[said] += 1
            else:
                odd.append(f"{name} {number} ({what}): {said}")
    assert not odd
    assert counts[REFUSED] > refused
    assert counts[JUDGED] > judged


def raises(error: Exception):
    def ask(_: Path) -> object:
        raise error

    return Seed("x", "x", ask)


def test_what_is_neither_judged_nor_refused_is_told(tmp_path):
    assert outcome(raises(InvalidProblem("a.csv: no")), tmp_path) == REFUSED
    assert outcome(raises(InvalidProblem("")), tmp_path).startswith("message")
    assert outcome(raises(InvalidProblem("so many words " * 1000)), tmp_path).startswith("message")
    assert outcome(raises(KeyError("load")), tmp_path).startswith("KeyError")
    assert outcome(raises(MemoryError()), tmp_path).startswith("MemoryError")
    assert outcome(Seed("x", "x", lambda _: print("note")), tmp_path).startswith("printed")
    assert outcome(Seed("x", "x", lambda _: np.log(np.zeros(1))), tmp_path).startswith("RuntimeWarning")


@pytest.mark.slow
def test_a_mutation_is_the_same_whenever_it_is_asked_for_and_changes_files():
    data = b"%%MatrixMarket matrix array real general\n3 1\n1.0\n2.0\n3.0\n" * 3
    for k in range(40):
        assert mutate(data, np.random.default_rng(k)) == mutate(data, np.random.default_rng(k))
    changed = [change(data, np.random.default_rng(1)) != data for change in MUTATIONS]
    assert sum(changed) >= len(MUTATIONS) - 1


# At the command line: what is made of one file of which valid set. A text cut off between two numbers is whole.
BROKEN = {
    "empty": lambda data: data[:0],
    "cut": lambda data: data[: len(data) // 4],
    "swapped": lambda data: np.frombuffer(data[: len(data) // 8 * 8], "<u8").byteswap().tobytes(),
    "binary": lambda data: bytes(range(256)) * (1 + len(data) // 256),
}
FORMATS = (
    *("matrix-K.mtx", "matrix-stiffness.csv", "matrix-K.npy", "matrix-K.npz", "matrix-stiffness.npz", "matrix-K.rsa"),
    *("problem-json", "contacts-csv", "problem-npz", "case-toml", "fclib-local", "siconos-local"),
    *("answer-a.json", "answer-a.csv", "answer-a.npz", "answer-u.npy", "answer-u.mtx", "forces-r.json", "forces-r.npy"),
)


def arguments(seed: Seed) -> list[str]:
    if seed.name.startswith(("fclib", "siconos")):
        return [seed.mutated, "r.npy"]
    if seed.name.startswith("forces"):
        return ["p.hdf5", seed.mutated]
    if seed.mutated.startswith("p/"):
        return ["p", "answer.json"]
    return [seed.mutated, "answer.json"] if seed.mutated.startswith("p.") else ["p", seed.mutated]


@pytest.mark.sampled(15)
@pytest.mark.parametrize("fault", BROKEN)
@pytest.mark.parametrize("name", FORMATS)
def test_at_the_command_line_a_broken_file_is_exit_2_and_one_line(capsys, monkeypatch, written, name, fault):
    root, known = written
    file = root / name / known[name].mutated
    data = file.read_bytes()
    monkeypatch.chdir(root / name)
    try:
        file.write_bytes(BROKEN[fault](data))
        code, out, err = run(capsys, "check", *arguments(known[name]))
    finally:
        file.write_bytes(data)
    assert code == 2
    assert out == ""
    assert err.startswith("contactqp: ")
    assert err.count("\n") == 1
    assert run(capsys, "check", *arguments(known[name]))[0] == 0


# One process for all formats: what one of them leaves behind would count against the others.
PROBE = """
import contextlib, io, json, os, resource, sys
resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31))
from contactqp.cli import main
for name, folder, arguments in json.loads(sys.stdin.read()):
    os.chdir(folder)
    out, err, code = io.StringIO(), io.StringIO(), None
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(["check", *arguments])
        except SystemExit as ended:
            code = ended.code
    print(json.dumps([name, code, out.getvalue()[:500], err.getvalue()[:500]]), flush=True)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no limit on memory to set")
def test_enormous_files_do_not_fill_the_memory(written):
    """A terabyte of nothing after each file, under two gigabytes of address space and a limit of time."""
    root, known = written
    kept = {name: (root / name / known[name].mutated).read_bytes() for name in FORMATS}
    asked = [(name, str(root / name), list(arguments(known[name]))) for name in FORMATS]
    try:
        for name in FORMATS:
            os.truncate(root / name / known[name].mutated, 2**40)
        ended = subprocess.run(
            [sys.executable, "-c", PROBE],
            input=json.dumps(asked),
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    finally:
        for name, data in kept.items():
            (root / name / known[name].mutated).write_bytes(data)
    found = [json.loads(line) for line in ended.stdout.splitlines()]
    assert [name for name, *_ in found] == list(FORMATS), ended.stderr[-500:]
    for name, code, out, err in found:
        if name == "fclib-local":  # HDF5 says itself where it ends
            assert code == 0
            continue
        assert (code, out, err.count("\n")) == (2, "", 1), (name, code, err)


@pytest.mark.slow
def test_an_archive_that_grows_is_refused_before_it_does(tmp_path, capsys, written):
    root, _ = written
    (tmp_path / "bomb.npz").write_bytes(bomb(b"\x93NUMPY\x01\x00"))
    code, _, err = run(capsys, "check", root / "problem-json/p", tmp_path / "bomb.npz")
    assert code == 2
    assert "bomb.npz: sizes in the archive: expected at most" in err
    code, _, err = run(capsys, "run", tmp_path / "bomb.npz")
    assert code == 2
    assert err.count("\n") == 1


def test_pipes_and_devices_are_no_files(capsys, tmp_path, written):
    root, _ = written
    os.mkfifo(tmp_path / "pipe")
    for name in (tmp_path / "pipe", "/dev/zero"):
        code, _, err = run(capsys, "check", root / "problem-json/p", name)
        assert code == 2
        assert "got a pipe or a device" in err
        code, _, err = run(capsys, "run", name)
        assert code == 2
        assert "got a pipe or a device" in err
