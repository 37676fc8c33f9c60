"""A recording to its problem: the same from Python as from the command."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

import srsinv
from srsinv import config
from srsinv.inverse.wiener import Wiener
from srsinv.recorded import problem_of, ready
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


WIRED = {  # the films that the channels read, and with which sign
    "exchanged": ([1, 0], [1.0, 1.0]),
    "turned": ([0, 1], [1.0, -1.0]),
}


@pytest.mark.parametrize("case", quick(WIRED, "exchanged"))
def test_elements_wired_otherwise_beyond_doubt_give_the_answer_of_those_wired_right(case):
    films, signs = WIRED[case]
    loaded = srsinv.load(EXAMPLE)
    right = ready(replace(loaded, sidecar={**loaded.sidecar, "tolerance": "none"}))
    wrong = replace(right, signal=np.array(signs)[:, None] * right.signal[films])
    expected, got = (Wiener()(problem_of(each)) for each in (right, wrong))
    scale = np.abs(expected.value).max(axis=-1, keepdims=True)
    np.testing.assert_allclose(got.value / scale, expected.value / scale, atol=1e-6)
    assert got.quality == "doubtful"
    kept = replace(wrong, sidecar={**wrong.sidecar, "wiring": "as_stated"})
    (sentence,) = problem_of(kept).warnings
    assert sentence in got.warnings[0]
    for one, other in zip(*(jax.tree.leaves(problem_of(each).sensor) for each in (kept, right)),
                          strict=True):  # fmt: skip
        np.testing.assert_array_equal(one, other)
