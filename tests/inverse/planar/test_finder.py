"""Directions of gratings from one pass: equivalent angles beside a prior, and refusals."""

import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.forward.planar import PathScan, StraightPass
from srsinv.forward.sensor import Sensor
from srsinv.grid import as_real
from srsinv.inverse.planar.finder import DirectionFinder
from srsinv.inverse.planar.signal import GratingShape, RidgeShape
from tests.refusals import refused

SENSOR = Sensor([Film(length_m=4e-3, turn_rad=turn) for turn in (0.3, 1.9)])
SCAN = PathScan(SENSOR, StraightPass(0.4, 0.05, 0.2, 64))
RANGES = {"pitch_m": (2e-3, 3e-3), "distance_m": (-2e-3, 2e-3)}
TRUTH = {"angle_deg": 10.0, "distance_m": 5e-4, "pitch_m": 2.5e-3, "load_N_per_m": 2.0,
         "shear_N_per_m": -0.8}  # fmt: skip


def finder(angle_deg: float, distance_m: float) -> DirectionFinder:
    priors = {"angle_deg": (angle_deg, 5.0), "distance_m": (distance_m, 2e-4),
              "pitch_m": (2.5e-3, 1e-3)}  # fmt: skip
    return DirectionFinder(SCAN, GratingShape(harmonics=1), RANGES, priors)


@pytest.fixture(scope="module")
def signal():
    made = finder(10.0, 5e-4).signal({name: as_real(each) for name, each in TRUTH.items()})
    return np.asarray(made)


@pytest.mark.full
@pytest.mark.parametrize("half_turns", [-1, 0, 1, 2])
def test_a_prior_is_of_the_feature_at_any_equivalent_angle(signal, half_turns):
    """Turned by 180 degrees with -d it is the same ridge; the prior is 2 degrees off the truth."""
    mean = 12.0 + 180.0 * half_turns, 5e-4 * (-1) ** half_turns
    noise = 1e-3 * np.abs(signal).max()
    found = finder(*mean)(signal, noise)
    value, stderr = found.parameters["angle_deg"]
    assert abs(value - 10.0) < 0.05 < 100 * stderr
    assert abs(found.parameters["distance_m"][0] - 5e-4) < 2e-5
    assert abs(float(found.fit.value["angle_deg"]) - mean[0]) < 3.0


@pytest.mark.full
def test_noise_is_of_the_signal(signal):
    find = finder(10.0, 5e-4)
    refused(lambda: find(signal, np.ones(2)), "(2,)", "(2, 1)")
    refused(lambda: find(signal, 0.0), "above 0")


def test_refused():
    one = PathScan(Sensor(SENSOR.elements[:1]), SCAN.path)
    refused(lambda: DirectionFinder((), RidgeShape()), "no scan")
    refused(lambda: DirectionFinder((SCAN, one), RidgeShape()), "[1, 2] elements")
    wrong = {"width": (1e-4, 1e-3)}
    refused(lambda: DirectionFinder(SCAN, RidgeShape(), wrong), "'width'", "width_m")
