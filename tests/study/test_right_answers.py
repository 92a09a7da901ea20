"""Right answers in the formats, orders and signs of other codes are accepted every time; the same spoiled never are.

The answers are exact by construction (`exact_answers`), in 26 formats of candidates x 10 problems, and the problems in
six formats of their own, in turn.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import contactqp as cq
from contactqp.exchange.problem_folder import write_problem
from contactqp.study.checking import check_answer
from contactqp.study.verdict import CheckOptions
from tests.study.exact_answers import Exact, exact

PROBLEMS = range(10)


@dataclass
class Written:
    """A candidate, and what has to be said of it."""

    file: str
    options: dict[str, str] = field(default_factory=dict)


def table(key: str, part: str, names, values, mark: str = ",", order=None) -> str:
    values = np.asarray(values).reshape(len(names), -1)
    order = range(len(names)) if order is None else order
    header = [part] if values.shape[1] == 1 else [f"{part}_{k + 1}" for k in range(values.shape[1])]
    rows = [mark.join([names[i], *(f"{v!r}" for v in values[i].tolist())]) for i in order]
    return "\n".join([mark.join([key, *header]), *rows]) + "\n"


def csv(answer: Exact, mark: str = ",", *, positions: bool = False, seed: int = 3) -> str:
    """All tables, their rows in any order."""
    p, random = answer.problem, np.random.default_rng(seed)
    dofs = [str(j) for j in range(p.dimension)] if positions else list(p.dof_names)
    contacts = [str(i) for i in range(p.contacts)] if positions else list(p.contact_names)
    text = table("dof", "displacement", dofs, answer.displacement, mark, random.permutation(p.dimension))
    if answer.friction_force is None:
        text += table("contact", "normal_force", contacts, answer.normal_force, mark, random.permutation(p.contacts))
    else:
        both = np.column_stack([answer.normal_force, answer.friction_force])
        lines = table("contact", "x", contacts, both, mark, random.permutation(p.contacts)).splitlines()
        friction = [f"friction_{k + 1}" for k in range(both.shape[1] - 1)]
        text += "\n".join([mark.join(["contact", "normal_force", *friction]), *lines[1:]]) + "\n"
    if answer.tie_force is not None:
        text += table("tie", "tie_force", [f"tie {k}" for k in range(p.ties)], answer.tie_force, mark)
    return text


def parts(answer: Exact) -> dict[str, np.ndarray]:
    names = ("displacement", "normal_force", "friction_force", "tie_force")
    return {name: getattr(answer, name) for name in names if getattr(answer, name) is not None}


def as_json(folder: Path, data, **options: str) -> Written:
    (folder / "a.json").write_text(json.dumps(data))
    return Written("a.json", options)


def lists(answer: Exact) -> dict[str, list]:
    return {name: values.tolist() for name, values in parts(answer).items()}


def by_name(answer: Exact) -> dict[str, dict]:
    p = answer.problem
    ties = [f"tie {k}" for k in range(p.ties)]
    names = dict(displacement=p.dof_names, normal_force=p.contact_names, friction_force=p.contact_names, tie_force=ties)
    return {part: dict(zip(names[part], values.tolist(), strict=True)) for part, values in parts(answer).items()}


def as_csv(folder: Path, text: str) -> Written:
    (folder / "a.csv").write_text(text)
    return Written("a.csv")


def as_npz(folder: Path, save, arrays: dict[str, np.ndarray]) -> Written:
    save(folder / "a.npz", **arrays)
    return Written("a.npz")


def as_folder(folder: Path, answer: Exact, suffix: str, write: Callable[[Path, np.ndarray], object]) -> Written:
    (folder / "a").mkdir()
    for name, values in parts(answer).items():
        write(folder / "a" / f"{name}{suffix}", values)
    return Written("a")


def write_mtx(file: Path, values: np.ndarray) -> None:
    scipy.io.mmwrite(file, values.reshape(len(values), -1))


def write_sparse_mtx(file: Path, values: np.ndarray) -> None:
    scipy.io.mmwrite(file, sp.coo_matrix(values.reshape(len(values), -1)))


def pressures(folder: Path, answer: Exact) -> Written:
    """Pressures by areas that are stated by name."""
    area = 2.0 ** np.arange(answer.problem.contacts) / 8
    (folder / "areas.csv").write_text(table("contact", "area", answer.problem.contact_names, area))
    data = lists(answer) | {"normal_pressure": (answer.normal_force / area).tolist()}
    if answer.friction_force is not None:
        data["friction_force"] = (answer.friction_force / area[:, None]).tolist()
    data.pop("normal_force")
    return as_json(folder, data, pressure_areas="areas.csv")


def plain_areas(folder: Path, answer: Exact) -> Written:
    """Forces that are pressures because areas come with them, one a line."""
    np.savetxt(folder / "areas.txt", np.full(answer.problem.contacts, 0.25))
    data = lists(answer) | {name: (4 * values).tolist() for name, values in parts(answer).items() if "_f" in name}
    if answer.tie_force is not None:
        data["tie_force"] = answer.tie_force.tolist()
    return as_json(folder, data, pressure_areas="areas.txt")


def reordered(folder: Path, answer: Exact) -> Written:
    """Unknowns in another order, among others that the problem does not have."""
    n = answer.problem.dimension
    place = np.random.default_rng(5).permutation(n + 4)[:n]
    longer = np.full(n + 4, 777.0)
    longer[place] = answer.displacement
    np.savetxt(folder / "map.txt", place, fmt="%d")
    return as_json(folder, lists(answer) | {"displacement": longer.tolist()}, dof_map="map.txt")


def in_order_of_names(folder: Path, answer: Exact) -> Written:
    order = np.random.default_rng(6).permutation(answer.problem.dimension)
    (folder / "map.txt").write_text("".join(f"{answer.problem.dof_names[j]}\n" for j in order))
    data = lists(answer) | {"displacement": answer.displacement[order].tolist()}
    return as_json(folder, data, dof_map="map.txt")


def renamed(folder: Path, answer: Exact) -> Written:
    names = answer.problem.dof_names
    (folder / "map.csv").write_text("problem,candidate\n" + "".join(f"{name},N{name}\n" for name in names))
    data = by_name(answer)
    data["displacement"] = {f"N{name}": value for name, value in data["displacement"].items()}
    return as_json(folder, data, dof_map="map.csv")


def contacts_reordered(folder: Path, answer: Exact) -> Written:
    order = np.random.default_rng(7).permutation(answer.problem.contacts)
    np.savetxt(folder / "map.txt", np.argsort(order), fmt="%d")
    data = lists(answer)
    for name in ("normal_force", "friction_force"):
        if name in data:
            data[name] = getattr(answer, name)[order].tolist()
    return as_json(folder, data, contact_map="map.txt")


def by_node(folder: Path, answer: Exact) -> Written:
    """Nodes with three axes each; those that are held are there too."""
    value = dict(zip(answer.problem.dof_names, answer.displacement.tolist(), strict=True))
    nodes = sorted({name.partition(".")[0] for name in value})
    rows = [",".join([node, *(repr(value.get(f"{node}.{axis}", 0.0)) for axis in "xyz")]) for node in [*nodes, "99"]]
    return as_csv(folder, "node,ux,uy,uz\n" + "\n".join(rows) + "\n")


def big_endian(folder: Path, answer: Exact) -> Written:
    np.save(folder / "u.npy", answer.displacement.astype(">f8"))
    return Written("u.npy")


def forces_alone(folder: Path, answer: Exact) -> Written:
    data = lists(answer)
    data.pop("displacement")
    return as_json(folder, data)


def displacement_txt(folder: Path, answer: Exact) -> Written:
    np.savetxt(folder / "displacement.txt", answer.displacement, header="displacement")
    return Written("displacement.txt")


def turned(answer: Exact) -> Exact:
    return replace(answer, normal_force=-answer.normal_force)


CANDIDATES: dict[str, Callable[[Path, Exact], Written]] = {
    "json by name": lambda folder, a: as_json(folder, by_name(a)),
    "json lists": lambda folder, a: as_json(folder, lists(a)),
    "json as run prints it": lambda folder, a: as_json(folder, [by_name(a) | {"energy": -1.0, "gap": {}, "x": None}]),
    "json negative in compression": lambda folder, a: as_json(folder, lists(turned(a)), compression="negative"),
    "csv": lambda folder, a: as_csv(folder, csv(a)),
    "csv semicolons": lambda folder, a: as_csv(folder, "# from a spreadsheet\n\n" + csv(a, ";")),
    "csv tabs": lambda folder, a: as_csv(folder, csv(a, "\t")),
    "csv positions": lambda folder, a: as_csv(folder, csv(a, positions=True)),
    "csv by node": by_node,
    "npz": lambda folder, a: as_npz(folder, np.savez, parts(a)),
    "npz compressed": lambda folder, a: as_npz(
        folder, np.savez_compressed, {{"displacement": "u"}.get(name, name): v for name, v in parts(a).items()}
    ),
    "npz single precision": lambda folder, a: as_npz(
        folder, np.savez, {name: values.astype(np.float32) for name, values in parts(a).items()}
    ),
    "folder npy": lambda folder, a: as_folder(folder, a, ".npy", np.save),
    "folder mtx": lambda folder, a: as_folder(folder, a, ".mtx", write_mtx),
    "folder sparse mtx": lambda folder, a: as_folder(folder, a, ".mtx", write_sparse_mtx),
    "folder txt": lambda folder, a: as_folder(folder, a, ".txt", np.savetxt),
    "folder csv": lambda folder, a: as_folder(folder, a, ".csv", lambda f, v: np.savetxt(f, v, delimiter=",")),
    "pressures by name": pressures,
    "pressures by areas": plain_areas,
    "dof map": reordered,
    "names in order": in_order_of_names,
    "renamed": renamed,
    "contact map": contacts_reordered,
    "npy big-endian": big_endian,
    "forces alone": forces_alone,
    "displacement alone": displacement_txt,
}


def canonical(folder: Path, problem: cq.ContactProblem) -> str:
    write_problem(folder / "p", problem)
    return "p"


def named(folder: Path, problem: cq.ContactProblem) -> Path:
    path = write_problem(folder / "p", problem)
    (path / "problem.json").unlink()
    (path / "dof_names.txt").write_text("\n".join(problem.dof_names))
    (path / "contact_names.txt").write_text("\n".join(problem.contact_names))
    return path


def dense_text(folder: Path, problem: cq.ContactProblem) -> str:
    path = named(folder, problem)
    for name in ("stiffness", "normal"):
        (path / f"{name}.mtx").unlink()
        matrix = getattr(problem, name).toarray()
        np.savetxt(path / f"{dict(stiffness='K', normal='E_N')[name]}.csv", matrix, delimiter=",")
    return "p"


def harwell_boeing(folder: Path, problem: cq.ContactProblem) -> str:
    """By SciPy's writer, with the load as text beside it."""
    path = named(folder, problem)
    for name in ("stiffness.mtx", "load.mtx"):
        (path / name).unlink()
    scipy.io.hb_write(path / "K.rua", sp.csc_matrix(problem.stiffness))
    np.savetxt(path / "f.txt", problem.load)
    return "p"


