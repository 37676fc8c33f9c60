"""The closed forms hold against each other before they are trusted with srsinv."""

import numpy as np
import pytest

from tests.reference import closed_forms as cf

X = np.linspace(-6e-3, 6e-3, 41)
Z = 0.75e-3
A = 1.1e-3


def hertz(x):
    return np.sqrt(1 - (x / A) ** 2)


PERIOD = 20e-3
PAIRS = {
    "line": (cf.stress(cf.cauchy_line(X, Z), Z), cf.line_load(X, Z)),
    "strip_by_quadrature": (
        cf.stress(cf.cauchy_strip(X, Z, 2 * A), Z),
        cf.by_quadrature(np.ones_like, -A, A, X, Z),
    ),
    "strip_by_angles": (
        cf.stress(cf.cauchy_strip(X, Z, 2 * A), Z),
        cf.strip_by_angles(X, Z, 2 * A),
    ),
    "hertz": (cf.stress(cf.cauchy_hertz(X, Z, A), Z), cf.by_quadrature(hertz, -A, A, X, Z)),
    "hertz_over_many_periods": (
        cf.stress(cf.cauchy_hertz_periodic(X, Z, A, 1e5 * A), Z),
        cf.stress(cf.cauchy_hertz(X, Z, A), Z),
    ),
    "cosine_at_a_crest": (
        cf.stress(cf.cauchy_cosine(np.zeros(1), Z, 1 / Z), Z)[..., 0],
        -np.exp(-1) * np.array([[0, 0], [2, 0], [0, 0]]),
    ),
}


@pytest.mark.parametrize("name", PAIRS)
def test_two_derivations_agree(name):
    ours, other = PAIRS[name]
    tolerance = 1e-8 if "periods" in name else 2e-14
    np.testing.assert_allclose(ours, other, atol=tolerance * np.abs(other).max(), rtol=0)


def test_periodic_hertz_is_a_sum_of_images():
    """Up to the slow tail of the images left out, which falls as one over their number."""
    images = sum(cf.stress(cf.cauchy_hertz(X - m * PERIOD, Z, A), Z) for m in range(-2000, 2001))
    ours = cf.stress(cf.cauchy_hertz_periodic(X, Z, A, PERIOD), Z)
    np.testing.assert_allclose(ours, images, atol=3e-5, rtol=0)


SHAPES = {
    "line": cf.cauchy_line,
    "strip": lambda x, z: cf.cauchy_strip(x, z, 2 * A),
    "cosine": lambda x, z: cf.cauchy_cosine(x, z, 900.0, 0.3),
    "hertz": lambda x, z: cf.cauchy_hertz(x, z, A),
    "hertz_periodic": lambda x, z: cf.cauchy_hertz_periodic(x, z, A, PERIOD),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_slope_is_the_derivative_of_stress(shape):
    step = 1e-7
    ahead, behind = (cf.stress(SHAPES[shape](X + s, Z), Z) for s in (step, -step))
    slope = cf.stress_slope(SHAPES[shape](X, Z), Z)
    error = np.abs(slope - (ahead - behind) / (2 * step)).max()
    assert error < 1e-7 * np.abs(slope).max()
