"""Aliased shares and pitches of arrays, against closed forms and samples."""

import numpy as np
import pytest
from scipy.special import gamma, gammaincc

from experiments.element_array import aliased_share, depth_for


@pytest.mark.parametrize("pitch", [1e-3, 2e-3])
def test_share_of_white_pressure_above_a_flat_film(pitch):
    """|G|^2 = (7 + 56 kz)^2 e^(-2kz): upper incomplete gamma functions."""
    depth, cells = 0.75e-3, 100_000
    k = np.linspace(0, 40 / depth, cells)
    share = aliased_share(((7 + 56 * k * depth) * np.exp(-k * depth)) ** 2, k, pitch)

    def beyond(kz):
        orders = np.arange(3)
        terms = gamma(orders + 1) * gammaincc(orders + 1, 2 * kz) / 2.0 ** (orders + 1)
        return [49, 2 * 7 * 56, 56**2] @ terms

    assert share == pytest.approx(beyond(np.pi * depth / pitch) / beyond(0.0), rel=2e-3)


def test_an_array_fine_enough_aliases_nothing():
    k = np.linspace(0, 1e5, 1001)
    assert aliased_share(np.exp(-2e-3 * k), k, 1e-5) == 0.0


def test_depth_for_a_share_is_the_last_that_exceeds_it():
    depth = np.array([1e-3, 2e-3, 4e-3])
    assert depth_for(0.1, np.array([0.4, 0.2, 0.05]), depth) == pytest.approx(2e-3 * np.sqrt(2))
    assert depth_for(0.1, np.array([0.05, 0.02, 0.01]), depth) == 1e-3
    assert np.isnan(depth_for(0.1, np.array([0.4, 0.05, 0.2]), depth))
