"""Noise that elements share: the posterior is that of its whole covariance, on every line."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv import ConstantSpeed, Film, Open, Periodic, Scenario, Sensor, TractionScene, Wiener
from srsinv.forward.noise import White
from srsinv.forward.snap_back import SnapBackNoise
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.shared import SharedNoise, shared_noise
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential
from tests.tiers import quick

N, CELL_M, RMS_PA, LENGTH_M = 32, 3e-4, 2e3, 1e-3
PRIOR = Exponential(RMS_PA, LENGTH_M)
SENSOR = Sensor([Film(offset_m=o) for o in (-1e-3, 0.0, 1.2e-3)])
BURSTS = SnapBackNoise.recorded_by(SENSOR, 400.0, 200.0, 5e-4, 5e-3, 1e-2)
SCENE = TractionScene(0.0, 0.5, [srsinv.UniformStrip(1e4, 2e-3)])
LINES = {"periodic": Periodic(N, CELL_M, -N * CELL_M / 2), "open": Open(N, CELL_M, -N * CELL_M / 2)}


def simulated(line="periodic", **other):
    noises = other.pop("noises", (White(1e-6), BURSTS))
    scenario = Scenario(SCENE, SENSOR, ConstantSpeed(0.03), noises=noises, **other)
    return srsinv.simulate(scenario, LINES[line], friction=0.5).problem


def covariance(problem):
    """Of the noise over all samples, element after element."""
    shared, lag = problem.shared_noise, np.arange(N)[:, None] - np.arange(N)
    axes, along, own = (np.asarray(x) for x in (shared.axes, shared.power, shared.own))
    power = np.einsum("ei,ik,fi->efk", axes, along, axes) + np.eye(3)[..., None] * own
    lags = np.fft.irfft(power, N)
    return lags[..., lag].transpose(0, 2, 1, 3).reshape(3 * N, 3 * N)


@pytest.mark.parametrize("line", quick(LINES, "periodic"))
def test_posterior_is_that_of_the_whole_covariance(line):
    problem = simulated(line)
    model = np.stack([np.asarray(problem.forward(row[None])).ravel() for row in np.eye(N)], 1)
    lags = np.fft.irfft(np.asarray(PRIOR.power(problem)), N)
    prior = lags[np.arange(N)[:, None] - np.arange(N)]
    prior = prior - np.outer(prior.sum(1), prior.sum(0)) / prior.sum()  # its mean is known
    total = model @ prior @ model.T + covariance(problem)
    gain = np.linalg.solve(total, model @ prior).T
    value, spread = gain @ np.asarray(problem.data).ravel(), prior - gain @ model @ prior
    deviation = np.eye(N) - np.full((N, N), 1 / N)
    estimate = Wiener(PRIOR, path="auto")(problem)
    got, stderr = estimate.deviation(np.ones(N, bool))
    np.testing.assert_allclose(got[0], deviation @ value, rtol=0, atol=1e-6 * np.abs(value).max())
    if line == "periodic":  # there the band is that of the deviation
        expected = np.sqrt(np.diag(deviation @ spread @ deviation))
        np.testing.assert_allclose(stderr[0], expected, rtol=1e-6)


def test_residual_is_white_and_signals_are_the_elements():
    problem = simulated()
    estimate = Wiener(PRIOR, scale="evidence")(problem)
    residual = np.asarray(problem.data + problem.mean_signal) - np.asarray(estimate.fitted)
    squares = residual.ravel() @ np.linalg.solve(covariance(problem), residual.ravel())
    np.testing.assert_allclose(np.sum(np.asarray(estimate.whitened) ** 2), squares, rtol=1e-6)
    assert 0.5 < float(estimate.chi2_per_freedom or 0.0) < 1.6


def test_elements_of_independent_noise_share_none():
    assert simulated(noises=(White(1e-6),)).shared_noise is None
    assert shared_noise(jnp.zeros((2, 2, 3)), jnp.ones(3)) == (None, ())


def test_axes_that_change_with_the_wavenumber_are_reported():
    turned = np.zeros((2, 2, 2))
    turned[..., 0], turned[..., 1] = [[2.0, 1.0], [1.0, 2.0]], [[3.0, 0.0], [0.0, 1.0]]
    none, (sentence,) = shared_noise(jnp.asarray(turned), jnp.ones(2))
    assert none is None
    assert "independent" in sentence


def test_gaps_of_their_own_leave_elements_independent():
    problem = simulated()
    observed = np.ones((3, N), bool)
    observed[0, 3] = False
    of = problem.line, problem.forward, problem.data, problem.noise

    def with_gaps():
        return LineProblem(*of, observed=observed, shared_noise=problem.shared_noise)

    made = with_gaps()
    assert made.shared_noise is None
    assert "different samples" in made.warnings[-1]
    observed[:, 3] = False
    made = with_gaps()
    assert isinstance(made.shared_noise, SharedNoise)


@pytest.mark.full
def test_methods_have_derivatives_beside_shared_noise():
    problem = simulated()

    def size(factor):
        estimate = Tikhonov(1, 1e-9 * factor)(problem)
        return np.float64(1.0) * (estimate.value[0] ** 2).sum()

    slope = jax.grad(size)(1.0)
    step = 1e-4
    difference = (size(1 + step) - size(1 - step)) / (2 * step)
    np.testing.assert_allclose(slope, difference, rtol=1e-5)
