"""Rules on the iterative path, which takes products of the operator alone: the scores, weights,
values and bands of the direct path, and of waves where the unknowns are many."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse

import srsinv
from srsinv import GaussianPrior, LinearProblem, Tikhonov, Wiener
from srsinv.inverse.line import rule as rules
from srsinv.status import Status
from tests.inverse.linear.problems import PROBLEMS
from tests.refusals import refused
from tests.tiers import hardest

M = 24
AT = np.arange(M) / M
BLUR = np.exp(-0.5 * ((AT[:, None] - AT) / 0.06) ** 2) / M
CIRCULANT = scipy.linalg.circulant(np.exp(-0.5 * (np.minimum(AT, 1 - AT) / 0.06) ** 2) / M)
SMOOTH = np.exp(-np.abs(AT[:, None] - AT) / 0.3)
TRUTH = np.sin(2 * np.pi * AT) + 0.5
NOISE = 1e-3


class Recorded(rules.Rule):
    """The largest weight of the box, after the scores of some are put into `seen`."""

    name = "recorded"
    logs: tuple[float, ...] = eqx.field(static=True)
    seen: list = eqx.field(static=True)

    def choose(self, scorer, box):
        self.seen.append((np.asarray(box).ravel(), scorer(np.array(self.logs)[:, None])))
        return rules.Choice(np.asarray(box)[1], Status.CONVERGED)


def scores(problem, order, logs, path):
    """The box of the log10 weight, and the scores at `logs`."""
    rule = Recorded(tuple(np.asarray(logs).tolist()), [])
    Tikhonov(order, rule=rule, path=path)(problem)
    return rule.seen[0]


def noisy(matrix):
    truth = np.resize(TRUTH, matrix.shape[1])
    return matrix @ truth + NOISE * np.random.default_rng(0).standard_normal(len(matrix))


def of_image(shape):
    """A blurred image by a function, 2 x 2 cells at once, with ends."""
    truth = np.outer(np.hanning(shape[0]), np.hanning(shape[1]))

    def blur(x):
        wide = jnp.pad(x, ((0, 1), (0, 1)))
        return (wide[1:, 1:] + wide[:-1, 1:] + wide[1:, :-1] + 2 * wide[:-1, :-1]) / 5

    def adjoint(y):
        wide = jnp.pad(y, ((1, 0), (1, 0)))
        return (wide[:-1, :-1] + wide[:-1, 1:] + wide[1:, :-1] + 2 * wide[1:, 1:]) / 5

    data = np.array(blur(truth)) + NOISE * np.random.default_rng(0).standard_normal(shape)
    return LinearProblem(blur, data, NOISE, adjoint=adjoint)


def hansen(name):
    matrix, truth = PROBLEMS[name](32)
    clean = matrix @ truth
    sigma = 1e-3 * np.linalg.norm(clean) / np.sqrt(32)
    noise = sigma * np.random.default_rng(2).standard_normal(32)
    return LinearProblem(matrix, clean + noise, sigma)


def under(prior, matrix=BLUR):
    return LinearProblem(matrix, noisy(matrix), NOISE, prior=prior)


SINGULAR = np.diff(np.eye(M), 2, axis=0)
GAPS = np.where(np.arange(M) % 5 == 2, np.nan, noisy(BLUR))
UNEVEN = NOISE * (1 + AT)
CASES: dict[str, tuple[Any, int]] = {
    "blur_0": (lambda: under(None), 0),
    "blur_1": (lambda: under(None), 1),
    "blur_2": (lambda: under(None), 2),
    "few_samples": (lambda: under(None, BLUR[::3]), 2),
    "many_samples": (lambda: under(None, np.repeat(BLUR, 2, axis=0)), 1),
    "circulant": (lambda: under(None, CIRCULANT), 1),
    "two_gains": (lambda: under(None, np.diag(np.where(AT < 0.5, 2.0, 0.1))), 0),
    "gaps": (lambda: LinearProblem(BLUR, GAPS, UNEVEN), 1),
    "sparse": (lambda: LinearProblem(scipy.sparse.csr_array(BLUR), noisy(BLUR), NOISE), 1),
    "image_1": (lambda: of_image((5, 7)), 1),
    "image_2": (lambda: of_image((5, 6)), 2),
    "stderr": (lambda: under(GaussianPrior(0.5 + AT, mean=0.5)), 0),
    "covariance": (lambda: under(GaussianPrior(covariance=SMOOTH, mean=0.5)), 0),
    "precision": (lambda: under(GaussianPrior(precision=np.linalg.inv(SMOOTH))), 0),
    "root": (lambda: under(GaussianPrior(root=np.r_[np.eye(M), SINGULAR])), 0),
    "singular": (lambda: under(GaussianPrior(root=SINGULAR, mean=AT)), 0),
    "shaw": (lambda: hansen("shaw"), 1),
    "phillips": (lambda: hansen("phillips"), 2),
    "gravity": (lambda: hansen("gravity"), 0),
}


SECOND = {"circulant", "few_samples", "gaps", "image_2", "precision", "singular", "gravity"}


@pytest.mark.parametrize("name", hardest(CASES, {"blur_2", "two_gains"}, SECOND))
def test_scores_are_those_of_the_matrix(name):
    """Every term that a rule may go by, at weights where rounding of the smallest singular values
    that count leaves six digits."""
    make, order = CASES[name]
    problem = make()
    (low, high), _ = scores(problem, order, [0.0], "iterative")
    logs = np.linspace(max(low, high - 16) + 2, high, 9)
    (_, direct_high), wanted = scores(problem, order, logs, "direct")
    _, found = scores(problem, order, logs, "iterative")
    assert high == pytest.approx(direct_high, abs=1e-3)
    for term, own, other in zip(found._fields, found, wanted, strict=True):
        assert np.allclose(own, other, rtol=1e-5, atol=1e-9 * np.max(np.abs(other))), term


RULES = {
    "evidence": rules.Evidence(),
    "gcv": rules.GeneralisedCrossValidation(),
    "upre": rules.UnbiasedPredictiveRisk(),
    "aicc": rules.CorrectedAkaikeCriterion(),
    "discrepancy": rules.DiscrepancyPrinciple(),
    "l_curve": rules.LCurve(),
    "ncp": rules.NormalisedCumulativePeriodogram(),
    "quasi_optimality": rules.QuasiOptimality(),
}


@pytest.mark.parametrize("name", hardest(RULES, {}, {"gcv", "ncp"}))
def test_rules_choose_as_on_the_direct_path(name):
    """Where all singular vectors are found, weight and value are exact. Each variance is off by
    18 % at most, the standard deviation of 64 draws; five of them."""
    problem = hansen("gravity")
    exact = Tikhonov(1, rule=RULES[name], path="direct")(problem)
    found = Tikhonov(1, rule=RULES[name], path="iterative")(problem)
    assert found.stats["weight"] == pytest.approx(exact.stats["weight"], rel=1e-5)
    assert found.stats["probes"] == 0
    assert found.stats["resolved_dof"] == pytest.approx(exact.stats["resolved_dof"], rel=1e-5)
    size = np.linalg.norm(exact.value)
    assert np.linalg.norm(found.value - exact.value) < 1e-5 * size
    assert np.all(np.abs(found.stderr**2 / exact.stderr**2 - 1) < 5 * np.sqrt(2 / 64))
    assert set(exact.warnings) <= set(found.warnings)


def test_scale_of_a_prior_is_found_by_products():
    problem = under(GaussianPrior(covariance=SMOOTH))
    exact, found = (
        Wiener(scale="evidence", path=path)(problem) for path in ("direct", "iterative")
    )
    assert found.stats["weight"] == pytest.approx(exact.stats["weight"], rel=1e-6)
    assert np.allclose(found.value, exact.value, rtol=0, atol=1e-7)


def of_waves(n, noise):
    """The blur of an n x n image by a periodic Gaussian, its gains and the data's amplitudes over
    the noise."""
    k = np.minimum(np.arange(n), n - np.arange(n))
    line = np.exp(-0.5 * (k / 2.0) ** 2)
    spread = np.outer(line, line) / np.sum(line) ** 2
    kernel = jnp.fft.rfft2(jnp.asarray(spread))

    def blur(x):
        return jnp.fft.irfft2(jnp.fft.rfft2(x) * kernel, x.shape)

    truth = np.zeros((n, n))
    truth[n // 5 : n // 2, n // 3 : 2 * n // 3] = 1.0
    data = np.array(blur(truth)) + noise * np.random.default_rng(0).standard_normal((n, n))
    gains = np.abs(np.fft.fft2(spread)).ravel() / noise
    return LinearProblem(blur, data, noise, adjoint=blur), gains, np.fft.fft2(data).ravel() / noise


@pytest.mark.parametrize(("n", "noise"), hardest([(40, 0.1), (128, 0.01)], {(40, 0.1)}, {}))
def test_image_has_the_weight_of_waves(n, noise):
    """More unknowns than are factored. The evidence over waves is exact, and the weight agrees
    with its own to five of the standard deviations that the estimate states."""
    problem, gains, waves = of_waves(n, noise)
    found = Tikhonov(0, path="iterative")(problem)
    assert found.status == Status.CONVERGED
    error = found.stats["weight_error"]
    assert 0 < error < 0.05
    assert "random probes" in " ".join(found.warnings)
    logs = np.linspace(-1, 1, 2001) + np.log10(found.stats["weight"])
    share = 10.0 ** logs[:, None] / (gains**2 + 10.0 ** logs[:, None])
    evidence = np.sum(np.log(share), axis=1) - share @ (np.abs(waves) ** 2 / n**2)
    best = 10.0 ** logs[np.argmax(evidence)]
    assert abs(np.log(found.stats["weight"] / best)) < 5 * error + 1e-3
    total = gains**2 + found.stats["weight"]
    value = np.fft.ifft2((gains * waves / total).reshape(n, n)).real
    assert np.allclose(found.value, value, rtol=0, atol=1e-5)
    freedom = np.sum(gains**2 / total)
    assert abs(found.stats["resolved_dof"] - freedom) < 5 * np.sqrt(2 * freedom / 64)


@pytest.mark.full
def test_data_without_signal_leave_the_weight_undetermined():
    problem = LinearProblem(BLUR, np.zeros(M), NOISE)
    found = Tikhonov(1, path="iterative")(problem)
    assert found.stats["rule_status"] == Status.RANGE_END
    assert np.allclose(found.value, 0.0, atol=1e-12)
    assert "Set the weight" in " ".join(found.warnings)


def test_what_no_rule_can_weigh_is_refused():
    method = Tikhonov(1, path="iterative")
    refused(lambda: method(LinearProblem(0 * BLUR, noisy(BLUR), NOISE)), "undetermined", "order=0")
    without_mean = np.diff(np.eye(M), axis=0)
    refused(lambda: method(LinearProblem(without_mean, AT[1:], NOISE)), "undetermined")
    flat = LinearProblem(0 * BLUR, noisy(BLUR), NOISE)
    refused(lambda: Tikhonov(0, path="iterative")(flat), "operator is zero")


@pytest.mark.full
def test_large_problem_needs_no_weight():
    """Beyond the limit of the direct path, `invert` chooses path and weight by itself."""
    n = 2100
    kernel = np.exp(-0.5 * (np.arange(-20, 21) / 6.0) ** 2)
    places: Any = np.arange(-20, 21)
    blur = scipy.sparse.diags_array(kernel / kernel.sum(), offsets=places, shape=(n, n))
    truth = np.sin(np.arange(n) / 100)
    data = blur @ truth + 0.5 * np.random.default_rng(0).standard_normal(n)
    found = srsinv.invert(LinearProblem(blur.tocsr(), data, 0.5))
    assert found.stats["path"] == "iterative"
    z = (found.value - truth) / found.stderr
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5
    assert found.stats["chi2_per_freedom"] == pytest.approx(1, abs=5 * np.sqrt(2 / n))
