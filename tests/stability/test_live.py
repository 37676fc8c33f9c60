"""Live inversion far from ordinary numbers: finite, positive and steady over thousands of cells."""

import numpy as np
import pytest

from srsinv import Film, Live, Sensor, Tikhonov, Wiener
from srsinv.inverse.live.smoother import Measurement
from srsinv.inverse.wiener import Exponential
from tests.tiers import quick

CELLS = 3000
CASES = {
    "no_noise": {"noise": 0.0},
    "140_dB": {"noise": 1e-14},
    "-60_dB": {"noise": 1e6},
    "alike": {"angles": (0.0, 1e-4)},
    "shallow": {"depth_m": 5e-5},
    "deep": {"depth_m": 2e-2},
    "wide_strip": {"width_m": 8e-3},
    "penalty_on_curvature": {"prior": Tikhonov(2, weight_p=1e-8, weight_q=1e-8)},
    "correlated_over_the_memory": {"prior": 1.0},
    "white": {"prior": 1e-7},
}


def model_of(angles=(0.0, np.pi / 2), depth_m=0.75e-3, width_m=0.7e-3, prior=4e-4, noise=1e-4):
    """The model of a case, and its noise."""
    films = [Film(depth_m, angle, width_m).with_strip_average() for angle in angles]
    if isinstance(prior, float):
        prior = Wiener(p=Exponential(1e3, prior), q=Exponential(1e3, prior))
    live = Live(Sensor(films), prior, lag_m=2 * depth_m)
    return live._model.space, live._state.one_pass.smoother, noise


@pytest.mark.parametrize(
    "case", quick(CASES, "no_noise", "140_dB", "alike", "penalty_on_curvature")
)
def test_filter_stays_positive(case):
    space, smoother, noise = model_of(**CASES[case])
    rng = np.random.default_rng(0)
    signals = rng.normal(size=(CELLS, 2))
    none = np.zeros(2), np.zeros((2, 0)), np.zeros(0)
    variances = []
    for i, signal in enumerate(signals):
        given = np.where(rng.random(2) < 0.1, np.nan, signal) if i < CELLS - 1000 else signal
        smoother.step(space, Measurement(given, np.full(2, noise), *none))
        if smoother.is_full:
            variances.append(smoother.variance[0].copy())
    values = np.linalg.eigvalsh(smoother.covariance)
    assert values.min() > -1e-9 * values.max()
    assert np.isfinite(smoother.traction).all()
    assert np.min(variances) > 0
    # It has forgotten where it began, and does not wander.
    assert np.allclose(variances[-1], variances[-20], rtol=1e-2)
    assert np.all(variances[-1] <= 1 + 1e-6)
