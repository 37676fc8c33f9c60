"""The iterative path: its operator, and what it says when its limit is hit."""

import copy
import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.grid import Open
from srsinv.inverse.line.gaps import Gaps
from srsinv.inverse.line.iterative import PosteriorMap, variance
from srsinv.inverse.line.near_periodic import PeriodicModel, PriorScore
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.rule import Evidence, GeneralisedCrossValidation
from srsinv.inverse.tikhonov import DerivativePenalty, Tikhonov
from srsinv.inverse.wiener import Exponential, ScaledSpectra, SpectralPrior, Wiener
from srsinv.status import Status
from tests.inverse.cases import (
    DEPTH_M,
    SLOW,
    N,
    blocks,
    gaps,
    make_case,
    make_operator,
    matrix,
    minimiser,
    penalty_rows,
    relative,
)
from tests.tiers import quick

CASES = {
    "periodic": {},
    "coloured": {"colour": True},
    "coloured_apart": {"colour": "apart"},
    "open": {"kind": "open"},
    "gaps": {"kind": "open", "observed": gaps()},
    "offset": {"films": "turned", "amplifier": SLOW, "free_offset": True},
    "gaps_and_offset": {
        "kind": "open",
        "amplifier": SLOW,
        "free_offset": True,
        "observed": gaps(),
    },
}


def priors(problem):
    weights = jnp.array([2e-5, 8e-5])
    power = [Exponential(1e3, 1e-3).power(problem), Exponential(3e2, 2e-3).power(problem)]
    return {
        "first": DerivativePenalty(weights, jnp.asarray(DEPTH_M), 1),
        "second": DerivativePenalty(weights, jnp.asarray(DEPTH_M), 2),
        "spectra": SpectralPrior(jnp.stack(power)),
    }


def matrices(problem, prior):
    """The normal equations and their preconditioners as matrices (2 n, 2 n)."""
    posterior = PosteriorMap(problem, prior)
    basis = np.eye(2 * N).reshape(-1, 2, N)
    maps = (posterior.normal, posterior.near_times, posterior.nearly_times)
    return [np.stack([of(r).ravel() for r in basis]) for of in maps]


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "prior"),
    [
        ("periodic", "second"), ("coloured", "first"), ("coloured_apart", "spectra"),
        ("open", "first"), ("gaps", "second"), ("offset", "spectra"),
        ("gaps_and_offset", "first"), ("gaps_and_offset", "spectra"),
    ],
)  # fmt: skip
def test_operator_and_preconditioners_are_symmetric_and_semidefinite(name, prior):
    problem = make_case(**CASES[name]).problem
    for each in matrices(problem, priors(problem)[prior]):
        assert relative(each.T, each) < 1e-5  # gaps are filled to that
        values = np.linalg.eigvalsh((each + each.T) / 2)
        assert values[0] > -1e-6 * values[-1]


TOO_HARD = {
    "next_to_no_weight": Tikhonov(1, 1e-15, 1e-15, path="iterative", tolerance=1e-13),
}


@pytest.mark.full
@pytest.mark.parametrize("name", TOO_HARD)
def test_the_limit_of_iterations_is_said(name):
    """An open line with gaps, where hundreds of steps are not enough."""
    estimate = TOO_HARD[name](make_case("open", observed=gaps()).problem)
    assert estimate.status is Status.STEP_LIMIT
    assert estimate.stats["iterations"] > 100
    assert "more steps" in estimate.reasons[0]


@pytest.mark.full
@pytest.mark.parametrize("log_weight", [-13, -10, -4])
@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("path", ["direct", "iterative"])
def test_what_is_called_converged_is_the_solution(path, order, log_weight):
    """Against QR of the stacked rows, which does not square the condition number."""
    problem = make_case("open", observed=gaps()).problem
    weights = [10.0**log_weight] * 2
    estimate = Tikhonov(order, *weights, path=path)(problem)
    if estimate.status == "converged":
        dense = minimiser(problem)(penalty_rows(problem, order, weights))
        assert relative(estimate.value, dense.value) < (1e-2 if log_weight <= -8 else 1e-6)
    assert log_weight <= -8 or estimate.status == "converged"


