"""A recording to its problem: the same from Python as from the command."""

from pathlib import Path

import jax
import numpy as np
import pytest

import srsinv
from srsinv import config
from srsinv.recorded import problem_of
from tests.jobs.run import composed
from tests.tiers import quick

EXAMPLE = Path(srsinv.__file__).parent / "examples" / "strip_two_element.csv"
PREPARED = {  # facts of the example that change its noise, its signal or its motion
    "as it is": [],
    "high-pass": ["recording.high_pass_Hz=5"],
    "quiet": ["recording.quiet_s=[[0,0.1]]", "recording.detrend=linear"],
    "mains": ["recording.mains_Hz=[50]", "recording.notch_Hz=[100]", "recording.notch_width_Hz=4"],
}


@pytest.mark.parametrize("case", quick(PREPARED, "high-pass"))
def test_a_recording_is_the_same_problem_from_python_and_from_the_command(case):
    typed = ["experiment=invert_recording", f"recording.path={EXAMPLE}", *PREPARED[case]]
    cfg = composed(*typed)
    recording = config.recording(cfg)
    by_command, by_python = config.recorded_problem(cfg, recording), problem_of(recording)
    assert by_command.warnings == by_python.warnings
    for one, other in zip(*map(jax.tree.leaves, (by_command, by_python)), strict=True):
        np.testing.assert_array_equal(one, other)
