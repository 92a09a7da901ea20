"""Every public object goes through pickle and copy and is the same again; a test that misses a new class fails."""

from __future__ import annotations

import copy
import copyreg
import io
import multiprocessing
import pickle
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from tests.public_objects import bars, content, errors, example, objects, parts, rubbing, tied


class _Plain(pickle.Pickler):
    """Pickles by what a class says itself: other packages (tblib, by dask) register ways for every exception."""

    dispatch_table: ClassVar[dict[type, Any]] = {}


def through_pickle(value: Any, protocol: int) -> Any:
    stream = io.BytesIO()
    _Plain(stream, protocol).dump(value)
    return pickle.loads(stream.getvalue())


WAYS: dict[str, Callable[[Any], Any]] = {
    **{f"pickle {k}": lambda value, k=k: through_pickle(value, k) for k in range(2, pickle.HIGHEST_PROTOCOL + 1)},
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


@pytest.fixture(autouse=True)
def _without_the_ways_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    own = {kind: way for kind, way in copyreg.dispatch_table.items() if not issubclass(kind, BaseException)}
    monkeypatch.setattr(copy, "dispatch_table", own)


@pytest.mark.slow
def test_every_public_class_has_an_example() -> None:
    public = {kind for name in cq.__all__ if isinstance(kind := getattr(cq, name), type)}
    found = {kind for _, value in parts(objects()) for kind in type(value).__mro__}
    assert public - found == set(), "add one to tests.public_objects"


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_every_object_is_the_same_after_a_copy(way: str) -> None:
    made = objects()
    assert made
    for name, value in made.items():
        again = WAYS[way](value)
        assert content(again) == content(value), name


@pytest.mark.slow
def test_every_object_that_others_lead_to_can_be_sent_alone() -> None:
    """One of each class, so that what is only reached through another one is tested too."""
    kinds: dict[type, tuple[str, Any]] = {}
    for where, value in parts(objects()):
        if type(value).__module__.partition(".")[0] == "contactqp":
            kinds.setdefault(type(value), (where, value))
    assert len(kinds) > 50
    for where, value in kinds.values():
        assert content(through_pickle(value, pickle.HIGHEST_PROTOCOL)) == content(value), where


def test_what_is_compared_tells_objects_apart() -> None:
    one, other = bars(), bars().replace(load=[10.0, np.nextafter(1.0, 2.0)])
    assert content(one) == content(bars())
    assert content(one) != content(other)
    assert content(cq.NotCertified("a", one)) != content(cq.NotCertified("a", other))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", sorted(errors(), key=lambda kind: kind.__name__), ids=lambda kind: kind.__name__)
def test_exceptions_keep_their_message_and_what_they_carry(kind: type[BaseException], way: str) -> None:
    error = example(kind)
    error.add_note("seen from outside")
    again = WAYS[way](error)
    assert type(again) is kind
    assert str(again) == str(error)
    assert content(again.__dict__) == content(error.__dict__)


def test_a_missing_backend_keeps_the_name_that_an_import_error_has() -> None:
    error = cq.BackendMissing("pip install it")
    error.name = "it"
    again = through_pickle(error, 2)
    assert (again.name, again.msg) == ("it", "pip install it")


@pytest.mark.sampled(28)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", ["bars", "rubbing", "tied", "part", "summed", "tie left out", "floating"])
def test_the_verdict_on_a_copy_is_the_same_to_the_last_bit(name: str, way: str) -> None:
    floating = cq.ContactProblem(
        sp.csr_array([[1.5, -1.5], [-1.5, 1.5]]), [0.7, 0.0], [[0.0, 1.0]], [0.5], near_null_space=[[1.0], [1.0]]
    )
    own = {"bars": bars(), "rubbing": rubbing(), "tied": tied(), "floating": floating}
    problem = own.get(name) or objects()[name]
    solution = cq.solve(problem)
    forces = (solution.normal_force, solution.friction_force, solution.tie_force)
    for part in (1.0, 1 + 1e-5):  # right, and a forgery
        given = (part * solution.displacement, *forces)
        verdict, again = (cq.certify(one, *given) for one in (copy.copy(problem), WAYS[way](problem)))
        assert verdict.passed == (part == 1.0)
        assert content(again) == content(verdict)
        assert (str(again), again.diagnosis) == (str(verdict), verdict.diagnosis)


def test_a_copy_keeps_the_sizes_that_add_up_to_a_load_and_the_numbers_of_ties() -> None:
    summed = bars()._with_load_sum(np.array([0.0, 1.0]), np.array([20.0, 1.0]))
    two = cq.ContactProblem([[2.0]], [1.0], [[1.0]], [0.5], tie=[[1.0], [2.0]]).with_ties(np.array([1]))
    for way in WAYS.values():
        np.testing.assert_array_equal(way(summed).load_size, [20.0, 1.0])
        assert way(two).tie_name(0) == "tie 1"


KINDS = sorted(errors(), key=lambda kind: kind.__name__)


def _raises(number: int) -> None:
    for kind in KINDS:
        copyreg.dispatch_table.pop(kind, None)
    raise example(KINDS[number])


@pytest.mark.slow
@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="nothing forks here")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_pool_hands_on_every_public_exception() -> None:
    expected = [example(kind) for kind in KINDS]
    with multiprocessing.get_context("fork").Pool(1) as pool:
        waiting = [pool.map_async(_raises, [number]) for number in range(len(KINDS))]
        for kind, one, error in zip(KINDS, waiting, expected, strict=True):
            with pytest.raises(kind, match="what came") as caught:
                one.get(timeout=60)
            kept, should = vars(caught.value), vars(error)
            assert {name: type(value) for name, value in kept.items() if name != "__notes__"} == {
                name: type(value) for name, value in should.items()
            }


def _refused(number: int) -> float:
    copyreg.dispatch_table.pop(cq.NotCertified, None)
    if number == 1:
        raise cq.NotCertified(f"job {number} is refused", cq.solve(bars()))
    return float(cq.solve(bars()).normal_force[0])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_a_pool_hands_on_what_a_worker_raises(start: str) -> None:
    """It waited for ever: the thread that reads the results died of an exception that could not be made again."""
    if start not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {start} here")
    with multiprocessing.get_context(start).Pool(1) as pool:
        waiting = pool.map_async(_refused, range(2), chunksize=1)
        with pytest.raises(cq.NotCertified, match="job 1 is refused") as caught:
            waiting.get(timeout=60)
    assert caught.value.solution.normal_force[0] > 0
