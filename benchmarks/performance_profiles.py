"""Performance profiles (Dolan and More 2002): the part of the problems solved within a factor of the fastest time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from contactqp.pictures.whole_file import check_installed, write_whole


def ratios(seconds: Mapping[str, Sequence[float]]) -> dict[str, np.ndarray]:
    """t / min t of every problem, (problems,) a solver; infinite where a solver did not solve it.

    Parameters
    ----------
    seconds : solver -> (problems,), infinite where not solved

    Examples
    --------
    >>> ratios({"a": [1.0, 4.0], "b": [3.0, np.inf]})
    {'a': array([1., 1.]), 'b': array([ 3., inf])}
    """
    times = np.array(list(seconds.values()), dtype=float)
    fastest = np.min(times, axis=0)
    compared = np.divide(times, fastest, out=np.full_like(times, np.inf), where=np.isfinite(times))
    return dict(zip(seconds, compared, strict=True))


def profile(compared: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """rho(tau) = the part of all problems with t / min t <= tau, for every factor tau.

    Examples
    --------
    >>> profile(np.array([1.0, 3.0, np.inf]), np.array([1.0, 2.0, 4.0])).round(2)
    array([0.33, 0.33, 0.67])
    """
    return np.asarray(np.mean(compared[:, None] <= factors, axis=0))


def draw(seconds: Mapping[str, Sequence[float]], file: Path, title: str) -> None:
    """The profiles of all solvers as steps, factors on a logarithmic axis; the whole file or nothing.

    Raises
    ------
    BackendMissing
        matplotlib is not installed.
    """
    check_installed("matplotlib", "report", "drawing performance profiles")
    from matplotlib.figure import Figure

    found = ratios(seconds)
    finite = np.concatenate([values[np.isfinite(values)] for values in found.values()])
    factors = np.unique(np.concatenate([finite, [1.0, 1.5 * np.max(finite, initial=2.0)]]))
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    for place, (name, values) in enumerate(found.items()):
        style = ("-", "--", ":")[place // 6 % 3]
        axes.step(factors, profile(values, factors), style, where="post", label=name)
    axes.set_xscale("log")
    axes.set(xlim=(1, factors[-1]), ylim=(0, 1.02), xlabel="factor of the fastest time", ylabel="part of the problems")
    axes.set_title(title)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    write_whole(file, lambda beside: figure.savefig(beside, dpi=150))
