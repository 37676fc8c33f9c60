"""Fits under jit, vmap, grad and jvp: the numbers of known fits, and their derivatives."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.forward.film import Film
from srsinv.inverse.nonlinear import Optimistix, Spectrum
from tests.differences import differences
from tests.refusals import refused
from tests.tiers import hardest

X, NOISE = np.linspace(0.0, 1.0, 50), 0.05
RNG = np.random.default_rng(0)
Y = 3 * np.exp(-2 * X) + 1 + NOISE * RNG.normal(size=X.size)
ALONG, WEIGHTS = NOISE * RNG.normal(size=X.size), RNG.normal(size=(3, X.size))
INITIAL = {"a": 1.0, "k": 1.0, "c": 0.5}


def decay(params):
    return params["a"] * jnp.exp(-params["k"] * X) + params["c"]


def fitted(theta, case: str) -> Any:
    """The fit of data, noise and what else is known, changed by theta."""
    noise: dict[str, Any] = {"noise": NOISE * jnp.exp(theta[1])}
    flat = Spectrum((NOISE * jnp.exp(theta[1])) ** 2 * jnp.ones(X.size // 2 + 1))
    known: dict[str, dict] = {
        "prior": noise | {"priors": {"k": (1.5 + theta[2], 0.1)}},
        "level": {"free": ("a", "k")},  # unknown, beside a parameter that is known
        "bound": noise | {"linear": ("a", "c"), "bounds": {"k": (0.0, 1.5)}},
        "robust": {"noise": flat, "loss": "soft_l1"},
    }
    initial = INITIAL | ({"c": 1.0 + theta[2]} if case == "level" else {})
    return srsinv.fit(decay, initial, jnp.asarray(Y) + theta[0] * ALONG, **known[case])


def numbers(theta, case: str):
    """Values, standard errors and residual of the fit."""
    made = fitted(theta, case)
    each = [part[name] for part in (made.value, made.stderr) for name in INITIAL]
    chi2, weighed = made.stats["chi2_per_freedom"], WEIGHTS @ made.whitened
    return jnp.stack([jnp.asarray(value) for value in (*each, chi2, *weighed)])


CASES = "prior", "level", "bound", "robust"


@pytest.mark.parametrize("case", hardest(CASES, ["prior"], ["level", "bound"]))
def test_numbers_and_derivatives_are_those_of_known_fits(case):
    """By data, noise, and a prior's mean or a parameter that is known; forward and reverse. What a
    bound holds does not move."""

    def of(theta):
        return numbers(theta, case)

    @jax.jit
    def everything(theta):
        return of(theta), jax.jacfwd(of)(theta), jax.jacrev(of)(theta)

    value, forward, reverse = map(np.asarray, everything(np.zeros(3)))
    np.testing.assert_allclose(value, of(np.zeros(3)), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9)
    assert np.any(forward[1]) == (case != "bound")
    expected = differences(of, np.zeros(3), 1e-2)
    np.testing.assert_allclose(forward, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.full
def test_many_at_once_are_those_one_by_one():
    """With a function of the parameters, and its standard error."""
    ys = Y + NOISE * RNG.normal(size=(3, X.size))

    def of(y):
        made = srsinv.fit(decay, INITIAL, y, noise=NOISE)
        return made, made.derive(lambda params: jnp.log(2.0) / params["k"])

    made, half_time = jax.jit(jax.vmap(of))(ys)
    for i, (alone, own) in enumerate(map(of, ys)):
        for name in INITIAL:
            assert float(made.value[name][i]) == pytest.approx(alone.value[name], rel=1e-8)
            assert float(made.stderr[name][i]) == pytest.approx(alone.stderr[name], rel=1e-8)
        np.testing.assert_allclose(made.covariance[i], alone.covariance, rtol=1e-7)
        np.testing.assert_allclose([each[i] for each in half_time], own, rtol=1e-8)
    assert made.quality == "doubtful"
    assert any("JAX traced this fit" in each for each in made.warnings)


@pytest.mark.full
def test_what_the_data_leave_open_has_an_infinite_error_and_the_rest_its_slope():
    def of(y):
        model = lambda p: p["a"] * p["b"] * X + p["c"]  # noqa: E731
        made = srsinv.fit(model, {"a": 1.0, "b": 1.0, "c": 0.0}, y, noise=NOISE)
        product: Any = made.derive(lambda p: p["a"] * p["b"])
        return made.value, made.stderr, product

    both = jax.jit(lambda y: (of(y), jax.jacrev(lambda y: of(y)[0]["c"])(y)))
    (value, stderr, product), slope = both(2 * X + 1)
    assert np.isinf([stderr["a"], stderr["b"]]).all()
    np.testing.assert_allclose(product, of(2 * X + 1)[2], rtol=1e-6)
    assert float(value["a"] * value["b"]) == pytest.approx(2.0)
    rows = np.stack([X, np.ones_like(X)], axis=1)
    np.testing.assert_allclose(slope, np.linalg.pinv(rows)[1], atol=1e-10)


def test_known_numbers_are_fitted_at_once_and_what_does_not_converge_is_nan():
    short = Optimistix(max_steps=1)

    @jax.jit
    def of(x):
        known = srsinv.fit(decay, INITIAL, Y, noise=NOISE)
        assert isinstance(known.value["k"], float)
        return srsinv.fit(decay, INITIAL, Y + x, noise=NOISE, solver=short).value["k"]

    assert np.isnan(of(0.0))


def rough(params):
    """A decay whose derivative by its rate changes by a fifth, up and down in 0.02 of it."""
    wave = 6e-4 * jnp.sin(2 * jnp.pi * params["k"] / 0.02) * jnp.exp(-3 * X)
    return decay(params) + wave


STEPS = {"k": 0.04}  # two of its waves
TIGHT = Optimistix(rounding=1e-9)


@pytest.mark.full
def test_by_steps_it_moves_as_the_differences_of_a_known_fit():
    y = rough({"a": 3.0, "k": 2.0, "c": 1.0})

    def of(y, model=rough, steps=STEPS):
        return srsinv.fit(model, INITIAL | {"k": 2.002}, y, noise=NOISE, steps=steps, solver=TIGHT)

    def numbers(y):
        return of(y).value, of(y).stderr

    made, moved = jax.jit(lambda y: jax.jvp(numbers, (y,), (jnp.asarray(ALONG),)))(y)
    known: Any = of(y)
    expected = dict(zip(known.names, -known.moves(ALONG), strict=True))
    own = srsinv.fit(rough, INITIAL | {"k": 2.002}, y, noise=NOISE, solver=TIGHT)
    assert abs(own.stderr["k"] / known.stderr["k"] - 1) > 0.05
    for name in INITIAL:
        assert float(made[0][name]) == pytest.approx(known.value[name], rel=1e-8)
        assert float(made[1][name]) == pytest.approx(known.stderr[name], rel=1e-7)
        assert float(moved[0][name]) == pytest.approx(expected[name], rel=1e-6)


@pytest.mark.full
def test_by_steps_of_a_smooth_model_it_moves_as_a_known_fit_beside_the_noise():
    """Second derivatives, too, are differences: the whole slope of the minimum."""

    def value(t):
        y = jnp.asarray(Y) + t * ALONG
        made = srsinv.fit(decay, INITIAL, y, noise=NOISE, steps={"k": 1e-3, "a": 1e-3})
        return jnp.stack([jnp.asarray(made.value[name]) for name in INITIAL])

    moved = jax.jit(jax.jacfwd(value))(0.0)
    expected = differences(lambda t: value(float(t[0])), np.zeros(1), 1e-2)[:, 0]
    np.testing.assert_allclose(moved, expected, rtol=1e-5)


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap])
def test_what_cannot_be_traced_says_so(transform):
    def attempt(of):
        return lambda: transform(of)(jnp.ones((1, 50)))

    model = lambda p: p["a"] * jnp.ones(50)  # noqa: E731
    start = {"a": 1.0}
    refused(attempt(lambda y: srsinv.fit_many(model, start, y.reshape(1, 50))), "srsinv.fit")
    refused(attempt(lambda y: srsinv.fit(model, start, y[..., 0], steps={"a": 0.0})), "step of a")
    refused(attempt(lambda y: srsinv.fit(model, start, y[..., 0], priors={"a": (0, 1)})), "noise")
    refused(attempt(lambda y: srsinv.fit(model, start, Y, bounds={"a": (0, y.sum())})), "bounds")


LINE, SCAN = srsinv.Open(64, 5e-4), srsinv.ConstantSpeed(0.05)
STRIP = {"position_m": 16.1e-3, "width_m": 3.3e-3, "pressure_Pa": 2e3, "friction": 0.3}


def log_width_error(log_depth: Any) -> Any:
    """The log of the standard error of a strip's width, which a film at a depth determines."""
    depth_m: Any = jnp.exp(log_depth)
    film = Film(depth_m, width_m=0.5e-3).with_strip_average()
    operator = srsinv.Sensor([film]).operator(LINE, SCAN)

    def signal(params):
        strip = srsinv.UniformStrip(params["pressure_Pa"], params["width_m"], params["position_m"])
        pressure = strip.cell_average(LINE)
        return operator(jnp.stack([pressure, params["friction"] * pressure]))

    return jnp.log(srsinv.fit(signal, STRIP, signal(STRIP), noise=1e-8).stderr["width_m"])


@pytest.mark.claim
def test_the_films_depth_that_measures_a_width_best_is_found_by_newtons_steps():
    """A deep film blurs the edges. A shallow one has them within a sample, here of 0.5 mm. The
    second derivative is that of the first one's differences."""
    value_and_slope = jax.jit(jax.value_and_grad(log_width_error))
    bend = jax.jit(jax.grad(jax.grad(log_width_error)))
    log_depth = np.log(0.6e-3)
    expected = differences(lambda t: value_and_slope(t[0])[1][None], np.array([log_depth]), 1e-3)
    assert float(bend(log_depth)) == pytest.approx(expected.item(), rel=1e-6)
    for _ in range(4):
        log_depth -= float(value_and_slope(log_depth)[1] / bend(log_depth))
    around = [float(value_and_slope(log_depth + step)[0]) for step in (-0.1, 0.0, 0.1)]
    assert around[1] < min(around[0], around[2])
    assert abs(float(value_and_slope(log_depth)[1])) < 1e-6
    assert 0.3e-3 < np.exp(log_depth) < 0.4e-3
