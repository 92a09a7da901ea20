"""Large decks that CalculiX is run on and judged, and small ones of many keywords for fuzzing.

python -m benchmarks.decks                 # needs ccx; exit 1 if one is not right within two minutes of a processor
python -m benchmarks.decks friction        # those whose names have this word
python -m benchmarks.decks --keep FOLDER   # leaves decks and answers there
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import contactqp as cq
from tests.decks import ASSEMBLED, STACK, lame_force, press_fit, two_blocks, write

# Springs behind contact that yield next to nothing and, node to face, pull with next to nothing.
STIFF = {"NODE TO SURFACE": "LINEAR\n1e8, 1e-6", "SURFACE TO SURFACE": "LINEAR\n1e8"}
# Seconds of one processor that CalculiX and the verdict may take together.
LIMIT = 120.0

# Two squares with friction over a third, which a tie and an equation hold, and a spring and a bar beside them.
PLANE = """\
*HEADING
squares
*INCLUDE, INPUT=nodes.inp
*ELEMENT, TYPE=CPE4, ELSET=BODY
1, 1, 2, 3, 4
2, 11, 12, 13, 14
*ELEMENT, TYPE=CPE4, ELSET=BODY
3, 21, 22, 23, 24
*ELEMENT, TYPE=T2D2, ELSET=BAR
8, 13, 31
*ELEMENT, TYPE=SPRINGA, ELSET=SPRING
9, 14, 32
*NSET, NSET=TOP, GENERATE
13, 14, 1
*ELSET, ELSET=ALL
BODY, BAR
*MATERIAL, NAME=STEEL
*ELASTIC, TYPE=ISO
1000., 0.3
*DENSITY
2.
*EXPANSION
1e-5
*SOLID SECTION, ELSET=BODY, MATERIAL=STEEL
0.5
*SOLID SECTION, ELSET=BAR, MATERIAL=STEEL
0.1
*SPRING, ELSET=SPRING

