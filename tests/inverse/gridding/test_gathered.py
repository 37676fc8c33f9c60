"""Samples gathered into wider cells: their noise, the signal of wide cells, what is missing."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, Periodic
from srsinv.inverse.gridding.gathered import gathered, noise_of_means
from srsinv.inverse.line.problem import LineProblem
from tests.inverse.cases import FILMS

CELL_M, SCAN = 1e-4, ConstantSpeed(0.05)


def problem(line, data, noise=1e-8, observed=None):
    power = np.full(np.asarray(line.k).shape, noise)
    return LineProblem.of_sensor(
        line, Sensor(FILMS["pair"]()), SCAN, data, power, observed=observed
    )


@pytest.mark.parametrize(("wide", "count"), [(5, 1), (5, 3), (8, 4), (9, 2), (7, 5)])
def test_noise_of_means_is_that_of_the_averaged_covariance(wide, count):
    n = wide * count
    power = np.random.default_rng(n).uniform(0.5, 2.0, n // 2 + 1)
    lag = np.fft.irfft(power, n)
    covariance = lag[(np.arange(n)[:, None] - np.arange(n)) % n]
    mean = np.kron(np.eye(wide), np.full((1, count), 1 / count))
    expected = np.fft.rfft((mean @ covariance @ mean.T)[0]).real
    np.testing.assert_allclose(noise_of_means(power, n, count), expected, rtol=1e-10)


def test_an_offset_stays_unknown():
    power = np.concatenate([[np.inf], np.ones(12)])
    wide = noise_of_means(power, 24, 3)
    assert np.isinf(wide[0])
    np.testing.assert_allclose(wide[1:], 1 / 3)


def test_wide_cells_give_the_mean_of_the_signals_of_narrow_ones():
    """Exactly so on the open line, whose cells have their exact kernels."""
    wide = np.random.default_rng(0).normal(size=(2, 16))
    narrow = Open(64, CELL_M, 0.003)
    fine = problem(narrow, np.zeros((2, 64)))
    signal = fine.forward(np.repeat(wide, 4, axis=1))
    coarse = gathered(problem(narrow, signal), 4)
    np.testing.assert_allclose(coarse.data, coarse.forward(wide), atol=1e-12 * np.abs(signal).max())
    np.testing.assert_allclose(coarse.line.x, np.asarray(narrow.x).reshape(16, 4).mean(axis=1))


def test_a_cell_with_a_missing_sample_is_missing():
    observed = np.ones((2, 24), bool)
    observed[0, 7] = False
    wide = gathered(problem(Periodic(24, CELL_M), np.ones((2, 24)), observed=observed), 4)
    assert list(zip(*np.nonzero(~wide.is_observed), strict=True)) == [(0, 1)]


def test_one_sample_a_cell_is_the_same_problem():
    same = problem(Periodic(24, CELL_M), np.ones((2, 24)))
    assert gathered(same, 1) is same


def test_refusals():
    given_problem = problem(Periodic(24, CELL_M), np.ones((2, 24)))
    with pytest.raises(BadInput, match="divisor"):
        gathered(given_problem, 5)
    with pytest.raises(BadInput, match="operator and no sensor"):
        gathered(given_problem.to_grid(), 2)
