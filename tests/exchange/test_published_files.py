"""Thirty published problems: read with the sizes and measures that an independent survey found in them."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from tests.exchange.published import SURVEY, needs_data, published

pytestmark = needs_data
# Of eigenvalues, beyond this size a matter of many seconds.
SMALL = 900
# Of what the survey calls asymmetric at all; below is rounding, which a symmetric M does not leave in W.
ROUNDING = 1e-11


@pytest.mark.sampled(15)
@pytest.mark.parametrize("name", SURVEY)
def test_a_published_file_says_what_the_survey_found(name):
    survey, file = SURVEY[name], published(name)
    stored = cq.read_problem(file, as_stored=True)
    problem = cq.read_problem(file)
    local = cq.local_form_of(problem)
    if survey.unknowns is None:
        assert isinstance(stored, cq.LocalProblem)
        assert stored.delassus.shape[0] == survey.dimension * survey.contacts
    else:
        assert isinstance(stored, cq.GlobalProblem)
        assert stored.matrix.shape[0] == survey.unknowns
        assert isinstance(problem, cq.ContactProblem if stored.symmetric else cq.LocalProblem)
    assert (local.dimension, local.contacts) == (survey.dimension, survey.contacts)
    assert set(local.friction) == {survey.friction}
    assert float(f"{np.linalg.norm(local.offset):.2e}") == survey.offset_size
    if survey.asymmetry > ROUNDING:
        assert float(f"{local.asymmetry:.0e}") == survey.asymmetry
    else:
        assert local.asymmetry < ROUNDING
    if len(local.offset) <= SMALL and survey.rank is not None:
        W = local.delassus.toarray()
        eigenvalues = np.linalg.eigvalsh((W + W.T) / 2)
        assert np.sum(eigenvalues > 1e-10 * eigenvalues[-1]) == survey.rank


def test_two_of_the_published_matrices_of_bodies_are_not_symmetric():
    unsymmetric = set()
    for name, survey in SURVEY.items():
        if survey.unknowns is not None and not cq.read_problem(published(name), as_stored=True).symmetric:
            unsymmetric.add(name)
    assert unsymmetric == {"CubeH8.hdf5", "LMGC_GlobalFrictionContactProblem00046.hdf5"}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", [name for name in SURVEY if name.endswith(".hdf5")])
def test_stored_solutions_are_zero_and_guesses_are_not_believed(name):
    """Why nothing that is stored beside a problem is taken for its solution."""
    import h5py

    file = published(name)
    with h5py.File(file) as data:
        holds = "solution" in data
    if not holds:
        assert cq.read_fclib_guesses(file) == ()
        return
    local = cq.local_form_of(cq.read_problem(file))
    solution = cq.read_fclib_solution(file)
    assert not np.any(solution.force)
    assert np.any(solution.velocity)
    assert not cq.certify_local(local, solution.force).passed
    (guess,) = cq.read_fclib_guesses(file)
    assert guess.force.shape == (local.contacts, 3)
    assert not cq.certify_local(local, guess.force).passed


@pytest.mark.sampled(15)
@pytest.mark.parametrize("name", SURVEY)
def test_a_published_problem_survives_writing(name, tmp_path):
    stored = cq.read_problem(published(name), as_stored=True)
    cq.write_fclib(tmp_path / "a.hdf5", stored)
    back = cq.read_fclib(tmp_path / "a.hdf5", as_stored=True)
    assert vars(stored)
    for a, b in ((getattr(p, field) for p in (stored, back)) for field in vars(stored)):
        if hasattr(a, "toarray"):
            assert a.shape == b.shape
            assert (a != b).nnz == 0
        else:
            assert np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b
