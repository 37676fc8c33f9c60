"""Methods compared, each from the same problems to traction with a band."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np
import scipy.stats
from jaxtyping import Float

from ..errors import refuse
from ..forward.feature import Feature
from ..inverse.estimate import Estimate
from ..inverse.features.method import FeatureFit
from ..inverse.line_problem import LineProblem
from ..inverse.method import Method
from ..inverse.nonlinear import Solver
from ..inverse.quality import Quality
from ..progress import stage

FEATURE_FIT = "Feature fit"
CONFIDENCE = 0.95  # confidence at which two methods differ


def stderr_that_holds(estimate: Estimate, cells: np.ndarray) -> Float[np.ndarray, "2 n"]:
    """Standard errors of the deviation from the mean over `cells`, infinite where the answer
    failed."""
    stderr = np.asarray(estimate.deviation(cells)[1])
    return np.full_like(stderr, np.inf) if estimate.quality is Quality.FAILED else stderr


# --- running ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Runs:
    """One method on many problems: estimates, the first call's time [s] and the median of the
    further ones."""

    estimates: list[Estimate]
    first_call_s: float
    steady_s: float


def compared_methods(
    methods: Mapping[str, Method], features: Mapping[str, Feature], solver: Solver
) -> dict[str, Method]:
    """The methods by the page's names, and the fit of the sum of features, where there are any.

    Raises `BadInput` for fewer than two.
    """
    named = dict(methods)
    if features:
        named[FEATURE_FIT] = FeatureFit(features, solver)
    refuse(
        len(named) < 2,
        f"Only {len(named)} contestants are named: give two at least, by "
        "method=[wiener_evidence,tikhonov] and feature=[strip_load].",
    )
    return named


def run_all(named: Mapping[str, Method], problems: Sequence[LineProblem]) -> dict[str, Runs]:
    """Every method on every problem."""
    runs = {}
    for name, method in named.items():
        with stage(f"{name}, {len(problems)} times"):
            runs[name] = run(method, problems)
    return runs


def run(method: Method, problems: Sequence[LineProblem]) -> Runs:
    """One method on the problems in sequence; the first call includes any compilation."""
    estimates, times = [], []
    for problem in problems:
        start = time.perf_counter()
        estimate = method(problem)
        jax.block_until_ready((estimate.value, estimate.stderr))  # what is computed when asked for
        estimates.append(estimate)
        times.append(time.perf_counter() - start)
    return Runs(estimates, times[0], float(np.median(times[1:] or times)))


def split_odd_even(problem: LineProblem) -> tuple[LineProblem, LineProblem]:
    """The same problem with the samples of every other cell: two draws of the noise."""
    parity = np.arange(problem.line.n) % 2
    return problem.restricted_to(parity == 0), problem.restricted_to(parity == 1)


def holdout_chi2(estimate: Estimate, problem: LineProblem) -> float:
    """Mean square of the problem's samples less the fitted signal, in units of the noise.

    For held-out samples; under a correct model 1 plus the estimate's own uncertainty.
    """
    rest = np.asarray(problem.data + problem.mean_signal) - np.asarray(estimate.fitted)
    rest = np.where(problem.is_observed, rest, np.nan)
    if problem.has_free_offset:
        rest = rest - np.nanmean(rest, axis=-1, keepdims=True)
    return float(np.nanmean(rest**2)) / problem.noise_rms**2


# --- ranking ---------------------------------------------------------------------------------


def ranks(score: Float[np.ndarray, "method ... draw"]) -> Float[np.ndarray, "method ... draw"]:
    """1 for the least score of each draw, and so on; equal scores get the mean of their ranks."""
    return np.asarray(scipy.stats.rankdata(score, axis=0))


@dataclass(frozen=True)
class Pair:
    """Two methods on the same draws: difference of their scores, the better one first.

    `difference`, `spread`: mean and standard deviation over the draws; `wins`: number of draws with
    a lower score of the better one; `apart`: whether the mean exceeds 0 by Student's t with
    probability `CONFIDENCE`.
    """

    better: int
    worse: int
    difference: float
    spread: float
    wins: int
    apart: bool


def pairs(score: Float[np.ndarray, "method draw"]) -> list[Pair]:
    """All pairs of methods, the best first."""
    order = np.argsort(score.mean(axis=1), kind="stable")
    index_pairs = [(int(a), int(b)) for i, a in enumerate(order) for b in order[i + 1 :]]
    return [_pair(a, b, score[b] - score[a]) for a, b in index_pairs]


def _pair(a: int, b: int, more: Float[np.ndarray, " draw"]) -> Pair:
    draws = more.size
    spread = float(more.std(ddof=1)) if draws > 1 else np.inf
    reach = scipy.stats.t.ppf((1 + CONFIDENCE) / 2, max(draws - 1, 1)) * spread / np.sqrt(draws)
    return Pair(a, b, float(more.mean()), spread, int(np.sum(more > 0)), bool(more.mean() > reach))
