"""Runs of missing samples, where a band is the prior's: said where the traction between them
changes more than that, and not where it is the prior's own."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.inverse import diagnostics
from srsinv.inverse.line.answer import missing_runs
from srsinv.inverse.tikhonov import DerivativePenalty, Tikhonov
from tests.inverse.cases import DEPTH_M, make_case
from tests.tiers import quick

N = 240
WORDS = "Samples are missing in runs"


def with_runs(*runs, kind="open"):
    """A problem with the samples of these cells missing, its sigma, and nothing in its data."""
    observed = np.ones((2, N), bool)
    for run in runs:
        observed[:, run] = False
    case = make_case(kind, n=N, observed=observed, noise_fraction=1e-2)
    return case.problem, case.sigma


def holding(problem, sigma, truth, seed=0):
    """The problem with signals of this traction in its data."""
    noise = sigma * np.random.default_rng(seed).normal(size=problem.data.shape)
    data = jnp.where(problem.is_observed, problem.forward(jnp.asarray(truth)) + noise, 0.0)
    return eqx.tree_at(lambda p: p.data, problem, data)


def random_walk(weight, cell_m, seed=0):
    """A draw of the prior that a weight on the first derivative stands for."""
    step = cell_m / DEPTH_M / np.sqrt(weight)
    walk = np.cumsum(step * np.random.default_rng(seed).normal(size=(2, N)), axis=1)
    return walk - walk.mean(axis=1, keepdims=True)


def said(estimate):
    return [each for each in estimate.warnings if each.startswith(WORDS)]


RUNS = slice(70, 86), slice(150, 166)
WEIGHT = 1e-5


@pytest.mark.full
@pytest.mark.parametrize("path", ["direct", "iterative"])
def test_traction_that_changes_more_than_its_prior_allows_is_said(path):
    problem, sigma = with_runs(*RUNS)
    method = Tikhonov(1, WEIGHT, WEIGHT, path=path)
    walk = random_walk(WEIGHT, float(problem.line.cell_m))
    assert said(method(holding(problem, sigma, walk))) == []
    estimate = method(holding(problem, sigma, 5 * walk))
    assert len(said(estimate)) == 2
    assert estimate.quality == "doubtful"


@pytest.mark.full
def test_what_is_said_is_true():
    """Of draws five times what the prior allows, the band holds few within runs, and of its own
    draws nearly what it says."""
    problem, sigma = with_runs(*RUNS)
    method, inside = Tikhonov(1, WEIGHT, WEIGHT, path="direct"), np.r_[RUNS]
    held = {1: [], 5: []}
    for factor, seed in [(f, s) for f in held for s in range(12)]:
        truth = factor * random_walk(WEIGHT, float(problem.line.cell_m), seed)
        value, stderr = method(holding(problem, sigma, truth, seed)).deviation(
            problem.observed_cells
        )
        truth = truth - truth[:, problem.observed_cells].mean(axis=1, keepdims=True)
        held[factor].append(np.mean(np.abs(value - truth)[:, inside] < 1.645 * stderr[:, inside]))
    assert np.mean(held[1]) > 0.8
    assert np.mean(held[5]) < 0.5


AT_THE_ENDS = slice(0, 40), slice(200, 240)
WITHIN = slice(70, 71), slice(150, 151)


@pytest.mark.parametrize("runs", quick([(WITHIN,), (AT_THE_ENDS,), ((),)], (AT_THE_ENDS,)))
def test_no_run_hides_anything(runs):
    """Of one cell, beyond the scan, and none: what is beside it bridges it, or nothing follows."""
    problem, sigma = with_runs(*runs)
    walk = 5 * random_walk(WEIGHT, float(problem.line.cell_m))
    assert said(Tikhonov(1, WEIGHT, WEIGHT)(holding(problem, sigma, walk))) == []


def test_what_a_prior_allows_and_what_is_seen():
    """A random walk on a circle changes by its step's variance times m (1 - m / n) over m of n
    cells; a slope by itself."""
    problem, _ = with_runs(*RUNS, kind="periodic")
    cell = float(problem.line.cell_m)
    prior = DerivativePenalty(np.array([WEIGHT, 4 * WEIGHT]), jnp.asarray(DEPTH_M), 1)
    slopes = np.stack([2.0 * np.arange(N), -3.0 * np.arange(N)])
    runs = missing_runs(problem, prior, slopes)
    assert runs is not None
    assert runs.cells == 16
    assert runs.length_m == pytest.approx(16 * cell)
    walk = (cell / DEPTH_M) ** 2 / WEIGHT * 16 * (1 - 16 / N)
    np.testing.assert_allclose(runs.of_prior, [walk, walk / 4], rtol=1e-10)
    np.testing.assert_allclose(runs.observed, [32.0**2, 48.0**2], rtol=1e-12)
    assert runs.lengths == pytest.approx((54 + 48 + 58) / 16)


def test_no_stretch_is_as_long_as_the_runs():
    problem, _ = with_runs(slice(10, 100), slice(110, 200))
    prior = DerivativePenalty(np.array([WEIGHT, WEIGHT]), jnp.asarray(DEPTH_M), 1)
    assert missing_runs(problem, prior, np.zeros((2, N))) is None


def test_by_chance_few_lengths_differ_more():
    """A ratio of 2.5 is said of a thousand independent lengths, and not of one."""
    many, one = (
        diagnostics.changing_in_runs("p", 2.0, 2.5, 1.0, run_m=1e-3, lengths=lengths)
        for lengths in (1e3, 1.0)
    )
    assert (len(many), len(one)) == (1, 0)
    assert diagnostics.changing_in_runs("p", 2.0, 2.0, 1.0, run_m=1e-3, lengths=1e3) == ()
    assert diagnostics.changing_in_runs("p", 0.5, 9.0, 1.0, run_m=1e-3, lengths=1e3) == ()
