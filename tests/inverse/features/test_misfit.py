"""What a fit leaves: whether it lies where the feature is, and what it adds to the errors."""

import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.scans import SCENES
from srsinv import false_alarm
from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.feature import HertzFeature, StripFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.inverse.features import FeatureFit
from srsinv.inverse.features.misfit import local_excess
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.noise.sliding import Levels, estimate
from srsinv.inverse.problem import Problem
from srsinv.inverse.quality import Quality
from srsinv.jobs._budget import budget_variables
from srsinv.recorded import problem_of, ready

N, DEPTH_M = 600, 0.75e-3
X = np.linspace(0.0, 0.02, N)
FITTED = 1e-4 * np.stack([np.exp(-(((X - 0.01) / 1e-3) ** 2)), 0 * X])
LEVELS = Levels(np.array([1e-6, 2e-6]), 4e-7, 2e-4)


def noise(rng):
    """Noise of the levels, (2, N)."""
    decay = np.exp(-(X[1] - X[0]) / LEVELS.correlation_m)
    slow = rng.normal(size=(2, N))
    for i in range(1, N):
        slow[:, i] = decay * slow[:, i - 1] + np.sqrt(1 - decay**2) * slow[:, i]
    return LEVELS.sliding * slow + LEVELS.white[:, None] * rng.normal(size=(2, N))


def whitened(residual, levels):
    """The residual in units of the noise, NaN where it is missing."""
    observed = np.isfinite(residual)
    white = levels.whitener(X, observed)(np.where(observed, residual, 0.0))
    return np.where(observed, np.asarray(white).reshape(residual.shape), np.nan)


def excess(residual):
    """With levels that are taken from the residual, as a fit does."""
    levels = estimate(residual, X, DEPTH_M)
    return local_excess(whitened(residual, levels), FITTED, X, DEPTH_M)


@pytest.mark.parametrize("missing", [False, True])
def test_a_misfit_where_the_feature_is_is_found(missing):
    residual = noise(np.random.default_rng(0)) + 0.03 * np.roll(FITTED, 15, axis=1)
    if missing:
        residual[:, ::7] = np.nan
    assert excess(residual) > 2


def test_flanks_that_are_missed_where_the_signal_is_small_are_found():
    flank = np.exp(-(((np.abs(X - 0.01) - 1.6e-3) / 3e-4) ** 2))
    residual = noise(np.random.default_rng(0)) + 5e-6 * np.stack([flank, -flank])
    assert excess(residual) > 1.5


def test_the_same_misfit_elsewhere_is_noise():
    residual = noise(np.random.default_rng(0)) + 0.03 * np.roll(FITTED, 250, axis=1)
    assert excess(residual) == 1.0


def test_stationary_noise_is_hardly_ever_found():
    """Of as many draws as the stated probability makes one of in twenty."""
    rng, draws = np.random.default_rng(3), round(0.05 / false_alarm.CHECK)
    excesses = [
        local_excess(whitened(noise(rng), LEVELS), FITTED, X, DEPTH_M) for _ in range(draws)
    ]
    assert sum(each > 1 for each in excesses) <= 2


def white(rng, taken=None):
    """White noise (2, N), less its part along the columns of `taken` (2, N, m)."""
    draw = rng.normal(size=(2, N))
    if taken is None:
        return draw
    basis = np.linalg.qr(taken.reshape(2 * N, -1))[0]
    return draw - (basis @ (basis.T @ draw.ravel())).reshape(2, N)


def test_what_the_fit_takes_out_hides_no_misfit():
    """With seven parameters of a small feature most of the noise there is gone: what is left is
    judged by that, and as noise it says nothing."""
    taken = np.stack([np.roll(FITTED, shift, axis=1) for shift in range(-90, 91, 30)], axis=-1)
    rng, draws = np.random.default_rng(5), 25
    sound = [white(rng, taken) for _ in range(draws)]
    assert sum(local_excess(each, FITTED, X, DEPTH_M, taken) > 1 for each in sound) <= 1
    small = 0.45 * np.cos(2 * np.pi * X / 1.3e-3) * (FITTED[0] > 3e-5)
    found = [local_excess(each + small, FITTED, X, DEPTH_M, taken) > 1 for each in sound]
    blind = [local_excess(each + small, FITTED, X, DEPTH_M) > 1 for each in sound]
    assert sum(found) > sum(blind)


def test_a_level_that_is_known_roughly_is_no_misfit():
    rng = np.random.default_rng(6)
    wide = np.ones((2, N)) * 1e-4  # a signal everywhere
    sound = [1.1 * white(rng) for _ in range(20)]
    assert any(local_excess(each, wide, X, DEPTH_M) > 1 for each in sound)
    assert not any(local_excess(each, wide, X, DEPTH_M, None, 0.07) > 1 for each in sound)


def test_passes_of_one_place_are_apart():
    """A misfit that turns its sign with the motion does not cancel."""
    there_and_back = np.concatenate([X[::2], X[::-2]])
    both = np.concatenate([FITTED[:, ::2], -FITTED[:, ::-2]], axis=1)
    residual = white(np.random.default_rng(7)) + 1.2e4 * both
    assert local_excess(residual, both, there_and_back, DEPTH_M) > 2


def test_a_stated_noise_hides_no_wrong_feature():
    """In 16,000 samples, most of them of noise alone, a wrong shape makes a tenth of chi-square."""
    films = [Film(DEPTH_M, angle).with_strip_average() for angle in (0.0, np.pi / 4)]
    sensor = Sensor(films, HalfSpace(0.5, 7e5), CurrentAmplifier(1e6))
    motion = Motion.from_speed(np.arange(8000) / 8000, np.full(8000, 0.02), -0.01)
    model = FeatureModel.along(sensor, motion, 1.7e-5).with_features({"it": HertzFeature()})
    own = {"position_m": 3e-4, "half_width_m": 1.4e-3, "pressure_Pa": 5e3, "shear_Pa": 2e3}
    clean = np.asarray(model({"it": own}))
    rms = 0.4 * np.sqrt(np.mean(clean**2))
    y = clean + rms * np.random.default_rng(1).normal(size=clean.shape)
    problem = Problem(sensor, motion, y, rms)
    right, wrong = (FeatureFit({"it": each})(problem) for each in (HertzFeature(), StripFeature()))
    assert right.quality == "good"
    assert wrong.chi2_per_freedom < 1.15
    assert wrong.quality == "doubtful"


@pytest.mark.full
@pytest.mark.parametrize("fault", ["quantised", "depth_sagging"])
def test_a_misfit_is_in_the_standard_errors(fault):
    """By the noise alone a parameter is off by 3.5 to 4.5 standard errors."""
    own = SCENES["strip, two elements"]
    problem = problem_of(ready(faulty(faults()[fault], own, 0).recording))
    estimate = FeatureFit({"one": own.feature})(problem)
    assert estimate.quality is Quality.DOUBTFUL
    (_, remedies, _) = budget_variables(estimate, problem.rig)["remedy"]
    assert all(remedies)
    for name, true in own.parameters.items():
        value, stderr = estimate.parameters[name]
        assert abs(value - true) < 3 * stderr < np.inf
        parts = estimate.budget.parts[name]
        assert parts["misfit"] > 0
        assert stderr == pytest.approx(np.linalg.norm(list(parts.values())), rel=1e-6)
