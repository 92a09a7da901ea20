"""Parts that only pull, only push, are bounded or yield, against closed forms and against their energies themselves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

import contactqp as cq
from contactqp.elements.constrained_energy import Part


def _energy(part: Part, unknowns: dict[str, float]) -> float:
    """The part's energy as its own words have it, with no unknown of its own; plastic parts by hand."""
    form = part.elongation if isinstance(part, cq.Cable | cq.Strut | cq.Spring) else {}
    e = sum(factor * unknowns[name] for name, factor in form.items())
    if isinstance(part, cq.Spring):
        return part.stiffness * (e - part.rest) ** 2 / 2
    if isinstance(part, cq.Cable):
        return float(part.stiffness or 0.0) * max(e - part.slack, 0.0) ** 2 / 2
    assert isinstance(part, cq.Strut)
    return float(part.stiffness or 0.0) * max(-e - part.gap, 0.0) ** 2 / 2


def _random_parts(names: list[str], random: np.random.Generator) -> list[Part]:
    parts: list[Part] = []
    for k in range(7):
        form = dict(zip(names, random.integers(-3, 4, len(names)).tolist(), strict=True)) | {names[k % 3]: 1}
        kind = (cq.Spring, cq.Cable, cq.Strut)[k % 3]
        parts.append(kind(f"part {k}", elongation=form, stiffness=float(random.integers(1, 50))))
    play = random.normal(size=3) / 10
    return [
        *parts,
        cq.Cable("prestressed", {names[0]: 1.0}, 20.0, slack=-abs(play[0])),
        cq.Strut("with a gap", {names[1]: 1.0}, 30.0, gap=abs(play[1])),
        cq.Spring("stretched", 5.0, {names[2]: 1.0}, rest=play[2]),
    ]


@pytest.mark.sampled(12)
@pytest.mark.parametrize("seed", range(25))
def test_the_minimum_is_that_of_the_energy_as_stated(seed: int) -> None:
    random = np.random.default_rng(seed)
    names = ["x", "y", "z"]
    parts, load = _random_parts(names, random), random.normal(size=3) * 10
    root = random.normal(size=(3, 3))
    K = root @ root.T

    def total(u: NDArray[np.float64]) -> float:
        of_parts = sum(_energy(part, dict(zip(names, u, strict=True))) for part in parts)
        return float(u @ K @ u / 2 - load @ u) + of_parts

    energy = cq.ConstrainedEnergy(names, K, load, parts)
    found = energy.solve()
    assert found.certificate.passed
    assert found.certificate.proven
    assert found.energy == pytest.approx(total(found.displacement), rel=1e-10, abs=1e-12)
    searched = minimize(total, np.zeros(3), method="BFGS", options={"gtol": 1e-9})
    assert found.energy <= searched.fun + 1e-9
    assert np.allclose(found.displacement, searched.x, atol=1e-5)


def _simple_beam(load: float, hinges: list[Part]) -> cq.ConstrainedEnergy:
    return cq.ConstrainedEnergy(["t"], [[10.0]], [load], hinges)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("hardening", [0.0, 2.5])
@pytest.mark.parametrize("load", [-9.0, -4.0, 3.0, 7.0, 20.0])
def test_a_hinge_yields_both_ways_and_hardens(load: float, hardening: float) -> None:
    k, back, up, low = 100.0, 10.0, 5.0, 3.0
    hinge = cq.PlasticHinge("hinge", {"t": 1.0}, up, low, stiffness=k, hardening=hardening)
    state = _simple_beam(load, [hinge]).solve().parts["hinge"]
    elastic = load / (k + back)
    limit = up if load > 0 else -low
    if -low <= k * elastic <= up:
        rotation, plastic = elastic, 0.0
    else:  # limit + h p = k (t - p), 10 t + k (t - p) = load
        rotation, plastic = np.linalg.solve([[k, -(k + hardening)], [back + k, -k]], [limit, load])
    assert state.deformation == pytest.approx(rotation, rel=1e-12)
    assert state.plastic == pytest.approx(plastic, rel=1e-11, abs=1e-15)
    assert state.force == pytest.approx(k * (rotation - plastic), rel=1e-12)
    assert state.status == ("yields" if plastic else "elastic")


@pytest.mark.slow
def test_the_plastic_limit_of_a_portal_is_that_of_the_kinematic_theorem() -> None:
    """Sway of a portal with rigid columns: four hinges of M_p, H h = 4 M_p."""
    hinges = [cq.PlasticHinge(f"hinge {i}", {"sway": sign / 2.0}, 6.0) for i, sign in enumerate((1, -1, 1, -1))]

    def sway(force: float) -> cq.ConstrainedMinimum:
        return cq.ConstrainedEnergy(["sway"], load=[force], parts=hinges).solve()

    held = sway(4 * 6.0 / 2 * 0.99)
    assert held.certificate.passed
    assert abs(held["sway"]) < 1e-12
    with pytest.raises(cq.NoEquilibrium):
        sway(4 * 6.0 / 2 * 1.01)


