"""Methods compared: inversions and a feature fit, each from one problem to traction with a band.

The feature fit is put on the line of the others: cell averages of the fitted features, with
standard errors from the parameters' covariance to first order.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.stats
from jaxtyping import Array, Float

from ..errors import refuse
from ..forward.feature import Feature
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from ..grid import Line
from ..inverse.feature_fit import FeatureFitter
from ..inverse.feature_model import FeatureModel, amplitudes
from ..inverse.nonlinear import Correlated, Fit, Solver
from ..inverse.problem import Estimate, Problem
from ..inverse.quality import Quality
from ..progress import stage
from ..status import Status
from . import build
from .analysis import observed_cells

FEATURE_FIT = "Feature fit"
MISSING = 1e8  # of the noise's variance: at missing samples in coloured noise
CONFIDENCE = 0.95  # confidence at which two methods differ


@dataclass(frozen=True)
class Reconstruction:
    """One method's solution of one problem, on the problem's line.

    - `value` (2, n) [Pa]; `stderr` (2, n) [Pa]: of the deviation from the mean.
    - `fitted` (e, n): the fitted signal, NaN where the method gives none.
    - `misfit`: mean square of the residual in units of the noise, 1 where only noise is left.
    - `quality`, `warnings`, `reasons`: the method's own.
    - `parameters`: (value, standard error) by name, of a feature fit.
    """

    value: Float[np.ndarray, "2 n"]
    stderr: Float[np.ndarray, "2 n"]
    fitted: Float[np.ndarray, "e n"]
    misfit: float
    status: Status
    quality: Quality
    warnings: tuple[str, ...]
    reasons: tuple[str, ...]
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    log_evidence: float | None = None


def stderr_that_holds(reconstruction: Reconstruction) -> Float[np.ndarray, "2 n"]:
    """Standard errors as stated, infinite where the answer failed."""
    failed = reconstruction.quality is Quality.FAILED
    return np.full_like(reconstruction.stderr, np.inf) if failed else reconstruction.stderr


ComparedMethod = Callable[[Problem], Reconstruction]


@dataclass(frozen=True)
class Inversion:
    """Wiener's or Tikhonov's method."""

    method: Callable[[Problem], Estimate]

    def __call__(self, problem: Problem) -> Reconstruction:
        estimate = jax.block_until_ready(self.method(problem))
        return Reconstruction(
            np.asarray(estimate.value),
            np.asarray(estimate.stderr),
            np.asarray(estimate.fitted),
            float(np.nanmean(np.asarray(estimate.whitened) ** 2)),
            estimate.status,
            estimate.quality,
            estimate.warnings,
            estimate.reasons,
        )


@dataclass(frozen=True)
class FeatureMethod:
    """Features fitted together, as a sum, to the valid samples.

    `cells`: those that the scan passed, in its order, of a line whose centres are `x_m` there.
    """

    features: dict[str, Feature]
    sensor: Sensor
    speed_m_per_s: float
    cells: np.ndarray
    x_m: np.ndarray
    solver: Solver

    @cached_property
    def _fitter(self) -> FeatureFitter:
        """Created in the first call, and counted in its time."""
        x, speed = self.x_m, self.speed_m_per_s
        return FeatureFitter(
            self.sensor, Motion((x - x[0]) / speed, x, np.full(x.shape, speed)), self.solver
        )

    def __call__(self, problem: Problem) -> Reconstruction:
        at = self.cells
        y = np.asarray(problem.data + problem.mean_signal)[:, at]
        feature_fit = self._fitter(self.features, y, _noise(problem, at))
        if feature_fit.fit is None:
            raise ValueError("a contest of features needs one feature at least")
        assert isinstance(feature_fit.model, FeatureModel)
        value, stderr = _on_cells(
            feature_fit.model, feature_fit.fit, problem, np.sign(self.speed_m_per_s)
        )
        fitted = np.full(problem.data.shape, np.nan)
        fitted[:, at] = feature_fit.signal()
        return Reconstruction(
            value,
            stderr,
            fitted,
            float(np.mean(feature_fit.fit.whitened**2) * y.size / problem.samples),
            feature_fit.status,
            feature_fit.quality,
            feature_fit.warnings,
            feature_fit.reasons,
            feature_fit.parameters,
            feature_fit.log_evidence,
        )


def _scanned_cells(problem: Problem, speed_m_per_s: float) -> np.ndarray:
    """The cells from the first to the last with a sample, in the order in which they are passed."""
    indices = np.flatnonzero(observed_cells(problem))
    cells = np.arange(indices[0], indices[-1] + 1)
    return cells if speed_m_per_s > 0 else cells[::-1]


def observed_samples(problem: Problem) -> np.ndarray:
    """Mask of valid samples (e, n)."""
    if problem.observed is None:
        return np.ones(problem.data.shape, bool)
    return np.asarray(problem.observed)


def noise_rms(problem: Problem) -> float:
    """Standard deviation of a sample's noise, an unknown offset aside."""
    return float(np.sqrt(np.mean(np.asarray(problem.noise)[1:])))


