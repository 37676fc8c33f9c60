"""Noise that differs from element to element, and a drift that forgets itself."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from srsinv.forward.scan import ConstantSpeed
from srsinv.grid import Open
from srsinv.inverse.line.solve import solve
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.noise.quiet import quiet_noise
from srsinv.inverse.problem import Problem
from srsinv.modules import with_fields
from srsinv.recorded import noise_of
from srsinv.recording import Recording
from srsinv.recording.mains import mains_lines
from tests.inverse.noise import test_nuisance as scene
from tests.refusals import refused

SEED = np.random.default_rng
RATE_HZ, COUNT = 1000.0, 4000


def forgetful(time_s, rate, forgotten_s):
    """The covariance of a drift that forgets itself after a time."""
    lag = np.abs(time_s[:, None] - time_s)
    return rate**2 * forgotten_s / 2 * np.exp(-lag / forgotten_s)


def drifting(rng, rate, forgotten_s, n=COUNT):
    """A draw of it; of an infinite time a random walk."""
    decay = np.exp(-1 / RATE_HZ / forgotten_s)
    step = rate * np.sqrt(
        1 / RATE_HZ if np.isinf(forgotten_s) else forgotten_s * (1 - decay**2) / 2
    )
    first = 0.0 if np.isinf(forgotten_s) else rate * np.sqrt(forgotten_s / 2) * rng.normal()
    return scipy.signal.lfilter(
        [1.0], [1.0, -decay], step * rng.normal(size=n), zi=[decay * first]
    )[0]


@pytest.mark.parametrize("samples", [1, 4, 15])
def test_the_power_of_a_drift_is_that_of_means_of_samples(samples):
    n, cell = 40, 1e-4
    noise = SampleNoise(1e-6, drift=2.0, drift_time_s=0.02)
    line, scan = Open(n, cell, 0.0), ConstantSpeed(0.02)
    lags = np.fft.irfft(np.asarray(noise.power(line, scan, 1.0, float(samples)))[0], n)
    time_s = np.arange(n * samples) * cell / 0.02 / samples
    means = np.kron(np.eye(n), np.full(samples, 1 / samples))
    exact = means @ forgetful(time_s, 2.0, 0.02) @ means.T
    # Around a circle what is far on one side is near on the other.
    np.testing.assert_allclose(lags[: n // 2], exact[0, : n // 2], rtol=1e-9)


@pytest.mark.full
def test_bands_are_those_of_each_elements_own_noise():
    """Against dense algebra with the exact covariance of each element's samples."""
    rates, times = (40e-6, 10e-6), (0.05, np.inf)
    white = np.array([1.0, 3.0]) * scene.NOISE
    noise = SampleNoise(white, drift=rates, drift_time_s=times)
    given = with_fields(scene.problem(np.zeros((2, scene.COUNT))), noise=noise)
    gridded = given.to_grid()
    model, (prior, precision) = scene.model_of(gridded), scene.penalty(gridded.line)
    block = scene.COUNT // model.shape[1]
    means = np.kron(np.eye(model.shape[1]), np.full(block, 1 / block))
    time_s = scene.TIME_S[: means.shape[1]]
    walk = rates[1] ** 2 * np.minimum(time_s[:, None], time_s)
    slow = forgetful(time_s, rates[0], times[0]), walk
    exact = [means @ (own + w**2 * np.eye(time_s.size)) @ means.T
             for own, w in zip(slow, white, strict=True)]  # fmt: skip
    _, covariance = scene.estimator(model, exact, precision)
    estimate = solve(gridded, prior, "direct")
    cells = gridded.observed_cells
    centre = np.eye(len(covariance)) - np.asarray(gridded.mean_weights)[0]
    floor = np.sqrt(np.diag(centre @ covariance @ centre.T))[cells]
    ours = np.asarray(estimate.stderr)[0, cells]
    assert 0.99 < np.sqrt(np.mean(ours**2) / np.mean(floor**2)) < 1.05


