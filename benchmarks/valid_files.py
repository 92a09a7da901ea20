"""Small valid files of every format that is read, each with what makes a question of it: the seeds of fuzzing.

One problem in the plane for most: two bodies on springs, one contact closed with friction or without, one tie.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse as sp

import contactqp as cq
from benchmarks.decks import judge_deck, solve_deck, write_decks
from benchmarks.printed_files import add_printed
from contactqp.elements.mesh_files import read_mesh
from contactqp.exchange.problem_folder import write_problem
from contactqp.study.checking import check_answer
from contactqp.study.verdict import CheckOptions

# Formats that are read in a process of their own take seconds a file.
SLOW = "ansys-"
K = np.array([[4.0, -1.0, 0.0], [-1.0, 5.0, 2.5], [0.0, 2.5, 3.0]])
CASE = Path(__file__).parent.parent / "cases" / "bar_wall.toml"


@dataclass(frozen=True)
class Seed:
    """One format: a folder of files, which of them is mutated, and who is asked about it."""

    name: str
    mutated: str
    ask: Callable[[Path], object]  # given the folder; what it returns is of no interest


def problem() -> cq.ContactProblem:
    """Three unknowns, two contacts, one tie."""
    return cq.ContactProblem(
        stiffness=sp.csr_array(K),
        load=[2.0, 1.0, 0.5],
        normal=[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        gap=[0.1, 5.0],
        tie=[[0.0, 1.0, -1.0]],
        tie_value=[0.01],
        dof_names=["1.x", "1.y", "2.x"],
        contact_names=["left", "right"],
    )


def seeds(root: Path) -> list[Seed]:
    """Write every valid file below a folder; each seed has a folder of its own name there."""
    found: list[Seed] = []

    def add(name: str, write: Callable[[Path], str], ask: Callable[[Path], object]) -> None:
        folder = root / name
        folder.mkdir(parents=True)
        found.append(Seed(name, write(folder), ask))

    _add_matrices(add)
    _add_problems(add)
    _add_answers(add)
    add_printed(add, _whole)
    _add_local(add)
    _add_quadratic_programs(add)
    _add_ansys(add)
    for name in ("plane", "space", "assembled"):
        add(f"deck-{name}", _deck(f"{name}.inp"), partial(solve_deck, name=name))
        add(f"deck-{name}-results", _deck(f"{name}.dat"), partial(judge_deck, name=name))
    add("deck-included", _deck("nodes.inp"), partial(judge_deck, name="plane"))
    for kind in ("inp", "msh22", "msh41", "vtu"):
        add(f"mesh-{kind}", lambda folder, kind=kind: _write_mesh(folder, kind), _read_mesh)
    return found


def _deck(mutated: str) -> Callable[[Path], str]:
    def write(folder: Path) -> str:
        write_decks(folder)
        return mutated

    return write


QPS = """NAME SMALL
ROWS
 N  cost
 L  wall
 E  tied
COLUMNS
 x  cost  -2.0  wall  1.0
 x  tied  1.0
 y  cost  -1.0  tied  -1.0
RHS
 RHS  wall  0.1  tied  0.01
BOUNDS
 UP BND  y  0.5
QUADOBJ
 x  x  4.0
 x  y  -1.0
 y  y  5.0
ENDATA
"""


def _add_quadratic_programs(add: Add) -> None:
    """The same energy and constraints in each form that is not a contact problem's own."""
    program = problem().to_qp()
    rows = sp.vstack([program.G, program.A, sp.identity(3)])
    bounds = {
        "l": np.concatenate([[-1e20, -1e20], program.b, np.full(3, -1e20)]),
        "u": np.concatenate([program.h, program.b, np.full(3, 1e20)]),
    }
    arrays = {name: getattr(program, name) for name in ("q", "h", "b")}
    matrices = {name: getattr(program, name).toarray() for name in ("P", "G", "A")}

    def matlab(file: Path) -> None:
        scipy.io.savemat(file, {"P": program.P, "q": program.q, "A": rows, **bounds, "r": 0.0})

    formats: dict[str, Callable[[Path], object]] = {
        "program.mat": matlab,
        "program.npz": lambda file: np.savez(file, **arrays, **matrices, lb=np.full(3, -9.0), ub=np.full(3, 9.0)),
        "program.qps": lambda file: file.write_text(QPS),
    }
    for name, write in formats.items():

        def fill(folder: Path, name: str = name, write: Callable[[Path], object] = write) -> str:
            write(folder / name)
            return name

        add(f"quadratic-{name}", fill, lambda folder, name=name: cq.solve(cq.read_problem(folder / name)))


