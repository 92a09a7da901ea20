"""Anything that Python has, given as any argument of any public function: only errors of this package leave.

Their messages are one line. Functions that a user gives raise errors of their own, which are the user's.
"""

from __future__ import annotations

import datetime
import io
import pathlib
import warnings
from collections.abc import Iterator
from decimal import Decimal
from fractions import Fraction
from functools import cache
from inspect import Parameter, signature
from typing import Any
from zlib import crc32

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.shapes import rectangle
from contactqp.model.arguments import checked
from tests import public_objects, wild_calls, wild_values
from tests.test_thrown import ask_everything

LONGEST_MESSAGE = 400
# One value in so many is thrown at every argument in every run of the tests, the others in the slow share.
THIN = 7
# What `testing` says of a wrong answer is an AssertionError.
ASSERTIONS = "contactqp.oracle.assertions"
# Work without end where a count is as large as this.
COUNTS = ("steps", "count", "max_iter", "unknowns", "duration")
TOO_MANY = ("10**400", "2**31", "unsigned", "1e20", "1e308", "2**63")


class Labelled:
    """Something like a series of pandas."""

    def __init__(self, values: list[float]) -> None:
        self.values, self.index = np.array(values), range(len(values))
        self.shape = self.values.shape

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.asarray(self.values, dtype)

    def __len__(self) -> int:
        return len(self.values)


