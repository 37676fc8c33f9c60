"""The state-space model and its smoother against dense Gaussian answers."""

import numpy as np
import pytest

from srsinv import Sensor
from srsinv.inverse.live.covariance import joint_covariance
from srsinv.inverse.live.smoother import FixedLagSmoother, Measurement
from srsinv.inverse.live.state_space import state_space
from tests.inverse.live.scans import CELL_M, dense, exact_covariance, prior
from tests.tiers import quick

DEPTH = 8  # cells
MEMORY = 64 * DEPTH  # over which answers are compared
LAGS = (0, DEPTH, 2 * DEPTH, 4 * DEPTH, 8 * DEPTH)


@pytest.fixture(scope="module")
def covariance():
    return joint_covariance(Sensor(), prior(), CELL_M, 4 * MEMORY, is_onwards=True)


@pytest.fixture(scope="module")
def model(covariance):
    return state_space(covariance, 2 * MEMORY, DEPTH)


def smoothed(model, signal, noise, lag, place=None, nuisance=None):
    """The smoother after all cells; `nuisance`: signals (e, k, n) of parameters of variance 1."""
    elements, n = signal.shape
    nuisance = np.zeros((elements, 0, n)) if nuisance is None else nuisance
    place = np.zeros((elements, n)) if place is None else place
    k = nuisance.shape[1]
    smoother = FixedLagSmoother.starting(model, lag, k)
    smoother.covariance[:k, :k] = np.eye(k)
    for j in range(n):
        smoother.step(
            model,
            Measurement(signal[:, j], noise[:, j], place[:, j], nuisance[..., j], np.zeros(k)),
        )
    return smoother


def process(covariance, rng, n):
    """A draw (z, n) of a process of these covariances (z, z, lag)."""
    lag = np.arange(n)[:, None] - np.arange(n)
    channels = range(len(covariance))
    whole = np.block([
        [np.where(lag >= 0, covariance[a, b][np.abs(lag)], covariance[b, a][np.abs(lag)])
         for b in channels] for a in channels
    ])  # fmt: skip
    values, axes = np.linalg.eigh(whole)
    root = axes * np.sqrt(np.maximum(values, 0.0))
    return (root @ rng.normal(size=len(whole))).reshape(len(covariance), n)


def test_covariances_are_those_of_prior_and_kernel(covariance):
    lags = 40 * DEPTH
    wanted = exact_covariance(lags)
    assert np.abs(covariance.values[:4, :4, : lags + 1] - wanted).max() < 1e-3
    # The slope's covariance with the signal is the derivative of the signal's.
    own = covariance.values[2, 2]
    slope = (own[2:20] - own[:18]) / 2
    assert np.allclose(covariance.values[4, 2, 1:19], slope, atol=0.02)


def test_model_is_stationary(model):
    m = model.states
    transition, noise = model.matrix[:m], model.noise[:m, :m]
    assert np.abs(transition @ transition.T + noise - np.eye(m)).max() < 1e-7
    assert np.linalg.eigvalsh(model.noise).min() > -1e-12
    assert np.abs(np.linalg.eigvals(transition)).max() < 1


def test_model_has_the_covariances_of_the_process(covariance, model):
    lags = 16 * DEPTH
    off = model.covariances(lags) - covariance.values[..., : lags + 1]
    assert np.abs(off).max() < 5e-3


def check_answers(model, signal, noise, lag, of_exact):
    """Estimates and standard errors are within `of_exact` standard errors of those that the exact
    covariances give from the same signals, and within 1e-6 of those that the model's own give."""
    n = signal.shape[1]
    smoother = smoothed(model, signal, noise - model.floor[2], lag)
    cells = np.arange(n - 1 - lag, n)
    values, stderr = smoother.traction.T, np.sqrt(smoother.variance.T)
    for of, most in ((exact_covariance(n), of_exact), (model.covariances(n), 1e-6)):
        mean, exact = dense(of, signal, noise, cells)
        assert np.abs(stderr / exact - 1).max() < most
        assert (np.abs(values - mean) / exact).max() < most