def scipy_sparse(folder: Path, problem: cq.ContactProblem) -> str:
    path = named(folder, problem)
    (path / "stiffness.mtx").unlink()
    (path / "gap.mtx").unlink()
    sp.save_npz(path / "K.npz", sp.csr_matrix(problem.stiffness))
    np.save(path / "gap.npy", problem.gap)
    return "p"


def archive(folder: Path, problem: cq.ContactProblem) -> str:
    names = ("load", "gap", "friction", "slip_origin", "tie_value")
    arrays = {name: getattr(problem, name) for name in names if getattr(problem, name) is not None}
    rows = {"K": problem.stiffness, "E_N": problem.normal, "E_T": problem.tangent, "A": problem.tie}
    arrays |= {name: matrix.toarray() for name, matrix in rows.items() if matrix is not None and matrix.shape[0]}
    arrays |= {"dof_names": np.array(problem.dof_names), "contact_names": np.array(problem.contact_names)}
    np.savez(folder / "p.npz", **arrays)
    return "p.npz"


def by_tables(folder: Path, problem: cq.ContactProblem) -> str:
    path = named(folder, problem)
    for name in ("normal.mtx", "gap.mtx", "contact_names.txt", "tangent.mtx", "friction.mtx", "slip_origin.mtx"):
        (path / name).unlink(missing_ok=True)
    width = 0 if problem.slip_origin is None else problem.slip_origin.shape[1]
    tangents, origins = ["tangent", "tangent_2"][:width], ["slip_origin", "slip_origin_2"][:width]
    lines = [",".join(["contact", "dof", "coefficient", "gap", *tangents, *origins, *(["friction"] if width else [])])]
    normal = problem.normal.toarray()
    tangent = np.zeros((0, problem.dimension)) if problem.tangent is None else problem.tangent.toarray()
    for i, name in enumerate(problem.contact_names):
        rows = np.vstack([normal[i : i + 1], tangent[width * i : width * (i + 1)]])
        whole = [repr(float(problem.gap[i]))]
        for j in np.flatnonzero(np.any(rows != 0, axis=0)):
            cells = [repr(float(v)) for v in rows[:, j]]
            tail = [*map(repr, map(float, problem.slip_origin[i])), repr(float(problem.friction[i]))] if width else []
            lines.append(",".join([name, problem.dof_names[j], cells[0], *whole, *cells[1:], *tail]))
    (path / "contacts.csv").write_text("\n".join(lines) + "\n")
    return "p"


