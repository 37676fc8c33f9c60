"""Columns that by their file begin at different times, or have rates of their own, on one clock."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy
from jaxtyping import Float

from srsinv.errors import refuse

from ..files import quoted
from ._stated import Clock
from ._table import ColumnTable, listing

_SAME_RATE = 1e-7  # relative: over a million samples a tenth of one
_SAME_START = 1e-2  # of an interval
_WHOLE = 0.25  # of an interval: starts nearer to a whole number of them only differ by rounding


def on_one_clock(table: ColumnTable, channels: Sequence[str], motion: Sequence[str]) -> ColumnTable:
    """The table with its signals and its columns of motion at the signals' own times, from the
    latest start to the earliest end; as it is where all have one clock, or none is stated.

    Signals are moved by whole samples, a motion is interpolated. Raises `BadInput` where signals
    are sampled at different rates, or at times of which one is between another's, and where no time
    is common to all.
    """
    stated = {name: table.clocks[name] for name in (*channels, *motion) if name in table.clocks}
    base = stated.get(channels[0])
    late = [name for name, each in stated.items() if each.start_s]
    refuse(
        base is None and bool(late),
        f"{table.name}: the file states when {listing(late)} begins, and not when "
        f"{quoted(channels[0])} does: state both, or neither.",
    )
    if base is None or all(_are_one(base, each) for each in stated.values()):
        rate = {"sample_rate_hz": 1 / base.interval_s} if base and base.interval_s else {}
        return replace(table, sidecar=rate | table.sidecar) if rate else table
    refuse(
        not base.interval_s,
        f"{table.name}: the file states that {listing(stated)} begin at different times, and not "
        "their interval: state it, or align them.",
    )
    clocks = {name: _since(base, each) for name, each in stated.items()}
    first = {name: _shift(table, channels, name, clocks) for name in channels}
    begin, end = max(first.values()), min(first[c] + table.columns[c].size for c in channels)
    for name in (each for each in motion if each in clocks):
        start, interval = clocks[name]
        last = start + (table.columns[name].size - 1) * interval
        begin = max(begin, int(np.ceil(start - _SAME_START)))
        end = min(end, int(np.floor(last + _SAME_START)) + 1)
    refuse(
        end <= begin,
        f"{table.name}: the columns {listing(clocks)} have no time in common, by the starts that "
        "the file states: record them together.",
    )
    columns = dict(table.columns)
    samples = columns[channels[0]].size
    for name in channels:
        columns[name] = columns[name][begin - first[name] : end - first[name]]
    for name in motion:
        if name in clocks:
            columns[name] = _at(table.numbers(name), clocks[name], np.arange(begin, end))
        elif columns[name].size == samples:  # of no clock of its own: on the first signal's
            columns[name] = columns[name][begin:end]
    sidecar = {"sample_rate_hz": 1 / base.interval_s} | table.sidecar
    notes = [*table.notes, *_notes(clocks, base.interval_s)]
    return replace(table, columns=columns, clocks={}, notes=notes, sidecar=sidecar)


def _are_one(one: Clock, other: Clock) -> bool:
    start, interval = _since(one, other)
    return abs(start) <= _SAME_START and abs(interval - 1) <= _SAME_RATE


def _since(base: Clock, other: Clock) -> tuple[float, float]:
    """A clock's start and interval, in samples of the base's; one without an interval has the
    base's."""
    late_s = (other.moment_s - base.moment_s) + (other.start_s - base.start_s)
    interval_s = base.interval_s or 1.0
    return late_s / interval_s, (other.interval_s or interval_s) / interval_s


def _shift(
    table: ColumnTable,
    channels: Sequence[str],
    name: str,
    clocks: dict[str, tuple[float, float]],
) -> int:
    """The sample of the first signal at which another one begins."""
    start, interval = clocks.get(name, (0.0, 1.0))
    refuse(
        abs(interval - 1) > _SAME_RATE or abs(start - round(start)) > _WHOLE,
        f"{table.name}: the signals {listing(channels)} are not sampled at the same times: "
        f"{quoted(name)} begins {start:.6g} samples after {quoted(channels[0])}, at {interval:.9g} "
        "times its interval: interpolate them to common times, or leave one out by "
        "recording.channels=[...].",
    )
    return round(start)


def _notes(clocks: dict[str, tuple[float, float]], interval_s: float) -> list[str]:
    """What is done to columns with a clock of their own, in sentences."""
    notes = []
    for name, (start, interval) in clocks.items():
        if abs(start) > _SAME_START:
            notes.append(
                f"{quoted(name)} begins {start * interval_s:.6g} s after the first signal, by the "
                "file: the columns are aligned by their starts."
            )
        if abs(interval - 1) > _SAME_RATE:
            notes.append(
                f"{quoted(name)} has an interval of {interval * interval_s:.6g} s, by the file: it "
                "is interpolated to the signals' times."
            )
    return notes


def _at(
    values: Float[np.ndarray, " own"], clock: tuple[float, float], at: np.ndarray
) -> Float[np.ndarray, " sample"]:
    """A motion's values at the samples `at`: its own where these are its own times."""
    start, interval = clock
    index = (at - start) / interval
    nearest = np.round(index).astype(int)
    if np.max(np.abs(index - nearest)) * interval <= _SAME_START:
        return values[nearest]
    curve = scipy.interpolate.PchipInterpolator(np.arange(values.size), values)
    return curve(np.clip(index, 0, values.size - 1))
