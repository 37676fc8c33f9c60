"""Sample timing: the interval, its jitter, and gaps with missing samples.

The only module that detects gaps.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ._table import MOST_SAMPLES

GAP = 1.5  # of the interval: beyond it a sample is missing
JITTER = 0.2  # of the interval: beyond it a signal is too coarse to be interpolated to even times
# Half a last digit, and the error of the line through the stamps, as fractions of the last digit.
HALF_A_DIGIT = 0.55
# Which of the intervals in order of length is the usual one: the median, and where those near it
# are not even, as when half of the rows are missing, one among the shortest.
USUAL = (0.5, 0.1)
_DIGITS = tuple(10.0**-digit for digit in range(10))
_TINY = 1e-100  # no interval, and the inverse of none


@dataclass(frozen=True)
class Gap:
    """A longer interval than usual: preceding data row, time, duration, number of missing rows."""

    row: int
    start_s: float
    length_s: float
    missing: int


@dataclass(frozen=True)
class Timing:
    """Timing of the samples.

    - `rate_hz`: one over the mean interval, gaps aside.
    - `jitter_rms`, `jitter_largest`: departures from that interval, as fractions of it, gaps aside.
    - `is_even`: whether the stamps are near even times, gaps aside, or only rounded from them.
    - `disorder`: data rows whose time does not come after that of the row before.
    """

    rate_hz: float
    jitter_rms: float
    jitter_largest: float
    is_even: bool
    gaps: tuple[Gap, ...]
    disorder: tuple[int, ...]

    def rows(self, samples: int) -> Int[np.ndarray, " sample"]:
        """Index of each data row, from 0, missing rows counted."""
        step = np.ones(samples, int)
        step[0] = 0
        for gap in self.gaps:
            step[gap.row] += min(gap.missing, 2**62 // samples)  # an integer holds the sum
        return np.cumsum(step)


def timing(time_s: Float[np.ndarray, " sample"]) -> Timing | None:
    """The timing of the stamps [s], NaN where one is missing; None where none follows another, or
    they lie a float64's whole range apart."""
    with np.errstate(over="ignore"):
        step_s = np.diff(time_s)
    forward = step_s[step_s > _TINY]
    if not forward.size or np.max(forward) > 1 / _TINY:
        return None
    first, *others = (_timing(time_s, step_s, float(np.quantile(forward, q))) for q in USUAL)
    return next((each for each in (first, *others) if each.is_even), first)


def _timing(
    time_s: Float[np.ndarray, " sample"], step_s: Float[np.ndarray, " interval"], usual_s: float
) -> Timing:
    forward = step_s[step_s > _TINY]
    # By the mean: the median of stamps in whole milliseconds is a whole one.
    usual_s = float(np.mean(forward[forward <= GAP * usual_s]))
    regular = forward[forward <= GAP * usual_s]
    mean_s = float(np.mean(regular))
    departure = (regular - mean_s) / mean_s
    gaps = tuple(
        Gap(
            row + 1, float(time_s[row]), float(step_s[row]), max(1, round(step_s[row] / mean_s) - 1)
        )
        for row in np.flatnonzero(step_s > GAP * mean_s).tolist()
    )
    estimate = Timing(
        rate_hz=1 / mean_s,
        jitter_rms=float(np.sqrt(np.mean(departure**2))),
        jitter_largest=float(np.max(np.abs(departure))),
        is_even=bool(np.max(np.abs(departure)) <= JITTER),
        gaps=gaps,
        disorder=tuple((np.flatnonzero(step_s <= 0) + 2).tolist()),
    )
    if estimate.is_even or estimate.disorder or not np.isfinite(time_s).all():
        return estimate
    if sum(gap.missing for gap in gaps) > MOST_SAMPLES:  # no file has so many rows
        return estimate
    return replace(estimate, is_even=line_through(time_s, estimate.rows(time_s.size))[1])


def line_through(
    time_s: Float[np.ndarray, " sample"], row: Int[np.ndarray, " sample"]
) -> tuple[Float[np.ndarray, " n"], bool]:
    """Times of all rows from 0 to the last along the line through the stamps, and whether the
    stamps' last digit explains the residual."""
    since_s, from_middle = time_s - time_s[0], row - row.mean()
    slope_s = float(from_middle @ since_s / (from_middle @ from_middle))
    line_s = since_s.mean() + slope_s * (np.arange(int(row[-1]) + 1) - row.mean())
    off_s = float(np.max(np.abs(since_s - line_s[row])))
    return time_s[0] + line_s, off_s <= HALF_A_DIGIT * resolution(time_s)


def resolution(values: Float[np.ndarray, " sample"]) -> float:
    """The power of ten, of at most 1, to which all values are rounded; 0: to none above 1e-9."""
    for digit in _DIGITS:
        whole = values / digit
        off = np.abs(whole - np.round(whole))
        if np.all(off <= 1e-6 + 8 * np.finfo(float).eps * np.abs(whole)):
            return digit
    return 0.0
