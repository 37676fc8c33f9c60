"""What the data do not determine: named, with no error bar, while the rest keeps its own."""

from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from tests.tiers import quick, rare

X = np.linspace(0, 1, 30)
STDERR = 0.01
Y = 3 * np.exp(-2 * X) + STDERR * np.random.default_rng(1).normal(size=30)
FLAT = np.ones(30)


def decay(amplitude, p):
    return amplitude * jnp.exp(-p["k"] * X)


def bell(p):
    return p["a"] * jnp.exp(-(((X - p["x"]) / p["w"]) ** 2)) + p["c"]


def mixed(p):
    """The amplitude is a sum of a, b and their product by weights that are not fitted, so that one
    compiled program serves all of them."""
    return decay(p["weight"] @ jnp.stack([p["a"], p["b"], p["a"] * p["b"]]), p)


def mixing(*weight):
    return {"a": 1.0, "b": 1.5, "k": 1.0, "weight": np.array(weight)}


def line(p):
    """Of columns that are not fitted."""
    return p["basis"] @ p["b"]


PROBLEMS = {  # model, start, data, fitted parameters, names of each undetermined direction
    "product": (mixed, mixing(0.0, 0.0, 1.0), Y, "abk", ["ab"]),
    "sum": (mixed, mixing(1.0, 1.0, 0.0), Y, "abk", ["ab"]),
    "unused": (mixed, mixing(1.0, 0.0, 0.0), Y, "abk", ["b"]),
    "no_amplitude": (bell, {"a": 0, "x": 0.5, "w": 0.1, "c": 1}, FLAT, "axwc", ["w", "x"]),
}


@pytest.mark.parametrize("name", quick(PROBLEMS, "product"))
def test_undetermined(name):
    model, start, y, free, directions = PROBLEMS[name]
    fit = srsinv.fit(model, start, y, noise=STDERR, free=[*free])
    undetermined = set("".join(directions))
    determined = [n for n in fit.names if n not in undetermined]
    assert fit.converged, fit.status
    assert sorted("".join(sorted(d)) for d in fit.undetermined) == directions
    assert {n for n in fit.names if np.isposinf(fit.stderr[n])} == undetermined
    assert np.isnan(fit.covariance).any() == (len(fit.names) > 1)
    # The others' errors are those with one of each direction held.
    held = {d[-1] for d in directions}
    fixed = srsinv.fit(
        model, fit.value, y, noise=STDERR, free=[n for n in fit.names if n not in held]
    )
    assert not fixed.undetermined
    for n in determined:
        np.testing.assert_allclose(fit.stderr[n], fixed.stderr[n], rtol=1e-6)


def test_determined_combination():
    model, start, y, free, _ = PROBLEMS["product"]
    fit = srsinv.fit(model, start, y, noise=STDERR, free=[*free])
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
    start = {"b": np.zeros(5), "basis": X[:3, None] ** np.arange(5)}
    fit = srsinv.fit(line, start, Y[:3], noise=STDERR, free="b")
    assert fit.converged, fit.status
    assert len(fit.undetermined) == 2
    np.testing.assert_allclose(fit.residual, 0.0, atol=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("count", rare([1, 2], 2))
def test_no_datum_left_for_the_noise(count):
    """As many parameters as data: the residual is zero and says nothing of the noise."""
    start = {"b": np.zeros(count), "basis": X[:count, None] ** np.arange(count)}
    fit = srsinv.fit(line, start, Y[:count], free="b")
    assert fit.converged, fit.status
    assert np.isposinf(fit.stderr["b"]).all()
    assert np.isposinf(np.diagonal(fit.covariance)).all()
    assert np.isposinf(fit.derive(lambda p: p["b"][0])[1])
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
    start = {"b": np.zeros(2), "basis": basis}
    fit = srsinv.fit(line, start, basis @ np.ones(2), noise=1.0, free="b")
    (a, b), (_, d) = exact_normal_matrix(basis)
    stderr = [float(v / (a * d - b * b)) ** 0.5 for v in (d, a)]
    assert fit.converged, fit.status
    assert not fit.undetermined
    np.testing.assert_allclose(fit.stderr["b"], stderr, rtol=1e-8)


@pytest.mark.parametrize("noise", [None, 0.01])
@pytest.mark.parametrize("linear", [(), pytest.param(("a",), marks=pytest.mark.full)])
def test_nothing_in_the_data(noise, linear):
    fit = srsinv.fit(
        lambda p: decay(p["a"], p), {"a": 1.0, "k": 1.0}, 0 * Y, noise=noise, linear=linear
    )
    assert fit.converged, fit.status
    assert abs(fit.value["a"]) < 1e-9
