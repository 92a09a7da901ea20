"""What is wrong with a scene is refused on all ranks in the words of one process, whichever rank notices.

Argument: of how many wrong scenes one is tried.
"""

import re
import sys
import tempfile
from pathlib import Path

import pytest

import contactqp as cq
from contactqp.distributed.distributed_bodies import distributed_model
from contactqp.distributed.ranks import Ranks
from contactqp.errors import ContactQPError, Unsupported
from contactqp.scene.building import build

ranks = Ranks()
SCENE = """
title = "A block on a floor"
source = "none"
about = "none"
units = { length = "m", force = "N" }
axes = ["x", "y"]
obstacles = [{ name = "floor", point = ["0 m", "FLOOR m"], normal = [0, 1] }]
contacts = [{ name = "foot", side = "block.FOOT", obstacle = "floor" }]
supports = [{ name = "guide", on = "block", near = ["NEAR m", "0 m"], axis = "x" }, SUPPORT]
pressures = [{ name = "press", side = "block.PRESS", value = "1 Pa" }]

[[bodies]]
name = "block"
MESH
model = "plane-strain"
thickness = "1 m"
modulus = "100 Pa"
poisson = 0.3
"""
GOOD = {
    "FLOOR": "0",
    "FOOT": "bottom",
    "NEAR": "0",
    "SUPPORT": "",
    "PRESS": "top",
    "MESH": 'shape = { kind = "rectangle", element = "quad4", size = ["1 m", "1 m"], divisions = [5, 4] }',
}
BAD = (
    {"FOOT": "botom"},
    {"PRESS": "topp"},
    {"NEAR": "0.03"},
    {"FLOOR": "0.5"},
    {"SUPPORT": '{ name = "x", on = "block.sole", axis = "x" }'},
    {
        "SUPPORT": '{ name = "a", on = "block.top", axis = "y", value = "1 m" }, '
        '{ name = "b", on = "block.left", axis = "y" }'
    },
    {
        "SUPPORT": ", ".join(
            f'{{ name = "{s}{a}", on = "block.{s}", axis = "{a}" }}' for s in ("left", "right") for a in "xy"
        ),
        "MESH": GOOD["MESH"].replace("[5, 4]", "[1, 4]"),
    },
    {
        "SUPPORT": '{ name = "a", on = "block.bottom", axis = "x" }, { name = "b", on = "block.bottom", axis = "y" }',
        "FLOOR": "0.001",
    },
    {"MESH": GOOD["MESH"].replace("[5, 4]", "[0, 4]")},
    {"MESH": GOOD["MESH"].replace("quad4", "hex8")},
    {"MESH": 'mesh = { file = "none.msh", unit = "m" }'},
    {"MESH": 'mesh = { file = "bad.inp", unit = "m" }'},
)


def refusal(make, changes, folder):
    text = SCENE
    for key, value in {**GOOD, **changes}.items():
        text = text.replace(key, value)
    file = folder / "case.toml"
    if ranks.rank == 0:
        file.write_text(text)
        (folder / "bad.inp").write_text("*NODE\n1, 0, 0\n*ELEMENT, TYPE=CPE4\n1, 1, 2, 3, 4\n")
    ranks.comm.barrier()
    try:
        scene = cq.load_scene(file)
        make(scene)
    except ContactQPError as error:
        return str(error)
    finally:
        ranks.comm.barrier()
    return None


with tempfile.TemporaryDirectory() as made:
    folder = Path(ranks.comm.bcast(made))
    for changes in ({}, *BAD[:: int(sys.argv[1])]):
        one = refusal(lambda scene: build(scene).problem, changes, folder)
        many = refusal(lambda scene: distributed_model(scene, ranks).problem, changes, folder)
        assert (one is None) == (changes == {}), f"{changes}: {one}"
        assert set(ranks.comm.allgather(many)) == {many}, "the same on all ranks"
        # What not all ranks notice names the first that does.
        assert many is None or re.sub(r"rank \d+: ", "", many) == one, f"{changes}:\n{many}\n{one}"
        assert many is None or "\n" not in many
        if ranks.rank == 0:
            print(many, flush=True)

truss = cq.load_scene(Path(__file__).parents[3] / "cases" / "bar_wall.toml")
with pytest.raises(Unsupported, match=r"^a scene without bodies: expected elastic bodies"):
    distributed_model(truss, ranks)
