"""Large deformations in case files: what is built, what is claimed of it, and that claims can fail."""

import tomllib
from decimal import Decimal
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.errors import NotConverged, SceneError, Unsupported
from contactqp.scene.answers import friction_along_axes
from contactqp.scene.building import build
from contactqp.scene.explaining import explain, report_methods
from contactqp.scene.judging import Trial, judge
from contactqp.scene.moving import DeformableModel
from contactqp.scene.printing import judgement_data
from contactqp.scene.scene import Scene
from contactqp.study.answer_pictures import fields_of
from tests.analysis.arches import arch_limit, arch_load

CASES = Path(__file__).parents[2] / "cases"
CHAIN = "cable_on_floor.toml"
ARCH = dict(
    title="an arch",
    deformation="large",
    axes=["x", "z"],
    nodes=[
        {"name": "l", "at": ["-1 m", "0 m"]},
        {"name": "t", "at": ["0 m", "0.2 m"]},
        {"name": "r", "at": ["1 m", "0 m"]},
    ],
    bars=[
        {"name": "a", "nodes": ["l", "t"], "area": "1 m^2", "modulus": "100 Pa"},
        {"name": "b", "nodes": ["t", "r"], "area": "1 m^2", "modulus": "100 Pa"},
    ],
    fixed=["l", "r"],
    loads=[{"name": "down", "unknown": "t.z", "value": "-1 N"}],
)
FLOOR = dict(
    obstacles=[{"name": "floor", "point": ["0 m", "-0.1 m"], "normal": [0, 1]}],
    contacts=[{"name": "foot", "node": "t", "obstacle": "floor"}],
)
BY_NODE = dict(path={"control": "displacement", "controlled": "t.z", "target": "-0.5 m", "steps": 25})
BY_ARC = dict(path={"control": "arc-length", "arc_length": "3 cm", "steps": 40})
BY_LOAD = dict(path={"steps": 10})


def claim(quantity, value, **keys):
    return {"quantity": quantity, "value": value, "derivation": "by hand", "tolerance": 1e-9} | keys


def rows(data, *claims):
    found = judge(Scene(**data, expect=list(claims)), Trial()).expectations
    assert len(found) == len(claims) > 0
    return found


@pytest.mark.slow
def test_a_scene_runs_to_the_history_of_the_analysis():
    history = cq.run(Scene(**ARCH, **BY_NODE))
    assert type(history).__name__ == "LargeHistory"
    w = -history.displacements[:, 1]
    np.testing.assert_allclose(history.times, arch_load(w), atol=1e-11)
    assert history[-1].problem.dof_names == ("t.x", "t.z")
    assert [point.kind for point in history.limit_points] == ["maximum", "minimum"]
    assert len(history) > 2
    assert all(solution.certificate.passed for solution in history)


@pytest.mark.slow
def test_events_have_the_names_of_the_scene():
    history = cq.run(Scene(**ARCH, **FLOOR, **BY_LOAD))
    assert [(event.kind, event.name, event.time) for event in history.events] == [("closed", "foot", 0.3)]
    assert history[-1].problem.contact_names == ("foot",)
    assert "t.z jumps from" in history.notes[0]


@pytest.mark.slow
def test_small_displacements_are_another_answer():
    small = cq.run(Scene(**(ARCH | dict(deformation="small")), **BY_LOAD))[-1]
    large = cq.run(Scene(**ARCH, path={"steps": 2, "corners": [{"down": "1e-6"}]}))[-1]
    assert large.displacement[1] == pytest.approx(1e-6 * small.displacement[1], rel=1e-4)
    assert abs(cq.run(Scene(**ARCH, **BY_LOAD))[-1].displacement[1] - small.displacement[1]) > 0.3


