"""Speed from measured positions.

Positions written with many digits are interpolated by a quintic spline, whose derivative converges
with fifth order. Rounded ones (few digits, or an encoder's counts) are not: rounding by r would
make noise of about r over the sampling interval, and the signal is proportional to the speed. There
the speed is the slope of the parabola through the longest window of samples around each that lies
within half a step of it, and the error that rounding leaves in it. In the window's middle that is a
mean of increments with positive weights, so that it neither overshoots nor turns a motion back.

What is done is decided from the numbers before any equation is solved: whether a solver notices
that its matrix is singular differs from one processor to another.
"""

import numpy as np
import scipy
from jaxtyping import Float

from srsinv.errors import refuse

from ._health import quantisation_step
from ._recording import SPEED
from ._timing import resolution

_QUINTIC = 5
# Units in the last place of the largest position: a range of no more is the rounding of one place.
_AT_REST = 4
# Of the whole duration, a float64's resolution: a shorter interval is rounding of the time stamps.
_LEAST_INTERVAL = float(np.finfo(float).eps)
# Of the mean interval. A spline's equations are as near to singular as its fourth power, 1e-8, and
# in float64 they are singular from 1e-4 on. A recording of which nine rows in ten are missing still
# has its usual interval above this.
_LEAST_OF_SPLINE = 1e-2
_FINE = 1e-3  # of a usual increment: finer steps do not matter to a spline
_HALF_WIDTHS = (1, 2, 4, 8, 16, 32, 64)  # samples to either side
_FEWEST = 16  # samples of which it can be told that they are rounded
_ROUGH = 0.1  # of a step: the rms of third differences above which positions are rounded
_AT_ONCE = 2**16  # samples, so that windows stay in the cache


def speed_of_positions(
    name: str, time_s: Float[np.ndarray, " sample"], position_m: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, " sample"]:
    """Speed [m/s] at every sample. Raises `BadInput`, calling the recording `name`, where the times
    are too close together."""
    if np.ptp(position_m) <= _AT_REST * np.spacing(np.max(np.abs(position_m))):
        return np.zeros_like(time_s)
    since_s = time_s - time_s[0]  # far from zero a spline's knots would lose digits
    refuse(
        bool(np.min(np.diff(since_s)) < _LEAST_INTERVAL * since_s[-1]),
        f"{name}: some times are too close together to derive a speed from the "
        f"positions: add a column {SPEED}, or give recording.{SPEED}=...",
    )
    step_m = position_step(position_m)
    if step_m is not None:
        return _slopes(since_s, position_m, step_m)
    with np.errstate(all="ignore"):  # of positions next to the least number
        return _by_curve(since_s, position_m)


def position_step(position_m: Float[np.ndarray, " sample"]) -> float | None:
    """The step [m] to which positions are rounded, where it matters, or None."""
    moves_m = np.abs(np.diff(position_m))
    step_m = max(quantisation_step(position_m) or 0.0, _decimal_step_m(position_m))
    matters = step_m > _FINE * np.median(moves_m[moves_m > 0])
    if not matters or position_m.size < _FEWEST:
        return None
    # Rounding makes third differences of 1.3 steps rms, a smooth motion next to none.
    third_m = np.diff(position_m, 3)
    return step_m if np.sqrt(np.mean(third_m**2)) > _ROUGH * step_m else None


def _decimal_step_m(position_m: Float[np.ndarray, " sample"]) -> float:
    """The largest step of few digits that all positions are multiples of, from any origin."""
    digit_m = resolution(position_m)
    if not digit_m:
        return 0.0
    counts = np.round((position_m - position_m[0]) / digit_m).astype(np.int64)
    return float(np.gcd.reduce(counts)) * digit_m


def _by_curve(
    since_s: Float[np.ndarray, " sample"], position_m: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, " sample"]:
    """By a spline; by a monotone curve, which solves no equations, where intervals are too uneven
    for that, or where the spline overshoots at a start or a stop."""
    steps_m, interval_s = np.diff(position_m), np.diff(since_s)
    if np.min(interval_s) >= _LEAST_OF_SPLINE * np.mean(interval_s):
        spline = scipy.interpolate.make_interp_spline(
            since_s, position_m, min(_QUINTIC, since_s.size - 1)
        )
        speed = np.asarray(spline.derivative()(since_s))
        goes_one_way = bool(np.all(steps_m >= 0) or np.all(steps_m <= 0))
        if not goes_one_way or np.ptp(np.sign(speed)) <= 1:
            return speed
    return scipy.interpolate.pchip_interpolate(since_s, position_m, since_s, der=1)


def _slopes(
    since_s: Float[np.ndarray, " sample"], position_m: Float[np.ndarray, " sample"], step_m: float
) -> Float[np.ndarray, " sample"]:
    """The slope of the longest admissible window around each sample; near the ends, that of the
    parabola through the nearest window, between its least and its greatest increment."""
    n = since_s.size
    speed = np.zeros(n)
    for half in (each for each in _HALF_WIDTHS if 2 * each < n):
        for start in range(0, n, _AT_ONCE):
            at = np.arange(start, min(start + _AT_ONCE, n))
            rows = np.clip(at, half, n - 1 - half)[:, None] + np.arange(-half, half + 1)
            slope, off_m = _local(since_s[rows], position_m[rows], since_s[at])
            fits = off_m <= (0.5 + rows.shape[1] ** -0.5) * step_m
            fits |= half == _HALF_WIDTHS[0]
            speed[at[fits]] = slope[fits]
    return speed


def _local(
    t: Float[np.ndarray, "window row"],
    x: Float[np.ndarray, "window row"],
    at_s: Float[np.ndarray, " window"],
) -> tuple[Float[np.ndarray, " window"], Float[np.ndarray, " window"]]:
    """Slopes [m/s] of parabolas at times `at_s`, and their largest distances [m] from the samples.
    The slope in a window's middle is that of a line."""
    increments = np.diff(x, axis=1) / np.diff(t, axis=1)
    middle = t.mean(axis=1, keepdims=True)
    t, x = t - middle, x - x.mean(axis=1, keepdims=True)
    bow = t**2 - np.mean(t**2, axis=1, keepdims=True)
    line = np.sum(t * x, axis=1) / np.sum(t * t, axis=1)
    curvature = np.sum(bow * x, axis=1) / np.sum(bow * bow, axis=1)
    off_m = np.max(np.abs(x - line[:, None] * t - curvature[:, None] * bow), axis=1)
    slope = line + 2 * curvature * (at_s - middle[:, 0])
    return np.clip(slope, increments.min(axis=1), increments.max(axis=1)), off_m
