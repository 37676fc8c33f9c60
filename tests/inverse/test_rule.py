"""The rules that choose a weight, against the criteria computed from dense matrices."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.inverse.quadratic import Scorer
from srsinv.inverse.rule import Discrepancy, Evidence, GeneralisedCrossValidation
from srsinv.inverse.tikhonov import Penalties, Tikhonov
from srsinv.inverse.wiener import Exponential, ScaledSpectra
from tests.inverse.cases import (
    DEPTH_M,
    SLOW,
    N,
    gaps,
    log_marginal,
    make_case,
    minimiser,
    penalty_rows,
    relative,
)

RULES = {"gcv": GeneralisedCrossValidation(), "evidence": Evidence(), "discrepancy": Discrepancy()}


def dense_gcv(problem, order):
    """log10 weights -> residual over N, over the square of the share of N that is left."""
    minimise, samples = minimiser(problem), problem.samples

    def criterion(*log_weights) -> float:
        dense = minimise(penalty_rows(problem, order, 10.0 ** np.array(log_weights)))
        return dense.residual / samples / (1 - dense.freedom / samples) ** 2

    return criterion


def weights(estimate):
    """The log10 weights that the estimate was made with."""
    names = [name for name in estimate.stats if name.startswith("weight_")]
    return np.log10([estimate.stats[name] for name in names])


ONE = {
    "spectral": {"films": "one", "friction": 0.3},
    "gaps": {"kind": "open", "friction": -0.3, "observed": gaps()},
}


@pytest.mark.parametrize("name", ONE)
def test_gcv_minimises_the_dense_criterion_in_one_weight(name):
    problem = make_case(**ONE[name]).problem
    estimate = Tikhonov(1, rule=RULES["gcv"])(problem)
    (chosen,) = weights(estimate)
    assert estimate.stats["rule_result"] == "converged"
    gcv = dense_gcv(problem, 1)
    scan = [gcv(w) for w in chosen + np.arange(-6, 6.1, 0.25)]
    assert gcv(chosen) < min(scan) * 1.002
    assert max(scan) > 1.5 * min(scan)


@pytest.mark.parametrize("seed", [0, 1])
def test_gcv_minimises_the_dense_criterion_in_two_weights(seed):
    problem = make_case(seed=seed).problem
    p, q = weights(Tikhonov(1, rule=RULES["gcv"])(problem))
    gcv, steps = dense_gcv(problem, 1), np.arange(-3, 3.1, 0.5)
    assert gcv(p, q) < min(gcv(p + a, q + b) for a in steps for b in steps) * 1.005


def test_gcv_finds_weights_far_apart():
    """p a hundred times smaller than q: the best weights lie decades off the scan's diagonal."""
    case = make_case(noise_share=0.1)
    truth = case.truth * np.array([[0.01], [1.0]])
    signal = np.asarray(case.problem.forward(jnp.asarray(truth)))
    sigma = 0.1 * signal.std()
    data = signal + sigma * np.random.default_rng(0).normal(size=signal.shape)
    problem = eqx.tree_at(
        lambda p: (p.data, p.noise), case.problem, (data, np.full(N // 2 + 1, sigma**2))
    )
    chosen = weights(Tikhonov(1, rule=RULES["gcv"])(problem))
    scorer = Scorer(Penalties(jnp.asarray(DEPTH_M), 1), problem, "spectral")
    axes = [np.arange(w - 8, w + 8, 0.25) for w in chosen]
    scan = jnp.asarray(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2))
    best = np.min(RULES["gcv"].criterion(scorer(scan), problem.samples))
    assert dense_gcv(problem, 1)(*chosen) < best * 1.02


SCORED = {
    "whole": ({}, ("spectral", "direct")),
    "coloured": ({"colour": True}, ("spectral", "direct")),
    "mean_seen": ({"amplifier": SLOW, "films": "turned"}, ("spectral", "direct")),
    "friction": ({"films": "one", "friction": 0.3}, ("spectral", "direct")),
    "gaps": ({"kind": "open", "observed": gaps()}, ("direct",)),
}
LOG_WEIGHTS = np.array([[-5.0, -4.0], [-4.0, -4.0], [-2.0, -6.0]])
SCORES = [(name, path) for name, (_, paths) in SCORED.items() for path in paths]


@pytest.mark.parametrize(("name", "path"), SCORES)
def test_scores_are_those_of_dense_matrices(name, path):
    """Residual and degrees of freedom, which generalised cross validation is made of."""
    problem = make_case(**SCORED[name][0]).problem
    logs = LOG_WEIGHTS[:, : problem.unknowns]
    score = Scorer(Penalties(jnp.asarray(DEPTH_M), 2), problem, path)(jnp.asarray(logs))
    minimise = minimiser(problem)
    dense = [minimise(penalty_rows(problem, 2, 10.0**w)) for w in logs]
    np.testing.assert_allclose(score.residual, [d.residual for d in dense], rtol=1e-7)
    np.testing.assert_allclose(score.freedom, [d.freedom for d in dense], rtol=1e-7)


@pytest.mark.parametrize(("name", "path"), SCORES)
def test_evidence_is_the_log_marginal_likelihood(name, path):
    """Up to one constant, so it is the differences between weights that count."""
    problem = make_case(**SCORED[name][0]).problem
    shape = [Exponential(1e3, 1e-3).power(problem), Exponential(3e2, 2e-3).power(problem)]
    power = np.stack(shape[: problem.unknowns])
    logs = np.array([[0.0, 0.0], [1.0, 0.0], [-2.0, 1.5]])[:, : problem.unknowns]
    score = Scorer(ScaledSpectra(jnp.asarray(power)), problem, path)(jnp.asarray(logs))
    dense = np.array([log_marginal(problem, 10.0 ** w[:, None] * power) for w in logs])
    ours = np.asarray(score.log_evidence)
    np.testing.assert_allclose(ours - ours[0], dense - dense[0], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("path", ["spectral", "direct"])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_evidence_of_a_derivative_penalty(order, path):
    """The penalty stands for a Gaussian prior; where it says nothing, the mean, it has no part."""
    problem = make_case().problem
    k, cell = np.asarray(problem.line.k), float(problem.line.cell_m)
    symbol = (2 * DEPTH_M / cell * np.sin(k * cell / 2)) ** (2 * order)
    symbol[0] = 1.0
    logs = LOG_WEIGHTS
    score = Scorer(Penalties(jnp.asarray(DEPTH_M), order), problem, path)(jnp.asarray(logs))
    dense = np.array([log_marginal(problem, 10.0 ** -w[:, None] / symbol) for w in logs])
    ours = np.asarray(score.log_evidence)
    np.testing.assert_allclose(ours - ours[0], dense - dense[0], rtol=1e-6, atol=1e-6)


DISCREPANCIES = {
    "spectral": ({}, 1.0),
    "twice": ({}, 2.0),
    "direct": ({"kind": "open", "observed": gaps(), "colour": True}, 1.2),
    "friction": ({"films": "one", "friction": 0.3}, 1.2),
}


@pytest.mark.parametrize("name", DISCREPANCIES)
def test_discrepancy_meets_its_target(name):
    settings, factor = DISCREPANCIES[name]
    problem = make_case(**settings).problem
    estimate = Tikhonov(1, rule=Discrepancy(factor))(problem)
    assert estimate.stats["rule_result"] == "converged"
    rows = penalty_rows(problem, 1, 10.0 ** weights(estimate))
    residual = minimiser(problem)(rows).residual
    assert residual == pytest.approx(factor**2 * problem.samples, rel=1e-3)


@pytest.mark.parametrize(("factor", "side"), [(1e-12, "below"), (1e6, "above")])
def test_discrepancy_says_when_no_weight_reaches_its_target(factor, side):
    estimate = Tikhonov(1, rule=Discrepancy(factor))(make_case().problem)
    assert "no weight reaches the target" in estimate.stats["rule_result"]
    assert f"the stated noise is {side} every residual" in estimate.stats["rule_result"]


def test_discrepancy_keeps_a_given_weight():
    problem = make_case().problem
    estimate = Tikhonov(1, weight_q=3e-5, rule=Discrepancy(1.1))(problem)
    assert estimate.stats["weight_q_per_Pa2"] == pytest.approx(3e-5, rel=1e-12)
    rows = penalty_rows(problem, 1, 10.0 ** weights(estimate))
    residual = minimiser(problem)(rows).residual
    assert residual == pytest.approx(1.21 * problem.samples, rel=1e-3)


@pytest.mark.parametrize("name", RULES)
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_rules_follow_the_scale_of_the_data(name, scale):
    """Signal, noise and noise level times a factor: the same filter, so the estimate scales."""
    method = Tikhonov(1, rule=RULES[name])
    one, other = (method(make_case(scale=s).problem) for s in (1.0, scale))
    np.testing.assert_allclose(weights(other), weights(one) - 2 * np.log10(scale), atol=1e-3)
    assert relative(other.value, scale * np.asarray(one.value)) < 1e-3
    assert relative(other.stderr, scale * np.asarray(one.stderr)) < 1e-3


@pytest.mark.parametrize("scale", [1e-2, 1e2])
def test_gcv_needs_no_noise_level(scale):
    """A wrong level of the noise moves the weight's unit, and leaves the estimate."""
    problem = make_case().problem
    wrong = eqx.tree_at(lambda p: p.noise, problem, scale**2 * problem.noise)
    method = Tikhonov(1, rule=RULES["gcv"])
    assert relative(method(wrong).value, method(problem).value) < 1e-6


def test_pure_noise_is_said_to_determine_nothing():
    """No signal at all: the strongest weight, and the rule says that it is at its range's end."""
    case = make_case()
    noise = case.sigma * np.random.default_rng(8).normal(size=case.problem.data.shape)
    problem = eqx.tree_at(lambda p: p.data, case.problem, noise)
    estimate = Tikhonov(0, rule=RULES["evidence"])(problem)
    assert "end of its range" in estimate.stats["rule_result"]
    assert np.abs(estimate.value).max() < 0.05 * np.abs(case.truth).max()
