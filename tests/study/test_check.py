"""`contactqp check`: somebody else's answers, right and wrong, in every format they come in."""

from __future__ import annotations

import json

import numpy as np
import pytest

import contactqp as cq
from contactqp.linalg.delassus import velocity_of
from contactqp.study.checking import check_forces
from contactqp.study.verdict import CheckOptions
from tests.cli.test_cli import CASES, run
from tests.exchange.files import global_tree, local_tree, write_hdf5
from tests.exchange.published import needs_data, published

WALL = CASES / "bar_wall.toml"


@pytest.fixture
def problem(tmp_path):
    """Two contacts in space, unsymmetric, one of them open."""
    random = np.random.default_rng(5)
    A = random.standard_normal((6, 6))
    W = A @ A.T + np.eye(6) + 1e-6 * random.standard_normal((6, 6))
    local = cq.LocalProblem(delassus=W, offset=[-1.0, 2.0, 0.5, 4.0, -0.3, 0.2], friction=[0.4, 0.6], dimension=3)
    file = tmp_path / "problem.hdf5"
    cq.write_fclib(file, local)
    return file, local, cq.solve(local)


WRITERS = {
    "r.npy": lambda file, r: np.save(file, r),
    "flat.npy": lambda file, r: np.save(file, r.ravel()),
    "r.json": lambda file, r: file.write_text(json.dumps(r.tolist())),
    "keys.json": lambda file, r: file.write_text(json.dumps({"force": r.ravel().tolist()})),
    "r.csv": lambda file, r: file.write_text(
        "rN,rT1,rT2\n" + "".join(f"{a!r},{b!r},{c!r}\n" for a, b, c in r.tolist())
    ),
    "bare.csv": lambda file, r: file.write_text("".join(f"{a!r}; {b!r}; {c!r}\n" for a, b, c in r.tolist())),
    "named.csv": lambda file, r: file.write_text(
        "contact,rN,rT1,rT2\n" + "".join(f"contact {i},{r[i, 0]},{r[i, 1]},{r[i, 2]}\n" for i in (1, 0))
    ),
    "r.txt": lambda file, r: file.write_text("# forces\n" + " ".join(f"{v!r}" for v in r.ravel().tolist())),
    "r.hdf5": lambda file, r: write_hdf5(file, {"solution": {"r": r.ravel()}}),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", WRITERS)
def test_right_forces_pass_and_wrong_ones_do_not_in_every_format(capsys, tmp_path, problem, name):
    file, _, solution = problem
    candidate = tmp_path / name
    WRITERS[name](candidate, solution.force)
    code, out, err = run(capsys, "check", file, candidate)
    assert (code, err) == (0, "")
    assert "right (tolerance" in out
    WRITERS[name](candidate, solution.force * [1, -1, 1])
    code, out, _ = run(capsys, "check", file, candidate)
    assert code == 1
    assert "WRONG" in out
    assert "contact 0" in out


def test_the_worst_contact_is_named_with_right_values_beside(capsys, tmp_path, problem):
    file, local, solution = problem
    wrong = solution.force.copy()
    touching = int(np.argmax(wrong[:, 0]))
    wrong[touching, 1:] *= 2  # outside the cone
    np.save(tmp_path / "wrong.npy", wrong)
    code, out, _ = run(capsys, "check", file, tmp_path / "wrong.npy", "--json")
    data = json.loads(out)
    assert code == 1
    assert not data["right"]
    worst = data["worst"][0]
    assert worst["contact"] == f"contact {touching}"
    assert worst["figure"] in ("cone", "slip direction")
    assert worst["force"] == wrong[touching].tolist()
    assert worst["velocity"] == pytest.approx(velocity_of(local, wrong)[touching].tolist())
    assert worst["right_force"] == pytest.approx(solution.force[touching].tolist(), rel=1e-9)
    assert any("cone" in failure for failure in data["failures"])
    printed = run(capsys, "check", file, tmp_path / "wrong.npy")[1]
    assert "right force" in printed
    assert max(len(line) for line in printed.splitlines() if "/" not in line) <= 80
    for force in (wrong[touching], solution.force[touching]):
        assert f"({', '.join(f'{x:.6g}' for x in force)})" in printed
    assert "right values: one solution" in printed


def test_a_half_converged_answer_is_wrong_and_passes_a_tolerance_that_says_so(capsys, tmp_path, problem):
    file, _, solution = problem
    np.save(tmp_path / "half.npy", solution.force * (1 + 1e-6))
    assert run(capsys, "check", file, tmp_path / "half.npy")[0] == 1
    assert run(capsys, "check", file, tmp_path / "half.npy", "--tolerance", "1e-4")[0] == 0
    assert run(capsys, "check", file, tmp_path / "half.npy", "--tolerance", "-1")[0] == 2


def test_nan_is_wrong(capsys, tmp_path, problem):
    file, _, solution = problem
    forces = solution.force.copy()
    forces[1, 2] = np.nan
    np.save(tmp_path / "nan.npy", forces)
    code, out, _ = run(capsys, "check", file, tmp_path / "nan.npy", "--json")
    data = json.loads(out)
    assert code == 1
    assert [one["contact"] for one in data["worst"]] == ["contact 1"]
    assert data["worst"][0]["force"][2] is None


def test_stored_zeros_are_refused_and_their_velocities_belong_to_others(capsys, tmp_path):
    tree = local_tree() | {"solution": {"u": np.ones(4), "r": np.zeros(4)}}
    file = write_hdf5(tmp_path / "a.hdf5", tree)
    code, out, _ = run(capsys, "check", file, file)
    assert code == 1
    assert "all forces in the file are zero" in out
    assert "the velocities in the file are not those of its forces" in out


def test_our_own_solution_passes_from_the_file_it_was_written_to(capsys, tmp_path):
    for name, tree in dict(local=local_tree(joints=True), bodies=global_tree(joints=True)).items():
        read = cq.read_fclib(write_hdf5(tmp_path / f"{name}.hdf5", tree), as_stored=True)
        answer = tmp_path / f"{name}-solved.hdf5"
        cq.write_fclib(answer, read, cq.solve(cq.local_form_of(read)))
        code, out, _ = run(capsys, "check", tmp_path / f"{name}.hdf5", answer)
        assert code == 0
        assert "velocities in the file are not" not in out
        stored = cq.read_fclib_solution(answer)
        if isinstance(read, cq.GlobalProblem):
            forces = read.directions @ stored.force.ravel() + read.joints @ stored.joint_force
            assert read.matrix @ stored.motion == pytest.approx(forces + read.load, abs=1e-12)


BAD_CANDIDATES = {
    "few.txt": ("1 2 3", "few.txt: force: expected shape (2, 3) or (6,), got (3,)"),
    "word.txt": ("1 2 3 4 5 x", "word.txt: force: expected a number, got 'x'"),
    "row.csv": ("a,b,c\n1,2,3\n4,5\n", "row.csv: row 2: expected 3 cells, got 2"),
    "cell.csv": ("1,2,3\n4,x,5\n", "cell.csv: row 2: expected a number, got 'x'"),
    "twice.csv": (
        "contact,a,b,c\n0,1,2,3\n0,1,2,3\n",
        "contact: expected every contact once, got '0' twice",
    ),
    "other.csv": ("contact,a,b,c\n0,1,2,3\n7,1,2,3\n", "other.csv: contact: expected a row of 'contact 1', got none"),
    "more.csv": ("contact,a,b,c\n0,1,2,3\n1,1,2,3\n2,1,2,3\n", "more.csv: contact: expected the 2 contacts"),
    "key.json": ('{"forces": [1]}', "key.json: keys: expected 'force' and at most"),
    "cut.json": ('{"force": [1', "cut.json: content: expected JSON"),
    "words.json": ('["a", "b"]', "words.json: force: expected real numbers"),
    "ragged.json": ("[[1, 2, 3], [4]]", "ragged.json: force: expected real numbers"),
    "pickle.npy": ("\x93NUMPY", "pickle.npy: content: expected an array of numbers"),
    "none.hdf5": (None, "none.hdf5: solution: expected a stored solution, got none"),
    "short.hdf5": (
        {"solution": {"r": np.zeros(3)}},
        "solution/r: expected 6 numbers (3 for each of 2 contacts)",
    ),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", BAD_CANDIDATES)
def test_a_candidate_that_holds_no_forces_is_exit_2(capsys, tmp_path, problem, name):
    content, words = BAD_CANDIDATES[name]
    file = tmp_path / name
    if isinstance(content, str):
        file.write_text(content, encoding="latin-1")
    else:
        write_hdf5(file, content or {"else": np.zeros(1)})
    code, _, err = run(capsys, "check", problem[0], file)
    assert code == 2
    assert words in err
    assert err.count("\n") == 1


def test_missing_joint_forces_and_singular_bodies_are_exit_2(capsys, tmp_path):
    joints = write_hdf5(tmp_path / "joints.hdf5", local_tree(joints=True))
    (tmp_path / "r.txt").write_text("0 0 0 0")
    code, _, err = run(capsys, "check", joints, tmp_path / "r.txt")
    assert code == 2
    assert "r.txt: joint_force: expected shape (1,), got (0,)" in err
    rows = dict(normal=[[0.0, -1.0]], gap=[0.25], tangent=[[1.0, 0.0]], friction=0.5)
    cq.write_fclib(tmp_path / "loose.h5", cq.ContactProblem(stiffness=np.zeros((2, 2)), load=[0.0, -1.0], **rows))
    code, _, err = run(capsys, "check", tmp_path / "loose.h5", tmp_path / "r.txt")
    assert code == 2
    assert "M is singular" in err


def test_where_no_solution_is_found_the_verdict_says_so(capsys, tmp_path, problem, monkeypatch):
    def give_up(*_, **__):
        raise cq.NotConverged("no algorithm came to an answer")

    monkeypatch.setattr("contactqp.study.checking.solve", give_up)
    (tmp_path / "r.txt").write_text("1 0 0 1 0 0")
    verdict = check_forces(str(problem[0]), str(tmp_path / "r.txt"), CheckOptions())
    assert not verdict.passed
    assert verdict.right is None
    assert verdict.worst[0].right_force is None
    code, out, _ = run(capsys, "check", problem[0], tmp_path / "r.txt")
    assert code == 1
    assert "no right values to set beside: no algorithm came to an answer" in out
    assert "right force" not in out


def case_answer(capsys, tmp_path, case, change=lambda data: data):
    """What `contactqp run --json` prints of a case, changed."""
    (data,) = json.loads(run(capsys, "run", case, "--method", "active-set", "--json")[1])
    file = tmp_path / "answer.json"
    file.write_text(json.dumps(change(data)))
    return file


def test_what_run_prints_of_a_case_is_right(capsys, tmp_path):
    code, out, _ = run(capsys, "check", WALL, case_answer(capsys, tmp_path, WALL))
    assert code == 0
    assert "right (tolerance" in out
    ignored = [line for line in out.splitlines() if "ignored" in line]
    assert ignored == ["  ignored: what contactqp run --json prints beside displacements and forces"]


def test_a_flipped_sign_in_a_case_is_wrong_with_the_right_force_beside(capsys, tmp_path):
    answer = case_answer(capsys, tmp_path, WALL, lambda data: data | {"normal_force": {"tip": -142.5}})
    code, out, _ = run(capsys, "check", WALL, answer, "--json")
    data = json.loads(out)
    assert code == 1
    (worst,) = data["worst"]
    assert (worst["contact"], worst["normal_force"], worst["right_normal_force"]) == ("tip", -142.5, 142.5)
    assert (worst["gap"], worst["right_gap"]) == (0.0, 0.0)
    assert data["diagnosis"]
    assert any("tension" in failure for failure in data["failures"])
    printed = run(capsys, "check", WALL, answer)[1]
    assert "force [kN]" in printed
    assert data["diagnosis"] in printed


def test_lists_serve_as_well_as_names(capsys, tmp_path):
    def in_order(data):
        return [{key: list(data[key].values()) for key in ("displacement", "normal_force")}]

    assert run(capsys, "check", WALL, case_answer(capsys, tmp_path, WALL, in_order))[0] == 0


BAD_ANSWERS = {
    "content: expected a JSON file with displacement and normal_force": {"gap": [0.0]},
    "displacement: expected shape (1,), got (2,)": {"displacement": [0, 0], "normal_force": [0]},
    "normal_force: expected 1 values by name, got no tip and tap, which the problem does not have": {
        "displacement": [0],
        "normal_force": {"tap": 0},
    },
    "normal_force: expected numbers": {"displacement": [0], "normal_force": ["x"]},
    'content: expected one answer, such as {"displacement": [...]}, got 2 in a list': [{}, {}],
    "content: expected a JSON file": 3,
}


@pytest.mark.parametrize("words", BAD_ANSWERS)
def test_an_answer_to_a_case_that_is_none_is_exit_2(capsys, tmp_path, words):
    file = tmp_path / "bad.json"
    file.write_text(json.dumps(BAD_ANSWERS[words]))
    code, _, err = run(capsys, "check", WALL, file)
    assert code == 2
    assert f"bad.json: {words}" in err


@needs_data
def test_a_published_problem_judges_its_own_guess_and_our_answer(capsys, tmp_path):
    file = published("local_problem_test.hdf5")
    (guess,) = cq.read_fclib_guesses(file)
    np.save(tmp_path / "guess.npy", guess.force)
    assert run(capsys, "check", file, tmp_path / "guess.npy")[0] == 1
    np.save(tmp_path / "ours.npy", cq.solve(cq.read_fclib(file)).force)
    assert run(capsys, "check", file, tmp_path / "ours.npy")[0] == 0


def test_columns_of_forces_in_another_order_are_refused_and_their_names_told(capsys, tmp_path, problem):
    file, _, solution = problem
    rows = "".join(f"{a!r},{b!r},{c!r}\n" for a, b, c in solution.force.tolist())
    candidate = tmp_path / "r.csv"
    for names in ("rN,rT1,rT2", "N [kN],T1,T2", "fz,fx,fy"):
        candidate.write_text(f"{names}\n{rows}")
        code, out, _ = run(capsys, "check", file, candidate)
        assert code == 0
        assert "ignored: names of columns" in out
    for names in ("rT1,rT2,rN", "T1,normal_force,T2", "t1,t2,N [kN]"):
        candidate.write_text(f"{names}\n{rows}")
        code, _, err = run(capsys, "check", file, candidate)
        assert code == 2
        assert "expected columns in the order N, T1, T2" in err


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (lambda r: r * [-1, 1, 1], "all normal forces have the opposite sign: with --compression negative this answer"),
        (lambda r: -r, "all forces have the opposite sign"),
        (lambda r: r * [1, -1, -1], "all tangential forces have the opposite sign"),
        (lambda r: r[:, [1, 2, 0]], "the columns stand in the order (T1, T2, N)"),
        (lambda r: r[:, [0, 2, 1]], "the two tangential directions are swapped"),
        (lambda r: r * [1, 1, -1], "the second tangential direction has the opposite sign"),
        (lambda r: r[::-1], "the contacts stand in reverse order"),
        (lambda r: r.T.ravel(), "all normal forces stand before the tangential ones"),
        (lambda r: r / 1000, "all forces are 0.001 times the right ones (kN instead of N?)"),
        (lambda r: r / 2, "all forces are 0.5 times the right ones (half of a symmetric model?)"),
        (lambda r: np.array([[float(f"{x:.6e}") for x in row] for row in r]), "with --tolerance 1e-0"),
    ],
)
def test_the_cause_of_wrong_forces_is_said(tmp_path, capsys, mistake, words):
    """Three points dragged apart on their own, W = 1: each pushes back with r_N, and slides with mu r_N, mu = 1/2."""
    slip = np.array([[3.0, 4.0], [5.0, 12.0], [-8.0, 15.0]]) / 3
    pressed = np.array([1.0, 2.0, 4.0]) / 3
    offset = np.column_stack([-pressed, slip])
    problem = cq.LocalProblem(delassus=np.eye(9), offset=offset.ravel(), friction=0.5, dimension=3)
    cq.write_fclib(tmp_path / "points.hdf5", problem)
    right = np.column_stack([pressed, -slip / np.linalg.norm(slip, axis=1)[:, None] * pressed[:, None] / 2])
    np.save(tmp_path / "right.npy", right)
    np.save(tmp_path / "wrong.npy", mistake(right))
    files = str(tmp_path / "points.hdf5"), str(tmp_path / "wrong.npy")
    assert run(capsys, "check", files[0], str(tmp_path / "right.npy"))[0] == 0
    code, out, _ = run(capsys, "check", *files)
    assert code == 1
    assert words in " ".join(out.split())