FORMS = (canonical, dense_text, harwell_boeing, scipy_sparse, archive, by_tables)


def verdict(folder: Path, answer: Exact, form: Callable[[Path, cq.ContactProblem], str], candidate: str):
    question = form(folder, answer.problem)
    written = CANDIDATES[candidate](folder, answer)
    files = {key: value if key == "compression" else str(folder / value) for key, value in written.options.items()}
    return check_answer(str(folder / question), str(folder / written.file), CheckOptions(**files))


def test_there_are_more_than_two_hundred_of_them():
    assert len(CANDIDATES) * len(PROBLEMS) >= 240


@pytest.mark.sampled(45)
@pytest.mark.parametrize("candidate", CANDIDATES)
@pytest.mark.parametrize("seed", PROBLEMS)
def test_a_right_answer_is_right_and_a_spoiled_one_wrong(tmp_path, seed, candidate):
    answer = exact(seed)
    form = FORMS[(seed + list(CANDIDATES).index(candidate)) % len(FORMS)]
    for name in ("right", "wrong"):
        (tmp_path / name).mkdir()
    found = verdict(tmp_path / "right", answer, form, candidate)
    assert found.passed, (candidate, found.certificate.failures)
    assert not any(line for ledger in found.ledgers for kind, line in ledger if "Error" in line)
    spoiled = replace(answer, displacement=answer.displacement + np.eye(len(answer.displacement))[0] / 8)
    if candidate == "forces alone":
        spoiled = turned(answer)
    assert not verdict(tmp_path / "wrong", spoiled, form, candidate).passed


@pytest.mark.sampled(10)
@pytest.mark.parametrize("seed", PROBLEMS)
def test_a_sign_that_is_not_told_is_wrong(tmp_path, seed):
    """The same file, right with --compression negative, is wrong without it."""
    answer = exact(seed)
    write_problem(tmp_path / "p", answer.problem)
    as_json(tmp_path, lists(turned(answer)))
    told = CheckOptions(compression="negative")
    assert check_answer(str(tmp_path / "p"), str(tmp_path / "a.json"), told).passed
    found = check_answer(str(tmp_path / "p"), str(tmp_path / "a.json"), CheckOptions())
    assert not found.passed
    assert found.data()["diagnosis"]
