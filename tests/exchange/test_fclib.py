"""FCLIB files in every storage, with what published files do differently from fclib.h, and back."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

import contactqp as cq
from tests.exchange.files import (
    MU,
    OFFSET,
    B,
    F,
    G,
    H,
    M,
    Q,
    R,
    S,
    V,
    W,
    global_tree,
    local_tree,
    put,
    stored,
    write_hdf5,
)

STORAGES = ("csc", "csr", "triplet")


@pytest.mark.sampled(2)
@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("spare", [0, 3])
def test_a_local_file_is_a_local_problem(tmp_path, storage, spare):
    problem = cq.read_fclib(write_hdf5(tmp_path / "a.hdf5", local_tree(storage, joints=True, spare=spare)))
    assert isinstance(problem, cq.LocalProblem)
    assert problem.dimension == 2
    assert np.array_equal(problem.delassus.toarray(), W)
    assert np.array_equal(problem.offset, Q)
    assert np.array_equal(problem.friction, MU)
    assert np.array_equal(problem.bilateral.toarray(), V)
    assert np.array_equal(problem.bilateral_delassus.toarray(), R)
    assert np.array_equal(problem.bilateral_offset, S)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("spare", [0, 3])
def test_a_global_file_is_a_contact_problem_in_our_signs(tmp_path, storage, spare):
    problem = cq.read_fclib(write_hdf5(tmp_path / "a.h5", global_tree(storage, joints=True, spare=spare)))
    assert isinstance(problem, cq.ContactProblem)
    assert np.array_equal(problem.stiffness.toarray(), M)
    assert np.array_equal(problem.load, F)
    assert np.array_equal(problem.normal.toarray(), -H[:, :1].T)
    assert np.array_equal(problem.tangent.toarray(), H[:, 1:].T)
    assert np.array_equal(problem.gap, OFFSET[:1])
    assert np.array_equal(problem.slip_origin, -OFFSET[None, 1:])
    assert np.array_equal(problem.tie.toarray(), G.T)
    assert np.array_equal(problem.tie_value, -B)
    assert np.array_equal(problem.friction, MU[:1])


def test_triplets_hold_the_column_in_p_and_the_row_in_i(tmp_path):
    entries = dict(stored(np.zeros((4, 4)), "triplet"), p=np.array([3]), i=np.array([1]), x=np.array([9.0]))
    entries |= dict(nz=np.array([1]), nzmax=np.array([1]))
    tree = put(local_tree("triplet"), "fclib_local/V", dict(entries, n=np.array([4])))
    tree = put(tree, "fclib_local/R", stored(np.eye(4), "triplet"))
    problem = cq.read_fclib(write_hdf5(tmp_path / "a.hdf5", put(tree, "fclib_local/vectors/s", np.zeros(4))))
    assert problem.bilateral[1, 3] == 9.0
    assert problem.bilateral.nnz == 1


def test_entries_that_are_stored_twice_are_summed(tmp_path):
    once = stored(W, "triplet")
    halves = {name: np.concatenate([once[name], once[name]]) for name in ("p", "i")}
    twice = once | halves | dict(x=np.concatenate([once["x"] / 2] * 2), nz=2 * once["nz"], nzmax=2 * once["nz"])
    problem = cq.read_fclib(write_hdf5(tmp_path / "a.hdf5", put(local_tree(), "fclib_local/W", twice)))
    assert np.array_equal(problem.delassus.toarray(), W)


def test_an_unsymmetric_M_becomes_a_local_problem_that_says_so(tmp_path):
    unsymmetric = M + np.array([[0, 0.5, 0], [0, 0, 0], [0, 0, 0]])
    tree = put(global_tree(), "fclib_global/M", stored(unsymmetric, "triplet"))
    file = write_hdf5(tmp_path / "a.hdf5", tree)
    problem = cq.read_fclib(file)
    assert isinstance(problem, cq.LocalProblem)
    expected = H.T @ np.linalg.solve(unsymmetric, H)
    assert problem.delassus.toarray() == pytest.approx(expected, rel=1e-14)
    assert problem.asymmetry == pytest.approx(np.max(abs(expected - expected.T)) / np.max(abs(expected)), rel=1e-12)
    assert problem.asymmetry > 0.01
    assert problem.offset == pytest.approx(H.T @ np.linalg.solve(unsymmetric, F) + OFFSET, rel=1e-14)
    stored_problem = cq.read_fclib(file, as_stored=True)
    assert isinstance(stored_problem, cq.GlobalProblem)
    assert stored_problem.asymmetry == pytest.approx(0.5 / np.sqrt(12))


def test_stored_solutions_and_guesses_are_offered_and_not_believed(tmp_path):
    zero, guess = np.zeros(4), np.array([1.0, 0.3, 2.0, np.nan])
    tree = local_tree() | {
        "solution": {"u": Q, "r": zero},
        "guesses": {"number_of_guesses": np.array([2]), "1": {"u": Q, "r": guess}, "2": {"u": Q, "r": zero}},
    }
    file = write_hdf5(tmp_path / "a.hdf5", tree)
    first, second = cq.read_fclib_guesses(file)
    assert np.array_equal(first.force, guess.reshape(2, 2), equal_nan=True)
    assert np.array_equal(second.velocity, Q.reshape(2, 2))
    solution = cq.read_fclib_solution(file)
    assert not cq.certify_local(cq.read_fclib(file), solution.force).passed
    assert not cq.certify_local(cq.read_fclib(file), first.force).passed
    bare = write_hdf5(tmp_path / "bare.hdf5", local_tree())
    assert cq.read_fclib_guesses(bare) == ()
    with pytest.raises(cq.InvalidProblem, match=r"bare\.hdf5: solution: expected a stored solution, got none"):
        cq.read_fclib_solution(bare)


def same(a, b):
    """Bit for bit."""
    a, b = (x.toarray() if hasattr(x, "toarray") else np.asarray(x) for x in (a, b))
    return a.shape == b.shape and np.array_equal(a, b)


def random_local(joints):
    random = np.random.default_rng(7)
    A = random.standard_normal((9, 9)) * (random.random((9, 9)) < 0.5)
    bilateral = dict(
        bilateral=random.standard_normal((9, 2)), bilateral_delassus=np.eye(2) / 3, bilateral_offset=[0.1, 0.2]
    )
    W = A @ A.T + np.triu(random.standard_normal((9, 9))) * 1e-7
    data = dict(delassus=W, offset=random.standard_normal(9), friction=random.random(3), dimension=3)
    return cq.LocalProblem(**data, **(bilateral if joints else {}))


LOCAL = (
    "delassus",
    "offset",
    "friction",
    "dimension",
    "bilateral",
    "bilateral_delassus",
    "bilateral_offset",
    "asymmetry",
)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("storage", [None, *STORAGES])
@pytest.mark.parametrize("joints", [False, True])
def test_a_local_problem_comes_back_bit_for_bit(tmp_path, storage, joints):
    problem = random_local(joints)
    cq.write_fclib(tmp_path / "a.hdf5", problem, storage=storage)
    back = cq.read_fclib(tmp_path / "a.hdf5")
    assert [name for name in LOCAL if not same(getattr(problem, name), getattr(back, name))] == []


@pytest.mark.sampled(3)
@pytest.mark.parametrize("storage", [None, *STORAGES])
@pytest.mark.parametrize("joints", [False, True])
def test_a_global_problem_comes_back_bit_for_bit(tmp_path, storage, joints):
    tied = dict(joints=G, joint_offset=B) if joints else {}
    problem = cq.GlobalProblem(M + np.triu(M) / 3, H, F, OFFSET, MU[:1], 3, **tied)
    cq.write_fclib(tmp_path / "a.hdf5", problem, storage=storage)
    back = cq.read_fclib(tmp_path / "a.hdf5", as_stored=True)
    names = ("matrix", "directions", "load", "offset", "friction", "dimension", "joints", "joint_offset", "asymmetry")
    assert [name for name in names if not same(getattr(problem, name), getattr(back, name))] == []


def contact_problem(dimension, dense):
    import scipy.sparse as sp

    random = np.random.default_rng(dimension)
    n, m = 7, 2
    A = random.standard_normal((n, n))
    K = A @ A.T
    K = (K + K.T) / 2
    return cq.ContactProblem(
        stiffness=K if dense else sp.csr_array(K),
        load=random.standard_normal(n),
        normal=random.standard_normal((m, n)),
        gap=[0.1, -0.2],
        tangent=random.standard_normal((m * (dimension - 1), n)),
        friction=[0.3, 0.7],
        slip_origin=random.standard_normal(m * (dimension - 1)),
        tie=random.standard_normal((1, n)),
        tie_value=[0.25],
    )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("dense", [False, True])
def test_a_contact_problem_comes_back_bit_for_bit(tmp_path, dimension, dense):
    problem = contact_problem(dimension, dense)
    cq.write_fclib(tmp_path / "a.hdf5", problem)
    back = cq.read_fclib(tmp_path / "a.hdf5")
    names = ("stiffness", "load", "normal", "gap", "tangent", "friction", "slip_origin", "tie", "tie_value")
    assert [name for name in names if not same(getattr(problem, name), getattr(back, name))] == []


def test_the_file_is_laid_out_as_fclib_reads_it(tmp_path):
    cq.write_fclib(tmp_path / "a.hdf5", random_local(True), title="Three contacts", description="Zähler")
    with h5py.File(tmp_path / "a.hdf5") as file:
        top = file["fclib_local"]
        assert set(file) == {"fclib_local"}
        assert set(top) == {"W", "V", "R", "spacedim", "vectors", "info"}
        assert set(top["vectors"]) == {"q", "mu", "s"}
        for name in ("nzmax", "m", "n", "nz"):
            assert top[f"W/{name}"].shape == (1,)
            assert top[f"W/{name}"].dtype == np.int32
        assert top["W/nz"][0] == -2
        assert len(top["W/p"]) == top["W/m"][0] + 1
        assert top["W/p"].dtype == top["W/i"].dtype == np.int32
        assert len(top["W/i"]) == len(top["W/x"]) == top["W/nzmax"][0]
        assert top["W/x"].dtype == np.float64
        title = top["info/title"]
        assert title.shape == ()
        assert title.dtype == "S15"
        assert title.id.get_type().get_strpad() == h5py.h5t.STR_NULLTERM
        assert title[()] == b"Three contacts"
        assert top["info/description"][()].decode() == "Zähler"
        assert top["info/math_info"][()] == b""


def test_triplets_are_written_with_the_column_in_p(tmp_path):
    cq.write_fclib(tmp_path / "a.hdf5", random_local(True), storage="triplet")
    with h5py.File(tmp_path / "a.hdf5") as file:
        V = file["fclib_local/V"]
        assert V["p"][:].max() == 1
        assert V["i"][:].max() == 8


def test_a_solution_of_bodies_is_stored_as_fclib_names_it(tmp_path):
    problem = cq.ContactProblem(
        stiffness=np.diag([2.0, 4.0, 8.0]),
        load=[1.0, -3.0, 0.5],
        normal=[[0.0, -1.0, 0.0]],
        gap=[0.125],
        tangent=[[1.0, 0.0, 0.0]],
        friction=0.2,
        slip_origin=[0.0625],
        tie=[[0.0, 0.0, 1.0]],
        tie_value=[0.25],
    )
    solution = cq.solve(problem)
    cq.write_fclib(tmp_path / "a.hdf5", problem, solution)
    answer = cq.read_fclib_solution(tmp_path / "a.hdf5")
    bodies = cq.read_fclib(tmp_path / "a.hdf5", as_stored=True)
    r, joint, v = answer.force.ravel(), answer.joint_force, answer.motion
    assert r[0] == pytest.approx(2.5)  # pushes the body up
    assert bodies.matrix @ v == pytest.approx(bodies.directions @ r + bodies.load + bodies.joints @ joint, abs=1e-12)
    assert answer.velocity.ravel() == pytest.approx(bodies.directions.T @ v + bodies.offset, abs=1e-12)
    assert bodies.joints.T @ v == pytest.approx(-bodies.joint_offset, abs=1e-12)
    assert cq.certify_local(cq.local_form_of(problem), answer.force, answer.joint_force).passed


def test_a_problem_without_friction_stores_zero_tangential_forces(tmp_path):
    rows = dict(normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]], friction=0.0)
    problem = cq.ContactProblem(stiffness=np.eye(2), load=[-1.0, 0.5], **rows)
    cq.write_fclib(tmp_path / "a.hdf5", problem, cq.solve(problem))
    assert cq.read_fclib_solution(tmp_path / "a.hdf5").force == pytest.approx(np.array([[1.0, 0.0]]))


def test_contacts_of_infinite_gaps_are_left_out_with_their_zero_forces(tmp_path):
    rows = dict(normal=[[0.0, -1.0], [-1.0, 0.0]], gap=[np.inf, 0.0], tangent=[[1.0, 0.0], [0.0, 1.0]])
    problem = cq.ContactProblem(stiffness=np.eye(2), load=[-1.0, 0.5], friction=[0.1, 0.25], **rows)
    file = tmp_path / "a.hdf5"
    cq.write_fclib(file, problem, cq.solve(problem))
    assert cq.read_fclib_solution(file).force == pytest.approx(np.array([[1.0, -0.25]]))
    read = cq.read_fclib(file)
    assert (read.gap.tolist(), read.friction.tolist()) == ([0.0], [0.25])
    np.testing.assert_array_equal(read.normal.toarray(), [[-1.0, 0.0]])
    np.testing.assert_array_equal(cq.local_form_of(problem).offset, cq.local_form_of(read).offset)


def test_what_cannot_be_written_leaves_the_old_file(tmp_path, monkeypatch):
    problem = random_local(False)
    file = tmp_path / "a.hdf5"
    cq.write_fclib(file, problem, title="old")
    before = file.read_bytes()
    frictionless = cq.ContactProblem(stiffness=[[1.0]], load=[1.0], normal=[[1.0]], gap=[0.0])
    for expected, arguments in {
        "tangent: expected tangential rows": (frictionless,),
        "solution: expected one of this problem": (problem, cq.solve(frictionless)),
    }.items():
        with pytest.raises(cq.InvalidProblem, match=expected):
            cq.write_fclib(file, *arguments)
    with pytest.raises(cq.InvalidProblem, match="storage: expected one of 'csc', 'csr', 'triplet', got 'coo'"):
        cq.write_fclib(file, problem, storage="coo")
    with monkeypatch.context() as patch:
        patch.setattr("contactqp.exchange.fclib._put_vectors", _full_disk)
        with pytest.raises(cq.InvalidProblem, match="No space left"):
            cq.write_fclib(file, problem)
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.hdf5"]
    with pytest.raises(cq.InvalidProblem, match=r"ends in \.hdf5 or \.h5"):
        cq.write_fclib(tmp_path / "a.dat", problem)


def _full_disk(*_):
    raise OSError(28, "No space left on device")


def test_without_h5py_the_pip_command_is_given(tmp_path, monkeypatch):
    file = write_hdf5(tmp_path / "a.hdf5", local_tree())
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    for act in (lambda: cq.read_fclib(file), lambda: cq.write_fclib(tmp_path / "b.h5", random_local(False))):
        with pytest.raises(cq.BackendMissing, match=r"pip install h5py"):
            act()