@pytest.mark.full
@pytest.mark.parametrize("log_weight", quick([-9, -11, -13], -11))
def test_bands_without_a_word_are_those_of_the_direct_path(log_weight):
    """Under ever weaker priors, until rounding has made them up."""
    problem = make_case("open", n=240, noise_fraction=2e-2, observed=gaps(240)).problem
    weights = [10.0**log_weight] * 2
    exact, near = (Tikhonov(1, *weights, path=path)(problem) for path in ("direct", "iterative"))
    ratio = np.asarray(near.stderr) / np.asarray(exact.stderr)
    off = np.abs(ratio - 1).max()
    assert off < 0.05 or any(each.startswith("Bands are rough") for each in near.warnings)
    assert (off < 0.05) == (log_weight == -9)


@pytest.mark.full
def test_variances_below_zero_are_no_answer():
    problem = make_case("open", n=240, noise_fraction=2e-2).problem
    estimate = Tikhonov(1, 1e-16, 1e-16, path="iterative", tolerance=1e-2)(problem)
    assert np.asarray(estimate.stderr).min() == 0
    assert estimate.quality == "failed"


@pytest.mark.full
def test_a_looser_tolerance_takes_fewer_steps():
    problem = make_case("open", observed=gaps()).problem
    steps = [
        Tikhonov(1, 2e-5, 8e-5, path="iterative", tolerance=t)(problem).stats["iterations"]
        for t in (1e-12, 1e-6, 1e-2)
    ]
    assert steps[0] > steps[1] > steps[2] > 0


def test_a_periodic_line_takes_next_to_no_steps():
    """There the preconditioner is the answer."""
    estimate = Tikhonov(1, 2e-5, 8e-5, path="iterative")(make_case().problem)
    assert estimate.stats["iterations"] <= 4


