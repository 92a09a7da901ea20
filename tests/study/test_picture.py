"""Error against run time: the curves are there, and a reader can tell them apart."""

from __future__ import annotations

from pathlib import Path

import pytest

from contactqp.study.report import picture
from contactqp.study.rows import Row

pytest.importorskip("matplotlib")


def _ladder(method: str, variant: str, errors: list[float]) -> list[Row]:
    return [
        Row(
            case="one",
            method=method,
            variant=variant,
            knob="tolerance",
            knob_value=10.0**-i,
            seconds=1e-3 * (i + 1),
            error_displacement=error,
            error_force=10 * error,
        )
        for i, error in enumerate(errors)
    ]


ROWS = [
    *_ladder("osqp", "raw", [1e-2, 1e-5, 1e-9]),
    *_ladder("osqp", "polished", [0.0, 0.0, 0.0]),
    *_ladder("scs", "raw", [1e-1, 1e-3, 1e-4]),
    Row(case="one", method="gurobi", verdict="missing"),
]


def test_a_curve_for_each_method_and_variant_in_both_panels(tmp_path: Path) -> None:
    figure = picture.draw(ROWS, "one")
    left, right = figure.axes
    for panel, factor in ((left, 1), (right, 10)):
        drawn = {line.get_label(): line for line in panel.get_lines()}
        assert set(drawn) == {"osqp raw", "osqp polished", "scs raw"}
        assert drawn["osqp raw"].get_xdata() == pytest.approx([1, 2, 3])  # milliseconds
        assert drawn["osqp raw"].get_ydata() == pytest.approx([factor * error for error in (1e-2, 1e-5, 1e-9)])
        assert drawn["osqp polished"].get_ydata() == pytest.approx(3 * [picture.LEAST_ERROR])
        assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
        assert "[ms]" in panel.get_xlabel()
        assert "[1]" in panel.get_ylabel()
    file = tmp_path / "picture.png"
    picture.save(figure, file)
    assert file.read_bytes().startswith(b"\x89PNG")
    assert file.stat().st_size > 10_000


def test_the_legend_names_every_method_once() -> None:
    (legend,) = picture.draw(ROWS, "one").legends
    assert [text.get_text() for text in legend.get_texts()] == ["osqp", "scs", "before polish", "after polish"]


def test_no_two_methods_look_alike() -> None:
    many = [row for i in range(40) for row in _ladder(f"method {i}", "", [1e-3])]
    styles = picture._styles(many)
    assert len(set(styles.values())) == len(styles) == 40


def test_medians_over_cases() -> None:
    (middle,) = picture.medians([ROWS[0], ROWS[0], Row(method="osqp", variant="raw", knob="tolerance", knob_value=1.0)])
    assert (middle.seconds, middle.error_force) == (ROWS[0].seconds, ROWS[0].error_force)