LIMIT, PLACE = arch_limit()
RIGHT = [
    (BY_NODE, "limit load factor", LIMIT, {}),
    (BY_NODE, "limit load factor", -LIMIT, {"occurrence": -1}),
    (BY_NODE, "limit load", f"{-LIMIT} N", {"at": "t.z"}),
    (BY_NODE, "limit displacement", f"{-PLACE} m", {"at": "t.z"}),
    (BY_NODE, "limit points", 2, {}),
    (BY_NODE, "load factor", arch_load(0.1), {"reached": "-10 cm"}),
    (BY_NODE, "load factor", arch_load(0.5), {}),
    (BY_NODE, "load", f"{-arch_load(0.3)} N", {"at": "t.z", "reached": "-0.3 m"}),
    (BY_NODE, "reaction", f"{arch_load(0.5) / 2} N", {"at": "l.z"}),
    (BY_NODE, "energy", f"{100 * 1.04**0.5 * (0.025 / 1.04) ** 2 - arch_load(0.5) * 0.5} J", {}),
    (FLOOR | BY_ARC, "event time", arch_load(0.3), {"at": "foot", "event": "closed"}),
    (FLOOR | BY_ARC, "limit load factor", arch_load(0.3), {"occurrence": 2}),
    (FLOOR | BY_LOAD, "snap-through load factor", LIMIT, {"tolerance": 1e-6}),
    (FLOOR | BY_LOAD, "snap-through load", f"{-LIMIT} N", {"at": "t.z", "tolerance": 1e-6}),
    (FLOOR | BY_LOAD, "snap-throughs", 1, {}),
    (FLOOR | BY_LOAD, "normal force", f"{0.5 - arch_load(0.3)} N", {"at": "foot", "time": 0.5}),
    (FLOOR | BY_LOAD, "normal force", f"{0.4 - arch_load(0.3)} N", {"at": "foot", "load_factor": 0.4}),
    (FLOOR | BY_LOAD, "total normal force", f"{1 - arch_load(0.3)} N", {}),
    (FLOOR | BY_LOAD, "event load", "-0.3 N", {"at": "foot", "along": "t.z", "event": "closed"}),
    (FLOOR | BY_LOAD, "elastic energy", f"{100 * 1.04**0.5 * (0.015 / 1.04) ** 2} J", {}),
    (FLOOR | BY_LOAD, "bar force", f"{-100 * 0.015 / 1.04 * (1.01 / 1.04) ** 0.5} N", {"at": "b"}),
]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("path", [BY_NODE, FLOOR | BY_ARC, FLOOR | BY_LOAD], ids=["node", "arc", "load"])
def test_claims_hold_and_fail_on_wrong_numbers(path):
    stated = [(quantity, value, keys) for of, quantity, value, keys in RIGHT if of == path]
    claims = [claim(quantity, number, **keys) for quantity, value, keys in stated for number in (value, off(value))]
    found = rows(ARCH | path, *claims)
    for (quantity, _, keys), good, bad in zip(stated, found[::2], found[1::2], strict=True):
        assert good.ok, (quantity, keys, good.expected, good.got)
        assert not bad.ok, (quantity, keys)


def off(value):
    """A value with its unit, a thousandth off."""
    number, unit, _ = (*str(value).split(" "), "", "")[:3]
    return f"{float(number) * 1.001:.17g} {unit}".strip() if float(number) else f"1e-3 {unit}"


def test_every_claim_is_of_one_of_the_paths():
    assert RIGHT
    assert all(of in (BY_NODE, FLOOR | BY_ARC, FLOOR | BY_LOAD) for of, *_ in RIGHT)


@pytest.mark.slow
def test_laws_of_the_bars_are_their_own():
    """An upright bar of each law, stretched by the same end: N = E A (L/L0) eps, E A e, E A h L0/L."""
    laws = {"green": 1.5 * (1.5**2 - 1) / 2, "engineering": 0.5, "logarithmic": np.log(1.5) / 1.5}
    nodes = [{"name": "end", "at": ["0 m", "0 m"]}]
    nodes += [{"name": f"{law} top", "at": ["0 m", "1 m"]} for law in laws]
    bars = [
        {"name": law, "nodes": [f"{law} top", "end"], "area": "1 m^2", "modulus": "1 Pa", "law": law} for law in laws
    ]
    data = dict(title="t", deformation="large", axes=["x", "z"], nodes=nodes, bars=bars)
    data |= dict(fixed=[f"{law} top" for law in laws] + ["end.x"])
    data |= dict(loads=[{"unknown": "end.z", "value": f"{-sum(laws.values())} N"}], path={"steps": 5})
    claims = [claim("bar force", f"{force} N", at=law) for law, force in laws.items()]
    assert [row.ok for row in rows(data, *claims, claim("displacement", "-0.5 m", at="end.z"))] == [True] * 4
    body = DeformableModel(build(Scene(**data))).body
    step, u = 1e-6, np.array([-0.3])
    slope = (body.internal_force(u + step) - body.internal_force(u - step)) / (2 * step)
    assert abs(slope[0]) > 1
    np.testing.assert_allclose(body.tangent(u).toarray()[0], slope, rtol=1e-8)
    force = (body.energy(u + step) - body.energy(u - step)) / (2 * step)
    np.testing.assert_allclose(body.internal_force(u)[0], force, rtol=1e-8)


