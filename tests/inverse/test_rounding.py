"""What is decided near the end of a float64's digits: by stated conditions, the same on any
processor, and tried on both sides of each."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.errors import BadInput
from srsinv.forward.film import Film
from srsinv.inverse.nonlinear import Correlated
from srsinv.inverse.rig.wiring import wiring_finding
from srsinv.numerics import whole_steps
from tests.inverse.cases import DEPTH_M, make_case

PAIR = (Film(DEPTH_M), Film(DEPTH_M, np.pi / 2))
N = 20


@pytest.mark.parametrize(("apart", "is_refused"), [
    (0.0, True), (1e-18, True), (1e-16, True), (1e-15, True), (1e-12, False), (1e-6, False),
])  # fmt: skip
@pytest.mark.parametrize("size", [1e-20, 1.0, 1e20])
def test_covariances_that_are_nearly_singular(size, apart, is_refused):
    """20 data that are the same but for `apart` of their variance."""
    covariance = size * (np.ones((N, N)) + apart * np.eye(N))
    if is_refused:
        with pytest.raises(BadInput, match="not positive definite"):
            Correlated(covariance)
    else:
        residual = np.sqrt(size * apart) * np.random.default_rng(0).normal(size=N)
        squares = float(jnp.sum(Correlated(covariance)(jnp.asarray(residual)) ** 2))
        assert 1 < squares < 60  # a chi squared of 20, beside the mean, which is all but free


@pytest.mark.parametrize(("skew", "is_refused"), [(1e-15, False), (1e-9, False), (1e-7, True)])
@pytest.mark.parametrize("size", [1e-20, 1.0, 1e20])
def test_covariances_that_are_nearly_symmetric(size, skew, is_refused):
    """Data of very different variance that correlate no more than rounding."""
    deviation = np.geomspace(1.0, 1e6, N)
    upper = np.triu(np.ones((N, N)), 1)
    covariance = size * np.outer(deviation, deviation) * (np.eye(N) + skew * upper)
    if is_refused:
        with pytest.raises(BadInput, match="symmetric"):
            Correlated(covariance)
    else:
        Correlated(covariance)


@pytest.mark.parametrize("noise", 10.0 ** -np.arange(0, 25, 4))
@pytest.mark.parametrize("turned", [False, True])
def test_signals_far_above_the_noise(noise, turned):
    """Evidence of the wiring, where the noise is less than a float64's digits of the signals."""
    problem = make_case(films=PAIR, noise_fraction=1e-3).problem
    sign = jnp.array([[1.0], [-1.0 if turned else 1.0]])
    changed = eqx.tree_at(
        lambda p: (p.data, p.noise), problem, (sign * problem.data, noise**2 * problem.noise)
    )
    found = wiring_finding(changed, ("first", "second"), DEPTH_M)
    assert found is None or "other sign" in found.words
    assert (found is not None) == turned or noise < 1e-3  # what cells leave out is no noise


def two_columns(p):
    return p["a"] * p["first"] + p["b"] * p["second"]


@pytest.mark.full
@pytest.mark.parametrize("apart", [0.0, 1e-16, 1e-10, 1e-6, 1.0])
def test_parameters_that_are_nearly_the_same(apart):
    """Their sum is known on both sides of where they are told apart, and no number is a nan."""
    x = np.linspace(0.0, 1.0, N)
    fit = srsinv.fit(
        two_columns,
        {"a": 1.0, "b": 1.0, "first": x, "second": x + apart * x**2},
        2.5 * x,
        noise=0.1,
        free=["a", "b"],
        bounds={"a": (-1e12, 1e12), "b": (-1e12, 1e12)},
    )
    assert fit.log_evidence is None or np.isfinite(fit.log_evidence)
    assert (fit.log_evidence is None) == (apart < 1e-14)
    assert np.isinf(fit.stderr["a"]) == (apart < 1e-14)


@pytest.mark.parametrize("count", [1, 3, 7, 1000, 2**20])
def test_steps_in_a_length_that_is_a_number_of_them(count):
    """Not one fewer where the last digits of either are rounding."""
    for step in (0.1, 1 / 3, 7e-5):
        for roundings in range(-64, 65, 8):
            length = count * step * (1 + roundings * np.finfo(float).eps)
            assert whole_steps(length, step) == count
    assert whole_steps(0.99 * 0.1, 0.1) == 0
