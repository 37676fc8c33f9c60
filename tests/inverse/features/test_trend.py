"""A drift of unknown size beside a feature: looked for, and found where nobody stated it."""

import dataclasses

import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.scans import SCENES
from srsinv.inverse.diagnostics import Quality
from srsinv.inverse.features.method import FeatureFit
from srsinv.recorded import problem_of, ready
from tests.tiers import quick

TWO, ONE, _ = SCENES
CASES = [
    (scene, fault, drift)
    for scene, fault in [(TWO, "warm_up"), (TWO, "offset"), (ONE, "ramp"), (ONE, "slow_sine")]
    for drift in (None, "auto")
]


@pytest.mark.parametrize(("scene", "fault", "drift"), quick(CASES, CASES[0]))
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
