"""Positions that are reported more slowly than they are recorded, and held in between.

A stage reports 50 times a second, a logger writes its last report 2,000 times, or leaves the cells
of other rows empty. Each run of equal values is one report or several equal ones; the position
between reports is that of a monotone curve through them. An encoder of coarse counts also repeats
its values, but goes by one count at a time; there the positions stay as they are (see `_speed`).
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Shaped

from ._timing import resolution

_FEWEST_REPEATS = 2  # samples, in the median, of a position that is held
_FEWEST_REPORTS = 8
_RESTS = 2.5  # times the usual interval without a change: less is a late report
MOST = 0.9  # of the steps, that are equal where an encoder goes by one count at a time
_FINEST_REPORT_M = 5e-5  # of equal steps: less is an encoder's count
COARSEST_COUNT_M = 1e-4  # of an encoder that is used for such a sensor at all


class Reports(NamedTuple):
    """Positions (sample,) [m] between reports, the interval between two [samples], and whether all
    reports are one step apart, as an encoder's counts would be."""

    position_m: Float[np.ndarray, " sample"]
    interval: int
    may_be_counts: bool


def between_reports(position_m: Float[np.ndarray, " sample"]) -> Reports | None:
    """The positions between reports, or None where they are not held."""
    change = np.flatnonzero(np.diff(position_m)) + 1
    lengths = np.diff(change)
    if change.size < _FEWEST_REPORTS:
        return None
    interval = int(np.median(lengths))
    if interval < _FEWEST_REPEATS:
        return None
    moves_m = np.abs(position_m[change] - position_m[change - 1])
    step_m = float(np.median(moves_m))
    # Counts that are printed in few digits differ by one of the last.
    rounding_m = max(1.5 * resolution(position_m), 1e-9 * step_m)
    one_step = bool(np.mean(np.abs(moves_m - step_m) <= rounding_m) > MOST)
    if one_step and step_m < _FINEST_REPORT_M:
        return None
    at = _report_samples(change, interval, position_m.size)
    reported = position_m[np.clip(at, 0, None)]
    if at[-1] < position_m.size - 1:  # the next report is not there: as fast as before
        reported = np.append(reported, 2 * reported[-1] - reported[-2])
        at = np.append(at, 2 * at[-1] - at[-2])
    may_be_counts = one_step and step_m < COARSEST_COUNT_M
    every = interpolated(at, reported, np.arange(position_m.size))
    return Reports(every, interval, may_be_counts)


def is_reported(positions: Float[np.ndarray, " sample"]) -> bool:
    """Whether positions are missing (NaN), and reported in enough samples to be interpolated."""
    return _FEWEST_REPORTS <= int(np.isfinite(positions).sum()) < positions.size


def interpolated(
    at: Shaped[np.ndarray, " report"],
    reported: Float[np.ndarray, " report"],
    times: Shaped[np.ndarray, " sample"],
) -> Float[np.ndarray, " sample"]:
    """Positions at the times, by a monotone curve through those reported at the times `at`."""
    return scipy.interpolate.PchipInterpolator(at, reported)(times)


def _report_samples(change: np.ndarray, interval: int, samples: int) -> np.ndarray:
    """The samples, from 0, at which reports came: where the position changes, before the first
    change, and, while it rests, once in every interval."""
    # A first report may be cut short, and rests before the first change are of whole intervals.
    before = change[0] - interval * -(-change[0] // interval)
    starts = np.concatenate(([before], change))
    ends = np.concatenate((change, [samples]))
    runs = [
        np.arange(start, end - interval // 2, interval)
        if end - start > _RESTS * interval
        else np.array([start])
        for start, end in zip(starts, ends, strict=True)
    ]
    return np.concatenate(runs)
