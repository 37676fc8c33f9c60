"""Noise levels from a fit's residual: a white part and one correlated along the path.

The correlated part, from sliding, has the covariance s^2 exp(-|dx|/l) along the motion
(docs/explanation/physics/noise.md). The levels are those of greatest restricted likelihood
(Patterson and Thompson 1971), with white noise of its own in each element and the same sliding
noise in all.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ...numerics import orthonormal_basis
from ..nonlinear import WhitePlusOU

# Factors and solutions of symmetric, positive definite, tridiagonal matrices.
NOTICED = 0.03  # relative difference of a standard error, about its own accuracy
LEAST_STEP = 1e-6  # of the correlation length: samples nearer than that are as good as one
LEAST_START = 0.03  # of the white noise: a search from zero would not leave it
LEAST_SLIDING = 1e-4  # of the white noise: less sliding noise than that is none
FLAT = 1e-6  # slope by the log of a level at which a search ends; a sample alone makes about 1
NEAR = 1e-2  # of the log of a level: within which the zero of the slopes is that of the search
RANGE = 50.0  # the correlation length lies within this factor of the film's depth
MOST_WHITE = 1e3  # times the estimate from the residual's differences


@dataclass(frozen=True)
class Levels:
    """Standard deviations: `white` (e,) per sample, `sliding` of the correlated part over
    `correlation_m`; `is_stated`: whether the latter is known, (#e,), not estimated, a number."""

    white: Float[np.ndarray, " e"]
    sliding: float | Float[np.ndarray, "#e"]
    correlation_m: float | Float[np.ndarray, "#e"]
    is_stated: bool = False

    @property
    def white_rms(self) -> float:
        """The white noise's rms over all elements."""
        return float(np.sqrt(np.mean(self.white**2)))

    @property
    def sliding_rms(self) -> float:
        """The rms of the correlated part over all elements."""
        return float(np.sqrt(np.mean(np.square(self.sliding))))

    @property
    def longest_m(self) -> float:
        """The longest of the correlation lengths."""
        return float(np.max(self.correlation_m))

    def whitener(self, position_m, observed: Bool[np.ndarray, "e sample"]) -> WhitePlusOU:
        """Whitener of the noise along the motion, at `observed` samples."""
        white = np.where(observed, self.white[:, None], np.inf)
        return WhitePlusOU(position_m, white, self.sliding, self.correlation_m)

    def differs_from(self, other: "Levels", step_m: float) -> bool:
        """Whether the difference changes a fit to samples `step_m` apart: that of the noise at
        short waves, or at waves longer than the correlation."""
        ours, theirs = (np.append(each.white, each._long_waves(step_m)) for each in (self, other))
        return bool(np.any(np.abs(np.log(ours / theirs)) > NOTICED))

    def _long_waves(self, step_m: float) -> Float[np.ndarray, " e"]:
        """Rms of white noise with the density of all noise at long waves."""
        return np.sqrt(self.white**2 + 2 * self.sliding**2 * self.correlation_m / step_m)


def first_levels(y: Float[np.ndarray, "e sample"], depth_m: float) -> Levels:
    """Initial levels: the white noise from the samples' differences, and little sliding noise."""
    white = np.maximum([_from_differences(row) for row in y], 1e-9 * np.nanmax(np.abs(y)))
    white = np.where(white > 0, white, 1.0)  # zeros do not determine a level
    return Levels(white, float(0.3 * white.mean()), 0.3 * depth_m)


def estimate(
    residual: Float[np.ndarray, "e sample"],
    position_m,
    depth_m: float,
    fitted: Float[np.ndarray, "e sample m"] | None = None,
    start: Levels | None = None,
) -> Levels:
    """The levels of maximum restricted likelihood of the residual (nan where missing).

    - `fitted`: the fit's derivatives. The fit removes noise from the residual along them, slow
      noise most of all: the likelihood is that of all other directions only.
    - `start`: levels to begin with.
    """
    start = first_levels(residual, depth_m) if start is None else start
    likelihood = _Likelihood(residual, position_m, fitted, float(start.white.mean()))
    return likelihood.greatest(start, depth_m)


def evidence_of_sliding(
    residual: Float[np.ndarray, "e sample"],
    position_m,
    fitted: Float[np.ndarray, "e sample m"] | None,
    levels: Levels,
) -> float:
    """Log of the restricted likelihood of these levels over that of the best white noise alone, of
    which chance makes more than g with a probability of about e^-g."""
    likelihood = _Likelihood(residual, position_m, fitted, float(levels.white.mean()))
    return likelihood.of_white() - likelihood.minus_log(levels)


class _Likelihood:
    """The restricted likelihood of a residual, in units of `size`."""

    def __init__(self, residual, position_m, fitted, size: float):
        taken = np.zeros((*residual.shape, 0)) if fitted is None else _directions(fitted, residual)
        self._rows = [_Row(position_m, *each) for each in zip(residual / size, taken, strict=True)]
        self._size = size
        self._spread = float(np.nanmax(np.abs(residual))) / size

    def minus_log(self, levels: Levels) -> float:
        """Minus the log of that of some levels."""
        white, sliding = (np.log(each / self._size) for each in (levels.white, levels.sliding))
        return self._minus_log(white, sliding, np.log(levels.correlation_m))[0]

    def greatest(self, start: Levels, depth_m: float) -> Levels:
        """The levels of greatest likelihood, from these on."""
        white = np.log(start.white / self._size)
        around = [(each - np.log(MOST_WHITE), each + np.log(MOST_WHITE)) for each in white]
        if start.is_stated:
            stated = np.log(start.sliding / self._size), np.log(start.correlation_m)
            best = self._least_white(white, around, stated)
            return replace(start, white=self._size * np.exp(best.x))
        sliding = max(start.sliding / self._size, LEAST_START)
        first = [*white, np.log(sliding), np.log(start.correlation_m)]
        bounds = [
            *around,
            (np.log(LEAST_SLIDING), np.log(max(self._spread, 10 * LEAST_SLIDING))),
            (np.log(depth_m / RANGE), np.log(depth_m * RANGE)),
        ]

        def of(logs):
            value, slopes = self._minus_log(logs[:-2], *logs[-2:])
            return value, [*slopes[0], *slopes[1:].sum(axis=1)]

        *white, sliding, correlation = np.exp(_least(of, first, bounds).x)
        return Levels(self._size * np.array(white), self._size * float(sliding), float(correlation))

    def of_white(self) -> float:
        """Minus the log of the greatest likelihood of white noise alone."""
        first = np.zeros(len(self._rows))
        bounds = [(-np.log(MOST_WHITE), np.log(MOST_WHITE))] * len(first)
        return float(self._least_white(first, bounds, (np.log(LEAST_SLIDING), 0.0)).fun)

    def _least_white(self, first, bounds, rest: tuple[Any, Any]) -> Any:
        """The search for the white levels, where the `rest` is known."""

        def of(logs):
            value, slopes = self._minus_log(logs, *rest)
            return value, slopes[0]

        return _least(of, first, bounds)

    def _minus_log(self, white, sliding, correlation) -> tuple[float, Float[np.ndarray, "3 e"]]:
        """By logarithms, each of the elements' or one for all; and its slopes by each element's."""
        levels = (
            np.broadcast_to(np.exp(x), len(self._rows)) for x in (white, sliding, correlation)
        )
        each = [row.products(*own) for row, *own in zip(self._rows, *levels, strict=True)]
        product = np.sum([row.product for row in each], axis=0)
        projections, inner = product[1:, 0], product[1:, 1:]
        inverse = np.linalg.inv(inner)
        left = np.append(1.0, -inverse @ projections)
        log_volume = sum(row.log_volume for row in each) + np.linalg.slogdet(inner)[1]
        slopes = [
            left @ row.slopes @ left + np.sum(row.slopes[:, 1:, 1:] * inverse, axis=(1, 2))
            for row in each
        ]
        volumes = [row.volume_slopes for row in each]
        return 0.5 * float(left @ product @ left + log_volume), 0.5 * np.add(slopes, volumes).T


def _least(of: Callable[[Any], tuple[float, Any]], first, bounds) -> Any:
    """The search for the least value, and from its end for the zero of the exact slopes beside it:
    where values hardly change, rounding would decide, and so the processor."""
    options = {"ftol": 0.0, "gtol": FLAT}
    least = scipy.optimize.minimize(
        of, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    low, high = np.array(bounds, float).T
    free = (low < least.x) & (least.x < high)

    def at(inside) -> tuple[float, Any]:
        logs = least.x.copy()
        logs[free] = inside
        return of(logs)

    if free.any():
        begun = least.x[free]
        flat = scipy.optimize.root(lambda inside: np.asarray(at(inside)[1])[free], begun)
        if flat.success and np.all(np.abs(flat.x - begun) < NEAR):
            least.x[free], least.fun = flat.x, at(flat.x)[0]
    return least


def _directions(fitted, residual) -> Float[np.ndarray, "e sample k"]:
    """An orthonormal basis of the derivatives at valid data."""
    known = np.isfinite(residual)[..., None] & np.isfinite(fitted)
    columns = np.where(known, fitted, 0.0).reshape(residual.size, -1)
    return orthonormal_basis(columns).reshape(*residual.shape, -1)


class _Row:
    """One element's residual and the directions taken out of it, at its valid samples."""

    def __init__(self, position_m, residual, taken):
        observed = np.isfinite(residual)
        self.values = np.column_stack([residual[observed], taken[observed]])
        self.steps = np.abs(np.diff(np.asarray(position_m, float)[observed]))

    def products(self, white: float, sliding: float, correlation: float) -> "_Products":
        """The columns' products V^T N^-1 V, in time linear in the number of samples.

        An Ornstein-Uhlenbeck process has the tridiagonal precision Q/s^2. With T = w^2 Q + s^2,
        N = w^2 + s^2 Q^-1 = T Q^-1, so that N^-1 V = T^-1 Q V. The slopes are by log w, log s and
        log l.
        """
        step = np.maximum(self.steps / correlation, LEAST_STEP)
        moving = np.where(step > LEAST_STEP, step, 0.0)  # minus its slope by log l
        decay, renewed = np.exp(-step), -np.expm1(-2 * step)
        known = decay**2 / renewed
        precision = _Tridiagonal(1 + _at_both(known, len(self.values)), -decay / renewed)
        by_length = _Tridiagonal(
            _at_both(2 * moving * known * (1 + known), len(self.values)),
            moving * precision.off_diagonal * (1 + 2 * known),
        )
        diagonal, ratio, _ = scipy.linalg.lapack.dpttrf(
            white**2 * precision.middle + sliding**2, white**2 * precision.off_diagonal
        )
        n, columns = self.values.shape
        both, _ = scipy.linalg.lapack.dpttrs(
            diagonal, ratio, np.hstack([precision @ self.values, self.values])
        )
        solved, smoothed = both[:, :columns], both[:, columns:]
        middle, off_diagonal = _inverse(diagonal, ratio)
        white_share = 2 * (n - sliding**2 * np.sum(middle))
        by_length_share = np.sum(by_length.middle * middle) + 2 * np.sum(
            by_length.off_diagonal * off_diagonal
        )
        return _Products(
            product=self.values.T @ solved,
            log_volume=float(np.sum(np.log(diagonal)) + np.sum(np.log(renewed))),
            slopes=np.stack([
                -2 * white**2 * solved.T @ solved,
                -2 * sliding**2 * smoothed.T @ solved,
                sliding**2 * smoothed.T @ (by_length @ smoothed),
            ]),
            volume_slopes=np.array([
                white_share,
                2 * n - white_share,
                white**2 * by_length_share - 2 * np.sum(moving * known),
            ]),
        )  # fmt: skip


@dataclass(frozen=True)
class _Products:
    """V^T N^-1 V, log |N|, and the slopes of both by the logs of w, s and l."""

    product: Float[np.ndarray, "k k"]
    log_volume: float
    slopes: Float[np.ndarray, "3 k k"]
    volume_slopes: Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class _Tridiagonal:
    """A symmetric tridiagonal matrix."""

    middle: Float[np.ndarray, " n"]
    off_diagonal: Float[np.ndarray, " between"]

    def __matmul__(self, columns: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        product = self.middle[:, None] * columns
        product[:-1] += self.off_diagonal[:, None] * columns[1:]
        product[1:] += self.off_diagonal[:, None] * columns[:-1]
        return product


def _at_both(between: Float[np.ndarray, " between"], n: int) -> Float[np.ndarray, " n"]:
    """At each sample the sum of what is between it and its neighbours."""
    total = np.zeros(n)
    total[:-1] += between
    total[1:] += between
    return total


def _inverse(
    diagonal: Float[np.ndarray, " n"], ratio: Float[np.ndarray, " between"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " between"]]:
    """The middle of the inverse of L D L^T, and what is beside it: x_i = 1/d_i + r_i^2 x_(i+1) and
    -r_i x_(i+1)."""
    rows = np.ones((2, len(diagonal)))
    rows[0, 1:] = -(ratio**2)
    middle = scipy.linalg.solve_banded((0, 1), rows, 1 / diagonal)
    return middle, -ratio * middle[1:]


def _from_differences(row: Float[np.ndarray, " sample"]) -> float:
    """White noise from third differences, which are small for a smooth signal; by their median, as
    they are large at edges. Where no four samples follow one another, from differences across what
    is missing, of a lower order where there are too few samples."""
    differences, order = np.diff(row, 3), 3
    differences = differences[np.isfinite(differences)]
    if not differences.size:
        observed = row[np.isfinite(row)]
        order = max(min(3, observed.size - 1), 0)
        differences = np.diff(observed, order)
    if not differences.size:
        return 0.0
    variance = math.comb(2 * order, order)  # of noise of unit level: sum_j binomial(order, j)^2
    return float(np.median(np.abs(differences)) * 1.4826 / np.sqrt(variance))