Add = Callable[[str, Callable[[Path], str], Callable[[Path], object]], None]


def _add_ansys(add: Add) -> None:
    """The example that comes with the reader, where that is installed."""
    try:
        found = importlib.util.find_spec("ansys.mapdl.reader")
    except ModuleNotFoundError:
        found = None
    if found is None or found.origin is None:
        return
    examples = Path(found.origin).parent / "examples"

    def fill(folder: Path, mutated: str) -> str:
        path = folder / "p"
        path.mkdir()
        (path / "load.csv").write_text("dof,load\n41.y,100\n")
        (path / "contacts.csv").write_text("contact,dof,coefficient,gap\nwall,41.y,1,1e-6\n")
        shutil.copy(examples / "file.full", path)
        shutil.copy(examples / "file.rst", folder)
        return mutated

    for mutated in ("p/file.full", "file.rst"):
        name = f"{SLOW}{mutated.rpartition('.')[2]}"
        add(name, lambda folder, mutated=mutated: fill(folder, mutated), lambda folder: _check(folder, "p", "file.rst"))


def _check(folder: Path, name: str = "p", candidate: str = "answer.json") -> object:
    """The verdict and all that would be printed of it."""
    return check_answer(str(folder / name), str(folder / candidate), CheckOptions()).data()


def _whole(folder: Path, *without: str) -> Path:
    """The problem as a folder p without problem.json and without some files, and its answer."""
    question = problem()
    path = write_problem(folder / "p", question, cq.solve(question))
    (path / "answer.json").rename(folder / "answer.json")
    for name in ("problem.json", *without):
        (path / name).unlink()
    (path / "dof_names.txt").write_text("1.x\n1.y\n2.x\n")
    (path / "contact_names.txt").write_text("left\nright\n")
    return path


def _add_matrices(add: Add) -> None:
    """Every format of matrices, as the stiffness (or the load) of a folder."""

    def stiffness(name: str, write: Callable[[Path], object]) -> Callable[[Path], str]:
        def fill(folder: Path) -> str:
            write(_whole(folder, "stiffness.mtx") / name)
            return f"p/{name}"

        return fill

    formats: dict[str, Callable[[Path], object]] = {
        "K.mtx": lambda file: scipy.io.mmwrite(file, sp.coo_matrix(K), symmetry="general"),
        "stiffness.csv": lambda file: np.savetxt(file, K, delimiter=","),
        "K.txt": lambda file: np.savetxt(file, K),
        "K.npy": lambda file: np.save(file, K),
        "K.npz": lambda file: np.savez_compressed(file, K=K),
        "stiffness.npz": lambda file: sp.save_npz(file, sp.csr_matrix(K)),
        "K.rsa": lambda file: file.write_text(HARWELL_BOEING),
    }
    for name, write in formats.items():
        add(f"matrix-{name}", stiffness(name, write), _check)
    for part in ("stiffness.mtx", "load.mtx", "normal.mtx"):
        add(f"matrix-market-{part}", lambda folder, part=part: f"p/{part}" if _whole(folder) else "", _check)


