"""Scores of estimates against the truth, of values whose errors are known."""

import numpy as np
import pytest

from srsinv.inverse.estimate import coverage_90, relative_error, z_rms
from srsinv.numerics import BAND_90, mean_known

N = 4000
CELLS = np.arange(N) >= N // 2
RNG = np.random.default_rng(0)
TRUTH = 3.0 + np.stack([np.sin(0.1 * np.arange(N)), np.zeros(N)])
STDERR = np.full((2, N), 0.2)
VALUE = TRUTH + STDERR * RNG.normal(size=(5, 2, N))


def test_scores_of_draws_with_their_own_standard_error():
    np.testing.assert_allclose(
        z_rms(VALUE, np.broadcast_to(STDERR, VALUE.shape), TRUTH, CELLS), 1.0, atol=0.05
    )
    covered = coverage_90(VALUE, np.broadcast_to(STDERR, VALUE.shape), TRUTH, CELLS)
    np.testing.assert_allclose(covered, 0.9, atol=0.02)
    error = relative_error(VALUE, TRUTH, CELLS)
    np.testing.assert_allclose(error[:, 0], 0.2 * np.sqrt(2), rtol=0.05)
    assert np.isnan(error[:, 1]).all()  # of a uniform truth


def test_scores_of_one_component():
    assert coverage_90(VALUE[0, 0], STDERR[0], TRUTH[0], CELLS).shape == ()
    assert z_rms(VALUE[0, 0], STDERR[0], TRUTH[0], CELLS) == pytest.approx(1.0, abs=0.05)
    assert relative_error(VALUE[0, 0], TRUTH[0]) == pytest.approx(0.2 * np.sqrt(2), rel=0.05)


def test_scores_take_the_mean_out_and_leave_other_cells_aside():
    moved = TRUTH + 7.0 + np.where(CELLS, 0.0, 1e3)
    assert relative_error(moved, TRUTH, CELLS)[0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(z_rms(moved, STDERR, TRUTH, CELLS), 0.0, atol=1e-12)
    np.testing.assert_array_equal(coverage_90(moved, STDERR, TRUTH, CELLS), 1.0)


@pytest.mark.parametrize("size", [0.99, 1.01])
def test_a_band_ends_where_it_says(size):
    off = size * BAND_90 * STDERR * np.where(np.arange(N) % 2, 1.0, -1.0)
    covered = coverage_90(TRUTH + off, STDERR, TRUTH, CELLS)
    np.testing.assert_array_equal(covered, float(size < 1))


def test_an_error_without_a_band_is_infinitely_wrong_and_none_is_not():
    none = np.zeros((2, N))
    assert np.isinf(z_rms(VALUE[0], none, TRUTH, CELLS)).all()
    np.testing.assert_array_equal(z_rms(TRUTH, none, TRUTH, CELLS), 0.0)


def test_a_mean_of_what_is_known():
    values = np.array([[1.0, np.nan, 4.0], [np.nan] * 3])
    np.testing.assert_array_equal(mean_known(values, axis=1), [2.5, np.nan])
    assert mean_known(values) == 2.5
