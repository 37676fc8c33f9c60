"""Features fitted to long recordings: in the stretch where the signal is."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.feature import LineFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import LineLoad
from srsinv.grid import Open
from srsinv.inverse.features import FeatureFit, FeatureFitter
from srsinv.inverse.features.window import stretch_of
from srsinv.inverse.problem import Problem
from tests.inverse.cases import DEPTH_M, signals_along

SPEED_M_PER_S, A_DEPTH = 0.05, 4  # samples
FEATURES = {"line": LineFeature()}


def recording(depths, places=(0.6,), loads=(8.0,), noise=0.02):
    """Two elements over line loads [N/m] at these fractions of so many depths, in white noise
    of this fraction of the signal's peak."""
    sensor = Sensor((Film(DEPTH_M), Film(DEPTH_M, np.pi / 2)))
    time_s = np.arange(depths * A_DEPTH) * DEPTH_M / A_DEPTH / SPEED_M_PER_S
    motion = Motion.from_speed(time_s, np.full(time_s.shape, SPEED_M_PER_S), 0.0)
    x, cell = np.asarray(motion.position_m), DEPTH_M / 20
    line = Open(int((x[-1] + 32 * DEPTH_M) / cell), cell, -16 * DEPTH_M)
    p = sum(
        load * np.asarray(LineLoad(1.0, place * x[-1]).cell_values(line))
        for load, place in zip(loads, places, strict=True)
    )
    clean = signals_along(sensor, line, motion, np.stack([p, 0.4 * p]))
    level = noise * np.abs(clean).max()
    drawn = level * np.random.default_rng(0).normal(size=clean.shape)
    return Problem(sensor, motion, clean + drawn, level)


@pytest.fixture(scope="module")
def both():
    """Estimates of a load and of nothing, from the stretch and from the whole recording."""
    problem = recording(300, noise=0.1)
    samples, method = problem.samples(), FeatureFit(FEATURES)
    fitter = FeatureFitter.along(samples.sensor, samples.motion)
    candidates = FEATURES, {}
    stretch = [method.candidate(each, problem) for each in candidates]
    whole = [fitter(each, samples.signal, samples.noise) for each in candidates]
    return stretch, whole


@pytest.mark.full
def test_the_stretch_tells_what_the_whole_recording_tells(both):
    (ours, _), (whole, _) = both
    assert ours.data.shape[1] < 0.5 * whole.data.shape[1]
    for name, (value, stderr) in whole.parameters.items():
        assert abs(ours.parameters[name][0] - value) < 0.15 * stderr
        assert ours.parameters[name][1] == pytest.approx(stderr, rel=0.01)


@pytest.mark.full
def test_the_evidence_is_that_of_a_load_anywhere_in_the_recording(both):
    """Noise elsewhere makes a load neither more probable nor less."""
    ours, whole = ([each.log_evidence for each in estimates] for estimates in both)
    assert ours[0] - ours[1] == pytest.approx(whole[0] - whole[1], abs=0.3)


@pytest.mark.full
def test_the_stretch_does_not_grow_with_the_recording():
    short, long = (stretch_of(recording(depths), FEATURES) for depths in (300, 1200))
    assert short.is_part
    assert long.window.length_m < 1.1 * short.window.length_m
    place = 0.6 * float(long.whole.end_m)
    assert long.window.start_m + 15 * DEPTH_M < place < long.window.end_m - 15 * DEPTH_M


@pytest.mark.full
def test_a_short_recording_is_whole():
    problem = recording(90)
    stretch = stretch_of(problem, FEATURES)
    assert stretch.problem is problem
    assert not stretch.is_part
    assert not stretch.warnings


@pytest.mark.full
def test_what_is_left_out_is_said():
    problem = recording(300, (0.1, 0.7), (8.0, 16.0))
    stretch = stretch_of(problem, FEATURES)
    end = float(stretch.whole.end_m)
    assert stretch.window.start_m < 0.7 * end < stretch.window.end_m
    (warning,) = stretch.warnings
    assert f"{stretch.elsewhere_m:.6g} m: give the feature's position_range_m" in warning
    assert stretch.elsewhere_m == pytest.approx(0.1 * end, abs=8 * DEPTH_M)
    chosen = {"line": LineFeature(position_range_m=(0.0, 0.4 * end))}
    near = stretch_of(problem, chosen)
    assert near.window.start_m < 0.1 * end < near.window.end_m
    assert near.elsewhere_m is None


@pytest.mark.full
def test_a_scan_of_a_wrong_unit_is_refused():
    """Before a stretch of a few samples is cut out of it."""
    time_s = np.arange(400) / 2000
    motion = Motion.from_speed(time_s, np.full(400, 2e3), 0.0)
    problem = Problem(Sensor((Film(DEPTH_M),)), motion, np.sin(time_s)[None], 0.1)
    with pytest.raises(BadInput, match=r"check the units of recording\.speed_m_per_s"):
        stretch_of(problem, FEATURES)


@pytest.mark.full
def test_a_range_beside_the_scan_is_refused():
    with pytest.raises(BadInput, match="no sample lies in the feature's position_range_m"):
        stretch_of(recording(300), {"line": LineFeature(position_range_m=(5.0, 6.0))})