def _add_problems(add: Add) -> None:
    def canonical(folder: Path) -> str:
        question = problem()
        write_problem(folder / "p", question, cq.solve(question))
        shutil.copy(folder / "p/answer.json", folder)
        return "p/problem.json"

    def tables(folder: Path) -> str:
        path = _whole(folder, "normal.mtx", "gap.mtx")
        (path / "contact_names.txt").unlink()
        rows = "left,1.x,1,0.1\nright,2.x,1,5\n"
        (path / "contacts.csv").write_text("contact,dof,coefficient,gap\n" + rows)
        return "p/contacts.csv"

    def archive(folder: Path) -> str:
        question = problem()
        write_problem(folder / "x", question, cq.solve(question))
        shutil.copy(folder / "x/answer.json", folder)
        parts = {name: getattr(question, name) for name in ("load", "gap", "tie_value")}
        rows = {"E_N": question.normal.toarray(), "A": question.tie.toarray()}
        names = {"dof_names": np.array(question.dof_names), "contact_names": np.array(question.contact_names)}
        stored = sp.csr_array(K)
        sparse = {f"K_{key}": getattr(stored, key) for key in ("data", "indices", "indptr", "shape")}
        np.savez(folder / "p.npz", **parts, **rows, **names, **sparse)
        return "p.npz"

    def case(folder: Path) -> str:
        shutil.copy(CASE, folder / "p.toml")
        (folder / "answer.json").write_text(json.dumps({"displacement": [1e-3], "normal_force": [142.5]}))
        return "p.toml"

    add("problem-json", canonical, _check)
    add("contacts-csv", tables, _check)
    add("problem-npz", archive, lambda folder: _check(folder, "p.npz"))
    add("case-toml", case, lambda folder: _check(folder, "p.toml"))


def _add_answers(add: Add) -> None:
    solution = cq.solve(problem())
    u, force, tie = solution.displacement, solution.normal_force, solution.tie_force
    names = {"dof": ("1.x", "1.y", "2.x"), "contact": ("left", "right"), "tie": ("tie 0",)}

    tables = (("dof", "displacement", u), ("contact", "normal_force", force), ("tie", "tie_force", tie))

    def table(file: Path) -> None:
        lines: list[str] = []
        for key, part, values in tables:
            rows = (f"{name},{value!r}" for name, value in zip(names[key], values.tolist(), strict=True))
            lines += [f"{key},{part}", *rows]
        file.write_text("\n".join(lines) + "\n")

    by_name = dict(zip(names["dof"], u.tolist(), strict=True))
    answer = [{"displacement": by_name, "normal_force": force.tolist(), "gap": None}]
    formats: dict[str, Callable[[Path], object]] = {
        "a.json": lambda file: file.write_text(json.dumps(answer)),
        "a.csv": table,
        "a.npz": lambda file: np.savez_compressed(file, u=u, normal_force=force, tie_force=tie),
        "u.npy": lambda file: np.save(file, u),
        "u.mtx": lambda file: scipy.io.mmwrite(file, u.reshape(-1, 1)),
        "displacement.txt": lambda file: np.savetxt(file, u),
    }
    for name, write in formats.items():

        def fill(folder: Path, name: str = name, write: Callable[[Path], object] = write) -> str:
            _whole(folder)
            write(folder / name)
            return name

        add(f"answer-{name}", fill, lambda folder, name=name: _check(folder, candidate=name))
    add("dof-map", _write_map, _check_with_map)


def _write_map(folder: Path) -> str:
    _whole(folder)
    (folder / "map.csv").write_text("problem,candidate\n1.x,a\n1.y,b\n2.x,c\n")
    u = cq.solve(problem()).displacement.tolist()
    (folder / "a.json").write_text(json.dumps({"displacement": dict(zip("abc", u, strict=True))}))
    return "map.csv"


def _check_with_map(folder: Path) -> object:
    options = CheckOptions(dof_map=str(folder / "map.csv"))
    return check_answer(str(folder / "p"), str(folder / "a.json"), options).data()


