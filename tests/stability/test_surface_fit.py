"""A ridge fitted through contact where the signal hardly holds it: no number that looks sure.

In `make claims` alone: tests/inverse/features/test_surface_fit.py fits ridges, and noise alone, and
test_feature_fit.py is honest about features of traction.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface_feature import RidgeFeature
from srsinv.inverse.features.fit import FeatureFitter
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.gridding.cells import Window

pytestmark = pytest.mark.claim

DEPTH_M, EDGE_M, PRESSURE_PA, MU = 0.75e-3, 1e-4, 2e4, 0.4
WINDOW = Window(-6e-3, 6e-3)
MOTION = Motion.from_speed(np.arange(61) / 600, 0.05, -2.5e-3)
RIDGE = {"height_m": 3e-5, "width_m": 0.8e-3, "position_m": 0.4e-3}
FEATURES = {"ridge": RidgeFeature(EDGE_M)}
DRAWN = np.random.default_rng(0).normal(size=(2, 61))
MAX_ERROR_SIGMA = 5  # standard errors from the truth at most


@cache
def sensor():
    width = StripAverage.at_depth(0.7e-3, DEPTH_M)
    films = [Film(DEPTH_M, angle, effects=[width]) for angle in (0.0, np.pi / 2)]
    return Sensor(films, HalfSpace(), CurrentAmplifier(1e6))


@cache
def fitter():
    return FeatureFitter.on_window(sensor(), MOTION, FEATURES, WINDOW, PRESSURE_PA)


@cache
def simulate_ridge():
    """The clean signal, on cells in no simple ratio to the fit's, and its noise."""
    model = FeatureModel.on_window(
        sensor(), MOTION, WINDOW, EDGE_M / 41, PRESSURE_PA
    ).with_features(FEATURES)
    own = RIDGE | {"edge_length_m": EDGE_M}
    rest = {"nominal_pressure_Pa": PRESSURE_PA, "gain": 1.0, "base_friction": MU}
    signal = np.asarray(model(jax.tree.map(jnp.asarray, rest | {"ridge": own})))
    return signal, 0.01 * float(np.sqrt(np.mean(signal**2)))


def test_a_plain_ridge(margin):
    """So that honesty below is not silence."""
    signal, noise = simulate_ridge()
    estimate = fitter()(FEATURES, signal + noise * DRAWN, noise)
    assert estimate.status == "converged"
    assert estimate.undetected == ()
    for name, true in (RIDGE | {"base_friction": MU}).items():
        value, stderr = estimate.parameters[name]
        margin(abs(value - true) / stderr, MAX_ERROR_SIGMA)
        assert abs(value - true) < MAX_ERROR_SIGMA * stderr < np.inf, name


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_no_height(level):
    """Nothing at all, and noise alone."""
    noise = simulate_ridge()[1]
    estimate = fitter()(FEATURES, level * noise * DRAWN, noise)
    assert estimate.undetected == ("ridge",)
    values, errors = np.array(list(estimate.parameters.values())).T
    assert np.isfinite(values).all()
    assert np.isposinf(errors).all()


def test_an_outlier():
    signal, noise = simulate_ridge()
    y = signal + noise * DRAWN
    y[0, 20] += 1e6 * noise
    estimate = fitter()(FEATURES, y, noise)
    assert np.isfinite([value for value, _ in estimate.parameters.values()]).all()
    assert not estimate.explains
