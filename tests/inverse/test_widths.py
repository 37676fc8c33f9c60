"""Widths of kernels and cut-offs of resolutions against closed forms."""

import numpy as np
import pytest

from srsinv.inverse.estimate import cutoff, full_width_at_half_maximum


@pytest.mark.parametrize(
    ("kernel", "width"),
    [
        (lambda x: np.maximum(0, 1 - np.abs(x) / 3e-3), 3e-3),
        (lambda x: np.exp(-((x - 2e-3) ** 2) / 2e-6), np.sqrt(8 * np.log(2)) * 1e-3),
        (lambda x: np.ones_like(x), np.nan),
        (lambda x: -np.exp(-(x**2) / 2e-6), np.nan),
        (lambda x: x * np.nan, np.nan),
    ],
)
def test_full_width_at_half_maximum(kernel, width):
    lag = np.linspace(-0.01, 0.01, 401)
    measured = full_width_at_half_maximum(lag, kernel(lag))
    assert measured == pytest.approx(width, rel=1e-3, nan_ok=True)


def test_the_cutoff_is_where_the_resolution_last_falls_through_one_half():
    k = np.linspace(0.0, 100.0, 201)
    rows = np.stack([np.exp(-((k / 40) ** 2)), np.ones_like(k), np.where(k < 20, 1.0, 0.0)])
    assert cutoff(k, rows) == pytest.approx([40 * np.sqrt(np.log(2)), np.nan, 19.75], rel=1e-3,
                                            nan_ok=True)  # fmt: skip