def test_rigid_and_inextensible_parts_are_the_limit_of_stiff_ones() -> None:
    def parts(k: float | None) -> list[Part]:
        return [cq.Cable("cable", {"x": 1.0}, k, slack=0.5), cq.Strut("prop", {"y": 1.0}, k, gap=0.25)]

    def solved(k: float | None) -> cq.ConstrainedMinimum:
        return cq.ConstrainedEnergy(2, np.diag([4.0, 4.0]), [6.0, -6.0], _renamed(parts(k))).solve()

    rigid, stiff = solved(None), solved(1e9)
    assert rigid.displacement == pytest.approx([0.5, -0.25], abs=1e-15)
    assert [rigid.parts[name].force for name in ("cable", "prop")] == [4.0, 5.0]
    assert stiff.displacement == pytest.approx(rigid.displacement, abs=1e-8)


def _renamed(parts: list[Part]) -> list[Part]:
    places = {"x": "u0", "y": "u1"}
    return [
        type(part)(part.name, {places[n]: f for n, f in part.elongation.items()}, part.stiffness, play)  # type: ignore
        for part, play in zip(parts, (0.5, 0.25), strict=True)
    ]


def test_bounds_and_equalities_act_with_their_signs() -> None:
    parts = [
        cq.AtMost("ceiling", {"a": 1.0}, 0.5),
        cq.AtLeast("floor", {"b": 1.0}, -0.5),
        cq.Equal("same", {"c": 1.0, "d": -1.0}),
        cq.AtLeast("far", {"a": 1.0}, -9.0),
    ]
    minimum = cq.ConstrainedEnergy(["a", "b", "c", "d"], np.eye(4), [2.0, -3.0, 1.0, 0.0], parts).solve()
    assert {name: part.force for name, part in minimum.parts.items()} == pytest.approx(
        {"ceiling": 1.5, "floor": 2.5, "same": 0.5, "far": 0.0}
    )
    assert minimum.parts["far"].status == "inactive"
    assert minimum.displacement == pytest.approx([0.5, -0.5, 0.5, 0.5])


def test_an_obstacle_bounds_many_unknowns_from_both_sides() -> None:
    between = cq.Obstacle("box", ["u0", "u1", "u2"], lower=[-1.0, -np.inf, -1.0], upper=1.0)
    minimum = cq.ConstrainedEnergy(3, np.eye(3), [-4.0, -4.0, 3.0], [between]).solve()
    assert minimum.displacement == pytest.approx([-1.0, -4.0, 1.0])
    assert minimum.multiplier["box: u0 from below"] == pytest.approx(3.0)
    assert minimum.multiplier["box: u2 from above"] == pytest.approx(2.0)
    assert minimum.parts["box"].force == pytest.approx(3.0 - 2.0)


def test_every_exact_method_agrees_and_a_wrong_answer_is_refused() -> None:
    cables = [cq.Cable("left", {"x": 1.0}, 100.0), cq.Cable("right", {"x": -1.0}, 100.0)]
    hinge = cq.PlasticHinge("hinge", {"x": 1.0}, 0.25, stiffness=50.0)
    energy = cq.ConstrainedEnergy(["x"], [[10.0]], [11.0], [*cables, hinge])
    right = energy.solve()
    for method in ("clarabel", "osqp", "lemke", "lagrange-multiplier"):
        other = energy.read(cq.solve(energy.problem, method))
        assert other.parts["left"].force == pytest.approx(right.parts["left"].force, rel=1e-6)
    solution = right.solution
    assert cq.certify(energy.problem, solution.displacement, solution.normal_force).passed
    for i in range(energy.problem.contacts):
        forces = solution.normal_force.copy()
        forces[i] += 1e-3
        assert not cq.certify(energy.problem, solution.displacement, forces).passed


BAD: list[tuple[dict[str, Any], str]] = [
    (dict(unknowns="x"), "unknowns: expected a sequence, each a string or a whole number"),
    (dict(unknowns=["x", "x"]), "'x' more than once"),
    (dict(unknowns=["x"], stiffness=np.eye(2)), r"stiffness: expected shape \(1, 1\), got \(2, 2\)"),
    (dict(unknowns=["x"], load=[1.0, 2.0]), "load: "),
    (dict(unknowns=["x"], stiffness=[[-1.0]]), "stiffness: expected positive semidefinite"),
]


@pytest.mark.parametrize(("arguments", "said"), BAD)
def test_bad_energies_are_refused(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=said):
        cq.ConstrainedEnergy(**arguments)