def recorded(n, missing, colour=False, seed=0):
    """Signals of films a depth of 16 cells deep under a scan that begins and ends 8 depths within
    the line; 3 % of its samples are missing, at random or in runs of up to 3 depths."""
    rng = np.random.default_rng(seed)
    line = Open(n, DEPTH_M / 16, 0.0)
    x = np.asarray(line.x)
    bumps = np.zeros((2, n))
    for row in bumps:
        for middle in rng.uniform(x[200], x[-200], max(3, n // 200)):
            row += 5e3 * rng.normal() * np.exp(-(((x - middle) / DEPTH_M) ** 2))
    operator = make_operator(line)
    signal = np.asarray(operator(jnp.asarray(bumps)))
    shape = 1 + 8 * colour * np.exp(-((np.asarray(line.k) * DEPTH_M) ** 2))
    level = 0.02 * signal.std()
    white = np.fft.rfft(rng.normal(size=signal.shape))
    data = signal + np.fft.irfft(level * np.sqrt(shape) * white, n)
    is_observed = np.ones((2, n), bool)
    is_observed[:, :128] = is_observed[:, -128:] = False
    if missing == "scattered":
        is_observed &= rng.random((2, n)) > 0.03
    while missing == "runs" and is_observed[0, 128:-128].mean() > 0.97:
        first, run = rng.integers(128, n - 176), rng.integers(4, 49)
        is_observed[:, first : first + run] = False
    return LineProblem(
        line,
        operator,
        np.where(is_observed, data, 0.0),
        level**2 * shape,
        observed=is_observed,
        known_mean_Pa=(0.0, None),
    )


METHODS = {
    "wiener": Wiener(Exponential(3e3, 2e-3), Exponential(1e3, 2e-3), path="iterative"),
    "value": Tikhonov(0, 3e-7, 3e-6, path="iterative"),
    "slope": Tikhonov(1, 3e-8, 1e-7, path="iterative"),
    "curvature": Tikhonov(2, 3e-8, 1e-7, path="iterative"),
}


def with_path(method, path):
    """The same method by another path."""
    changed = copy.copy(method)
    object.__setattr__(changed, "path", path)
    return changed


MISSING = [
    ("slope", "runs", True), ("wiener", "scattered", True), ("value", "runs", False),
    ("slope", "scattered", False), ("curvature", "scattered", True),
]  # fmt: skip


@pytest.mark.parametrize(("name", "missing", "colour"), quick(MISSING, MISSING[0]))
def test_value_and_bands_are_those_of_the_dense_solution(name, missing, colour):
    """In every cell, gaps and ends of the line included."""
    problem = recorded(500, missing, colour)
    method = METHODS[name]
    direct = with_path(method, "direct")(problem)
    ours = method(problem)
    assert ours.status == "converged"
    assert relative(ours.value, direct.value) < 1e-6
    np.testing.assert_allclose(ours.stderr, direct.stderr, rtol=0.02)
    for component in "pq":
        each = [e.stats[f"resolved_dof_{component}"] for e in (ours, direct)]
        assert abs(each[0] - each[1]) < 0.02 * each[1] + 0.5


@pytest.mark.full
@pytest.mark.parametrize("weight", [1e-7, 1e-11])
def test_bands_are_the_diagonal_of_the_map(weight):
    """Under a weak prior, too, where the inverse over a run of missing samples has a condition of
    10^8, and far from all runs, where much of what each adds cancels."""
    problem = recorded(2000, "runs")
    posterior = PosteriorMap(
        problem, DerivativePenalty(np.full(2, weight), jnp.asarray(DEPTH_M), 1)
    )
    posterior.find_shapes()
    bands = variance(posterior, np.zeros((2, 2000)))
    for c, cell in itertools.product((0, 1), np.random.default_rng(0).integers(0, 2000, 12)):
        impulse = np.zeros((2, 2000))
        impulse[c, cell] = 1.0
        exact = posterior.nearly_times(impulse)[c, cell]
        assert bands[c, cell] == pytest.approx(exact, rel=0.02)


@pytest.mark.full
@pytest.mark.parametrize(("missing", "weight"), [("scattered", 1e-11), ("runs", 1e-7)])
def test_steps_hardly_grow_with_the_line(missing, weight):
    """Nor under a prior so weak that the ends of the data matter over many depths."""
    method = Tikhonov(1, weight, weight, path="iterative")
    short, long = (method(recorded(n, missing)).stats["iterations"] for n in (1000, 4000))
    assert long <= max(1.2 * short, 10)


RULES = {"gcv": GeneralisedCrossValidation(), "evidence": Evidence()}


@pytest.mark.claim
@pytest.mark.parametrize("missing", ["scattered", "runs"])
@pytest.mark.parametrize("rule", RULES)
def test_a_rule_chooses_as_on_the_direct_path(rule, missing):
    assert_chosen_alike(RULES[rule], recorded(400, missing))


@pytest.mark.full
def test_a_rule_chooses_one_weight_as_on_the_direct_path():
    """Where friction is known: of two weights it scans a plane."""
    known = {"friction": 0.3, "observed": gaps(240)}
    assert_chosen_alike(
        RULES["gcv"], make_case("open", n=240, noise_fraction=2e-2, **known).problem
    )


def assert_chosen_alike(rule, problem):
    """To a step of its finest grid, for the scores are those of the nearest periodic problem."""
    names = [f"weight_{component}_per_Pa2" for component in "pq"[: problem.unknowns]]
    chosen = [
        np.log10([estimate.stats[name] for name in names])
        for estimate in (
            Tikhonov(1, rule=rule, path=path)(problem) for path in ("direct", "iterative")
        )
    ]
    np.testing.assert_allclose(*chosen, atol=0.15)


@pytest.mark.parametrize("colour", [True, "apart"])
def test_scores_with_gaps_are_those_of_conditioning(colour):
    """On a periodic line: of the covariance of the samples that are there, by dense matrices."""
    problem = make_case(observed=gaps(), colour=colour).problem
    family = ScaledSpectra(jnp.stack([Exponential(1e3, 1e-3).power(problem)] * 2))
    chosen = [family(jnp.array(logs)) for logs in ([0.0, 0.0], [1.0, -1.0], [-1.0, 0.5])]
    periodic = PeriodicModel(problem, Gaps.of(problem.is_observed))
    scores = [PriorScore(periodic, prior).whole for prior in chosen]
    rows, y = gaps().ravel(), np.asarray(problem.data)[gaps()]
    each = np.broadcast_to(problem.noise, (2, problem.noise.shape[1]))
    noise = blocks(each, N)[np.ix_(rows, rows)]
    model = matrix(problem)[rows]
    for ours, prior in zip(scores, chosen, strict=True):
        covariance = model @ blocks(np.asarray(prior.power), N) @ model.T + noise
        left = noise @ np.linalg.solve(covariance, y)
        assert float(ours.residual) == pytest.approx(left @ np.linalg.solve(noise, left), rel=1e-3)
        resolved = rows.sum() - np.trace(np.linalg.solve(covariance, noise))
        assert float(ours.freedom) == pytest.approx(resolved, rel=0.02)

    def evidence(prior):
        covariance = model @ blocks(np.asarray(prior.power), N) @ model.T + noise
        return -(np.linalg.slogdet(covariance)[1] + y @ np.linalg.solve(covariance, y)) / 2

    differences = [float(each.log_evidence - scores[0].log_evidence) for each in scores]
    exact = [evidence(prior) - evidence(chosen[0]) for prior in chosen]
    np.testing.assert_allclose(differences, exact, atol=0.3)
