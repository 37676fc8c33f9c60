"""Noise on cells that is found beside the signals: correlated, drifting, or none."""

import dataclasses

import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.hindsight import best_in_hindsight
from experiments.robustness.scans import RATE_HZ, SCENES, SPEED, ornstein_uhlenbeck, scan
from srsinv.inverse.estimate import coverage_90, relative_error
from srsinv.inverse.noise.correlated import cell_noise, with_found_noise
from srsinv.inverse.noise.whittle import CellSignals, Likelihood, SpectralBands
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.modules import with_fields
from srsinv.recorded import problem_of, ready
from tests.tiers import quick

DEPTH_M = 0.75e-3
TWO, ONE, _ = SCENES
SLOPE_STEP = 1e-5


def on_cells(made, drift=None, cell_m=2e-4):
    """The problem of a scan on cells, with the noise that is found."""
    recording = ready(made.recording)
    facts = recording.sidecar if drift is None else {**recording.sidecar, "drift": drift}
    friction = made.scene.friction if made.scene.elements == 1 else None
    stated = problem_of(
        dataclasses.replace(recording, sidecar=facts), friction=friction, cell_m=cell_m
    )
    return stated.to_grid()


def as_white(made, cell_m=5e-5, is_apart=True):
    """The problem of a scan on cells, its noise taken for white and its rig as it is stated;
    `is_apart`: whether p and q are told apart where there are two elements."""
    friction = None if made.scene.elements > 1 and is_apart else made.scene.friction
    stated = problem_of(ready(made.recording), friction=friction, cell_m=cell_m)
    noise = with_fields(stated.noise, is_estimate=False)
    return with_fields(stated, noise=noise, rig=None).to_grid()


def correlated(scene, seed, times, correlation_s):
    """A scan with noise that is correlated in time, so many times the white noise of a sample."""
    made = scan(SCENES[scene], np.random.default_rng(seed))
    own = ornstein_uhlenbeck(made.rng, made.signal.shape, 1 / RATE_HZ / correlation_s)
    return made.plus(times * made.scene.white * own)


@pytest.mark.parametrize("scene", [TWO, ONE])
@pytest.mark.parametrize("parts", [(False, False), (True, True)])
def test_slopes_of_the_likelihood_are_those_of_its_differences(scene, parts):
    made = scan(SCENES[scene], np.random.default_rng(0))
    likelihood = Likelihood(SpectralBands.of(CellSignals.of(as_white(made), DEPTH_M)), *parts)
    size = np.concatenate(likelihood.greatest()[1]).size
    x = 0.3 * np.random.default_rng(1).normal(size=size)
    _, slopes, _ = likelihood(x)
    off = SLOPE_STEP * np.eye(size)
    differences = [(likelihood(x + o)[0] - likelihood(x - o)[0]) / (2 * SLOPE_STEP) for o in off]
    assert slopes == pytest.approx(np.array(differences), rel=1e-5, abs=1e-4)


@pytest.mark.parametrize(
    ("scene", "is_apart"), quick([(TWO, True), (TWO, False), (ONE, True)], (ONE, True))
)
def test_a_scan_with_white_noise_has_no_more(scene, is_apart):
    """Of two elements with a known friction neither has room for a misfit."""
    for seed in range(4):
        made = scan(SCENES[scene], np.random.default_rng(seed))
        assert cell_noise(as_white(made, is_apart=is_apart), DEPTH_M) is None


def test_correlated_noise_is_found_at_its_level():
    """The power of its tail, 2 s^2 / l, is what short waves show: over draws within a fifth. The
    correlation is that of the time at the scan's speed."""
    times, correlation_s = 2.0, 0.01
    found = [
        cell_noise(as_white(correlated(TWO, seed, times, correlation_s)), DEPTH_M)
        for seed in range(8)
    ]
    assert all(found)
    assert not any(each.causes for each in found)  # no wrong fact explains it as well
    tails = [np.mean(each.correlated**2) / each.length_m for each in found]
    made = SCENES[TWO]
    true = (times * made.white) ** 2 / (correlation_s * SPEED)
    assert np.mean(tails) == pytest.approx(true, rel=0.2)
    lengths = np.exp(np.mean(np.log([each.length_m for each in found])))
    assert lengths == pytest.approx(correlation_s * SPEED, rel=0.5)


def test_what_is_found_has_the_signals_unit():
    made = correlated(TWO, 0, 2.0, 0.01)
    one = cell_noise(as_white(made), DEPTH_M)
    small = dataclasses.replace(made, signal=made.signal * 2.0**-40, noise=made.noise * 2.0**-40)
    other = cell_noise(as_white(small), DEPTH_M)
    assert other.correlated == pytest.approx(one.correlated * 2.0**-40, rel=1e-3)
    assert other.length_m == pytest.approx(one.length_m, rel=1e-3)


def test_noise_of_averages_is_found_as_any_other():
    """A mean over four passes has half the noise's level as a factor on it: the same noise."""
    grid = as_white(correlated(TWO, 0, 2.0, 0.01), cell_m=2e-4)
    half = np.full(np.shape(grid.data), 0.5)
    averaged = with_fields(grid, noise=4 * grid.noise, noise_scale=half)
    one, other = (with_found_noise(each, DEPTH_M) for each in (grid, averaged))
    assert len(one.warnings) == 1
    np.testing.assert_allclose(0.25 * other.noise[:, 1:], one.noise[:, 1:], rtol=1e-6)


FAULTS = [
    "correlated_20ms", "saturated", "pink_noise", "gain_of_one_20", "hum_50", "offset", "slow_sine",
]  # fmt: skip


@pytest.mark.parametrize("fault", quick(FAULTS, "correlated_20ms", "offset"))
def test_weights_by_the_evidence_are_near_the_best_in_hindsight(fault):
    """Where noise is taken for white, those of these faults are off by up to 5000 times."""
    made = faulty(faults()[fault], SCENES[TWO], 0)
    on = on_cells(made)
    truth, cells = made.traction(on.line), on.observed_cells
    estimate = Tikhonov()(on)
    error = relative_error(np.asarray(estimate.value), truth, cells)
    best = best_in_hindsight(on, truth)
    assert np.linalg.norm(error) < 1.5 * np.linalg.norm(best)
    assert min(coverage_90(*map(np.asarray, (estimate.value, estimate.stderr)), truth, cells)) > 0.8
    assert estimate.quality == "doubtful"


@pytest.mark.parametrize("fault", ["ramp", "warm_up", "slow_sine"])
@pytest.mark.parametrize("scene", quick([TWO, ONE], ONE))
def test_a_drift_that_is_named_is_no_traction(scene, fault):
    """Unnamed they are off by 75 to 1500 %."""
    made = faulty(faults()[fault], SCENES[scene], 0)
    on = on_cells(made, drift="auto")
    truth, cells = made.traction(on.line), on.observed_cells
    estimate = Tikhonov()(on)
    assert max(relative_error(np.asarray(estimate.value), truth, cells)) < 0.75
    assert min(coverage_90(*map(np.asarray, (estimate.value, estimate.stderr)), truth, cells)) > 0.8
