"""A hundred different configurations in one process, as a sweep or a notebook would run them."""

import itertools
import random
from pathlib import Path

import pytest

from srsinv.__main__ import main
from tests.stability.test_process import needs_statm, resident_bytes

COUNT = 100
MOST_GROWTH_BYTES = 2**30
MOST_MAPS = 15_000
SCENES = ("pressed_strip", "strip", "hertz", "sinusoid", "ridge", "tape", "rough")
CELLS = (32, 48, 64, 96)
REST = (
    ("method=[wiener]",),
    ("method=[tikhonov]", "effects=[strip_width,layered_skin]"),
    ("method=[wiener_evidence]", "precision=float32"),
    ("method=[wiener]", "grid.line=open"),
)


@needs_statm
@pytest.mark.claim
def test_a_hundred_configurations(tmp_path, margin):
    """Memory and memory maps stay within bounds: compiled programs are let go of."""
    every = list(itertools.product(SCENES, CELLS, REST))
    random.Random(0).shuffle(every)
    held = most_maps = 0
    for number, (scene, cells, rest) in enumerate(every[:COUNT]):
        grid = (f"grid.cells={cells}", "grid.refinement=2", f"scene={scene}")
        assert main([*grid, *rest, f"hydra.run.dir={tmp_path / str(number)}"]) == 0
        held = held or resident_bytes()
        most_maps = max(most_maps, Path("/proc/self/maps").read_bytes().count(b"\n"))
        assert resident_bytes() - held < MOST_GROWTH_BYTES, number
        assert most_maps < MOST_MAPS, number
    margin(resident_bytes() - held, MOST_GROWTH_BYTES)
