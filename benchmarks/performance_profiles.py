"""Performance profiles as a picture: the part of the problems solved within a factor of the fastest time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from contactqp.exchange.files import check_installed, write_whole
from contactqp.study.statistics import profile, ratios


def draw(seconds: Mapping[str, Sequence[float]], file: Path, title: str) -> None:
    """The profiles of all solvers as steps, factors on a logarithmic axis; the whole file or nothing.

    Raises
    ------
    BackendMissing
        matplotlib is not installed.
    """
    check_installed("matplotlib", "drawing performance profiles")
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
