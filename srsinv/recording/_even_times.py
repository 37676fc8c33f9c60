"""Even times for the rows of a recording: the index of each row, and which rows are missing.

Stamps determine the samples' times; none is moved by more than a quarter of the interval or half
the stamps' last digit without interpolating the signal. A row missing by the stamps is a missing
sample.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from srsinv.errors import BadInput, refuse

from ._timing import JITTER, line_through, resolution, timing

ROUNDED = 0.25  # of an interval: stamps nearer to even ones than this are only rounded
MAX_MISSING_RATIO = 9  # missing rows for each valid one
# How far a stated rate may be from the stamps': half a unit of the third digit, to which rates are
# stated at least (35.5, 333); clocks themselves agree to 1e-4. The stamps are used in either case;
# a difference means another unit, another setting, or rows missing throughout.
AGREES = 5e-3


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
            f"{name}: {missing} rows are lost and {row.size} are there: cut the recording at its "
            f"longest gap, of {longest.length_s:.4g} s, after data row {longest.row} (blank rows "
            f"aside), at {longest.start_s:.9g} s."
        )
    refuse(
        not stamps.is_even,
        f"{name}: the sampling interval varies by {stamps.jitter_largest:.0%} of its mean, gaps "
        f"aside, more than {JITTER:.0%}, so that the rows stand on no even times: interpolate the "
        "signal to even times by its own time stamps, or, only where the converter's clock was "
        "even and no row is lost, so that the stamps alone are wrong, give recording.times=ignore "
        "and recording.sample_rate_hz=...",
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
        f"{name}: sample_rate_hz is {stated_hz:.6g}, but the time stamps come at "
        f"{stamps.rate_hz:.6g} Hz: leave sample_rate_hz out, as the stamps are used, or check "
        "their unit, by the column's name or recording.time_unit; where the file states the rate, "
        f"and the stamps are right, give recording.sample_rate_hz={stamps.rate_hz:.6g}; only where "
        "the stamps themselves are wrong and no row is lost, give recording.times=ignore.",
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