def _noise(problem: Problem, at: np.ndarray):
    """The noise of these samples, as a fit takes it."""
    power = np.asarray(problem.noise)
    power = np.where(np.isfinite(power), power, power[1])
    observed = observed_samples(problem)[:, at]
    if np.ptp(power) <= 1e-9 * power.max():
        return np.where(observed, np.sqrt(power[1]), np.inf)
    toeplitz = scipy.linalg.toeplitz(np.fft.irfft(power, problem.line.n)[: at.size])
    covariance = np.kron(np.eye(len(observed)), toeplitz)
    return Correlated(
        covariance + np.diag(np.where(observed, 0.0, MISSING * toeplitz[0, 0]).ravel())
    )


def _on_cells(model: FeatureModel, fit: Fit, problem: Problem, direction: float):
    """p and q (2, n) on the problem's cells, and the standard error of their deviation from the
    mean where there are samples."""
    indices, n = np.flatnonzero(observed_cells(problem)), problem.line.n
    turn = jnp.array([[1.0], [direction]])

    def deviation(params):
        traction = turn * cell_traction(model, params, problem.line)
        return jnp.ravel(traction - jnp.mean(traction[:, indices], axis=-1, keepdims=True))

    value = turn * cell_traction(model, fit.value, problem.line)
    background = [0.0 if b is None else float(b) for b in problem.background_Pa]
    stderr = fit.derive(deviation)[1]
    return np.asarray(value) + np.reshape(background, (2, 1)), np.reshape(stderr, (2, n))


def cell_traction(model: FeatureModel, params, line: Line) -> Float[Array, "2 n"]:
    """Averages of p and q [Pa] over the cells of any line, while sliding towards +x."""
    total = jnp.zeros((2, line.n))
    for name, feature in model.features.items():
        shape = feature.profile(params[name]).cell_average(line)
        if feature.is_periodic:
            shape = shape * jnp.interp(line.x, model.line.x, model.fade)
        total = total + jnp.stack(amplitudes(feature, params[name]))[:, None] * shape
    return total


# --- running ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """Input of all methods; the first problem has all samples of any of them."""

    sensor: Sensor
    speed_m_per_s: float
    problems: list[Problem]


@dataclass(frozen=True)
class Runs:
    """One method on many problems: reconstructions, the first call's time [s] and the median of the
    further ones."""

    reconstructions: list[Reconstruction]
    first_call_s: float
    steady_s: float


def compared_methods(cfg: build.Config, setting: Setting) -> dict[str, ComparedMethod]:
    """The methods and the sum of features that the configuration names, by the page's names.

    Raises `BadInput` for fewer than two.
    """
    named: dict[str, ComparedMethod] = {}
    if cfg.get("method"):
        named |= {name: Inversion(method) for name, method in build.methods(cfg).items()}
    if cfg.get("feature"):
        named[FEATURE_FIT] = feature_method(build.features(cfg), cfg, setting)
    refuse(
        len(named) < 2,
        f"Only {len(named)} contestants are named: give two at least, by "
        "method=[wiener_evidence,tikhonov] and feature=[strip_load].",
    )
    return named


def feature_method(
    features: dict[str, Feature], cfg: build.Config, setting: Setting
) -> FeatureMethod:
    """Method of fitting these features, with the setting's sensor and the configured solver."""
    whole, speed = setting.problems[0], setting.speed_m_per_s
    cells = _scanned_cells(whole, speed)
    x_m = np.asarray(whole.line.x)[cells]
    return FeatureMethod(features, setting.sensor, speed, cells, x_m, build.solver(cfg))


def run_all(named: Mapping[str, ComparedMethod], problems: Sequence[Problem]) -> dict[str, Runs]:
    """Every method on every problem."""
    runs = {}
    for name, method in named.items():
        with stage(f"{name}, {len(problems)} times"):
            runs[name] = run(method, problems)
    return runs


def run(method: ComparedMethod, problems: Sequence[Problem]) -> Runs:
    """One method on the problems in sequence; the first call includes any compilation."""
    reconstructions, times = [], []
    for problem in problems:
        start = time.perf_counter()
        reconstructions.append(method(problem))
        times.append(time.perf_counter() - start)
    return Runs(reconstructions, times[0], float(np.median(times[1:] or times)))


def split_odd_even(problem: Problem) -> tuple[Problem, Problem]:
    """The same problem with the samples of every other cell: two draws of the noise."""
    parity = np.arange(problem.line.n) % 2
    observed = observed_samples(problem)

    def restricted(mask):
        both = jnp.asarray(mask), jnp.where(mask, problem.data, 0.0)
        is_none = {"is_leaf": lambda leaf: leaf is None}
        return eqx.tree_at(lambda p: (p.observed, p.data), problem, both, **is_none)

    return restricted(observed & (parity == 0)), restricted(observed & (parity == 1))


def holdout_chi2(reconstruction: Reconstruction, problem: Problem) -> float:
    """Mean square of the problem's samples less the fitted signal, in units of the noise.

    For held-out samples; under a correct model 1 plus the reconstruction's own uncertainty.
    """
    rest = np.asarray(problem.data + problem.mean_signal) - reconstruction.fitted
    rest = np.where(observed_samples(problem), rest, np.nan)
    if not np.isfinite(float(problem.noise[0])):
        rest = rest - np.nanmean(rest, axis=-1, keepdims=True)
    return float(np.nanmean(rest**2)) / noise_rms(problem) ** 2


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
