"""Sample timing: the interval, its jitter, gaps with missing samples, and even times for the rows.

The only module that detects gaps. Stamps determine the samples' times; none is moved by more than a
quarter of the interval or half the stamps' last digit without interpolating the signal. A row
missing by the stamps is a missing sample.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from srsinv.errors import BadInput, refuse

from ._table import MOST_SAMPLES

GAP = 1.5  # of the interval: beyond it a sample is missing
JITTER = 0.2  # of the interval: beyond it a signal is too coarse to be interpolated to even times
# Half a last digit, and the error of the line through the stamps, as fractions of the last digit.
HALF_A_DIGIT = 0.55
# Which of the intervals in order of length is the usual one: the median, and where those near it
# are not even, as when half of the rows are missing, one among the shortest.
USUAL = (0.5, 0.1)
ROUNDED = 0.25  # of an interval: stamps nearer to even ones than this are only rounded
MAX_MISSING_RATIO = 9  # missing rows for each valid one
# How far a stated rate may be from the stamps': half a unit of the third digit, to which rates are
# stated at least (35.5, 333); clocks themselves agree to 1e-4. The stamps are used in either case;
# a difference means another unit, another setting, or rows missing throughout.
AGREES = 5e-3
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


@dataclass(frozen=True, eq=False)
class EvenTimes:
    """Even times [s] and the rows' indices on them.

    - `time_s` (n,): even; `row` (sample,): each row's index there, strictly increasing.
    - `is_rounded`: whether the stamps are `time_s` but for rounding; else the signal has to be
      interpolated. `is_gap` (sample - 1,): the intervals in which rows are missing.
    """

    time_s: Float[np.ndarray, " n"]
    row: Int[np.ndarray, " sample"]
    is_rounded: bool
    is_gap: Bool[np.ndarray, " interval"]

    @property
    def missing_rows(self) -> int:
        """Number of rows missing between the first and the last."""
        return self.time_s.size - self.row.size

    @property
    def gaps(self) -> int:
        """Number of gaps."""
        return int(self.is_gap.sum())


def even_times(
    name: str, time_s: Float[np.ndarray, " sample"], stated_hz: float | int | None = None
) -> EvenTimes:
    """Even times for the rows at the strictly increasing stamps `time_s` [s].

    `stated_hz`: the rate by the experimenter, which decides where stamps are too coarse to
    distinguish missing rows from rounding. Raises `BadInput` where the intervals vary too much,
    gaps aside, and where nearly all rows are missing; refusals call the recording `name`.
    """
    stamps = timing(time_s)
    assert stamps is not None  # of times that a recording can have
    rounded = _without_loss(time_s, stated_hz)
    if rounded is not None:
        return rounded
    row = stamps.rows(time_s.size)
    missing = int(row[-1]) + 1 - row.size
    if missing > MAX_MISSING_RATIO * row.size:
        longest = max(stamps.gaps, key=lambda gap: gap.length_s)
        raise BadInput(
            f"{name}: {missing} rows are missing and only {row.size} are there: cut the "
            f"recording at its longest gap, of {longest.length_s:.4g} s, after data row "
            f"{longest.row} at {longest.start_s:.9g} s."
        )
    refuse(
        not stamps.is_even,
        f"{name}: the sampling interval varies by {100 * stamps.jitter_largest:.0f} %, more "
        f"than {100 * JITTER:.0f} %: interpolate the signal to even times, or, if only the "
        "times are wrong, give recording.times=ignore and "
        "recording.sample_rate_hz=...",
    )
    return _on(time_s, row)


def _on(time_s: Float[np.ndarray, " sample"], row: Int[np.ndarray, " sample"]) -> EvenTimes:
    """Even times from the first stamp to the last; where stamps are further from them than rounding
    to a fraction of an interval, along the line through all of them, if their last digit explains
    the residual."""
    n = int(row[-1]) + 1
    even_s = np.linspace(time_s[0], time_s[-1], n)
    interval_s = (time_s[-1] - time_s[0]) / (n - 1)
    is_rounded = bool(np.max(np.abs(time_s - even_s[row])) < ROUNDED * interval_s)
    line_s, is_explained = line_through(time_s, row)
    if is_explained and not is_rounded:
        even_s, is_rounded = line_s, True
    return EvenTimes(even_s, row, is_rounded, np.diff(row) > 1)


def check_rate(
    name: str, time_s: Float[np.ndarray, " sample"], stated_hz: float | int | None
) -> None:
    """Refuse a stated sample rate that the time stamps contradict."""
    stamps = None if stated_hz is None else timing(time_s)
    if stated_hz is None or stamps is None:
        return
    agrees = _agree(stated_hz, stamps.rate_hz, time_s)
    refuse(
        not agrees and _without_loss(time_s, stated_hz) is None,
        f"{name}: sample_rate_hz is {stated_hz:.6g}, but the times come at "
        f"{stamps.rate_hz:.6g} Hz: give "
        f"recording.sample_rate_hz={stamps.rate_hz:.6g}, correct recording.time_unit, "
        "or, if the times are wrong, give recording.times=ignore.",
    )


def _agree(stated_hz: float | int, rate_hz: float, time_s: Float[np.ndarray, " sample"]) -> bool:
    rounding = resolution(time_s) / float(time_s[-1] - time_s[0])
    return abs(stated_hz / rate_hz - 1) <= AGREES + rounding


def _without_loss(
    time_s: Float[np.ndarray, " sample"], stated_hz: float | int | None
) -> EvenTimes | None:
    """Even times without gaps, where the rows' rate is the stated one and rounding explains the
    rest: stamps in whole milliseconds at 833 Hz look like rows missing at 1000 Hz."""
    own_hz = (time_s.size - 1) / float(time_s[-1] - time_s[0])
    if stated_hz is None or not _agree(stated_hz, own_hz, time_s):
        return None
    times = _on(time_s, np.arange(time_s.size))
    return times if times.is_rounded else None
