"""Models that are linear, against closed-form least squares: value, covariance, correlation."""

from typing import NamedTuple

import numpy as np
import pytest

import srsinv
from srsinv.inverse.nonlinear import Correlated, Spectrum

N, M = 40, 3
RNG = np.random.default_rng(3)
X = np.linspace(-1, 1, N)
BASIS = np.stack([np.ones(N), X + 0.3, np.cos(3 * X)], axis=1)
TRUTH = np.array([2.0, -1.0, 0.5])
# As badly scaled as metres beside inverse picofarads.
SCALES = np.array([1e-12, 1.0, 1e12])
PRIORS = {"b[0]": (1.5, 0.05), "b[2]": (0.0, 0.2)}
PRIOR_MEAN, PRIOR_STDERR = np.array([1.5, 0.0, 0.0]), np.array([0.05, np.inf, 0.2])
POWER = 0.04 / (1 + (np.arange(N // 2 + 1) / 4) ** 2)
ROUGH = 0.02 * np.exp(-np.abs(X[:, None] - X) / 0.2) + 1e-3 * np.eye(N)
EACH = 0.1 + 0.3 * RNG.random(N)
WITH_GAPS = np.where(np.arange(N) % 5 == 2, np.inf, EACH)


def circulant(power):
    row = np.fft.irfft(power, N)
    return np.stack([np.roll(row, j) for j in range(N)])


class LinearCase(NamedTuple):
    """Noise as a user gives it, and its covariance matrix."""

    noise: object
    covariance: np.ndarray
    scales: np.ndarray = np.ones(M)
    priors: dict | None = None


CASES = {
    "white": LinearCase(0.2, 0.04 * np.eye(N)),
    "unknown_level": LinearCase(None, np.eye(N)),
    "each": LinearCase(EACH, np.diag(EACH**2)),
    "gaps": LinearCase(WITH_GAPS, np.diag(np.minimum(WITH_GAPS, 1e9) ** 2)),
    "spectrum": LinearCase(Spectrum(POWER), circulant(POWER)),
    "correlated": LinearCase(Correlated(ROUGH), ROUGH),
    "scaled": LinearCase(0.2, 0.04 * np.eye(N), SCALES),
    "scaled_unknown_level": LinearCase(None, np.eye(N), SCALES),
    "priors": LinearCase(0.2, 0.04 * np.eye(N), priors=PRIORS),
}


def model(p):
    return p["basis"] @ p["b"]


def closed_form(case: LinearCase, y):
    """The best parameters and their covariance, through a factor of the noise's covariance."""
    whiten = np.linalg.inv(np.linalg.cholesky(case.covariance))
    rows, data = whiten @ BASIS, whiten @ y
    if case.priors:
        rows = np.vstack([rows, np.diag(1 / PRIOR_STDERR)])
        data = np.concatenate([data, PRIOR_MEAN / PRIOR_STDERR])
    q, r = np.linalg.qr(rows)
    value, inverse = np.linalg.solve(r, q.T @ data), np.linalg.inv(r)
    left = data - rows @ value
    level = left @ left / (N - M) if case.noise is None else 1.0
    return value / case.scales, level * inverse @ inverse.T / np.outer(case.scales, case.scales)


# Of those that compile a program of their own each is once in either of them, but for two.
BOTH_WAYS = [
    pytest.param(name, linear, id=f"{name}-{way}")
    for name in CASES
    for way, linear in (("searched", ()), ("solved", ("b",)))
    if (name, way) not in {("spectrum", "searched"), ("correlated", "solved")}
]


@pytest.mark.full
@pytest.mark.parametrize(("name", "linear"), BOTH_WAYS)
def test_closed_form(name, linear):
    case = CASES[name]
    y = BASIS @ TRUTH + 0.2 * np.random.default_rng(5).normal(size=N)
    initial = {"b": np.zeros(M), "basis": BASIS * case.scales}
    fit = srsinv.fit(
        model, initial, y, noise=case.noise, priors=case.priors, free="b", linear=linear
    )
    value, covariance = closed_form(case, y)
    stderr = np.sqrt(np.diagonal(covariance))
    unit = np.outer(stderr, stderr)
    assert fit.converged, fit.status
    assert not fit.undetermined
    np.testing.assert_allclose(fit.value["b"] * case.scales, value * case.scales, rtol=1e-9)
    np.testing.assert_allclose(fit.stderr["b"], stderr, rtol=1e-9)
    np.testing.assert_allclose(fit.covariance / unit, covariance / unit, atol=1e-9)
    np.testing.assert_allclose(fit.correlation, covariance / unit, atol=1e-9)
    np.testing.assert_array_equal(fit.stderr["basis"], 0.0)
    left_out = np.isposinf(case.noise) if name == "gaps" else np.zeros(N, bool)
    left = np.where(left_out, np.nan, y - BASIS * case.scales @ fit.value["b"])
    np.testing.assert_allclose(fit.residual, left, atol=1e-12)


def test_ill_conditioned_basis():
    """Powers to the seventh on [1, 2], a condition number of 1e8 once columns are scaled: no
    direction is lost."""
    x = np.linspace(1, 2, N)
    basis = x[:, None] ** np.arange(8)
    truth = np.ones(8)
    fit = srsinv.fit(
        lambda p: basis @ p["b"], {"b": np.zeros(8)}, basis @ truth, noise=1.0, linear=["b"]
    )
    inverse = np.linalg.inv(np.linalg.qr(basis)[1])
    stderr = np.linalg.norm(inverse, axis=1)
    assert fit.converged, fit.status
    assert not fit.undetermined
    np.testing.assert_allclose(fit.stderr["b"], stderr, rtol=1e-6)
    np.testing.assert_allclose((fit.value["b"] - truth) / stderr, 0.0, atol=1e-6)
