"""Motions in case files: the masses and starts they are made of, what is claimed of them, and that claims can fail."""

from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

import contactqp as cq
from contactqp.scene.building import build
from contactqp.scene.explaining import explain
from contactqp.scene.judging import Trial, judge
from contactqp.scene.moving import exact_mass, mass_on_all
from contactqp.scene.scene import Scene

CASES = Path(__file__).parents[2] / "cases"
# Two kg that fly at 3 m/s to a wall 1 m ahead and come back with half of the speed: touch at 1/3 s.
BALL = dict(
    title="a ball",
    axes=["x"],
    nodes=[{"name": "1", "at": ["0 m"]}],
    masses=[{"name": "ball", "node": "1", "mass": "2 kg"}],
    obstacles=[{"name": "wall", "point": ["1 m"], "normal": [-1]}],
    contacts=[{"name": "tip", "node": "1", "obstacle": "wall"}],
    motion={
        "duration": "0.5 s",
        "time_step": "1 ms",
        "restitution": 0.5,
        "velocities": [{"of": "1", "value": ["3 m/s"]}],
    },
)
# A block that is let go 1 cm over a plane with g = 10 m/s^2.
BLOCK = dict(
    title="a block",
    axes=["x", "y"],
    gravity=["0 m/s^2", "-10 m/s^2"],
    bodies=[
        {
            "name": "block",
            "shape": {"kind": "rectangle", "element": "quad4", "size": ["2 cm", "1 cm"], "divisions": [2, 1]},
            "model": "plane-strain",
            "thickness": "5 cm",
            "modulus": "1 MPa",
            "poisson": 0.3,
            "density": "1000 kg/m^3",
        }
    ],
    obstacles=[{"name": "plane", "point": ["0 m", "-1 cm"], "normal": [0, 1]}],
    contacts=[{"name": "foot", "side": "block.bottom", "obstacle": "plane"}],
    motion={"duration": "0.06 s", "time_step": "0.2 ms"},
)


# A beam of 6 kg and 2 m on a pin that turns at 3 rad/s.
TURNING = dict(
    title="a beam on a pin",
    axes=["x", "y"],
    nodes=[{"name": "a", "at": ["0 m", "0 m"]}, {"name": "b", "at": ["1.2 m", "1.6 m"]}],
    beams=[
        {
            "name": "rod",
            "nodes": ["a", "b"],
            "area": "3 m^2",
            "inertia": "1 m^4",
            "modulus": "1 Pa",
            "density": "1 kg/m^3",
            "divisions": 3,
        }
    ],
    fixed=["a.x", "a.y"],
    motion={
        "duration": "1 ms",
        "time_step": "1 ms",
        "theta": 0.5,
        "velocities": [{"of": "rod", "value": ["0 m/s", "0 m/s"], "to": ["-4.8 m/s", "3.6 m/s"]}],
    },
)


def claim(quantity, value, **keys):
    return {"quantity": quantity, "value": value, "derivation": "by hand", "tolerance": 1e-12} | keys


def rows(data, *claims):
    found = judge(Scene(**data, expect=list(claims)), Trial()).expectations
    assert len(found) == len(claims) > 0
    return found


def test_run_gives_the_motion():
    history = cq.run(Scene(**BALL))
    assert isinstance(history, cq.MotionHistory)
    assert len(history) == 501
    assert history.times[-1] == pytest.approx(0.5)
    assert history.velocities[-1, 0] == pytest.approx(-1.5, rel=1e-14)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("by", ["1", "1.x"])
