"""What the data do not determine: named, with no error bar, while the rest keeps its own."""

from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from tests.tiers import quick

X = np.linspace(0, 1, 30)
STDERR = 0.01
Y = 3 * np.exp(-2 * X) + STDERR * np.random.default_rng(1).normal(size=30)
FLAT = np.ones(30)


def decay(amplitude, p):
    return amplitude * jnp.exp(-p["k"] * X)


def bell(p):
    return p["a"] * jnp.exp(-(((X - p["x"]) / p["w"]) ** 2)) + p["c"]


PROBLEMS = {  # model, start, data, names of each undetermined direction
    "product": (lambda p: decay(p["a"] * p["b"], p), {"a": 1, "b": 1.5, "k": 1}, Y, ["ab"]),
    "sum": (lambda p: decay(p["a"] + p["b"], p), {"a": 1, "b": 1.5, "k": 1}, Y, ["ab"]),
    "unused": (lambda p: decay(p["a"], p), {"a": 1, "b": 1.5, "k": 1}, Y, ["b"]),
    "no_amplitude": (bell, {"a": 0, "x": 0.5, "w": 0.1, "c": 1}, FLAT, ["w", "x"]),
}


@pytest.mark.parametrize("name", quick(PROBLEMS, "product"))
def test_undetermined(name):
    model, start, y, directions = PROBLEMS[name]
    fit = srsinv.fit(model, start, y, noise=STDERR)
    undetermined = set("".join(directions))
    determined = [n for n in fit.names if n not in undetermined]
    assert fit.converged, fit.status
    assert sorted("".join(sorted(d)) for d in fit.undetermined) == directions
    assert {n for n in fit.names if np.isposinf(fit.stderr[n])} == undetermined
    assert np.isnan(fit.covariance).any() == (len(fit.names) > 1)
    # The others' errors are those with one of each direction held.
    held = {d[0] for d in directions}
    fixed = srsinv.fit(
        model, fit.value, y, noise=STDERR, free=[n for n in fit.names if n not in held]
    )
    assert not fixed.undetermined
    for n in determined:
        np.testing.assert_allclose(fit.stderr[n], fixed.stderr[n], rtol=1e-6)


def test_determined_combination():
    model, start, y, _ = PROBLEMS["product"]
    fit = srsinv.fit(model, start, y, noise=STDERR)
    alone = srsinv.fit(lambda p: decay(p["a"], p), {"a": 1.0, "k": 1.0}, y, noise=STDERR)
    value, stderr = fit.derive(lambda p: p["a"] * p["b"])
    np.testing.assert_allclose([value, stderr], [alone.value["a"], alone.stderr["a"]], rtol=1e-6)
    np.testing.assert_array_equal(
        np.isinf(fit.derive(lambda p: jnp.stack([p["a"], p["b"] + p["k"], p["k"]]))[1]),
        [True, True, False],
    )
    (move,) = fit.undetermined
    relative_move = {n: move[n] / fit.value[n] for n in "ab"}
    np.testing.assert_allclose(relative_move["a"], -relative_move["b"], rtol=1e-5)


@pytest.mark.full
def test_more_parameters_than_data():
    fit = srsinv.fit(
        lambda p: jnp.asarray(X[:3, None] ** np.arange(5)) @ p, np.zeros(5), Y[:3], noise=STDERR
    )
    assert fit.converged, fit.status
    assert len(fit.undetermined) == 2
    np.testing.assert_allclose(fit.residual, 0.0, atol=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("count", [1, 2])
def test_no_datum_left_for_the_noise(count):
    """As many parameters as data: the residual is zero and says nothing of the noise."""
    fit = srsinv.fit(
        lambda p: jnp.asarray(X[:count, None] ** np.arange(count)) @ p, np.zeros(count), Y[:count]
    )
    assert fit.converged, fit.status
    assert np.isposinf(fit.stderr).all()
    assert np.isposinf(np.diagonal(fit.covariance)).all()
    assert np.isposinf(fit.derive(lambda p: p[0])[1])
    assert not fit.undetermined
    assert not fit.at_bound


def exact_normal_matrix(basis):
    columns = [[Fraction(v) for v in column] for column in basis.T.tolist()]
    return [[sum(map(Fraction.__mul__, u, v), Fraction()) for v in columns] for u in columns]


@pytest.mark.full
@pytest.mark.parametrize("apart", [1e-3, 1e-5, 1e-6])
def test_nearly_degenerate(apart):
    """Two columns that differ by little: determined, with the error of exact arithmetic."""
    basis = np.stack([1 + X, 1 + X + apart * X**2], axis=1)
    fit = srsinv.fit(lambda p: basis @ p, np.zeros(2), basis @ np.ones(2), noise=1.0)
    (a, b), (_, d) = exact_normal_matrix(basis)
    stderr = [float(v / (a * d - b * b)) ** 0.5 for v in (d, a)]
    assert fit.converged, fit.status
    assert not fit.undetermined
    np.testing.assert_allclose(fit.stderr, stderr, rtol=1e-8)


@pytest.mark.parametrize("noise", [None, 0.01])
@pytest.mark.parametrize("linear", [(), pytest.param(("a",), marks=pytest.mark.full)])
def test_nothing_in_the_data(noise, linear):
    fit = srsinv.fit(
        lambda p: decay(p["a"], p), {"a": 1.0, "k": 1.0}, 0 * Y, noise=noise, linear=linear
    )
    assert fit.converged, fit.status
    assert abs(fit.value["a"]) < 1e-9