class Hostile:
    """Says that it is an array, and is none; its words have two lines."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        raise RuntimeError("no array\nat all")

    def __repr__(self) -> str:
        return "hostile\nof two lines"


class Incomplete:
    """Says that it has entries, and has none."""

    def __len__(self) -> int:
        return 3

    def __getitem__(self, place: int) -> float:
        raise KeyError(place)


class Anything:
    """Made of whatever it is given."""

    def __init__(self, *given: Any) -> None:
        self.given = given


def circle() -> list[Any]:
    found: list[Any] = []
    found.append(found)
    return found


def numbers() -> Iterator[float]:
    yield from (1.0, 2.0)


@cache
def wild(folder: pathlib.Path) -> dict[str, Any]:
    made = public_objects.objects()
    problem, rubbing, local, _, global_form = made["problems"]
    arrays = {
        "without axes": np.array(5.0), "nothing without axes": np.array(None), "empty": np.zeros(0),
        "three": np.zeros(3), "three axes": np.zeros((2, 2, 2)), "no rows": np.zeros((0, 2)),
        "no columns": np.zeros((2, 0)),
        "masked": np.ma.masked_array([1.0, 2.0], [True, False]), "objects": np.array([object(), None]),
        "NaNs": np.full(2, np.nan), "infinite": np.full(2, np.inf), "a matrix of NaNs": np.full((2, 2), np.nan),
        "huge": np.full(2, 1e308), "a huge matrix": np.full((2, 2), 1e308), "a tiny matrix": np.full((2, 2), 1e-320),
        "fields": np.zeros(2, dtype=[("a", float)]), "an array of words": np.array(["a", "b"]),
        "whole numbers": np.array([0, 1]), "truth values": np.array([True, False]),
        "half floats": np.zeros(2, np.float16),
        "long": np.arange(5000.0), "large": np.ones((60, 60)), "one NaN": np.array([0.0, np.nan]),
        "sparse": sp.csr_array(np.ones((2, 3))), "a sparse matrix": sp.csr_matrix(np.eye(2)),
        "sparse NaNs": sp.csr_array(np.full((2, 2), np.nan)), "sparse and complex": sp.csr_array(1j * np.eye(2)),
        "sparse along one axis": sp.coo_array(np.ones(2)),
    }  # fmt: skip
    ours = {
        "a scene": made["scene"], "a problem": rubbing, "a local problem": local, "a global problem": global_form,
        "a solution": made["solutions"][0], "a local solution": made["solutions"][2], "a history": made["history"],
        "a motion": made["motion"], "a certificate": made["solutions"][0].certificate,
        "a plane": cq.Plane([0, 0], [0, 1]),
        "a plane in space": cq.Plane([0, 0, 0], [0, 0, 1]), "a mesh": rectangle(1.0, 1.0, (1, 1)),
        "a body": wild_calls.body(), "a material": cq.Material(1.0, 0.0), "a structure": public_objects.block(),
        "a surface": wild_calls.side(), "a truss": wild_calls.truss(), "a pairing": made["pairing"],
        "a spring": cq.Spring("s", 1.0, {"w": 1.0}), "planes": [cq.Plane([0, 0], [0, 1])], "problems": [problem],
        "bodies": [wild_calls.body()], "a support of nothing": [cq.Support("nobody", "top", 0)],
        "a support by a word": [cq.Support("block", "top", 0, "x")],
    }  # fmt: skip
    others = {
        "None": None, "no word": "", "a word": "word", "NaN in words": "nan", "5 in words": "5", "two lines": "a\nb",
        "a long word": "x" * 5000, "bytes": b"bytes", "a mapping": {"a": 1}, "an empty mapping": {},
        "None by None": {None: None},
        "a set": {1, 2}, "an object": object(), "a class": Anything, "a function of nothing": lambda *_: None,
        "a function of NaN": lambda *_: np.nan, "True": True, "1j": 1j, "NaN": np.nan, "inf": np.inf,
        "-inf": -np.inf,
        "1e308": 1e308, "-1e308": -1e308, "1e-320": 1e-320, "1e20": 1e20, "-1": -1, "0": 0, "2.5": 2.5, "7": 7,
        "10**400": 10**400, "a third": Fraction(1, 3), "a decimal NaN": Decimal("NaN"), "a loud NaN": Decimal("sNaN"),
        "a date": datetime.date(2020, 1, 1), "a duration": np.timedelta64(1, "s"), "[]": [], "[[]]": [[]],
        "[None]": [None],
        "['a']": ["a"], "ragged": [1, [2, 3]], "complex": [1j, 2j], "[5]": [5], "[-1]": [-1], "[0, 0]": [0, 0],
        "[True]": [True, False], "a tuple": (1, 2, 3), "deep": [[[1.0]]], "itself": circle(), "a range": range(3),
        "numbers once": None, "a folder": pathlib.Path("/"), "a folder by name": "/",
        "no file": pathlib.Path("/no/such/file"),
        "a zero byte": "a\0b", "a device": "/dev/null", "labelled": Labelled([1.0, 2.0]), "hostile": Hostile(),
        "incomplete": Incomplete(), "a stream": io.StringIO("1"), "...": ..., "not implemented": NotImplemented,
        "an exception": ValueError("x"), "a module": np,
    }  # fmt: skip
    return arrays | ours | others | wild_values.values(folder)


@pytest.fixture(scope="module")
def calls(tmp_path_factory: pytest.TempPathFactory) -> dict[str, wild_calls.Call]:
    return wild_calls.calls(tmp_path_factory.mktemp("wild"))


@pytest.fixture(scope="module")
def thrown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return wild(tmp_path_factory.mktemp("values"))


def test_every_public_name_is_called_or_takes_nothing_from_a_user(calls: dict[str, wild_calls.Call]) -> None:
    """A name that is new fails this test until it is called in `wild_calls`, or said there to be called by nobody."""
    public = set(wild_calls.names())
    assert public - calls.keys() - wild_calls.NOT_CALLED.keys() == set()
    assert (calls.keys() | wild_calls.NOT_CALLED.keys()) - public == set()
    assert calls.keys() & wild_calls.NOT_CALLED.keys() == set()


@pytest.mark.slow
def test_the_calls_work_as_they_stand(calls: dict[str, wild_calls.Call]) -> None:
    """An argument in a call that is refused anyhow is never looked at."""
    for call in calls.values():
        call.function(**call.arguments)


def test_the_message_of_an_error_is_one_line() -> None:
    assert str(cq.InvalidProblem("gap: expected 2,\n  got [[1.0],\r\n [2.0]]")) == "gap: expected 2, got [[1.0], [2.0]]"
    assert str(cq.BackendMissing("no\nqp")) == "no qp"
    assert str(cq.NotConverged("stopped\nafter 3")) == "stopped after 3"
    assert len(str(cq.SceneError(f"{'x' * 5000}: none"))) < 100


NAMES = sorted(set(wild_calls.names()) - wild_calls.NOT_CALLED.keys())


# One value in so many is thrown at every option in every run of the tests.
THIN_OPTIONS = 29


@pytest.mark.sampled(16)
@pytest.mark.parametrize("name", NAMES)
def test_only_errors_of_this_package_leave(
    name: str, calls: dict[str, wild_calls.Call], thrown: dict[str, Any], tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    throw_at(name, calls[name], named(calls[name]), thrown, THIN)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_only_errors_of_this_package_leave_whatever_is_thrown(
    name: str, calls: dict[str, wild_calls.Call], thrown: dict[str, Any], tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    throw_at(name, calls[name], named(calls[name]), thrown, 1)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("name", wild_calls.COLLECTING)
def test_only_errors_of_this_package_leave_whatever_an_option_is(
    name: str, thrown: dict[str, Any], tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    throw_at(name, *wild_calls.options()[name], thrown, THIN_OPTIONS)


@pytest.mark.slow
@pytest.mark.parametrize("name", wild_calls.COLLECTING)
def test_only_errors_of_this_package_leave_whatever_any_option_is(
    name: str, thrown: dict[str, Any], tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    throw_at(name, *wild_calls.options()[name], thrown, 1)


def test_every_function_that_collects_options_is_given_some(calls: dict[str, wild_calls.Call]) -> None:
    """What stands behind `**options` has no name in a signature, and `throw_at` does not see it there."""
    collecting = {
        name
        for name, call in calls.items()
        if any(one.kind is Parameter.VAR_KEYWORD for one in signature(call.function).parameters.values())
    }
    assert tuple(wild_calls.options()) == wild_calls.COLLECTING
    assert collecting - {name.partition(":")[0] for name in wild_calls.COLLECTING} == set()


def named(call: wild_calls.Call) -> list[str]:
    """Names of the arguments in the signature of a call."""
    kinds = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    return [one.name for one in signature(call.function).parameters.values() if one.kind not in kinds]


def throw_at(name: str, call: wild_calls.Call, arguments: list[str], thrown: dict[str, Any], thin: int) -> None:
    """Replace each of these arguments of a call by wild values, every `thin`-th of them."""
    defaults = {one.name: one.default for one in signature(call.function).parameters.values()}
    for argument in arguments:
        for label, value in thrown.items():
            if crc32(f"{name} {argument} {label}".encode()) % thin or value is defaults.get(argument, ...):
                continue
            if argument in COUNTS and label in TOO_MANY:
                continue
            given = numbers() if label == "numbers once" else value
            message = leaves(f"{name}({argument} = {label})", call, {argument: given})
            assert "\n" not in message, (name, argument, label)
            assert len(message) <= LONGEST_MESSAGE, (name, argument, label, message)


def leaves(where: str, call: wild_calls.Call, changed: dict[str, Any]) -> str:
    """Return the message of an error of this package; any other error and any warning fails."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", cq.StartWarning)
        warnings.simplefilter("ignore", cq.TimeStepWarning)
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)  # a title that no font has
        try:
            found = call.function(**(call.arguments | changed))
            if not isinstance(found, cq.Scene):  # pydantic's own properties warn
                ask_everything(found)
        except cq.NotCertified as error:  # whose message lists all that the certificate refuses
            return str(error)[:LONGEST_MESSAGE]
        except cq.ContactQPError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001  what this test is about
            said = isinstance(error, AssertionError) and call.function.__module__ == ASSERTIONS
            if not said:
                pytest.fail(f"{where}: {type(error).__name__}: {error}")
    return ""


