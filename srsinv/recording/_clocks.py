"""Columns that by their file begin at different times, or have rates of their own, on one clock."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy
from jaxtyping import Float

from srsinv.errors import BadInput, refuse

from ..files import quoted
from ._columns import quantity_of
from ._stated import Clock
from ._table import ColumnTable, listing
from ._timing import resolution
from ._units import PER_S, known_unit, split_unit

_SAME_RATE = 1e-7  # relative: over a million samples a tenth of one
_SAME_START = 1e-2  # of an interval
_WHOLE = 0.25  # of an interval: starts nearer to a whole number of them only differ by rounding


def own_times(
    names: Sequence[str], units: Mapping[str, str]
) -> tuple[list[str], dict[str, list[str]]]:
    """The names, columns of times that share one numbered, and the columns after each of those.

    Case and a number do not part names: Time (s), Time 2 (s); pandas writes Time (s).1. Columns of
    times that stand side by side are not of different columns.
    """
    table = ColumnTable("", units=dict(units))
    shared: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        if name and quantity_of(table, name) == "time":
            words = split_unit(re.sub(r"\.\d+$", "", name), PER_S)[0].casefold()
            shared.setdefault(re.sub(r"[ _-]\d+$", "", words), []).append(index)
    numbered = list(names)
    alike = [
        each for each in shared.values() if len(each) > 1 and min(np.diff([*each, len(names)])) > 1
    ]
    if len(alike) != 1:
        return numbered, {}
    for index in alike[0]:
        before = list(names[:index]).count(names[index])
        numbered[index] += f" no. {before + 1}" if before else ""
    parts = zip(alike[0], [*alike[0][1:], len(numbered)], strict=True)
    return numbered, {
        numbered[at]: [name for name in numbered[at + 1 : end] if name] for at, end in parts
    }


def take_own_times(table: ColumnTable, blocks: Mapping[str, Sequence[str]]) -> None:
    """Take several columns of times, each of the columns after it (`blocks`), for the first of them
    where they are equal, else as the clocks of those columns.

    Raises `BadInput` where they differ, and are not even or in no unit that is stated.
    """
    first, *others = blocks or [""]
    if first not in table.columns:
        return
    unit = _time_unit(table, first)
    own = {name: table.columns.get(name, np.full(1, np.nan)) for name in blocks}
    for name in others:
        its = _time_unit(table, name) or unit
        if its != unit:
            own[name] = own[name] * (PER_S[unit] / PER_S[its] if unit and its else np.nan)
    for name in others:
        table.columns.pop(name, None)
        table.units.pop(name, None)
        table.stamps[:] = [each for each in table.stamps if each != name]
    if all(_are_equal(own[first], own[name]) for name in others):
        table.notes.append(f"The {len(own)} columns {quoted(first)} are equal: the first is used.")
        return
    times = {name: _own_rows(table, own[name], blocks[name]) for name in own}
    if unit is None or not all(map(_are_even, times.values())):
        raise BadInput(
            f"{table.name}: the {len(own)} columns {quoted(first)} differ, and are uneven "
            "or without a unit: write one column of times for all columns."
        )
    steps = {name: (values[-1] - values[0]) / (values.size - 1) for name, values in times.items()}
    del table.columns[first]  # the clocks have its times
    table.stamps[:] = [each for each in table.stamps if each != first]
    rounding = max(map(resolution, times.values()))
    for name, values in times.items():
        is_same = abs(steps[name] - steps[first]) * values.size < 2 * rounding
        step = steps[first] if is_same else steps[name]
        clock = Clock(0.0, float(values[0]) / PER_S[unit], float(step) / PER_S[unit])
        table.clocks.update((each, clock) for each in blocks[name] if each in table.columns)


def _time_unit(table: ColumnTable, name: str) -> str | None:
    """The unit of a column of times, as the file or its name states it."""
    if name in table.stamps:
        return "s"
    named = split_unit(name.partition(" no. ")[0], PER_S)[1]
    return known_unit(table.units.get(name), PER_S) or named


def _are_equal(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether times are equal but for rounding to a hundredth of their interval."""
    valid = np.isfinite(one)
    if valid.sum() < 2 or np.isinf(one).any() or not np.array_equal(valid, np.isfinite(other)):
        return False
    step = float(np.median(np.abs(np.diff(one[valid]))))
    return bool(np.max(np.abs(one[valid] - other[valid])) <= _SAME_START * step)


def _own_rows(table: ColumnTable, times: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """The times, without empty cells at their end where all columns of these names have such, and
    these columns without them."""
    named = [name for name in names if name in table.columns]
    last = 1 + int(np.max(np.flatnonzero(np.isfinite(times)), initial=-1))
    if all(np.isnan(table.columns[name][last:]).all() for name in named):
        for name in named:
            table.columns[name] = table.columns[name][:last]
        return times[:last]
    return times


def _are_even(times: Float[np.ndarray, " sample"]) -> bool:
    if times.size < 2 or not np.isfinite(times).all() or not times[0] < times[-1]:
        return False
    even, step = np.linspace(times[0], times[-1], times.size, retstep=True)
    return bool(np.max(np.abs(times - even)) < _WHOLE * step)


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
        f"{table.name}: the file states the start of {listing(late)}, but not of "
        f"{quoted(channels[0])}: state both, or neither.",
    )
    if base is None or all(_are_one(base, each) for each in stated.values()):
        rate = {"sample_rate_hz": 1 / base.interval_s} if base and base.interval_s else {}
        return replace(table, sidecar=rate | table.sidecar) if rate else table
    refuse(
        not base.interval_s,
        f"{table.name}: the file states that {listing(stated)} begin at different "
        "times, but not their interval: state it, or align them.",
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
        f"{table.name}: the columns {listing(clocks)} do not overlap in time, by the "
        "starts that the file states: record them together.",
    )
    columns = dict(table.columns)
    samples = columns[channels[0]].size
    for name in channels:
        columns[name] = columns[name][begin - first[name] : end - first[name]]
    for name in motion:
        if name in clocks:
            columns[name] = _at(table.numbers(name), clocks[name], np.arange(begin, end))
        elif name in columns and columns[name].size == samples:
            columns[name] = columns[name][begin:end]  # of no clock of its own: the first signal's
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
        f"{table.name}: the signals {quoted(channels[0])}, {quoted(name)} are not sampled at the "
        "same times: interpolate them to common times, or leave one out by "
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