def test_a_law_that_cannot_bear_a_bar_of_no_length_keeps_all_from_it():
    data = ARCH | dict(bars=[ARCH["bars"][0] | {"law": "logarithmic"}, ARCH["bars"][1]])
    model = DeformableModel(build(Scene(**data, **BY_LOAD)))
    assert not model.truss.bar_law.length_free
    assert np.isinf(model.body.energy(np.array([-1.0, -0.2])))
    assert np.isfinite(DeformableModel(build(Scene(**ARCH, **BY_LOAD))).body.energy(np.array([-1.0, -0.2])))


@pytest.mark.slow
def test_friction_on_a_ball_is_along_the_tangents_of_now():
    ball = [{"name": "ball", "kind": "circle", "centre": ["0.1 m", "-0.9 m"], "radius": "1 m"}]
    contacts = [{"name": "foot", "node": "t", "obstacle": "ball", "friction": 0.2}]
    loads = [*ARCH["loads"], {"name": "push", "unknown": "t.x", "value": "30 N"}]
    data = ARCH | dict(obstacles=ball, contacts=contacts, loads=loads)
    path = dict(path={"steps": 6, "corners": [{"down": 10}, {"down": 10, "push": 1}]})
    scene = Scene(**data, **path)
    last = cq.run(scene)[-1]
    model = build(scene)
    x = np.array([0.0, 0.2]) + last.displacement
    n = x - [0.1, -0.9]
    assert np.linalg.norm(n) == pytest.approx(1, abs=1e-12)
    along = friction_along_axes(model, last)[0]
    assert along @ n == pytest.approx(0, abs=1e-10)
    assert np.linalg.norm(along) == pytest.approx(0.2 * last.normal_force[0], rel=1e-9)
    inner = DeformableModel(model).body.internal_force(last.displacement)
    np.testing.assert_allclose(inner, [30.0, -10.0] + last.normal_force[0] * n - along, atol=1e-9)
    assert abs(model.along_axes(last.friction_force)[0] - along).max() > 1e-3


@pytest.mark.slow
def test_a_tripod_slides_over_a_sphere():
    """In space: balance of the bars, the weight and the push with pressure and friction across it, along the slip."""
    feet = [[1.0, 0.0], [-0.5, 0.8], [-0.6, -0.7]]
    nodes = [{"name": f"{i}", "at": [f"{x} m", f"{y} m", "1 m"]} for i, (x, y) in enumerate(feet)]
    bars = [{"name": f"{i}", "nodes": [f"{i}", "t"], "area": "1 m^2", "modulus": "100 Pa"} for i in range(3)]
    scene = Scene(
        title="t",
        deformation="large",
        axes=["x", "y", "z"],
        nodes=[*nodes, {"name": "t", "at": ["0 m", "0 m", "0 m"]}],
        bars=bars,
        masses=[{"name": "head", "node": "t", "mass": "2 kg"}],
        gravity=["0 m/s^2", "0 m/s^2", "-10 m/s^2"],
        fixed=["0", "1", "2"],
        obstacles=[{"name": "ball", "kind": "sphere", "centre": ["0.1 m", "0 m", "-1 m"], "radius": "0.98 m"}],
        contacts=[{"name": "tip", "node": "t", "obstacle": "ball", "friction": 0.25}],
        loads=[{"name": "push", "unknown": "t.y", "value": "12 N"}],
        path={"steps": 8, "corners": [{"gravity": 1}, {"gravity": 1, "push": 1}]},
    )
    history = cq.run(scene)
    last, model = history[-1], build(scene)
    out = (last.displacement - [0.1, 0, -1]) / 0.98
    assert np.linalg.norm(out) == pytest.approx(1, abs=1e-12)
    along = friction_along_axes(model, last)[0]
    assert str(last.contact_status[0]) == "slip"
    assert np.linalg.norm(along) == pytest.approx(0.25 * last.normal_force[0], rel=1e-9)
    assert along @ out == pytest.approx(0, abs=1e-9)
    assert along @ (last.displacement - history[-2].displacement) > 0
    inner = DeformableModel(model).body.internal_force(last.displacement)
    np.testing.assert_allclose(inner, [0, 12, -20] + last.normal_force[0] * out - along, atol=1e-9)