def test_an_unknown_argument_is_told_with_the_function_and_the_nearest_one() -> None:
    with pytest.raises(cq.InvalidProblem, match=r"^Material: no argument is called 'young'; its arguments: modulus"):
        cq.Material(young=1.0, poisson=0.3)
    with pytest.raises(TypeError, match=r"^Material: no argument is called 'poison' \(do you mean 'poisson'\?\)$"):
        cq.Material(modulus=1.0, poisson=0.3, poison=0.3)
    with pytest.raises(cq.InvalidProblem, match=r"^ContactProblem: no argument is called 'norml' .*mean 'normal'\?\)$"):
        cq.ContactProblem(stiffness=[[2.0]], load=[3.0], norml=[[1.0]], gap=[1.0])
    with pytest.raises(cq.InvalidProblem, match=r"^ContactProblem: 'normal' and 'gap' missing; its arguments: stiffn"):
        cq.ContactProblem(stiffness=[[1.0]], load=[1.0])  # type: ignore[call-overload]
    with pytest.raises(TypeError, match=r"^ContactProblem: 'gap' missing; its arguments: stiffness, load, normal, gap"):
        cq.ContactProblem([[1.0]], [1.0], [[1.0]])  # type: ignore[call-overload]
    with pytest.raises(cq.InvalidProblem, match=r"^ContactProblem: no argument is called 'xyz'; its arguments: stiff"):
        cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0], xyz=3)
    with pytest.raises(cq.InvalidProblem, match=r"^LocalProblem: no argument is called 'delasus' .*mean 'delassus'"):
        cq.LocalProblem(delasus=[[1.0]])
    solution = cq.solve(cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0]))
    with pytest.raises(cq.InvalidProblem, match=r"^certify: no argument is called 'normal_forces' .*'normal_force'"):
        cq.certify(solution.problem, [1.0], normal_forces=[1.0])
    with pytest.raises(TypeError, match=r"^solve: missing a required argument: 'problem'; its arguments: problem"):
        cq.solve()
    with pytest.raises(cq.InvalidProblem, match=r"^draw: no argument is called 'pairings'; its arguments: .*contacts"):
        cq.draw(solution, "x.png", pairings=[])