def test_a_ball_comes_back(by):
    motion = BALL["motion"] | {"velocities": [{"of": by, "value": ["3 m/s"]}]}
    right = [
        claim("event time", "1/3 s", at="tip", event="closed", tolerance="1 ms"),
        claim("event time", "1/3 s", at="tip", event="opened", occurrence=-1, tolerance="2 ms"),
        claim("events", "2", at="tip"),
        claim("velocity", "-1.5 m/s", at="1.x"),
        claim("velocity", "3 m/s", at="1.x", time="100 ms"),
        claim("displacement", "0.3 m", at="1.x", time="0.1 s"),
        claim("displacement", "0.3 m", at="1.x", time="0.1009 s"),
        claim("contact impulse", "9 N*s", at="tip"),
        claim("contact impulse", "0 N*s", at="tip", time="0.3 s", tolerance="1e-15 N*s"),
        claim("total momentum", "-3 N*s", along="x"),
        claim("momentum", "6 N*s", at="ball", along="x", time="0.1 s"),
        claim("kinetic energy", "9 J", time="0 s"),
        claim("total energy", "9/4 J"),
        claim("impact energy", "27/4 J"),
        claim("energy drift", "0 J", tolerance="1e-12 J"),
    ]
    found = rows(BALL | {"motion": motion}, *right)
    assert all(row.ok for row in found), [row for row in found if not row.ok]


def test_claims_of_a_motion_fail_on_wrong_numbers():
    wrong = [
        claim("event time", "1/3 s", at="tip", event="closed", tolerance="0.1 ms"),
        claim("velocity", "1.5 m/s", at="1.x"),
        claim("displacement", "0.3009 m", at="1.x", time="0.1009 s"),
        claim("contact impulse", "6 N*s", at="tip"),
        claim("total momentum", "3 N*s", along="x"),
        claim("momentum", "3 N*s", at="ball", along="x", time="0.1 s"),
        claim("kinetic energy", "9 J"),
        claim("total energy", "9 J"),
        claim("impact energy", "0 J", tolerance="1 J"),
        claim("energy drift", "1 J"),
        claim("events", "3", at="tip"),
    ]
    assert not any(row.ok for row in rows(BALL, *wrong))


def test_a_claim_of_an_event_that_does_not_come():
    again = claim("event time", "1 s", at="tip", event="closed", occurrence=-2)
    words = r"expected contact 'tip' to close 2 times in the motion; its events: closed at 0.334, opened at 0.335"
    with pytest.raises(cq.SceneError, match=words):
        rows(BALL, again)


def test_times_count_from_the_start_that_is_stated():
    motion = BALL["motion"] | {"start": "10 s"}
    found = rows(
        BALL | {"motion": motion},
        claim("event time", "10 + 1/3 s", at="tip", event="closed", tolerance="1 ms"),
        claim("velocity", "3 m/s", at="1.x", time="10.1 s"),
        claim("velocity", "-1.5 m/s", at="1.x"),
    )
    assert all(row.ok for row in found), found


def test_masses_of_bars_and_points_are_exact():
    scene = Scene(
        **BALL
        | {
            "nodes": [{"name": "0", "at": ["-2 m"]}, *BALL["nodes"]],
            "bars": [
                {
                    "name": "bar",
                    "nodes": ["0", "1"],
                    "area": "3 cm^2",
                    "modulus": "1 GPa",
                    "density": "1 kg/cm^3",
                    "divisions": 2,
                }
            ],
            "units": {"length": "m", "force": "kN"},
        }
    )
    mass = exact_mass(scene)  # 300 kg for each metre, in kN s^2 / m
    assert mass["bar 1.x", "bar 1.x"] == F(2, 3) * F(300, 1000)
    assert mass["bar 1.x", "1.x"] == F(1, 6) * F(300, 1000)
    assert mass["1.x", "1.x"] == F(1, 3) * F(300, 1000) + F(2, 1000)
    assert mass_on_all(build(scene)).sum() == pytest.approx(0.602, rel=1e-14)
    lumped = scene.model_copy(update={"motion": scene.motion.model_copy(update={"mass": "lumped"})})
    assert exact_mass(lumped) == {("0.x", "0.x"): F(150, 1000), ("bar 1.x",) * 2: F(3, 10), ("1.x",) * 2: F(152, 1000)}


