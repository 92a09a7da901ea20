"""The gallery of the cases: their pictures, and what their files say of them.

`python -m docs.generating.case_gallery` solves them all and draws the pictures anew, in a minute or two.
"""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterable
from pathlib import Path

from contactqp.scene.judging import judge_all
from contactqp.scene.scene import Scene, load_scene
from contactqp.scene.schema import PHYSICS
from contactqp.scene.shipped import shipped_files
from contactqp.study.answer_pictures import answer_pictures

PICTURES = Path(__file__).parents[1] / "static" / "cases"
# Pixels of a picture, and letters of what is said below it.
WIDTH, HEIGHT, LETTERS = 420, 320, 220


def gallery() -> str:
    """Return the page's part: the cases by what they are about, simple ones first."""
    scenes = [load_scene(file) for file in shipped_files()]
    sections = ((physics, [scene for scene in scenes if scene.physics == physics]) for physics in PHYSICS)
    return "\n\n".join(_section(physics, mine) for physics, mine in sections if mine)


def _section(physics: str, scenes: Iterable[Scene]) -> str:
    return f"## {physics.capitalize()}\n\n" + "\n\n".join(map(_entry, scenes))


def _entry(scene: Scene) -> str:
    name = name_of(scene)
    about = " ".join(scene.about.split())
    return (
        f"### {scene.title}\n\n![{scene.title}](static/cases/{name}.png)\n\n{_shortened(about)}\n\n"
        f"`contactqp run {name}` solves it; its file is `cases/{name}.toml`."
    )


def name_of(scene: Scene) -> str:
    """Return the name by which the command line knows a case."""
    return (scene.file or Path()).stem


def _shortened(text: str) -> str:
    """Return whole sentences of at most so many letters, or one."""
    kept = ""
    for sentence in _sentences(text):
        if kept and len(kept) + len(sentence) > LETTERS:
            break
        kept += sentence
    return kept.strip()


def _sentences(text: str) -> list[str]:
    """Return the sentences of a text, each with the blank after it."""
    return re.split(r"(?<=[.:] )(?=[A-Z])", text)


def picture(scene: Scene) -> bytes:
    """Return the small picture of a case's answer, its history where it moves; PNG."""
    from PIL import Image

    drawn = answer_pictures(judge_all(scene, ("active-set",))[0])
    png = drawn.history if scene.motion is not None else drawn.answer
    if png is None:
        raise ValueError(f"{scene.file}: {drawn.why_not}")
    small = io.BytesIO()
    with Image.open(io.BytesIO(png)) as image:
        reduced = image.convert("RGB")
        reduced.thumbnail((WIDTH, HEIGHT))
        reduced.quantize(32, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return small.getvalue()


if __name__ == "__main__":
    PICTURES.mkdir(parents=True, exist_ok=True)
    for file in shipped_files():
        if not sys.argv[1:] or file.stem in sys.argv[1:]:
            (PICTURES / f"{file.stem}.png").write_bytes(picture(load_scene(file)))
