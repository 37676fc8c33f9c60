"""How much noise there is, from what a fit leaves: a white part and one correlated along the path.

The correlated part, from sliding, has the covariance s^2 exp(-|dx|/l) along the motion
(docs/physics.md, section 10). The levels are those of greatest likelihood, with white noise of its
own in each element and the same sliding noise in all.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize

from .nonlinear import Sliding

# Of symmetric, positive definite, tridiagonal matrices.
_FACTOR, _SOLVE = get_lapack_funcs(("pttrf", "pttrs"), dtype=float)
LEAST_STEP = 1e-6  # of the correlation length: samples nearer than that are as good as one
LEAST_SHARE = 1e-4  # of the white noise: less sliding noise than that is none
RANGE = 50.0  # the correlation length lies within this factor of the film's depth
MOST_WHITE = 1e3  # times what the residual's differences say


@dataclass(frozen=True)
class Levels:
    """Standard deviations: `white` (e,) per sample, `sliding` of the correlated part over
    `correlation_m`."""

    white: Float[np.ndarray, " e"]
    sliding: float
    correlation_m: float

    def whitener(self, position_m, seen: Bool[np.ndarray, "e sample"]) -> Sliding:
        """The noise of data along the motion, where they are seen."""
        white = np.where(seen, self.white[:, None], np.inf)
        return Sliding(position_m, white, self.sliding, self.correlation_m)

    def far_from(self, other: "Levels") -> bool:
        """Whether a fit would notice the difference."""
        ours, theirs = (np.append(each.white, each.sliding) for each in (self, other))
        floor = LEAST_SHARE * ours.max()
        return bool(np.any(np.abs(np.log((ours + floor) / (theirs + floor))) > 0.03))


def first_levels(y: Float[np.ndarray, "e sample"], depth_m: float) -> Levels:
    """To begin with: the white noise that the samples' differences show, and little sliding."""
    white = np.maximum(_from_differences(y), 1e-9 * np.nanmax(np.abs(y)) + 1e-300)
    return Levels(white, float(0.3 * white.mean()), 0.3 * depth_m)


def estimate(residual: Float[np.ndarray, "e sample"], position_m, depth_m: float) -> Levels:
    """The levels under which the residual (nan where missing) is the most likely."""
    first = first_levels(residual, depth_m)
    size = float(first.white.mean())
    rows = [_Row(position_m, each) for each in residual / size]
    start = np.log([*(first.white / size), 0.3, 0.3 * depth_m])

    def minus_log_likelihood(logs) -> float:
        *white, sliding, correlation = np.exp(logs)
        return sum(
            row.minus_log_likelihood(w, sliding, correlation)
            for row, w in zip(rows, white, strict=True)
        )

    bounds = [(s - np.log(MOST_WHITE), s + np.log(MOST_WHITE)) for s in start[:-2]]
    spread = float(np.nanmax(np.abs(residual))) / size
    bounds.append((np.log(LEAST_SHARE), np.log(max(spread, 10 * LEAST_SHARE))))
    bounds.append((np.log(depth_m / RANGE), np.log(depth_m * RANGE)))
    best = minimize(minus_log_likelihood, start, method="L-BFGS-B", bounds=bounds)
    *white, sliding, correlation = np.exp(best.x)
    return Levels(size * np.array(white), float(size * sliding), float(correlation))


class _Row:
    """One element's residual where it is seen, along the path."""

    def __init__(self, position_m, residual):
        seen = np.isfinite(residual)
        self.values = residual[seen]
        self.steps = np.abs(np.diff(np.asarray(position_m, float)[seen]))

    def minus_log_likelihood(self, white: float, sliding: float, correlation: float) -> float:
        """In the number of samples' time: an Ornstein-Uhlenbeck process has the tridiagonal
        precision Q/s^2, and w^2 + s^2 Q^-1 = (w^2 Q + s^2) Q^-1."""
        step = np.maximum(self.steps / correlation, LEAST_STEP)
        decay, renewed = np.exp(-step), -np.expm1(-2 * step)
        middle = np.ones(self.values.size)
        middle[:-1] += decay**2 / renewed
        middle[1:] += decay**2 / renewed
        beside = -decay / renewed
        diagonal, ratio, _ = _FACTOR(white**2 * middle + sliding**2, white**2 * beside)
        pulled = middle * self.values
        pulled[:-1] += beside * self.values[1:]
        pulled[1:] += beside * self.values[:-1]
        solved, _ = _SOLVE(diagonal, ratio, pulled)
        log_volume = np.sum(np.log(diagonal)) + np.sum(np.log(renewed))
        return 0.5 * float(self.values @ solved + log_volume)


def _from_differences(y: Float[np.ndarray, "e sample"]) -> Float[np.ndarray, " e"]:
    """White noise from third differences, which a smooth signal hardly has; their median, as edges
    do have some."""
    third = np.diff(y, 3, axis=-1)
    return np.nanmedian(np.abs(third), axis=-1) * 1.4826 / np.sqrt(20.0)
