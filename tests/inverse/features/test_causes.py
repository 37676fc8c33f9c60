"""What a fit's misfit comes from: a cause that is no fact of the rig is named, with what it is."""

import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.scans import SCENES
from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.quality import Quality
from srsinv.recorded import problem_of, ready
from tests.tiers import hardest

SCENE = SCENES["strip, two elements"]
FIT = FeatureFit({"strip": SCENE.feature})
NAMED = {
    "low_pass": ("low_pass_Hz", 20.0, 1.0),
    "low_pass_strong": ("low_pass_Hz", 10.0, 0.5),
    "saturated": ("saturation", 1 - 0.9 * np.tanh(1 / 0.9), 0.02),
    "hum_weak": ("hum_Hz", 50.0, 0.1),
    "wrong_family": ("load_m", SCENE.truth["position_m"], 4e-4),
}


def fitted(fault: str, seed: int = 0) -> FeatureEstimate:
    return FIT(problem_of(ready(faulty(faults()[fault], SCENE, seed).recording)))


@pytest.mark.parametrize("fault", hardest(NAMED, ["low_pass"], ["saturated", "hum_weak"]))
def test_what_is_wrong_is_named_with_its_value(fault):
    name, value, within = NAMED[fault]
    estimate = fitted(fault)
    assert estimate.quality is Quality.DOUBTFUL
    assert [cause.name for cause in estimate.causes] == [name]
    assert estimate.causes[0].value == pytest.approx(value, abs=within)


def test_nothing_is_named_where_the_model_is_right():
    estimate = fitted("none")
    assert estimate.quality is Quality.GOOD
    assert estimate.causes == ()


@pytest.mark.full
def test_facts_are_named_where_they_end_on_a_bound():
    """A strip of another family drives the facts of the rig as far as they go."""
    estimate = fitted("wrong_family")
    assert estimate.fit is not None
    assert {"strip_width_1_m", "speed"} & {*estimate.fit.at_bound}
    assert {*estimate.budget.left} <= {*estimate.fit.names}