def test_parts_with_unknown_unknowns_or_one_name_are_refused() -> None:
    with pytest.raises(cq.InvalidProblem, match="stay: expected unknowns of x, y, got 'z'"):
        cq.ConstrainedEnergy(["x", "y"], parts=[cq.Cable("stay", {"z": 1.0}, 1.0)])
    with pytest.raises(cq.InvalidProblem, match="part: expected distinct names, got 'stay' more than once"):
        cq.ConstrainedEnergy(["x"], parts=[cq.Cable("stay", {"x": 1.0}), cq.Strut("stay", {"x": 1.0})])
    one, other = (cq.ConstrainedEnergy([name], [[1.0]], [1.0]) for name in "xy")
    with pytest.raises(cq.InvalidProblem, match="of this energy's own"):
        one.read(cq.solve(other.problem))


BAD_PARTS = [
    lambda: cq.Cable("c", {}, 1.0),
    lambda: cq.Cable("c", {"x": 0.0}, 1.0),
    lambda: cq.Cable("c", [1.0], 1.0),  # type: ignore[arg-type]
    lambda: cq.Cable("c", {"x": 1.0}, -1.0),
    lambda: cq.Cable("c", {"x": 1.0}, 1.0, slack=float("nan")),
    lambda: cq.Strut("c", {"x": True}, 1.0),
    lambda: cq.Spring("c", 0.0, {"x": 1.0}),
    lambda: cq.AtMost("c", {"x": 1.0}, float("inf")),
    lambda: cq.Obstacle("c", ["x"]),
    lambda: cq.Obstacle("c", ["x"], lower=1.0, upper=0.0),
    lambda: cq.Obstacle("c", ["x"], lower=[1.0, 2.0]),
    lambda: cq.Obstacle("c", ["x"], lower="a"),
    lambda: cq.PlasticHinge("c", {"x": 1.0}, 0.0),
    lambda: cq.PlasticHinge("c", {"x": 1.0}, 1.0, hardening=-1.0),
]


@pytest.mark.parametrize("make", BAD_PARTS)
def test_bad_parts_are_refused_by_their_name(make: Any) -> None:
    with pytest.raises(cq.InvalidProblem, match=r"^c: "):
        make()


def test_the_minimum_is_printed_with_the_states_of_its_parts() -> None:
    parts = [cq.Cable("strap", {"u": 1.0}, 100.0, slack=0.01), cq.Spring("spring", 50.0, {"u": 1.0})]
    energy = cq.ConstrainedEnergy(["u"], load=[5.0], parts=parts, units={"length": "mm", "force": "N"})
    minimum = energy.solve()
    first, *rest = str(minimum).splitlines()
    assert first.startswith("active-set: passed, proven; energy -0.115 N mm; ")  # 0.09/2 + 0.04 - 0.2
    assert rest == [
        "1 unknown",
        "     displacement [mm]",
        "  u               0.04",
        "2 parts",
        "           status  force [N]  deformation [mm]",
        "  strap      taut          3              0.04",
        "  spring  elastic          2              0.04",
    ]
    assert repr(minimum) == "ConstrainedMinimum(2 parts, 1 unknown, passed, proven)"
    assert "spring" in minimum._repr_html_()


def test_of_many_parts_those_of_the_largest_forces_are_printed() -> None:
    bed = [cq.Strut(f"strut {i}", {"w": 1.0}, float(i + 1)) for i in range(30)]
    printed = str(cq.ConstrainedEnergy(["w"], load=[-1.0], parts=bed).solve())
    assert "30 parts, the 10 of the largest forces" in printed
    assert "strut 29" in printed
    assert "strut 19 " not in printed


@pytest.mark.parametrize(
    "stiffnesses", [(121e3, 1.1e-5, 12.1, 1e-6), (11e6, 1100.0, 12.1, 1.21e-3), (1e4, *10.0 ** np.arange(5, -7, -1))]
)
def test_props_whose_stiffnesses_span_many_decades_carry_a_load_in_any_order(stiffnesses: tuple[float, ...]) -> None:
    """The first prop alone is reached: w = -P / k. No pivot of the singular stiffness is small in such an order.

    The props were taken to hold each other by rounding, and the right answer was refused with an infinite bound.
    """
    for order in (np.arange(len(stiffnesses)), np.random.default_rng(0).permutation(len(stiffnesses))):
        props = [cq.Strut(f"prop {i}", {"w": 1.0}, stiffnesses[i], gap=1e-3 * float(i)) for i in order]
        minimum = cq.ConstrainedEnergy(["w"], load=[-1.0], parts=props).solve()
        assert minimum["w"] == pytest.approx(-1 / stiffnesses[0], rel=1e-12)
        assert minimum.parts["prop 0"].force == pytest.approx(1.0, rel=1e-12)
        assert minimum.certificate.proven