def test_bars_weigh():
    """In statics, too: half of a bar at each of its ends."""
    data = dict(
        title="a bar that stands",
        axes=["z"],
        gravity=["-10 m/s^2"],
        nodes=[{"name": "a", "at": ["0 m"]}, {"name": "b", "at": ["2 m"]}],
        bars=[{"name": "b", "nodes": ["a", "b"], "area": "1 cm^2", "modulus": "1 GPa", "density": "1000 kg/m^3"}],
        fixed=["a"],
    )
    (row, top) = rows(
        data, claim("reaction", "2 N", at="a.z"), claim("displacement", "-1 * 2 / 1e5 m", at="b.z", tolerance=1e-12)
    )
    assert row.ok
    assert top.ok, top


def test_a_start_is_linear_along_a_bar():
    data = BALL | {
        "nodes": [{"name": "0", "at": ["-2 m"]}, *BALL["nodes"]],
        "bars": [
            {
                "name": "bar",
                "nodes": ["0", "1"],
                "area": "1 cm^2",
                "modulus": "1 GPa",
                "density": "1 t/m^3",
                "divisions": 4,
            }
        ],
        "motion": {
            "duration": "1 us",
            "time_step": "1 us",
            "displacements": [{"of": "bar", "value": ["8 mm"], "to": ["0 mm"]}],
            "velocities": [{"of": "bar", "value": ["1 m/s"], "to": ["-1 m/s"]}],
        },
    }
    history = cq.run(Scene(**data))
    names = history.motion.scheme.body.problem.dof_names
    assert dict(zip(names, history.displacements[0], strict=True)) == pytest.approx(
        {"0.x": 8e-3, "bar 1.x": 6e-3, "bar 2.x": 4e-3, "bar 3.x": 2e-3, "1.x": 0.0}
    )
    assert dict(zip(names, history.velocities[0], strict=True)) == pytest.approx(
        {"0.x": 1.0, "bar 1.x": 0.5, "bar 2.x": 0.0, "bar 3.x": -0.5, "1.x": -1.0}
    )