@pytest.mark.parametrize("lag", quick(LAGS, 0, 4 * DEPTH))
def test_same_answer_as_a_dense_solve(covariance, model, lag):
    """Within 2 % of the exact answer from the same data, over the memory, and to 1e-6 of the
    answer that the model's own covariances give."""
    rng = np.random.default_rng(lag)
    n = MEMORY
    noise = np.full((2, n), 1e-4)
    signal = process(covariance.values[:4, :4], rng, n)[2:] + 1e-2 * rng.normal(size=(2, n))
    check_answers(model, signal, noise, lag, 0.02)


def test_missing_and_unequal_cells(covariance, model):
    """3 % of cells missing and runs, and noise that differs by 20 dB: within 5 % of a standard
    error."""
    rng = np.random.default_rng(0)
    n, lag = MEMORY, 4 * DEPTH
    noise = 1e-4 * 10 ** rng.uniform(-1, 1, size=(2, n))
    signal = process(covariance.values[:4, :4], rng, n)[2:] + np.sqrt(noise) * rng.normal(
        size=(2, n)
    )
    signal[:, rng.random(n) < 0.03] = np.nan
    signal[:, n - 60 : n - 40] = np.nan
    signal[0, n - 30 : n - 10] = np.nan
    check_answers(model, signal, noise, lag, 0.05)


def test_the_same_process_in_the_other_order(covariance, model):
    """Its covariances are the transposes, with the slopes' signs turned; turned again it is the
    same."""
    sign = np.array([1, 1, 1, 1, -1, -1])
    back, own = model.reversed().covariances(40), model.covariances(40)
    turned = own.swapaxes(0, 1) * sign[:, None, None] * sign[None, :, None]
    assert np.allclose(back, turned, atol=1e-6)
    assert np.allclose(model.reversed().reversed().matrix, model.matrix, atol=1e-6)
    onwards = joint_covariance(Sensor(), prior(), CELL_M, MEMORY, is_onwards=True).values
    other = joint_covariance(Sensor(), prior(), CELL_M, MEMORY, is_onwards=False).values
    assert np.allclose(
        other, onwards.swapaxes(0, 1) * sign[:, None, None] * sign[None, :, None], atol=1e-9
    )


def test_nuisance_parameters_are_estimated_jointly(model):
    """An offset of unknown size is as noise that is the same in all cells."""
    rng = np.random.default_rng(1)
    n, lag = 12 * DEPTH, 2 * DEPTH
    covariance = model.covariances(n)
    noise = np.full((2, n), 1e-4)
    signal = process(covariance[:4, :4], rng, n)[2:] + 1e-2 * rng.normal(size=(2, n))
    size = 0.7
    offset = np.zeros((2, 2, n))
    offset[0, 0] = offset[1, 1] = size
    smoother = smoothed(model, signal + 0.4, noise - model.floor[2], lag, nuisance=offset)
    wide = covariance.copy()
    wide[2, 2] += size**2
    wide[3, 3] += size**2
    mean, exact = dense(wide, signal + 0.4, noise, np.arange(n - 1 - lag, n))
    assert np.allclose(np.sqrt(smoother.variance.T), exact, rtol=1e-6)
    assert np.allclose(smoother.traction.T, mean, atol=1e-6)


def test_samples_beside_the_centre(model):
    """A cell that was sampled half a cell aside is told by its signal there, which the slope
    gives; without its place the answer is off."""
    rng = np.random.default_rng(2)
    n, lag = 12 * DEPTH, 2 * DEPTH
    drawn = process(model.covariances(n), rng, n)
    place = np.where(rng.random((2, n)) < 0.2, 0.5, 0.0)
    signal = drawn[2:4] + place * drawn[4:]
    noise = np.full((2, n), 1e-6)
    told = smoothed(model, signal, noise, lag, place=place)
    untold = smoothed(model, signal, noise, lag)
    truth = drawn[:2, n - 1 - lag :]
    scores = [np.sqrt(np.mean((each.traction.T - truth) ** 2 / each.variance.T))
              for each in (told, untold)]  # fmt: skip
    assert scores[0] < 1.3
    assert scores[1] > 2