@pytest.mark.slow
def test_a_bar_that_tears_ends_with_what_there_is(tmp_path, capsys):
    """Hencky's law carries E A / e at most: 0.3679 of its modulus times its area, and the load here is 0.4."""
    file = tmp_path / "wire.toml"
    file.write_text(
        'title = "a wire"\ndeformation = "large"\naxes = ["x", "z"]\nfixed = ["a", "b.x"]\n'
        'nodes = [{ name = "a", at = ["0 m", "1 m"] }, { name = "b", at = ["0 m", "0 m"] }]\n'
        'bars = [{ name = "w", nodes = ["a", "b"], area = "1 m^2", modulus = "1 Pa", law = "logarithmic" }]\n'
        'loads = [{ unknown = "b.z", value = "-0.4 N" }]\npath = { steps = 8 }\n'
    )
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(file), "--plot", str(tmp_path / "wire.png")])
    captured = capsys.readouterr()
    assert exit_.value.code == 1
    assert captured.err.count("contactqp:") == 1
    assert "at load factor 1: Newton's method: the displacements grow without bound" in captured.err
    assert "8 instants so far, to load factor 0.875" in captured.out
    assert "Traceback" not in captured.err + captured.out
    assert (tmp_path / "wire.history.png").exists()


@pytest.mark.slow
def test_supports_of_a_contact_get_what_the_obstacle_gives_them():
    """The node of the arch may not move aside: an inclined floor pushes it against its support."""
    floor = dict(
        obstacles=[{"name": "floor", "point": ["0 m", "0.15 m"], "normal": [3, 4]}], contacts=FLOOR["contacts"]
    )
    data = ARCH | floor | dict(fixed=["l", "r", "t.x"]) | BY_LOAD
    scene = Scene(**data)
    last = cq.run(scene)[-1]
    pushed = last.normal_force[0]
    assert pushed > 0.1
    asked = [claim("reaction", f"{-0.6 * pushed} N", at="t.x"), claim("displacement", "-0.05 m", at="t.z")]
    assert all(row.ok for row in rows(data, *asked))
    forces = DeformableModel(build(scene)).support_forces(last)
    np.testing.assert_allclose(forces[1::2].sum(), 1 - 0.8 * pushed, rtol=1e-10)
    assert abs(forces[3]) < 1e-10


@pytest.mark.slow
def test_methods_take_the_steps_or_refuse():
    scene = Scene(**ARCH, path={"steps": 4, "corners": [{"down": "0.28"}]})
    ends = [cq.run(scene, method)[-1].displacement for method in ("active-set", "lemke", "clarabel")]
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, atol=1e-10)
    with pytest.raises(Unsupported, match="clarabel: the tangent is indefinite"):
        cq.run(Scene(**ARCH, **BY_LOAD), "clarabel")
    with pytest.raises(Unsupported, match="control='displacement' with 'lemke'"):
        cq.run(Scene(**ARCH, **BY_NODE), "lemke")
    with pytest.raises(SceneError, match=r"steps: expected in \[path\], and not as an option"):
        cq.run(Scene(**ARCH, **BY_LOAD), steps=3)
    assert report_methods(scene)[0] == ("active-set",)


@pytest.mark.slow
def test_a_path_that_breaks_off_keeps_its_names():
    with pytest.raises(NotConverged, match=r"t\.z can go no further") as failure:
        cq.run(Scene(**ARCH, **FLOOR, **BY_NODE))
    so_far = failure.value.history
    assert so_far[-1].problem.contact_names == ("foot",)
    assert so_far[-1].displacement[1] == pytest.approx(-0.3, abs=1e-14)


def test_the_explanation_says_that_tangents_are_updated():
    blocks = {block.name: block for block in explain(Scene(**ARCH, **FLOOR, **BY_ARC)).blocks}
    assert blocks["Newton loop"].included
    assert "tangents, gaps and normals are updated" in blocks["Newton loop"].reason
    assert "arc-length control" in blocks["load path"].reason
    assert explain(Scene(**ARCH, **FLOOR, **BY_ARC)).contacts == ("foot: -u(t.z) <= 0.3 m, at the start",)
    ball = [{"name": "floor", "kind": "circle", "centre": ["0.6 m", "-0.6 m"], "radius": "0.9 m"}]
    (row,) = explain(Scene(**ARCH, **(FLOOR | dict(obstacles=ball)), **BY_ARC)).contacts
    assert row == "foot: 0.6 u(t.x) - 0.8 u(t.z) <= 0.1 m, at the start"
    small = {block.name: block for block in explain(Scene(**(ARCH | dict(deformation="small")), **BY_LOAD)).blocks}
    assert not small["Newton loop"].included


@pytest.mark.slow
def test_the_data_has_the_path():
    data = judgement_data(judge(Scene(**ARCH, **BY_NODE), Trial()))
    assert [point["kind"] for point in data["limit_points"]] == ["maximum", "minimum"]
    assert data["load_factors"][-1] == pytest.approx(arch_load(0.5))
    assert data["stable"][0] is True
    assert False in data["stable"]
    assert data["energies"]["elastic"] > 0
    snapped = judgement_data(judge(Scene(**ARCH, **FLOOR, **BY_LOAD), Trial()))
    assert snapped["snap_throughs"][0]["load_factor"] == pytest.approx(LIMIT, rel=1e-6)
    assert "snap-through" in snapped["notes"][0]


