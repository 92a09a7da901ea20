"""What a test or a page registers as blocks of case files ends with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from contactqp.scene.blocks import BLOCKS, Frame
from contactqp.scene.claims import QUANTITIES
from contactqp.scene.scene import Scene
from contactqp.scene.schema import SceneData


@contextmanager
def registered_blocks() -> Iterator[None]:
    """Take back, at the end, every block that is registered within it."""
    before, quantities = dict(BLOCKS), dict(QUANTITIES)
    yield
    for key in BLOCKS.keys() - before.keys():
        del BLOCKS[key]
        for model in (Frame, SceneData, Scene):
            del model.model_fields[key]
            model.model_rebuild(force=True)
    QUANTITIES.clear()
    QUANTITIES.update(quantities)