def _add_local(add: Add) -> None:
    """FCLIB and Siconos, and forces for them."""
    rows = dict(normal=[[-1.0, 0.0, 0.0]], gap=[0.5], tangent=[[0.0, 1.0, 0.0]], friction=0.3)
    bodies = cq.ContactProblem(stiffness=K, load=[-3.0, 1.0, 0.0], **rows)
    local = cq.local_form_of(bodies)
    force = cq.solve(local).force

    def stored(question: object, name: str) -> Callable[[Path], str]:
        def fill(folder: Path) -> str:
            cq.write_fclib(folder / "p.hdf5", question, cq.solve(local))  # type: ignore[arg-type]
            np.save(folder / "r.npy", force)
            return name

        return fill

    def siconos(text: str) -> Callable[[Path], str]:
        def fill(folder: Path) -> str:
            (folder / "p.dat").write_text(text)
            np.save(folder / "r.npy", force)
            return "p.dat"

        return fill

    ask = lambda folder: _check(folder, "p.hdf5", "r.npy")  # noqa: E731
    add("fclib-local", stored(local, "p.hdf5"), ask)
    add("fclib-global", stored(bodies, "p.hdf5"), ask)
    add("fclib-solution", stored(local, "p.hdf5"), lambda folder: _check(folder, "p.hdf5", "p.hdf5"))
    W = local.delassus.toarray()
    text = f"2\n1\n0\n2\n2\n2\t2\n{_numbers(W.T)}\n{_numbers(local.offset)}\n0.3\n"
    add("siconos-local", siconos(text), lambda folder: _check(folder, "p.dat", "r.npy"))
    H = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    dense = f"0\n3\n3\n3\t3\n{_numbers(K)}\n0\n3\n2\n3\t2\n{_numbers(H.T)}\n"
    text = f"2\n1\n{dense}{_numbers(bodies.load)}\n0.5 0\n0.3\n"
    add("siconos-global", siconos(text), lambda folder: _check(folder, "p.dat", "r.npy"))
    formats: dict[str, Callable[[Path], object]] = {
        "r.json": lambda file: file.write_text(json.dumps({"force": force.tolist()})),
        "r.csv": lambda file: file.write_text("contact,rN,rT\n0," + ",".join(map(repr, force[0].tolist())) + "\n"),
        "r.txt": lambda file: np.savetxt(file, force),
        "r.npy": lambda file: np.save(file, force),
    }
    for name, write in formats.items():

        def fill(folder: Path, name: str = name, write: Callable[[Path], object] = write) -> str:
            stored(local, "p.hdf5")(folder)
            write(folder / name)
            return name

        add(f"forces-{name}", fill, lambda folder, name=name: _check(folder, "p.hdf5", name))


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(values))


def _write_mesh(folder: Path, kind: str) -> str:
    if kind == "inp":
        (folder / "m.inp").write_text(ABAQUS)
        return "m.inp"
    import meshlane

    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]])
    mesh = meshlane.Mesh(points, [("quad", np.array([[0, 1, 2, 3], [1, 4, 5, 2]]))])
    name = {"msh22": "m.msh", "msh41": "m.msh", "vtu": "m.vtu"}[kind]
    form = {"msh22": "gmsh22", "msh41": "gmsh", "vtu": "vtu"}[kind]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        mesh.write(folder / name, file_format=form, **({} if kind == "vtu" else {"binary": kind == "msh41"}))
    return name


def _read_mesh(folder: Path) -> object:
    return read_mesh(next(folder.glob("m.*")))


ABAQUS = """*HEADING
two squares
*NODE, NSET=ALL
1, 0., 0.
2, 1., 0.
3, 1., 1.
4, 0., 1.
5, 2., 0.
6, 2., 1.
*ELEMENT, TYPE=CPE4, ELSET=BODY
1, 1, 2, 3, 4
2, 2, 5, 6, 3
*NSET, NSET=LEFT
1, 4
*SURFACE, NAME=TOP
BODY, S3
"""
HARWELL_BOEING = """stiffness                                                               K
             7             1             1             2             1
RSA                        3             3             5             0
(4I5)           (5I5)           (3E16.8)            (3E16.8)
F                          1             0
    1    3    5    6
    1    2    2    3    3
  4.00000000E+00 -1.00000000E+00  5.00000000E+00
  2.50000000E+00  3.00000000E+00
  2.00000000E+00  1.00000000E+00  5.00000000E-01
"""