SNAPS = pytest.param("von_mises_snaps.toml", marks=pytest.mark.slow)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["truss_dragged.toml", SNAPS])
def test_pictures_are_made_of_them(tmp_path, capsys, name):
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(CASES / name), "--plot", str(tmp_path / f"{name}.png")])
    assert exit_.value.code == 0, capsys.readouterr().err
    assert (tmp_path / f"{name}.png").exists()
    assert (tmp_path / f"{name}.history.png").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["von_mises_truss.toml", SNAPS])
def test_a_report_is_made_of_them(tmp_path, capsys, name):
    with pytest.raises(SystemExit) as exit_:
        main(["report", str(CASES / name), "-o", str(tmp_path / "report"), "--jobs", "1"])
    assert exit_.value.code == 0, capsys.readouterr()
    table = (tmp_path / "report" / "results.csv").read_text().splitlines()
    assert len(table) == 2
    assert "active-set" in table[1]


@pytest.mark.slow
def test_pictures_show_the_normal_of_now():
    """On a ball the plane that is drawn touches it where the node is, and lies its gap below the node."""
    ball = [{"name": "floor", "kind": "circle", "centre": ["0.3 m", "-0.9 m"], "radius": "1 m"}]
    scene = Scene(**ARCH, **(FLOOR | dict(obstacles=ball)), path={"steps": 3, "corners": [{"down": 10}]})
    last = cq.run(scene)[-1]
    (contact,) = fields_of(scene, last).contacts
    out = (np.array([0.0, 0.2]) + last.displacement - [0.3, -0.9]) / (1 + last.gap[0])
    np.testing.assert_allclose(contact.push, [out], atol=1e-12)
    assert contact.initial_gap + out @ last.displacement == pytest.approx(contact.gap, abs=1e-12)
    assert abs(last.displacement[0]) > 0.01


@pytest.mark.slow
def test_the_cable_converges_in_second_order():
    """Bars four times as long: the errors of both tensions are some sixteen times as large."""
    a = 0.6040217522897695
    exact = np.array([-10 * a, 10 * np.sqrt(1 + 2 * a)])
    errors = []
    for part in (2, 4):
        data = tomllib.loads((CASES / CHAIN).read_text(), parse_float=Decimal)
        del data["expect"]
        for bar in data["bars"]:
            bar["divisions"] //= part
        inner = {bar["name"]: bar["divisions"] for bar in data["bars"]}
        data["contacts"] = [c for c in data["contacts"] if _stands(c["node"], inner)]
        scene = Scene(**data)
        last = cq.run(scene)[-1]
        assert last.stable
        errors.append(DeformableModel(build(scene)).support_forces(last)[:2] - exact)
    ratio = abs(errors[1]) / abs(errors[0])
    assert np.all(abs(errors[0]) < 0.01 * abs(exact))
    assert np.all((ratio > 2) & (ratio < 8)), ratio


def _stands(node, inner):
    """Whether a node is one of the bars', some of which have fewer inside than they had."""
    bar, _, place = node.partition(" ")
    return not place or int(place) < inner[bar]


@pytest.mark.slow
def test_the_weight_of_the_cable_is_carried():
    (judgement,) = [judge(cq.load_scene(CASES / CHAIN), Trial())]
    model = DeformableModel(build(judgement.scene))
    forces = model.support_forces(judgement.solution)
    carried = forces[1::2].sum() + judgement.solution.normal_force.sum()
    assert carried == pytest.approx(50, rel=1e-12)
    assert forces[0::2].sum() == pytest.approx(0, abs=1e-9)
    assert judgement.history.notes == ()


@pytest.mark.slow
def test_the_printed_force_of_the_chapter_would_not_be_met():
    """Half of d'H: 16/27 in place of 2 sqrt(3)/9 of E A h^3 / L^3."""
    scene = cq.load_scene(CASES / "von_mises_truss.toml")
    limit = next(claim for claim in scene.expect if claim.quantity == "limit load")
    size = 1000 * F(729, 68921)
    assert float(-limit.targets[0].si / size) == pytest.approx(2 * 3**0.5 / 9, rel=1e-14)
    wrong = limit.model_copy(update={"value": f"-{F(16, 27) * size} N"})
    (row,) = judge(scene.model_copy(update={"expect": (wrong,), "published": ()}), Trial()).expectations
    assert not row.ok
