"""Whether what a fit leaves lies where the feature is."""

import numpy as np
import pytest

from srsinv.inverse.features.misfit import FALSE_ALARM, local_excess
from srsinv.inverse.features.sliding_noise import Levels, estimate

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


def excess(residual):
    """With levels that are taken from the residual, as a fit does."""
    return local_excess(residual, FITTED, X, DEPTH_M, estimate(residual, X, DEPTH_M))


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
    rng, draws = np.random.default_rng(3), round(0.05 / FALSE_ALARM)
    excesses = [local_excess(noise(rng), FITTED, X, DEPTH_M, LEVELS) for _ in range(draws)]
    assert sum(each > 1 for each in excesses) <= 2
