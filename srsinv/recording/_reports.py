"""Positions that are reported more slowly than they are recorded, and held in between.

A stage reports 50 times a second, a logger writes its last report 2,000 times. Each run of equal
values is one report or several equal ones; the position between reports is that of a monotone curve
through them. An encoder of coarse counts also repeats its values, but goes by one count at a time;
there the positions stay as they are (see `_speed`).
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ._health import quantisation_step

_FEWEST_REPEATS = 5  # samples, in the median, of a position that is held
_FEWEST_REPORTS = 5
_EVEN = 0.2  # of the usual interval, by which those between reports may differ
_MOST_COUNT_M = 5e-5  # of an encoder that resolves what such a sensor feels


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
    is_even = np.abs(lengths - interval * np.maximum(np.round(lengths / interval), 1)) <= max(
        1.0, _EVEN * interval
    )
    if interval < _FEWEST_REPEATS or np.mean(is_even) < 0.9:
        return None
    step_m = quantisation_step(position_m) or 0.0
    moves_m = np.abs(position_m[change] - position_m[change - 1])
    one_step = bool(np.mean(moves_m <= 1.5 * step_m) > 0.9)
    if one_step and step_m < _MOST_COUNT_M:
        return None
    at = _report_samples(change, interval, position_m.size)
    reported = position_m[np.clip(at, 0, None)]
    if at[-1] < position_m.size - 1:  # the next report is not there: as fast as before
        reported = np.append(reported, 2 * reported[-1] - reported[-2])
        at = np.append(at, 2 * at[-1] - at[-2])
    curve = scipy.interpolate.PchipInterpolator(at, reported)
    return Reports(curve(np.arange(position_m.size)), interval, one_step)


def _report_samples(change: np.ndarray, interval: int, samples: int) -> np.ndarray:
    """The samples, from 0, at which reports came: where the position changes, before the first
    change, and, while it rests, once in every interval."""
    before = change[0] - interval * -(-change[0] // interval)  # a first report may be cut short
    starts = np.concatenate(([before], change))
    ends = np.concatenate((change, [samples]))
    runs = [
        np.arange(start, max(end - interval // 2, start + 1), interval)
        for start, end in zip(starts, ends, strict=True)
    ]
    return np.concatenate(runs)
