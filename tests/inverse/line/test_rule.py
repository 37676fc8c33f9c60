"""The rules that choose a weight, against the criteria computed from dense matrices.

Scores are asked for as many weights at once as a rule's first scan, so that one program serves.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv import LinearProblem
from srsinv.grid import half_spectrum_weights
from srsinv.inverse.line import rule as rules
from srsinv.inverse.line.rule import Evidence, GeneralisedCrossValidation
from srsinv.inverse.line.scorer import LineScorer
from srsinv.inverse.quality import Quality
from srsinv.inverse.tikhonov import Penalties, Tikhonov
from srsinv.inverse.wiener import Exponential, ScaledSpectra, StretchedSpectra
from tests.inverse.cases import (
    DEPTH_M,
    SLOW,
    N,
    deviation,
    gaps,
    log_marginal,
    make_case,
    minimiser,
    penalty_rows,
    relative,
)
from tests.tiers import quick

RULES = {"gcv": GeneralisedCrossValidation(), "evidence": Evidence()}
BATCH = 19  # weights of a rule's first scan
BOX = np.array([[-14.0, -14.0], [4.0, 4.0]])


def penalties(order=1):
    return Penalties(jnp.asarray(DEPTH_M), order)


def chosen(rule, problem, path):
    """The log10 weights that a rule chooses from all in the box."""
    box = jnp.asarray(BOX[:, : problem.unknowns])
    choice = RULES[rule].choose(LineScorer(penalties(), problem, path), box)
    assert choice.status == "converged"
    return np.asarray(choice.log_weights)


def weights(estimate):
    """The log10 weights that the estimate was made with."""
    names = [name for name in estimate.stats if name.startswith("weight_")]
    return np.log10([estimate.stats[name] for name in names])


# Problems by name, and the paths that serve each; of two shapes, and one more with its gaps.
PROBLEMS = {
    "whole": ({}, ("spectral", "direct")),
    "coloured": ({"colour": True}, ("spectral", "direct")),
    "coloured_apart": ({"colour": "apart"}, ("spectral", "direct")),
    "mean_seen": ({"amplifier": SLOW, "films": "turned"}, ("spectral", "direct")),
    "friction": ({"films": "one", "friction": 0.3}, ("spectral", "direct")),
    "gaps": ({"kind": "open", "observed": gaps()}, ("direct",)),
}
SCORED = [(name, path) for name, (_, paths) in PROBLEMS.items() for path in paths]


def dense_gcv(problem):
    """log10 weights -> residual over N, over the square of the share of N that is left."""
    minimise, samples = minimiser(problem), problem.sample_count

    def criterion(log_weights) -> float:
        dense = minimise(penalty_rows(problem, 1, 10.0 ** np.asarray(log_weights)))
        return dense.residual / samples / (1 - dense.freedom / samples) ** 2

    return criterion


def around(point, reach, step):
    """All points (., c) whose coordinates differ from `point` by multiples of `step`."""
    steps = np.arange(-reach, reach + step / 2, step)
    return point + np.stack(np.meshgrid(*[steps] * len(point)), axis=-1).reshape(-1, len(point))


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "path"), [("friction", "spectral"), ("whole", "spectral"), ("gaps", "direct")]
)
def test_gcv_minimises_the_dense_criterion(name, path):
    problem = make_case(**PROBLEMS[name][0]).problem
    log10_weights, gcv = chosen("gcv", problem, path), dense_gcv(problem)
    scan = [gcv(each) for each in around(log10_weights, 4, 0.25 if problem.unknowns == 1 else 1.0)]
    assert gcv(log10_weights) < min(scan) * 1.005
    assert max(scan) > 1.5 * min(scan)


def test_gcv_finds_weights_far_apart():
    """p a hundred times smaller than q: the best weights lie decades off the scan's diagonal."""
    case = make_case(noise_fraction=0.1)
    truth = case.truth * np.array([[0.01], [1.0]])
    signal = np.asarray(case.problem.forward(jnp.asarray(truth)))
    sigma = 0.1 * signal.std()
    data = signal + sigma * np.random.default_rng(0).normal(size=signal.shape)
    problem = eqx.tree_at(
        lambda p: (p.data, p.noise), case.problem, (data, np.full((1, N // 2 + 1), sigma**2))
    )
    log10_weights, gcv = chosen("gcv", problem, "spectral"), dense_gcv(problem)
    assert abs(np.ptp(log10_weights)) > 1.0
    assert gcv(log10_weights) < min(gcv(each) for each in around(log10_weights, 8, 1.0)) * 1.02


@pytest.mark.parametrize("rule", RULES)
def test_a_rule_costs_little_over_the_best_weights(rule):
    """In the mean over draws of the noise; tests/claims/rules.py has more scenes."""
    own, best = [], []
    for seed in range(3):
        problem, truth, _ = make_case(noise_fraction=0.1, seed=seed)
        minimise, wanted = minimiser(problem), deviation(problem, truth)
        log10_weights = chosen(rule, problem, "spectral")
        squares = [
            np.mean((minimise(penalty_rows(problem, 1, 10.0**each)).value - wanted) ** 2)
            for each in (log10_weights, *around(log10_weights, 2, 0.5))
        ]
        own.append(squares[0])
        best.append(min(squares))
    assert np.mean(own) < 1.2**2 * np.mean(best)


def log_weights(problem):
    """As many weights as a rule's first scan has, unlike in each component."""
    spread = np.linspace(-6.0, -2.0, BATCH)
    return np.stack([spread, np.roll(spread, 7)], axis=-1)[:, : problem.unknowns]


@pytest.mark.parametrize(("name", "path"), quick(SCORED, *SCORED[::3]))
def test_scores_are_those_of_dense_matrices(name, path):
    """Residual and degrees of freedom, which generalised cross validation is made of."""
    problem = make_case(**PROBLEMS[name][0]).problem
    logs = log_weights(problem)
    score = LineScorer(penalties(), problem, path)(jnp.asarray(logs))
    minimise = minimiser(problem)
    dense = [minimise(penalty_rows(problem, 1, 10.0**w)) for w in logs]
    np.testing.assert_allclose(score.residual, [d.residual for d in dense], rtol=1e-7)
    np.testing.assert_allclose(score.freedom, [d.freedom for d in dense], rtol=1e-7)


@pytest.mark.parametrize(("name", "path"), quick(SCORED, *SCORED[1::4]))
def test_terms_of_joint_rules_are_those_of_dense_matrices(name, path):
    """Seminorm, and the derivatives by the common logarithm of all weights as differences of dense
    solutions; the periodogram has the residual's power."""
    problem, step = make_case(**PROBLEMS[name][0]).problem, 1e-4
    logs = log_weights(problem)[2:-2]
    score = LineScorer(penalties(), problem, path)(jnp.asarray(logs))
    minimise = minimiser(problem)
    for i, each in enumerate(logs):
        rows = penalty_rows(problem, 1, 10.0**each)
        at, ahead, behind = (minimise(np.exp(s / 2) * rows) for s in (0.0, step, -step))
        slope = (ahead.value - behind.value) / (2 * step)
        movement = np.sum((slope - slope.mean(axis=-1, keepdims=True)) ** 2)
        pull = (ahead.residual - behind.residual) / (4 * step)
        seminorm = np.sum((rows @ at.value.ravel()) ** 2)
        assert float(score.seminorm[i]) == pytest.approx(seminorm, rel=1e-6)
        assert float(score.pull[i]) == pytest.approx(pull, rel=1e-4)
        assert float(score.movement[i]) == pytest.approx(movement, rel=1e-4)
    n, periodogram = problem.line.n, np.asarray(score.periodogram)
    np.testing.assert_allclose(periodogram @ half_spectrum_weights(n), score.residual, rtol=1e-9)


def check_evidence(scorer, logs, power):
    """Up to one constant, so it is the differences between weights that count."""
    dense = np.array([log_marginal(scorer.problem, power(w)) for w in logs])
    ours = np.asarray(scorer(jnp.asarray(logs)).log_evidence)
    np.testing.assert_allclose(ours - ours[0], dense - dense[0], rtol=1e-6, atol=1e-6)


@pytest.mark.full
@pytest.mark.parametrize(("name", "path"), SCORED)
def test_evidence_is_the_log_marginal_likelihood(name, path):
    problem = make_case(**PROBLEMS[name][0]).problem
    shape = [Exponential(1e3, 1e-3).power(problem), Exponential(3e2, 2e-3).power(problem)]
    power = np.stack(shape[: problem.unknowns])
    scorer = LineScorer(ScaledSpectra(jnp.asarray(power)), problem, path)
    check_evidence(scorer, log_weights(problem) + 4.0, lambda w: 10.0 ** w[:, None] * power)


@pytest.mark.parametrize(
    ("name", "path"), quick(SCORED, ("whole", "spectral"), ("whole", "direct"))
)
def test_evidence_of_a_length_is_the_log_marginal_likelihood(name, path):
    """Of spectra whose correlation lengths are stretched, at the same power of short waves."""
    problem = make_case(**PROBLEMS[name][0]).problem
    spectra = (Exponential(1e3, 1e-3), Exponential(3e2, 2e-3))[: problem.unknowns]

    def power(logs):
        *factors, stretch = 10.0**logs
        long = [Exponential(s.rms_Pa, s.correlation_m * stretch) for s in spectra]
        each = zip(factors, long, strict=True)
        return np.stack([f * stretch * np.asarray(s.power(problem)) for f, s in each])

    weights = log_weights(problem)[:5] + 4.0
    logs = np.column_stack([weights, np.linspace(-1, 1, len(weights))])
    check_evidence(LineScorer(StretchedSpectra(spectra, problem), problem, path), logs, power)


@pytest.mark.parametrize(
    ("order", "path"), [(0, "spectral"), (1, "spectral"), (2, "spectral"), (1, "direct")]
)
def test_evidence_of_a_derivative_penalty(order, path):
    """The penalty stands for a Gaussian prior; where it says nothing, the mean, it has no part."""
    problem = make_case().problem
    k, cell = np.asarray(problem.line.k), float(problem.line.cell_m)
    symbol = (2 * DEPTH_M / cell * np.sin(k * cell / 2)) ** (2 * order)
    symbol[0] = 1.0
    scorer = LineScorer(penalties(order), problem, path)
    check_evidence(scorer, log_weights(problem), lambda w: 10.0 ** -w[:, None] / symbol)


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
    estimate = Tikhonov(1, rule=RULES["evidence"])(problem)
    assert "end of its range" in estimate.stats["rule_status"]
    assert np.abs(estimate.value).max() < 0.05 * np.abs(case.truth).max()


DATA = np.cumsum(np.random.default_rng(0).normal(size=40)) / 6
JOINT = ("DiscrepancyPrinciple", "LCurve", "NormalisedCumulativePeriodogram", "QuasiOptimality")


@pytest.mark.parametrize("name", JOINT)
def test_a_joint_rule_ends_where_its_criterion_is_least_along_the_diagonal(name):
    """On a fine scan of the dense criterion there is no lower interior minimum, and the slope is
    zero there."""
    rule, problem = getattr(rules, name)(), make_case(noise_fraction=0.05).problem
    scorer = LineScorer(penalties(), problem, "spectral")
    chosen = np.asarray(rule.choose(scorer, jnp.asarray(BOX)).log_weights)
    assert np.ptp(chosen) < 1e-9  # both ends of the box are alike

    def values(decades):
        return scorer.values(rule.criterion, np.repeat(np.asarray(decades)[:, None], 2, axis=1))

    every = np.linspace(*BOX[:, 0], 1500)
    fine = np.asarray(values(every))
    least = (fine[1:-1] < fine[:-2]) & (fine[1:-1] < fine[2:])
    least &= np.isfinite(fine[:-2]) & np.isfinite(fine[2:])
    at = every[1:-1][least][np.argmin(fine[1:-1][least])]
    assert chosen[0] == pytest.approx(at, abs=2 * (every[1] - every[0]))
    ahead, here, behind = values(chosen[0] + np.array([1e-3, 0.0, -1e-3]))
    assert here <= min(ahead, behind)


@pytest.mark.parametrize("name", [*JOINT, "UnbiasedPredictiveRisk", "CorrectedAkaikeCriterion"])
def test_every_rule_costs_little_over_the_best_weights(name):
    """In white noise of a known level every rule is within thrice the error of the best weights."""
    rule, errors, best = getattr(rules, name)(), [], []
    for seed in range(4):
        case = make_case(noise_fraction=0.05, seed=seed)
        truth = deviation(case.problem, case.truth)

        def error(estimate, problem=case.problem, truth=truth):
            return relative(deviation(problem, np.asarray(estimate.value)), truth)

        errors.append(error(Tikhonov(rule=rule)(case.problem)))
        grid = np.linspace(-9, 0, 37)
        best.append(min(error(Tikhonov(1, 10.0**w, 10.0**w)(case.problem)) for w in grid))
    assert np.median(errors) < 3 * np.median(best)


def test_an_estimate_by_a_rule_that_does_not_choose_for_bands_says_so():
    """As the discrepancy principle, on the line and of any linear problem; given weights do not."""
    problem, plain = make_case(noise_fraction=0.05).problem, LinearProblem(np.eye(40), DATA, 0.1)
    rule = rules.DiscrepancyPrinciple()
    for each in (problem, plain):
        doubted, good = Tikhonov(rule=rule)(each), Tikhonov(rule=RULES["evidence"])(each)
        (own,) = rule.band_warnings
        assert own in doubted.warnings
        assert own not in good.warnings
        assert doubted.quality is Quality.DOUBTFUL
    given = Tikhonov(1, 1e-5, 1e-5, rule=rule)(problem)
    assert given.warnings == Tikhonov(1, 1e-5, 1e-5)(problem).warnings


@pytest.mark.parametrize("path", ["spectral", "direct"])
def test_the_l_curve_is_most_bent_where_its_criterion_is_least(path):
    """The curvature of log |L r| over log |residual| by differences along the curve."""
    scorer, step = LineScorer(penalties(), make_case(noise_fraction=0.05).problem, path), 1e-3
    middle = np.linspace(-8.0, -3.0, 6)
    decades = (middle[:, None] + step * np.array([-1, 0, 1])).ravel()
    score = scorer(np.repeat(decades[:, None], 2, axis=1))
    seminorm = np.asarray(score.seminorm) / 10.0**decades
    curve = np.stack([np.log(score.residual), np.log(seminorm)]).reshape(2, -1, 3) / 2
    (u, v), (uu, vv) = (curve[..., 2] - curve[..., 0]) / 2, curve @ [1.0, -2.0, 1.0]
    curvature = (u * vv - v * uu) / np.hypot(u, v) ** 3
    ours = -scorer.values(rules.LCurve.criterion, np.repeat(middle[:, None], 2, axis=1))
    np.testing.assert_allclose(ours, curvature, rtol=1e-3, atol=1e-3 * np.abs(curvature).max())
