"""The log evidence against brute-force integration, and exactly where all is Gaussian."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

import srsinv
from tests.tiers import quick

X = np.linspace(0, 1, 20)
NOISE = np.random.default_rng(2).normal(size=20)
GRID = {1: 20_000, 2: 400}  # cells along each axis, by the number of axes


def line(p):
    return p["a"] * X


def tilted(p):
    return p["a"] * jnp.exp(-p["k"] * X)


def integral(model, y, stderr, boxes, priors):
    """The log of the mean likelihood over the boxes, by the midpoint rule."""
    names = list(boxes)
    grids = [np.linspace(*boxes[n], 2 * GRID[len(names)] + 1)[1::2] for n in names]
    mesh = {n: g.ravel() for n, g in zip(names, np.meshgrid(*grids, indexing="ij"), strict=True)}
    made = np.asarray(jax.vmap(model)({n: jnp.asarray(v) for n, v in mesh.items()}))
    log = -0.5 * np.sum(((y - made) / stderr) ** 2, axis=1)
    for n, (mean, width) in priors.items():
        low, high = boxes[n]
        log += -0.5 * ((mesh[n] - mean) / width) ** 2
        log += np.log((high - low) / (width * np.sqrt(2 * np.pi)))
    return logsumexp(log) - np.log(len(log)) - len(y) * np.log(stderr * np.sqrt(2 * np.pi))


@pytest.mark.parametrize("stderr", [0.1, 1.0, 10.0, 100.0])
@pytest.mark.parametrize("slope", [0.5, 0.02, -0.1, 1.3, -1.0])
def test_one_bounded_parameter(slope, stderr):
    """Exact for a linear model: a sharp posterior, one broader than its bounds, one on a bound,
    and one far beyond it."""
    y = slope * X + 0.3 * stderr * NOISE
    boxes = {"a": (0.0, 1.0)}
    fit = srsinv.fit(line, {"a": 0.5}, y, noise=stderr, bounds=boxes)
    expected = integral(line, y, stderr, boxes, {})
    np.testing.assert_allclose(fit.log_evidence, expected, atol=2e-3)


@pytest.mark.full
@pytest.mark.parametrize(
    ("stderr", "priors", "within"),
    [
        (0.01, {}, 0.02),
        (0.1, {}, 0.1),
        (30.0, {}, 0.05),  # nothing learned: the evidence is that of the noise alone
        (0.05, {"a": (1.2, 0.3)}, 0.05),
        (0.1, {"a": (1.0, 0.2), "k": (2.0, 0.3)}, 0.05),
    ],
)
def test_two_parameters(stderr, priors, within):
    y = np.asarray(tilted({"a": 1.3, "k": 1.8})) + stderr * NOISE
    boxes = {"a": (0.0, 4.0), "k": (0.0, 5.0)}
    fit = srsinv.fit(tilted, {"a": 1.0, "k": 1.0}, y, noise=stderr, bounds=boxes, priors=priors)
    expected = integral(tilted, y, stderr, boxes, priors)
    np.testing.assert_allclose(fit.log_evidence, expected, atol=within)


@pytest.mark.parametrize("linear", [(), ("b",)])
@pytest.mark.parametrize("width", quick([1e-3, 1.0, 1e6], 1.0))
def test_linear_gaussian(linear, width):
    basis = np.stack([np.ones(20), X, X**2], axis=1)
    widths, mean, stderr = width * np.array([1.0, 2.0, 0.5]), np.array([1.0, 0.0, -1.0]), 0.3
    y = basis @ np.array([1.0, 1.0, 0.0]) + stderr * NOISE
    priors = {f"b[{i}]": (mean[i], widths[i]) for i in range(3)}
    fit = srsinv.fit(
        lambda p: basis @ p["b"], {"b": np.zeros(3)}, y, noise=stderr, priors=priors, linear=linear
    )
    covariance = stderr**2 * np.eye(20) + (basis * widths**2) @ basis.T
    if width < 1e3:
        expected = multivariate_normal(basis @ mean, covariance).logpdf(y)
    else:
        expected = by_lemma(basis, widths, mean, stderr, y)
    np.testing.assert_allclose(fit.log_evidence, expected, rtol=1e-8)


def by_lemma(basis, widths, mean, stderr, y):
    """The same density by the determinant and inversion lemmas, for covariances of 1e12."""
    rows = basis / stderr
    inner = rows.T @ rows + np.diag(widths**-2.0)
    left = (y - basis @ mean) / stderr
    inside = rows.T @ left
    square = left @ left - inside @ np.linalg.solve(inner, inside)
    log_det = np.linalg.slogdet(inner)[1] + 2 * np.sum(np.log(widths)) + 40 * np.log(stderr)
    return -0.5 * (square + log_det + 20 * np.log(2 * np.pi))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"noise": None, "bounds": {"a": (0, 1)}},
        {"noise": 0.1},
        {"noise": 0.1, "bounds": {"a": (0, 1e-200)}},  # whose width has no square
    ],
)
def test_none_without_noise_or_priors(options):
    assert srsinv.fit(line, {"a": 0.0}, 0.5 * X + 0.1 * NOISE, **options).log_evidence is None
