"""What holds at an optimum: exact slopes, flat directions, tolerances and the price of a bound."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from .search import TOGETHER, Criterion, Point

STEP = 2e-4  # of the range: of differences of the fourth order, exact to about 1e-10
FLAT = 1e-6  # curvature over the largest one, 1e3 times the error of its differences


def differences(values: Callable[[np.ndarray], np.ndarray], point: Point) -> np.ndarray:
    """Derivatives by every coordinate at a point, by differences of the fourth order; `values`
    maps points (n, coordinate) to (n, ...)."""
    count = point.size
    shifts = STEP * np.array([1.0, -1.0, 2.0, -2.0])
    points = point + (shifts[:, None, None] * np.eye(count)).reshape(-1, count)
    at = values(points).reshape(4, count, -1)
    slopes = (8 * (at[0] - at[1]) - (at[2] - at[3])) / (12 * STEP)
    return slopes[:, 0] if slopes.shape[1] == 1 else slopes


def gradient_error(criterion: Criterion, points: Float[np.ndarray, "n coordinate"]) -> float:
    """The largest difference between the gradient of jax and differences, over the gradient's
    largest component at that point."""
    worst = 0.0
    for point in points:
        _, gradient = criterion.slope(point)
        by_differences = differences(criterion.values, point)
        worst = max(worst, np.abs(gradient - by_differences).max() / np.abs(gradient).max())
    return worst


def flat_directions(criterion: Criterion, point: Point) -> int:
    """Directions within the box in which the error has no curvature at an optimum: other designs
    along them are as good."""
    inside = criterion.space.is_periodic | ((point > 0) & (point < 1))
    inside &= criterion.is_active
    if not inside.any():
        return 0

    def gradients(points: np.ndarray) -> np.ndarray:
        return np.array([criterion.slope(each)[1] for each in points])

    hessian = differences(gradients, point).reshape(point.size, point.size)[np.ix_(inside, inside)]
    curvature = np.linalg.eigvalsh((hessian + hessian.T) / 2)
    return int(np.sum(np.abs(curvature) < FLAT * np.abs(curvature).max()))


def tolerance(
    criterion: Criterion, point: Point, growth: float, at: Float[np.ndarray, " place"]
) -> tuple[np.ndarray, np.ndarray]:
    """Log errors (coordinate, place) with one coordinate at each place `at`, the others at the
    optimum; and how far each may be below and above it (coordinate, 2) before the error has grown
    by `growth`, NaN where it does not within the box."""
    moved = np.repeat(point[None], point.size * at.size, axis=0)
    moved = moved.reshape(point.size, at.size, point.size)
    for c in range(point.size):
        moved[c, :, c] = at
    profiles = criterion.values(moved.reshape(-1, point.size)).reshape(point.size, at.size)
    limit = criterion.value(point) + math.log1p(growth)
    reach = np.array([
        [_reach(criterion, point, c, sign, limit, periodic) for sign in (-1.0, 1.0)]
        for c, periodic in enumerate(criterion.space.is_periodic)
    ])  # fmt: skip
    return profiles, reach


def _reach(criterion, point: Point, c: int, sign: float, limit: float, periodic: bool) -> float:
    """How far one coordinate goes before the log error crosses a limit."""
    end = 0.5 if periodic else (point[c] if sign < 0 else 1 - point[c])
    steps = np.linspace(0, end, TOGETHER)
    direction = sign * np.eye(point.size)[c]
    above = np.flatnonzero(criterion.values(point + steps[:, None] * direction) > limit)
    if not above.size or end == 0:
        return math.nan
    low, high = steps[above[0] - 1], steps[above[0]]
    root: Any = scipy.optimize.brentq(
        lambda step: criterion.value(point + step * direction) - limit, low, high, xtol=1e-9
    )
    return float(root)