def test_parts_that_share_a_node_may_both_state_its_start():
    """Two bars in line turn about the end of the first, with 2 rad/s; the node between them is stated by both."""
    bar = {"area": "1 cm^2", "modulus": "1 GPa", "density": "1 t/m^3"}
    data = {
        "title": "two bars that turn",
        "axes": ["x", "y"],
        "nodes": [{"name": f"{i}", "at": [f"{i}/10 m", "0 m"]} for i in range(3)],
        "bars": [bar | {"name": f"bar {i}", "nodes": [f"{i}", f"{i + 1}"]} for i in range(2)],
        "motion": {
            "duration": "1 us",
            "time_step": "1 us",
            "velocities": [
                {"of": f"bar {i}", "value": ["0 m/s", f"{i}/5 m/s"], "to": ["0 m/s", f"{i + 1}/5 m/s"]}
                for i in range(2)
            ],
        },
    }
    assert cq.run(Scene(**data)).velocities[0] == pytest.approx([0, 0, 0, 0.2, 0, 0.4], rel=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("mass", ["consistent", "lumped"])
def test_a_block_falls_without_strain_and_its_side_closes_and_opens_once(mass):
    data = BLOCK | {"motion": BLOCK["motion"] | {"mass": mass}}
    touch = 0.02**0.5 / 10**0.5
    right = [
        claim("node velocity", "-0.4 m/s", at="block", along="y", near=["1 cm", "1 cm"], time="40 ms", tolerance=1e-10),
        claim("elastic energy", "0 J", time="40 ms", tolerance="1e-15 J"),
        claim("total momentum", "-0.004 N*s", along="y", time="40 ms", tolerance=1e-10),
        claim("momentum", "-0.004 N*s", at="block", along="y", time="40 ms", tolerance=1e-10),
        claim("total momentum", "0 N*s", along="x", tolerance="1e-12 N*s"),
        claim("event time", "0.0447213595 s", at="foot", event="closed", tolerance="0.4 ms"),
    ]
    assert touch == pytest.approx(0.0447213595)
    judgement = judge(Scene(**data, expect=right), Trial())
    assert judgement.met, [row for row in judgement.expectations if not row.ok]
    # Momentum is what the weight and the plane have given.
    given = judge(Scene(**data, expect=[claim("contact impulse", "0 N*s", at="foot", tolerance="1 N*s")]), Trial())
    gained = judge(Scene(**data, expect=[claim("total momentum", "0 N*s", along="y", tolerance="1 N*s")]), Trial())
    impulse, momentum = given.expectations[0].got, gained.expectations[0].got
    assert impulse > 0.004
    assert momentum == pytest.approx(impulse - 0.1 * 0.06, abs=1e-12)
    slipped = claim("event time", "1 s", at="foot", event="slip")
    with pytest.raises(cq.SceneError, match="expected 'closed' or 'opened': the nodes of a side slip and stick one"):
        judge(Scene(**data, expect=[slipped]), Trial())


def test_the_momentum_of_a_side_that_is_held_is_not_forgotten():
    """A consistent mass spreads to fixed nodes: all of a bar's momentum counts, rho A L (0 + v) / 2."""
    data = dict(
        title="a bar",
        axes=["x"],
        nodes=[{"name": "a", "at": ["0 m"]}, {"name": "b", "at": ["1 m"]}],
        bars=[{"name": "b", "nodes": ["a", "b"], "area": "1 m^2", "modulus": "1 Pa", "density": "6 kg/m^3"}],
        fixed=["a"],
        motion={"duration": "1 s", "time_step": "1 ms", "velocities": [{"of": "b.x", "value": ["1 m/s"]}]},
    )
    (row,) = rows(data, claim("total momentum", "3 N*s", along="x", time="0 s"))
    assert row.ok, row


def test_a_step_that_is_too_long_is_said_and_not_hidden(tmp_path, capsys):
    """The chapter's 0.01 s against 7.7e-5 s: a warning with both numbers in Python, a line in what `run` prints."""
    from contactqp.cli import main

    text = (
        (CASES / "rod_at_wall.toml").read_text().split("[[expect]]")[0].replace("modified-mass-central", "moreau-jean")
    )
    for key, value in (("start", "0 s"), ("duration", "0.2 s"), ("time_step", "0.01 s")):
        line = next(line for line in text.splitlines() if line.startswith(f"{key} = "))
        text = text.replace(line, f'{key} = "{value}"')
    text = "\n".join(line for line in text.splitlines() if not line.startswith("displacements"))
    file = tmp_path / "coarse.toml"
    file.write_text(text)
    with pytest.warns(cq.TimeStepWarning, match=r"time step 0\.01 is too long .* it lasts about 7\.7e-05"):
        cq.run(cq.load_scene(file))
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(file)])
    printed = capsys.readouterr()
    assert exit_.value.code == 0
    assert printed.err == ""
    assert "time step 0.01 is too long to resolve the contact" in " ".join(printed.out.split())
    assert "7.7e-05" in printed.out


def test_run_prints_times_velocities_and_energies(capsys):
    from contactqp.cli import main

    with pytest.raises(SystemExit) as exit_:
        main(["run", str(CASES / "bars_colliding.toml")])
    printed = capsys.readouterr().out
    assert exit_.value.code == 0
    for words in (
        "moreau-jean with active-set, 300 steps",
        "velocity [m/s]",
        "time [s]",
        "0.000504",
        "kinetic 1.578",
        "drift",
    ):
        assert words in " ".join(printed.split())
    assert "first 1.x" not in printed


def test_json_has_velocities_energies_and_all_nodes(capsys):
    import json

    from contactqp.cli import main

    with pytest.raises(SystemExit):
        main(["run", str(CASES / "sliding_block_stops.toml"), "--json"])
    (data,) = json.loads(capsys.readouterr().out)
    assert data["velocity"] == {"1.x": 0.0, "1.z": 0.0}
    assert data["time"] == pytest.approx(0.5)
    assert data["energies"]["dissipated"] == pytest.approx(0.962361)
    assert {"kinetic", "impact", "drift", "work", "elastic"} < set(data["energies"])
    assert [event["kind"] for event in data["events"]] == ["closed", "slip", "stick"]


