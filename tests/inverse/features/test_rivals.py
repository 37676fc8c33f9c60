"""Two minima of a fit: the other one is in the standard errors."""

from functools import reduce

import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from srsinv.forward.feature import StripFeature
from srsinv.inverse.features.fit import Rivals
from srsinv.inverse.nonlinear import Fit, fit

FEATURES, PLACE, NOISE, ODDS = {"strip": StripFeature()}, 0.3, 0.02, 2.0
SIGNALS = np.array([PLACE, 1.0, 0.0])
# Widths of 1 and -1 have one square. The third sample makes the one `ODDS` times as probable as the
# other: its residuals are -TILT and -3 TILT.
TILT = NOISE * np.sqrt(np.log(ODDS) / 4)


def signals(params):
    """The place, the width's square, and a third signal by which one sign is more probable."""
    own = params["strip"]
    return jnp.stack([own["position_m"], own["width_m"] ** 2, TILT * (own["width_m"] - 2)])


def ended(width: float) -> Fit:
    start = {"strip": {"position_m": PLACE, "width_m": width}}
    return fit(signals, start, SIGNALS, noise=NOISE)


def test_the_standard_error_is_of_both_minima():
    near, far = ended(0.9), ended(-0.9)
    rivals = Rivals.of(FEATURES, near, [far])
    assert rivals.warnings
    wider = reduce(Fit.with_error, rivals.moves.values(), near)
    value, stderr = near.value["strip"]["width_m"], wider.stderr["strip"]["width_m"]

    def density(width: float) -> float:
        misfit = np.asarray(signals({"strip": {"position_m": PLACE, "width_m": width}})) - SIGNALS
        return float(np.exp(-np.sum(misfit**2) / (2 * NOISE**2)))

    at = np.linspace(-1.5, 1.5, 20_001)
    weights = np.array([density(width) for width in at])
    square = scipy.integrate.trapezoid(weights * (at - float(value)) ** 2, at)
    exact = np.sqrt(square / scipy.integrate.trapezoid(weights, at))
    assert float(stderr) == pytest.approx(exact, rel=0.02)


def test_a_minimum_that_is_the_same_is_no_rival():
    near, same = ended(0.9), ended(1.1)
    assert Rivals.of(FEATURES, near, [same]) == Rivals()
