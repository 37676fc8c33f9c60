"""Bounds: the constrained minimum, exactly inside, by every solver, against scipy's own method."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import srsinv
from srsinv.inverse.nonlinear import JaxoptLBFGSB, OptaxLBFGS, Optimistix
from tests.tiers import quick

X = np.linspace(0, 1, 40)
NAMES = ("a", "k", "c", "w")
SOLVERS = (Optimistix(), OptaxLBFGS(), JaxoptLBFGSB())
SPREAD = np.array([0.5, 0.5, 0.3, 0.5])
STDERR = 0.02


def model(p):
    return p["a"] * jnp.exp(-p["k"] * X) + p["c"] * jnp.cos(p["w"] * X)


@jax.jit
def residual(z, y):
    return (model(dict(zip(NAMES, z, strict=True))) - y) / STDERR


derivative = jax.jit(jax.jacfwd(residual))


def problem(seed):
    """Data, a start and bounds that mostly exclude the truth; some are one-sided, and some starts
    lie on them."""
    rng = np.random.default_rng(seed)
    truth = np.array([3.0, 2.0, 1.0, 6.0]) + SPREAD * rng.normal(size=4)
    y = np.asarray(model(dict(zip(NAMES, truth, strict=True)))) + STDERR * rng.normal(size=40)
    lower = truth + SPREAD * (rng.normal(size=4) - 1)
    upper = lower + SPREAD * (1 + 2 * rng.random(4))
    start = (lower + upper) / 2
    if seed % 3 == 1:
        upper[1], lower[2] = np.inf, -np.inf
    if seed % 4 == 2:
        start[[0, 3]] = lower[0], upper[3]
    return y, start, lower, upper


@pytest.mark.parametrize("solver", quick(SOLVERS, SOLVERS[0]), ids=lambda solver: solver.name)
def test_constrained_minimum(solver):
    active = 0
    for seed in range(12):
        y, start, lower, upper = problem(seed)
        expected = scipy.optimize.least_squares(
            residual, np.clip(start, lower + 1e-6, upper - 1e-6), derivative, (lower, upper),
            args=(y,), xtol=1e-15, ftol=1e-15, gtol=1e-15,
        )  # fmt: skip
        bounds = {name: (lower[i], upper[i]) for i, name in enumerate(NAMES)}
        fit = srsinv.fit(
            model, dict(zip(NAMES, start, strict=True)), y,
            noise=STDERR, bounds=bounds, solver=solver,
        )  # fmt: skip
        z = np.array([fit.value[name] for name in NAMES])
        assert fit.converged, (seed, fit.status)
        assert fit.stats["solver"] == solver.name
        assert (z >= lower).all()
        assert (z <= upper).all()
        np.testing.assert_allclose(fit.stats["cost"], expected.cost, rtol=1e-8)
        np.testing.assert_allclose(z, expected.x, atol=1e-6)
        # On its bound the cost rises inwards, elsewhere it is flat.
        slope = np.asarray(derivative(z, y)).T @ np.asarray(residual(z, y))
        unit = np.linalg.norm(np.asarray(derivative(z, y)), axis=0)
        at = np.array([name in fit.at_bound for name in NAMES])
        inward = np.where(z - lower < upper - z, 1.0, -1.0)
        assert (inward * slope / unit >= -1e-3)[at].all()
        assert (np.abs(slope / unit) <= 1e-3)[~at].all()
        active += at.sum()
    assert active >= 12


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [
        ((None, 1.0), 1.0),
        ((3.0, None), 3.0),
        ((None, 5.0), 2.0),
        ((-np.inf, np.inf), 2.0),
        ((1.9, 2.0), 2.0),
    ],
)
def test_one_parameter(bounds, expected):
    start = np.clip(1.5, *(b if b is not None else np.nan_to_num(s * np.inf)
                           for b, s in zip(bounds, (-1, 1), strict=True)))  # fmt: skip
    y = np.exp(-2 * X)
    fit = srsinv.fit(lambda p: jnp.exp(-p["k"] * X), {"k": start}, y, bounds={"k": bounds})
    assert fit.converged, fit.status
    np.testing.assert_allclose(fit.value["k"], expected, atol=1e-9)
    assert ("k" in fit.at_bound) == (expected in bounds)


def test_two_trees_of_bounds():
    y = 3 * np.exp(-2 * X)
    fit = srsinv.fit(
        lambda p: p[0] * jnp.exp(-p[1] * X), [1.0, 1.0], y, bounds=([0.0, None], [2.5, 9.0])
    )
    assert fit.value[0] == 2.5
    assert fit.at_bound == ("0",)