def test_explain_says_whether_mass_was_built():
    moving = {block.name: block for block in explain(Scene(**BALL)).blocks}
    assert moving["mass matrix"].included
    assert moving["mass matrix"].reason == "consistent, of 1 point mass; nothing else has any"
    assert moving["time stepping"].reason.startswith("moreau-jean, 500 steps of 0.001 s from 0 s")
    block = {block.name: block for block in explain(Scene(**BLOCK)).blocks}
    assert block["mass matrix"].reason == "consistent, of all bodies"
    still = {block.name: block for block in explain(cq.load_scene(CASES / "bar_wall.toml")).blocks}
    assert not still["mass matrix"].included
    assert not still["time stepping"].included
    assert still["time stepping"].reason == "statics: nothing moves in time"


def test_any_exact_method_solves_the_steps_and_approximate_ones_are_refused():
    right = claim("velocity", "-1.5 m/s", at="1.x", tolerance=1e-9)
    assert judge(Scene(**BALL, expect=[right]), Trial("lemke")).met
    with pytest.raises(cq.Unsupported, match="penalty: approximate by design"):
        judge(Scene(**BALL), Trial("penalty", {"penalty": 1e6}))
    with pytest.raises(cq.SceneError, match=r"theta: expected in \[motion\], and not as an option of 'active-set'"):
        judge(Scene(**BALL), Trial("active-set", {"theta": 1.0}))


def test_bodies_collide_and_exchange_momentum_exactly():
    """One block flies at another that rests: what the pair gives one it takes from the other, to rounding."""
    upper = BLOCK["bodies"][0] | {"name": "upper", "shape": BLOCK["bodies"][0]["shape"] | {"corner": ["0 m", "2 cm"]}}
    data = BLOCK | {
        "gravity": None,
        "bodies": [*BLOCK["bodies"], upper],
        "contacts": [{"name": "pair", "sides": ["upper.bottom", "block.top"], "pairing": "mortar", "reach": "2 cm"}],
        "motion": BLOCK["motion"] | {"velocities": [{"of": "upper", "value": ["0 m/s", "-1 m/s"]}]},
    }
    right = [
        claim("event time", "10 ms", at="pair", event="closed", tolerance="0.4 ms"),
        claim("total momentum", "-0.01 N*s", along="y", time="10.5 ms"),
        claim("total momentum", "-0.01 N*s", along="y"),
    ]
    found = rows(data, *right)
    assert all(row.ok for row in found), found


@pytest.mark.slow
def test_a_box_falls_in_space():
    shape = {"kind": "box", "element": "hex8", "size": ["1 cm", "1 cm", "1 cm"], "divisions": [1, 1, 2]}
    body = BLOCK["bodies"][0] | {"shape": shape, "model": "3d", "thickness": None}
    data = BLOCK | {
        "axes": ["x", "y", "z"],
        "gravity": ["0 m/s^2", "0 m/s^2", "-10 m/s^2"],
        "bodies": [body],
        "obstacles": [{"name": "plane", "point": ["0 m", "0 m", "-1 cm"], "normal": [0, 0, 1]}],
    }
    found = rows(
        data,
        claim("total momentum", "-0.0004 N*s", along="z", time="40 ms", tolerance=1e-10),
        claim("node velocity", "-0.4 m/s", at="block", along="z", near=["0 m"] * 3, time="40 ms", tolerance=1e-10),
        claim("event time", "44.72 ms", at="foot", event="closed", tolerance="0.4 ms"),
    )
    assert all(row.ok for row in found), found


@pytest.mark.slow
def test_knobs_reach_the_scheme():
    for scheme, knobs, speed in (
        ("paoli-schatzman", {"restitution": "1/4"}, -0.75),
        ("moreau-jean", {"theta": 1, "restitution": 1}, -3.0),
        ("penalty", {"penalty": "1000 N/m"}, -3.0),
    ):
        motion = {"duration": "0.5 s", "time_step": "1 ms", "velocities": BALL["motion"]["velocities"]}
        scene = Scene(**BALL | {"motion": motion | {"scheme": scheme} | knobs})
        assert cq.run(scene).velocities[-1, 0] == pytest.approx(speed, rel=1e-3)


