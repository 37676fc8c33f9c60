"""Information of a pass over a grating, and the pass that is proposed next."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.forward.planar import PathScan
from srsinv.forward.sensor import Sensor
from srsinv.grid import as_real
from srsinv.inverse.planar.finder import Direction
from srsinv.inverse.planar.next_pass import ExpectedGain, PassLimits, next_pass
from srsinv.inverse.planar.signal import (
    GratingShape,
    PlanarSignal,
    information,
    standard_errors,
    weights,
)
from tests.refusals import refused

SENSOR = Sensor([Film(length_m=4e-3, turn_rad=turn) for turn in (0.3, np.pi / 2)])
FEATURE, LIMITS = GratingShape(harmonics=1), PassLimits(0.02, 0.1, samples=32)
ROW = np.array([40.0, 2e-4, 2.5e-3, 2.0, -0.8])
STDERR, RMS = np.array([4.0, 1e-4, 5e-5, 0.5, 0.5]), 3e-6


class KnownPosterior(Direction):
    """A posterior that is given in place of a fit's."""

    def __init__(self, covariance):
        object.__setattr__(self, "covariance", covariance)

    def posterior(self, names) -> Any:
        return ROW.copy(), vars(self)["covariance"]


@pytest.mark.full
def test_gain_is_the_rise_of_the_log_determinant():
    """By the Fisher information of the same pass."""
    arrays = as_real(ROW[None]), as_real(np.diag(STDERR)), as_real(np.full(2, RMS))
    gain = ExpectedGain(SENSOR, FEATURE, LIMITS, *arrays, 1)
    path = LIMITS.path(0.5, 0.05)
    per_element = np.asarray(
        information(PlanarSignal(FEATURE, (PathScan(SENSOR, path),)), as_real(ROW), arrays[2])
    )
    scaled = per_element.sum(axis=0) * np.outer(STDERR, STDERR)
    expected = np.linalg.slogdet(np.eye(5) + scaled)[1] / 2
    assert float(gain(jnp.asarray([0.5, np.log(0.05)]))) == pytest.approx(expected, rel=1e-9)


@pytest.mark.full
def test_proposed_pass_is_better_than_those_tried():
    proposed = next_pass(SENSOR, FEATURE, KnownPosterior(np.diag(STDERR**2)), RMS, LIMITS, draws=2)
    assert proposed.gain_nats >= proposed.gains_nats.max()
    assert proposed.gain_nats > 2 * np.median(proposed.gains_nats)
    assert 0.02 * 0.999 <= float(proposed.path.speed_m_per_s) <= 0.1 * 1.001


def test_bounds_and_weights():
    """Two elements that each determine one of two parameters, and one that both share."""
    each = np.array([np.diag([4e6, 0.0]), np.diag([0.0, 1.0])])
    np.testing.assert_allclose(standard_errors(each.sum(axis=0)), [5e-4, 1.0])
    np.testing.assert_allclose(weights(each, 1), [0.0, 1.0])
    assert np.all(np.isinf(standard_errors(each[0])))
    assert np.all(np.isnan(weights(each[:1], 1)))


def test_refused():
    unknown = np.diag([np.inf, 1.0, 1.0, 1.0, 1.0])
    refused(lambda: next_pass(SENSOR, FEATURE, KnownPosterior(unknown), RMS, LIMITS), "priors")
    refused(lambda: PassLimits(0.1, 0.05), "lesser first")
    known = KnownPosterior(np.diag(STDERR**2))
    refused(lambda: next_pass(SENSOR, FEATURE, known, 0.0, LIMITS), "above 0")
    refused(lambda: next_pass(SENSOR, FEATURE, known, np.ones(3), LIMITS), "(3,)")
    refused(lambda: next_pass(SENSOR, FEATURE, known, RMS, LIMITS, seed=-1), "seed")
