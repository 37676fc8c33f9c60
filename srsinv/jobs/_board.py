"""A scan over a board for the fit of its pitch: samples along x, and the settings checked on it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import is_number, refuse
from ..inverse.board.pitch import LEAST_PERIODS
from ..recording import Recording
from ..recording.noise import filled

SHORT_GAP = 0.25  # of the shortest pitch: a spline over it is off by some hundredths of a pattern


@dataclass(frozen=True)
class PitchSettings:
    """`feature` and `fit_fabricslide` of the configuration, checked against the recording."""

    range_m: tuple[float, float]
    harmonics: int
    false_alarm: float


def along_x(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Even positions that grow (n,) [m], and the signals (c, n) there, NaN where all miss one."""
    x_m, signal = recording.position_m, recording.signal
    if x_m[-1] < x_m[0]:
        x_m, signal = x_m[::-1], signal[:, ::-1]
    in_some = ~np.isnan(signal).all(axis=0)
    for channel, values in zip(recording.channels, signal[:, in_some], strict=True):
        refuse(
            bool(np.isnan(values).any()),
            f"{recording.name}: channel {channel} has missing samples, but the pitch "
            "needs all: leave it out of recording.channels.",
        )
        refuse(
            bool(np.ptp(values) == 0),
            f"{recording.name}: channel {channel} is constant ({values[0]:.4g}): leave it "
            "out of recording.channels.",
        )
    return np.linspace(x_m[0], x_m[-1], x_m.size), np.ascontiguousarray(signal)


def without_gaps(name: str, x_m: np.ndarray, signal: np.ndarray, shortest_m: float) -> np.ndarray:
    """The signals (c, n) with gaps that are short beside the shortest pitch interpolated from their
    neighbours."""
    rows = np.flatnonzero(~np.isnan(signal).any(axis=0))
    if rows.size == x_m.size:
        return signal
    refuse(rows.size < 2, f"{name}: only {rows.size} samples are valid: record the scan again.")
    longest = int(np.argmax(np.diff(rows)))
    start_m, end_m = float(x_m[rows[longest]]), float(x_m[rows[longest + 1]])
    refuse(
        end_m - start_m > SHORT_GAP * shortest_m,
        f"{name}: no channel has samples from {start_m:.4g} to {end_m:.4g} m, too "
        f"long a gap for a pitch of {shortest_m:.4g} m: cut the recording there, or "
        "raise the shortest of feature.pitch_range_m.",
    )
    return np.stack([filled(row) for row in signal])


def settings_for(given: Mapping[str, Any], ends: Any, name: str, x_m: np.ndarray) -> PitchSettings:
    """Those given, and the range `ends` of the pitch, for a recording at `x_m`."""
    key, example = f"feature.pitch_range_m is {ends}", "such as [0.015,0.03]"
    refuse(
        not (isinstance(ends, list | tuple) and len(ends) == 2 and all(map(is_number, ends))),
        f"{key}: give two numbers, the shortest and the longest pitch in metres, {example}.",
    )
    refuse(
        not 0 < ends[0] < ends[1],
        f"{key}: give the shortest pitch, above 0, and then the longest, {example}.",
    )
    step, length = x_m[1] - x_m[0], x_m[-1] - x_m[0]
    refuse(
        ends[1] > length / LEAST_PERIODS,
        f"{key}, but {name} is only {length:.4g} m long, and must hold "
        f"{LEAST_PERIODS} pitches: give a longest pitch up to "
        f"{length / LEAST_PERIODS:.4g} m.",
    )
    refuse(
        ends[0] < 2 * step,
        f"{key}, but the samples of {name} are {step:.4g} m apart: give a shortest "
        f"pitch of at least {2 * step:.4g} m, two samples.",
    )
    harmonics, false_alarm = given["harmonics"], given["false_alarm"]
    refuse(
        not (isinstance(harmonics, int) and not isinstance(harmonics, bool) and harmonics >= 1),
        f"fit_fabricslide.harmonics is {harmonics}: give a whole number from 1.",
    )
    refuse(
        not (is_number(false_alarm) and 0 < false_alarm < 1),
        f"fit_fabricslide.false_alarm is {false_alarm}: give a number between 0 and 1.",
    )
    resolved = int(ends[0] / (2 * step))
    return PitchSettings((float(ends[0]), float(ends[1])), min(harmonics, resolved), false_alarm)