@pytest.mark.slow
def test_the_units_of_the_scene_do_not_matter():
    found = cq.run(cq.load_scene(CASES / "bars_colliding.toml"))
    other = cq.load_scene(CASES / "bars_colliding.toml").model_copy(
        update={"units": Scene(**BALL | {"units": {"length": "mm", "force": "kN"}}).units}
    )
    np.testing.assert_allclose(cq.run(other).displacements, 1e3 * found.displacements, atol=1e-12)


def test_a_beam_that_turns_on_a_pin_has_the_energy_and_momentum_of_a_rigid_rod():
    """m (2 m)^2 / 3 (3 rad/s)^2 / 2 = 36 J, and m v at the middle, which moves at half of the speed of the end."""
    claims = [
        claim("kinetic energy", "36 J", time="0 s"),
        claim("total momentum", "-14.4 N*s", along="x", time="0 s"),
        claim("momentum", "10.8 N*s", at="rod", along="y", time="0 s"),
        claim("velocity", "3 rad/s", at="rod 1.theta", time="0 s"),
    ]
    assert all(row.ok for row in rows(TURNING, *claims))
    lumped = TURNING | {"motion": TURNING["motion"] | {"mass": "lumped"}}
    assert all(row.ok for row in rows(lumped, *claims[1:]))


def test_the_frequency_of_a_divided_cantilever_is_that_of_euler_and_bernoulli():
    """1.8751041^2 sqrt(E I / (rho A L^4)), from above by a consistent mass."""
    model = build(Scene(**TURNING))
    names = model.problem.dof_names
    free = [model.exact.unknowns.place[name] for name in names]
    held = [i for i, name in enumerate(names) if name != "a.theta"]
    K, M = sp.csr_matrix(model.problem.stiffness).toarray(), mass_on_all(model)[free][:, free].toarray()
    lowest = scipy.linalg.eigh(K[held][:, held], M[held][:, held], eigvals_only=True)[0]
    assert np.sqrt(lowest) == pytest.approx(1.8751041**2 * np.sqrt(1.0 / (3.0 * 2.0**4)), rel=2e-4)


def test_rotations_may_have_starts_in_their_own_units():
    """Opposite rotations of 0.3 rad at the ends of a beam of 2 m, E I = 1 N m^2, store E I / L (0.6 rad)^2 / 2."""
    beam = TURNING["beams"][0] | {"divisions": 1}
    start = {
        "velocities": [],
        "displacements": [{"of": f"{end}.theta", "value": [v]} for end, v in (("a", "0.3 rad"), ("b", "-0.3 rad"))],
    }
    data = TURNING | {"beams": [beam], "motion": TURNING["motion"] | start}
    assert all(row.ok for row in rows(data, claim("elastic energy", "0.09 J", time="0 s")))
    wrong = [{"of": "b.theta", "value": ["1 m"]}], [{"of": "b.x", "value": ["0.1 rad"]}]
    for displacements in wrong:
        with pytest.raises(
            cq.SceneError, match=r"displacements\[0\].value \('b...*expected an? (length|angle) such as"
        ):
            Scene(**data | {"motion": data["motion"] | {"displacements": displacements}})
    with pytest.raises(cq.SceneError, match="expected an angular velocity such as"):
        Scene(**data | {"motion": data["motion"] | {"velocities": [{"of": "b.theta", "value": ["1 m/s"]}]}})


def test_beams_that_would_turn_a_shared_node_differently_are_refused_in_radians():
    data = TURNING | {
        "nodes": [*TURNING["nodes"], {"name": "c", "at": ["2.4 m", "3.2 m"]}],
        "beams": [*TURNING["beams"], TURNING["beams"][0] | {"name": "next", "nodes": ["b", "c"]}],
    }
    still = {"of": "next", "value": ["-4.8 m/s", "3.6 m/s"]}
    motion = data["motion"] | {"velocities": [*data["motion"]["velocities"], still]}
    with pytest.raises(cq.SceneError, match=r"expected 3.0 rad/s for 'b.theta', as motion.velocities\[0\] states it"):
        Scene(**data | {"motion": motion})