def test_elements_and_levels_have_to_be_as_many():
    three = SampleNoise([1e-6, 2e-6, 3e-6])
    known = scene.problem(np.zeros((2, scene.COUNT)))
    refused(
        lambda: Problem(known.sensor, known.motion, known.data, three), "3 noise levels", "2 elem"
    )


def standing(rng, white, rates, times, hum=0.0, still=0.5):
    """A recording that stands still for a part of its time and then slides over something."""
    time_s = np.arange(COUNT) / RATE_HZ
    start = int(still * COUNT)
    position = 0.02 * np.maximum(time_s - time_s[start], 0)
    felt = 50 * np.sin(2 * np.pi * position / 3e-3)
    drift = [drifting(rng, *each) for each in zip(rates, times, strict=True)]
    noise = np.array(white)[:, None] * rng.normal(size=(2, COUNT)) + np.array(drift)
    waves = hum * np.sin(2 * np.pi * 50.1 * time_s + np.array([[0.3], [1.0]]))
    speed = np.where(np.arange(COUNT) >= start, 0.02, 0.0)
    return Recording(felt + noise + waves, time_s, speed, ("a", "b"), {"quiet_s": "auto"})


@pytest.mark.parametrize("hum", [0.0, 30.0])
@pytest.mark.full
def test_noise_is_measured_where_the_sensor_stands_still(hum):
    white, rates, times = (1.0, 3.0), (20.0, 0.0), (0.02, np.inf)
    found = []
    for seed in range(4):
        recording = standing(SEED(seed), white, rates, times, hum)
        lines = mains_lines(recording.signal, RATE_HZ, [50.0]) if hum else ()
        found.append(quiet_noise(recording, lines))
    assert np.mean([each.white for each in found], axis=0) == pytest.approx(white, rel=0.05)
    assert np.mean([each.drift[0] for each in found]) == pytest.approx(20.0, rel=0.15)
    assert np.median([each.drift_time_s[0] for each in found]) == pytest.approx(0.02, rel=0.4)
    assert [each.drift[1] for each in found] == [0.0] * 4


@pytest.mark.full
def test_a_walk_is_taken_as_one():
    found = [
        quiet_noise(standing(SEED(seed), (1.0, 1.0), (10.0, 10.0), (np.inf, np.inf)))
        for seed in range(3)
    ]
    assert np.isinf([each.drift_time_s for each in found]).mean() > 0.8
    assert np.mean([each.drift for each in found]) == pytest.approx(10.0, rel=0.15)


def test_stretches_may_be_named_and_have_to_hold_samples():
    recording = standing(SEED(9), (1.0, 1.0), (0.0, 0.0), (np.inf, np.inf))
    for pairs in ([0.1, 1.9], [[0.1, 0.9], [1.1, 1.9]]):
        named = replace(recording, sidecar={"quiet_s": pairs})
        assert np.asarray(noise_of(named, 1e-3).white) == pytest.approx(1.0, rel=0.08)
    few = replace(recording, sidecar={"quiet_s": [0.1, 0.15]})
    refused(lambda: noise_of(few, 1e-3), "selects 51 samples", "longer stretches")
    last, spacing = float(recording.time_s[-1]), 1 / RATE_HZ
    for pairs in ([0.0, 100.0], [-0.5, 0.5], [[0.1, 0.9], [0.9, last + 1.5 * spacing]]):
        beyond = replace(recording, sidecar={"quiet_s": pairs})
        refused(
            lambda given=beyond: noise_of(given, 1e-3), "recording.quiet_s", "within the recording"
        )
    to_the_end = replace(recording, sidecar={"quiet_s": [0.0, last + 0.5 * spacing]})
    assert np.isfinite(noise_of(to_the_end, 1e-3).white).all()
    moving = standing(SEED(9), (1.0, 1.0), (0.0, 0.0), (np.inf, np.inf), still=0.0)
    refused(lambda: noise_of(moving, 1e-3), "selects 0 samples", "[start, end]")