25.
*SURFACE, NAME=BELOW
1, S3
*SURFACE, NAME=ABOVE, TYPE=NODE
11
12
*SURFACE, NAME=LEFT
3, S2
*SURFACE, NAME=RIGHT
1, S4
*SURFACE INTERACTION, NAME=TOUCH
*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR
1e5, 1e-3
*FRICTION
0.2, 1e4
*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE, ADJUST=0.001
ABOVE, BELOW
*CLEARANCE, MASTER=BELOW, SLAVE=ABOVE, VALUE=0.002
*TIE, NAME=JOINT, POSITION TOLERANCE=0.1, ADJUST=NO
LEFT, RIGHT
*EQUATION
2
13, 1, 1., 14, 1, -1.
*AMPLITUDE, NAME=UP
0., 0., 1., 1.
*BOUNDARY
1, 1, 2
2, ENCASTRE
31, 1, 2
32, 1, 2
*STEP, INC=100, NLGEOM=NO
*STATIC, SOLVER=SPOOLES
0.1, 1.
*BOUNDARY, AMPLITUDE=UP
TOP, 2, 2, -0.01
*CLOAD, OP=MOD
23, 1, -2.
*DLOAD
3, P3, 1.5
BODY, GRAV, 9.81, 0., -1.
*DSLOAD
LEFT, P, 0.1
*NODE PRINT, NSET=TOP
U
*END STEP
*STEP
*STATIC
0.5, 2.
*BOUNDARY
TOP, 1, 1, 0.001
*CLOAD, OP=NEW
23, 1, -1.
*DLOAD
3, P3, 2.
*END STEP
"""
NODES = """\
*NODE, NSET=EVERY
1, 0., 0.
2, 1., 0.
3, 1., 1.
4, 0., 1.
11, 0.1, 1.001
12, 0.9, 1.001
13, 0.9, 2.
14, 0.1, 2.
21, -1., 0.
22, -0.01, 0.
23, -0.01, 1.
24, -1., 1.
31, 2., 2.
32, 0.1, 3.
"""


def write_decks(folder: Path) -> None:
    """Write the decks, and the results of each as CalculiX prints them."""
    (folder / "plane.inp").write_text(PLANE)
    (folder / "nodes.inp").write_text(NODES)
    (folder / "space.inp").write_text(STACK)
    (folder / "assembled.inp").write_text(ASSEMBLED)
    for name in ("plane", "space", "assembled"):
        (folder / f"{name}.dat").write_text(_results(folder / f"{name}.inp"))


_PRINTED: dict[str, str] = {}


def _results(file: Path) -> str:
    """Return the results of one of the decks above as CalculiX prints them, solved for once."""
    if file.name not in _PRINTED:
        deck = cq.read_deck(file)
        labels, moved = deck.displacements(cq.solve(deck.problem()).displacement)
        three = np.pad(moved, ((0, 0), (0, 3 - moved.shape[1])))
        rows = [f"{label:10d}" + "".join(f" {x:13.6E}" for x in row) for label, row in zip(labels, three, strict=True)]
        title = f" displacements (vx,vy,vz) for set EVERY and time {deck.model.end:14.7E}"
        _PRINTED[file.name] = "\n".join(["", title, "", *rows, ""])
    return _PRINTED[file.name]


def solve_deck(folder: Path, name: str) -> object:
    """Solve the exact problem of a deck and the one on its springs."""
    deck = cq.read_deck(folder / f"{name}.inp")
    solutions = [cq.solve(deck.problem(enforcement)) for enforcement in ("exact", "penalty")]
    return solutions, list(deck.ledger)


def judge_deck(folder: Path, name: str) -> object:
    """Judge the results that lie beside a deck."""
    return cq.crosscheck(folder / f"{name}.inp", folder / f"{name}.dat").summary()


def reworded(text: str, random: np.random.Generator) -> str:
    """Change some words of a deck for other words of it, or its numbers for near ones, so that it is mostly a deck."""
    lines = text.splitlines()
    places = [(at, words) for at, line in enumerate(lines) for words in [line.split(",")] if line.strip()]
    every = [word.strip() for _, words in places for word in words]
    for _ in range(int(random.integers(1, 4))):
        at, words = places[int(random.integers(0, len(places)))]
        place = int(random.integers(0, max(len(words), 1)))
        how = int(random.integers(0, 5))
        if how == 0 and words:
            words[place] = every[int(random.integers(0, len(every)))]
        elif how == 1 and words:
            words[place] = str(random.choice(["0", "-1", "1e30", "1e-30", "7", "S4", "2", "P2", "-0.001", "15"]))
        elif how == 2 and words:
            words.pop(place)
        elif how == 3:
            words.insert(place, every[int(random.integers(0, len(every)))])
        else:
            lines[at] = ",".join(words) + "\n" + ",".join(words)
            continue
        lines[at] = ",".join(words)
    return "\n".join(lines) + "\n"


def large_decks() -> dict[str, Callable[[], str]]:
    """Return by name what writes decks of quadratic tetrahedra, two bodies each whose meshes do not match."""
    found: dict[str, Callable[[], str]] = {}
    blocks = dict(divisions=((9, 9, 7), (8, 8, 5)))
    rings = dict(element="tet10", divisions=((6, 28, 3), (6, 24, 3)))
    for kind, stiff in STIFF.items():
        found[f"two blocks, {kind.lower()}"] = partial(two_blocks, "tet10", kind, stiff, **blocks)
        found[f"press fit, {kind.lower()}"] = partial(press_fit, kind, stiff, **rings)
    for kind, stiff in STIFF.items():  # in partial slip
        named = f"two blocks with friction, {kind.lower()}"
        found[named] = partial(two_blocks, "tet10", kind, stiff, **blocks, push=5e-4, friction="0.3, 1e7")
    return found


def used() -> tuple[float, float]:
    """Return the seconds of processors that this process and those that it ran have used."""
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime, others.ru_utime + others.ru_stime


def judge_large(folder: Path, word: str = "") -> bool:
    """Run CalculiX on the large decks, print a line for each, and return whether all are right in time."""
    print("| deck | unknowns | contacts | CalculiX | exact | off | a node | seconds | of processors | its own | ours |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    right = True
    for number, (name, deck) in enumerate(large_decks().items()):
        if word not in name:
            continue
        file = write(folder, deck(), f"deck{number}.inp")
        problem = cq.read_deck(file).problem()
        began, before = time.monotonic(), used()
        found = cq.crosscheck(file)
        whole = time.monotonic() - began
        (own, theirs), (pair,) = np.subtract(used(), before), found.pairs
        forces = f"{pair.resultant:.6g} | {pair.reference_resultant:.6g} | {pair.error:.1e} | {pair.node_error:.1e}"
        seconds = f"{whole:.0f} | {own + theirs:.0f} | {theirs:.0f} | {own:.0f}"
        print(f"| {name} | {problem.dimension} | {problem.contacts} | {forces} | {seconds} |", flush=True)
        right = right and found.passed and own + theirs < LIMIT
    print(
        f"\nLame's force of the press fit: {lame_force():.6g}; load of the machine at the end {os.getloadavg()[0]:.1f}"
    )
    return right


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="leave decks and answers there")
    parser.add_argument("word", nargs="?", default="", help="only the decks whose names have this word")
    keep, word = (parsed := parser.parse_args()).keep, parsed.word
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        sys.exit(not judge_large(keep, word))
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(not judge_large(Path(folder), word))


if __name__ == "__main__":
    main()
