"""Positions in steps of an encoder: what they leave uncertain is in the errors of fits."""

import numpy as np
import pytest

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.feature import StripFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.inverse.features import FeatureFit
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.noise.model import SampleNoise
from srsinv.recorded import problem_of
from srsinv.recording import Recording

STEP_M, RATE_HZ, DEPTH_M = 1e-5, 1000.0, 0.75e-3
OWN = {"position_m": 3e-4, "width_m": 2.2e-3, "pressure_Pa": 5e3, "shear_Pa": 2750.0}
TRUTH = {"position_m": 3e-4, "width_m": 2.2e-3, "pressure_Pa": 5e3, "friction": 0.55}
SENSOR = Sensor(
    [Film(DEPTH_M, 0.0).with_strip_average()], HalfSpace(0.5, 7e5), CurrentAmplifier(1e6)
)


def fit(seed, step_m=STEP_M):
    """There and back over a strip, its positions in steps, from another origin each way; 2.03 steps
    in a sample, so that all places within a step come up."""
    rng = np.random.default_rng(seed)
    steady = np.full(700, 0.0203)
    turn = -steady[0] * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 80))
    speed = np.concatenate([steady, turn, -steady])
    motion = Motion.from_speed(np.arange(speed.size) / RATE_HZ, speed, -0.007)
    model = FeatureModel.along(SENSOR, motion, 1.7e-5).with_features({"it": StripFeature()})
    clean = np.asarray(model({"it": OWN}))
    rms = 0.01 * np.sqrt(np.mean(clean**2))
    signal = clean + rms * rng.normal(size=clean.shape)
    x = np.asarray(motion.position_m)
    if step_m:
        origin = np.where(speed >= 0, *rng.uniform(-0.5, 0.5, 2))
        x = step_m * np.round(x / step_m + origin)
    time_s, facts = np.asarray(motion.time_s), {}
    recording = Recording(signal, time_s, speed, ("a",), facts, measured_position_m=x)
    problem = problem_of(recording, SENSOR, noise=SampleNoise(rms))
    return FeatureFit({"it": StripFeature()})(problem)


def test_a_place_is_known_to_the_steps_of_the_positions():
    """About that of a mean over both ways, each off by what is uniform over a step."""
    rounded, exact = fit(0), fit(0, 0.0)
    about = STEP_M / np.sqrt(12) / np.sqrt(2)
    assert exact.parameters["position_m"][1] < 0.2 * about
    assert 0.8 * about < rounded.parameters["position_m"][1] < 2 * about
    assert rounded.parameters["friction"][1] > 1.5 * exact.parameters["friction"][1]
    assert (rounded.quality, exact.quality) == ("good", "good")


@pytest.mark.claim
def test_errors_hold_what_steps_leave_uncertain():
    scores = []
    for seed in range(1, 5):
        found = fit(seed).parameters
        scores.append([(found[name][0] - TRUTH[name]) / found[name][1] for name in TRUTH])
    assert np.max(np.abs(scores)) < 4
    assert np.sqrt(np.mean(np.square(scores))) < 1.4