def test_a_misspelled_name_of_the_package_is_answered_with_the_nearest() -> None:
    for name, words in (("solv", "; nearest: solve"), ("Structre", "; nearest: Structure"), ("xyzzy", "")):
        with pytest.raises(AttributeError, match=f"^module 'contactqp' has no attribute '{name}'{words}$"):
            getattr(cq, name)
    assert not hasattr(cq, "__wrapped__")


def test_the_misspelled_argument_is_told_and_not_that_one_is_missing() -> None:
    mesh, steel = cq.rectangle(1.0, 1.0, (1, 1), "quad4"), cq.Material(210e9, 0.3)
    with pytest.raises(cq.InvalidProblem, match=r"^Body: no argument is called 'modl' \(do you mean 'model'\?\)$"):
        cq.Body(mesh, steel, modl="plane-strain")
    with pytest.raises(TypeError, match=r"^Body: missing a required argument: 'model'; its arguments: mesh, material"):
        cq.Body(mesh, steel)


def test_symbols_lead_to_the_names_of_arguments() -> None:
    with pytest.raises(cq.InvalidProblem, match=r"'g' \(do you mean 'stiffness' and 'load' and 'normal' and 'gap'"):
        cq.ContactProblem(K=[[2.0]], f=[3.0], E_N=[[1.0]], g=[1.0])
    with pytest.raises(cq.InvalidProblem, match=r"'E' or 'nu' \(do you mean 'modulus' and 'poisson'"):
        cq.Material(E=1.0, nu=0.3)


def test_what_is_not_yet_a_problem_is_told_how_it_becomes_one() -> None:
    structure = cq.Structure([cq.Body(cq.rectangle(1.0, 1.0, (1, 1), "quad4"), cq.Material(1.0, 0.3), "plane-strain")])
    with pytest.raises(cq.InvalidProblem, match=r"got Structure; structure.assemble\("):
        cq.solve(structure)
    with pytest.raises(cq.InvalidProblem, match=r"got System; system.problem\(contacts\)"):
        cq.solve(structure.assemble([cq.Support("body", "top", 0)]))


def test_warnings_stand_at_the_line_that_called() -> None:
    body = cq.Body(cq.rectangle(1.0, 1.0, (2, 2), "quad4"), cq.Material(1.0, 0.3), "plane-strain")
    bottom = cq.Structure([body]).surface("body", "bottom")
    with pytest.warns(cq.StartWarning) as caught:
        cq.pair(bottom, cq.Plane([0.0, 0.0], [0.0, -1.0]))
    assert [one.filename for one in caught] == [__file__]


def test_an_array_stays_one_where_a_number_would_do_as_well() -> None:
    @checked
    def given(value: float | np.ndarray) -> Any:
        return value

    assert given(np.array([1.0, 2.0])).tolist() == [1.0, 2.0]
    assert isinstance(given(np.array(1.0)), float)


@pytest.mark.parametrize("name", wild_values.outside_their_arrays())
def test_a_matrix_whose_entries_lie_outside_its_arrays_is_refused(name: str) -> None:
    with pytest.raises(cq.InvalidProblem, match="stiffness"):
        cq.ContactProblem(wild_values.outside_their_arrays()[name], [1.0, 1.0], [[1.0, 0.0]], [0.0])
