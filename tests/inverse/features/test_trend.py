"""A drift of unknown size beside a feature: looked for, and found where nobody stated it."""

import dataclasses

import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.scans import SCENES
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.quality import Quality
from srsinv.modules import with_fields
from srsinv.recorded import problem_of, ready
from tests.tiers import hardest

TWO, ONE, _ = SCENES
CASES = [
    (scene, fault, drift)
    for scene, fault in [
        (TWO, "warm_up"), (TWO, "offset"), (TWO, "step"), (ONE, "ramp"), (ONE, "slow_sine")
    ]
    for drift in (None, "auto")
]  # fmt: skip
SECOND = [(TWO, "warm_up", None), (TWO, "offset", "auto"), (ONE, "ramp", None)]


@pytest.mark.parametrize(("scene", "fault", "drift"), hardest(CASES, [(TWO, "step", None)], SECOND))
def test_a_drift_is_no_feature(scene, fault, drift):
    """By features alone pressure or friction is off by 20 to 400 %."""
    own = SCENES[scene]
    recording = ready(faulty(faults()[fault], own, 0).recording)
    recording = dataclasses.replace(recording, sidecar={**recording.sidecar, "drift": drift})
    estimate = FeatureFit({"one": own.feature})(problem_of(recording))
    read = estimate.parameters
    off = {name: read[name][0] - true for name, true in own.parameters.items()}
    assert all(abs(off[name]) < 4 * read[name][1] for name in off)
    true = np.array(list(own.parameters.values()))
    assert np.abs(np.array(list(off.values())) / true).max() < 0.05
    assert drift or estimate.quality is Quality.DOUBTFUL


@pytest.mark.full
def test_jumps_are_found_where_they_are():
    """Two jumps, one up on both elements and one down on one of them."""
    own = SCENES[TWO]
    problem = problem_of(ready(faulty(faults()["none"], own, 0).recording))
    data, time_s = np.array(problem.data), np.asarray(problem.motion.time_s)
    size, first, second = 0.3 * np.nanmax(np.abs(data)), time_s.size // 5, time_s.size // 2
    data[:, first:] += size
    data[1, second:] -= size
    estimate = FeatureFit({"one": own.feature})(with_fields(problem, data=data))
    assert estimate.quality is Quality.DOUBTFUL
    read = estimate.parameters
    for name, true in own.parameters.items():
        assert abs(read[name][0] - true) < 4 * read[name][1]
        assert read[name][0] == pytest.approx(true, rel=0.05)
