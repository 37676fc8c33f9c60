"""Reading of a `Recording` from a file and its sidecar."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from srsinv.errors import BadInput, choice, echo, refuse

from ..files import path_of, quoted, within_memory
from ._clocks import on_one_clock
from ._columns import (
    Quantity,
    column_of,
    quantity_of,
    resolve,
    signal_columns,
    signal_unit,
    unit_of,
    units_that_differ,
    unnamed_columns,
    written_unit,
)
from ._counters import unwrapped
from ._doubts import disagreement
from ._recording import POSITION, SPEED, TIME, Recording, check_range, check_samples, check_times
from ._reports import between_reports, interpolated, is_reported
from ._sidecar import Sidecars, check_elements, merge
from ._speed import speed_of_positions
from ._table import ColumnTable, listing
from ._timing import check_rate
from ._units import (
    PER_M,
    PER_M_PER_S,
    PER_S,
    PER_V,
    bracketed,
    in_volts,
)
from .formats import BY_SUFFIX
from .reader import Reader, store, take_table

# Facts on the file that are in the Recording's own fields once it is read.
_LAYOUT = (
    "time_column", "time_unit", "speed_column", "speed_unit", "position_column", "position_unit",
    "channels", "signal_unit", "polarity", "gain",
)  # fmt: skip
# What stands for a sample that is out of range: netCDF's filling, SCPI's infinity and no number,
# and the largest float32.
_OUT_OF_RANGE = (9.969209968386869e36, 9.9e37, 9.91e37, 1e38, 3.4028234663852886e38)
_SAME_CODE = 1e-3  # relative: codes are printed with three digits or more
MISSING = ("refuse", "allow")  # treatment of an empty cell, the default first
TIMES_OF_ROWS = ("use", "ignore")  # treatment of a column of times


def load(
    path: str | os.PathLike[str],
    *,
    reader: Reader = BY_SUFFIX,
    sidecar: str | os.PathLike[str] | None = None,
    calibration: str | os.PathLike[str] | None = None,
    missing: str = MISSING[0],
    times: str = TIMES_OF_ROWS[0],
    **known: Any,
) -> Recording:
    """Load a recording from a file, with the facts of its sidecar.

    - `path`: text (.csv, .txt, .tsv), NPZ, HDF5 (.h5, .hdf5), netCDF (.nc), MATLAB 5 or 7.3 (.mat)
      or WAV; TDMS, Parquet or FLAC with the extra `tdms`, `parquet` or `flac` installed.
    - `reader`: a `srsinv.kinds.Reader`, for a format of your own; by default the one of the
      suffix.
    - `sidecar`: path of a JSON or YAML mapping of further facts. None: NAME.json, NAME.yaml or
      NAME.yml beside the file, where there is one.
    - `calibration`: path of the mapping that a calibration of the rig wrote. Its gain, polarity and
      sensor win over the sidecar's.
    - `missing`: "allow" takes an empty cell of a signal (NaN in an array) for a missing sample, NaN
      in the result; by default it is refused.
    - `times`: "ignore" leaves a column of times out, for stamps that are wrong: the rows are taken
      as even at `sample_rate_hz`, none missing; "use" takes it.
    - `known`: facts by the keys of a sidecar, as `speed_m_per_s=0.05`, `sample_rate_hz=2000`,
      `gain=100`, `sensor={...}`. They override the file's and both mappings', in depth; None: not
      given.

    Returns a [`Recording`][srsinv.Recording], its signals (element, sample) in V or in the unit
    that is stated. Raises `BadInput` for a file that cannot be read as such a recording.

    Columns (1-D, of equal length; in MATLAB row or column vectors, or fields of one struct) end in
    their unit, as `Name (unit)`, `Name [unit]` or `name_unit`, in any case; or the file states it,
    or `time_unit`, `speed_unit` and `position_unit` do. A unit decides what a column may be:
    - time (s, ms, us, ns, dates or clock times): `time_s`, `Time (ms)`, `timestamp`, `t`, or
      `time_column`; or none, with `sample_rate_hz`, which the file may state itself. Beside times,
      `sample_rate_hz` has to agree with them, and changes nothing.
    - speed (m/s, cm/s, mm/s, um/s, nm/s): `speed_m_per_s`, `Stage velocity [mm/s]`, or
      `speed_column`; or none, with a position or the number `speed_m_per_s`.
    - position (m, cm, mm, um, nm) along x: `position_m`, `Stage pos (mm)`, or `position_column`; or
      none. Without a speed column the speed is derived from the positions, rounded ones too.
    - signals: those that `channels` lists; or `voltage_0_V`, `voltage_1_mV`, ... in the order of
      their numbers; or all in V, mV or uV, as `Ch A [V]`, and all called channels, as `AI0`; or all
      that is left in WAV, FLAC and TDMS.
    `time_column`, `position_column`, `speed_column` and `channels` take a column's whole name, or
    the name without its unit. In a file with times a row without any number is left out. In a file
    without times it is a missing sample of all signals. Counters that wrap are continued,
    positions that are held between reports are interpolated, and columns that start at different
    times are aligned, each with a sentence in `Recording.notes`.

    A signal's unit is `signal_unit`, or the file's own, or that of its column's name, or else
    "counts"; values in mV or uV are converted to V. It is multiplied by `polarity` (1 or -1) and
    divided by `gain`, each one number or one for each channel; a gain is in the signal's unit per
    volt, so that the result is in V whatever that unit is.
    """
    path = path_of(path, "recording.path")
    choice(f"{path.name}: recording.missing", missing, MISSING)
    choice(f"{path.name}: recording.times", times, TIMES_OF_ROWS)
    with within_memory(path):
        given = Sidecars(sidecar, calibration)
        return recording_of_table(path, take_table(path, reader), given, missing, times, known)


def recording_of_table(
    path: Path,
    table: ColumnTable,
    sidecar: Sidecars,
    missing: str,
    times: str,
    known: Mapping[str, Any],
) -> Recording:
    """The recording in a file's table: see [`load`][]."""
    facts = read_facts(path, table, sidecar, known)
    channels = signal_columns(table, facts)
    check_elements(path.name, facts, channels)
    column = column_of(table, facts, "time") if times == "use" else None
    table, facts = _on_one_clock(table, facts, channels)
    if column is not None:
        table = table.without_blank_rows()
    if known.get(SPEED) is None:
        table = _within_reports(table, column_of(table, facts, "position"))
    notes, doubted = list(table.notes), []
    columns = {c: _present(table, c, missing) for c in channels}
    samples = columns[channels[0]].size
    columns[TIME] = _time_s(table, facts, column, samples, notes)
    if known.get(SPEED) is None:
        columns |= _motion(table, facts, columns[TIME], notes, doubted)
    _check_lengths(table, columns)
    doubted += disagreement(columns[TIME], columns.get(SPEED), columns.get(POSITION))
    check_samples(path.name, samples)
    check_times(path.name, columns[TIME], table.row_of)
    for quantity in {SPEED, POSITION} & columns.keys():
        check_range(path.name, quantity, columns[quantity], table.row_of)
    if column is not None:
        check_rate(path.name, columns[TIME], facts.get("sample_rate_hz"))
    names, signal, unit = _signal(table, facts, channels, [columns[c] for c in channels])
    return Recording(
        signal=signal,
        time_s=columns[TIME],
        speed_m_per_s=_speed_m_per_s(table, facts, columns),
        channels=names,
        sidecar={key: value for key, value in facts.items() if key not in _LAYOUT},
        signal_unit=unit,
        name=path.name,
        measured_position_m=columns.get(POSITION),
        notes=tuple(notes),
        doubts=tuple(doubted),
    )


def _on_one_clock(
    table: ColumnTable, facts: dict[str, Any], channels: tuple[str, ...]
) -> tuple[ColumnTable, dict[str, Any]]:
    """The table with its columns on the signals' clock, and the facts, with its rate where they
    state none."""
    quantities: tuple[Quantity, ...] = ("time", "speed", "position")
    motion = [c for q in quantities if (c := column_of(table, facts, q)) is not None]
    aligned = on_one_clock(table, channels, motion)
    rate_hz = aligned.sidecar.get("sample_rate_hz")
    return aligned, facts if rate_hz is None else {"sample_rate_hz": rate_hz} | facts


def _present(table: ColumnTable, column: str, missing: str) -> Float[np.ndarray, " row"]:
    """A signal's numbers; NaN for a missing sample, where that is allowed."""
    values = table.numbers(column, allow_missing=missing == "allow")
    over = np.abs(values) > min(_OUT_OF_RANGE) * (1 - _SAME_CODE)
    if not over.any():
        return values
    large = np.abs(values[over])
    over[over] = np.any([np.isclose(large, code, _SAME_CODE, 0) for code in _OUT_OF_RANGE], axis=0)
    if not over.any():
        return values
    row = int(over.argmax())
    refuse(
        missing != "allow",
        f"{table.name}: data row {table.row_of(row)} of column {quoted(column)} is "
        f"{values[row]:g}, an instrument's code for a sample out of range: set "
        "recording.missing=allow to treat it as missing.",
    )
    return np.where(over, np.nan, values)


def check_settings(settings: Mapping[str, Any], reader: Reader = BY_SUFFIX) -> None:
    """Refuse settings of a recording (`path`, `sidecar` and facts) that name no readable table or
    state invalid facts. Columns are not checked: not every job needs the same ones."""
    facts_of(settings, reader)


def facts_of(settings: Mapping[str, Any], reader: Reader = BY_SUFFIX) -> dict[str, Any]:
    """All facts about a recording that the file itself, its sidecars, or `settings` of it (`path`,
    `sidecar` and facts) state. Raises `BadInput` as [`load`][] does for them."""
    path = path_of(settings["path"], "recording.path")
    from ._schema import RecordingFacts

    known = {key: value for key, value in settings.items() if key in RecordingFacts.model_fields}
    with within_memory(path):
        table = take_table(path, reader)
        facts = read_facts(path, table, Sidecars.of_settings(settings), known)
    store(path, reader, table)
    return facts


def read_facts(
    path: Path, table: ColumnTable, sidecar: Sidecars, known: Mapping[str, Any]
) -> dict[str, Any]:
    """Facts beside the columns: from the file's own sidecar, those beside it, and `known`, in which
    film elements may be by name, as a configuration has them."""
    sensor = known.get("sensor")
    elements = sensor.get("elements") if isinstance(sensor, Mapping) else None
    if isinstance(sensor, Mapping) and isinstance(elements, Mapping):
        known = {**known, "sensor": {**sensor, "elements": list(elements.values())}}
    facts = merge(sidecar.facts(path, table.sidecar), known)
    from ._schema import check_facts

    check_facts(path.name, facts)
    return facts


def _time_s(
    table: ColumnTable,
    facts: Mapping[str, Any],
    column: str | None,
    samples: int,
    notes: list[str],
) -> Float[np.ndarray, " sample"]:
    if column is not None:
        unit = _unit(table, facts, column, "time", PER_S)
        values = table.numbers(column)
        if np.any(np.diff(values) < 0):  # else what begins anew is no counter
            values = _unwrapped(table, column, values, range(values.size), notes)
        return values / PER_S[unit]
    refuse(
        facts.get("sample_rate_hz") is None and column_of(table, facts, "time") is not None,
        f"{table.name}: recording.times=ignore needs the sampling rate: give "
        "recording.sample_rate_hz=...",
    )
    refuse(
        facts.get("sample_rate_hz") is None,
        f"{table.name}: no column of times is recognised among "
        f"{listing(table.columns)}: give "
        f"recording.time_column={_typed_column(table, facts, 'time')}, or "
        "recording.sample_rate_hz=...",
    )
    with np.errstate(over="ignore"):  # at so low a rate that the times are refused
        return np.arange(samples) / float(facts["sample_rate_hz"])


def _unit(
    table: ColumnTable,
    facts: Mapping[str, Any],
    column: str,
    quantity: Quantity,
    units: Mapping[str, int],
) -> str:
    """A column's unit, one of `units`, which nothing that is stated contradicts."""
    unit, source = unit_of(table, facts, column, quantity)
    stated, key = facts.get(f"{quantity}_unit"), f"recording.{quantity}_unit"
    its, listed = f"{table.name}: the unit of column {column!r}", ", ".join(units)
    written = written_unit(table, column)
    refuse(
        unit is None and written is not None,
        f"{its} is {written}, which is none of {listed}: convert the column, or give "
        f"{key}=... if it is one of them by another name.",
    )
    if two := units_that_differ(table, column, units):
        raise BadInput(
            f"{its} is {two[0]} by its name and {two[1]} by the file: correct one of them."
        )
    refuse(unit is None, f"{its} is not stated: give it by {key}=..., one of {listed}.")
    # recording.time_unit is that of a bare column, which boards' settings state for all files.
    refuse(
        stated not in (None, unit) and quantity != "time",
        f"{its} is {unit} by {source}, but {key} is {stated}: leave {key} out, or "
        "rename the column if its name is wrong.",
    )
    return str(unit)


def _within_reports(table: ColumnTable, column: str | None) -> ColumnTable:
    """The table from the first row that reports a position to the last, where these are enough; as
    it is where columns differ in length."""
    if column is None or column not in table.columns or not is_reported(table.finite(column)):
        return table
    at = np.flatnonzero(np.isfinite(table.finite(column)))
    first, last = int(at[0]), int(at[-1])
    size = table.columns[column].size
    if last - first == size - 1 or any(v.size != size for v in table.columns.values()):
        return table
    rows = [table.row_of(row) for row in range(first, last + 1)]
    note = (
        f"Data rows before {rows[0]} and after {rows[-1]} are left out, as {quoted(column)} is "
        "empty there."
    )
    columns = {name: values[first : last + 1] for name, values in table.columns.items()}
    return replace(table, columns=columns, rows=rows, notes=[*table.notes, note])


def _positions(
    table: ColumnTable, column: str, time_s: Float[np.ndarray, " sample"], notes: list[str]
) -> Float[np.ndarray, " row"]:
    """A column of positions without the wraps of a counter, interpolated between its reports where
    other rows are empty."""
    values = table.finite(column)
    at = np.flatnonzero(np.isfinite(values))
    can_be_filled = (
        is_reported(values)
        and at[-1] - at[0] == values.size - 1 == time_s.size - 1
        and bool(np.all(np.diff(time_s) > 0))
    )
    values = table.numbers(column, allow_missing=can_be_filled)
    if not can_be_filled:
        return _unwrapped(table, column, values, range(values.size), notes)
    notes.append(
        f"{quoted(column)} is reported in {at.size} of {values.size} data rows, at most "
        f"{np.max(np.diff(at))} apart: it is interpolated from report to report."
    )
    return interpolated(
        time_s[at], _unwrapped(table, column, values[at], at.tolist(), notes), time_s
    )


def _unwrapped(
    table: ColumnTable,
    column: str,
    values: Float[np.ndarray, " row"],
    at: Sequence[int],
    notes: list[str],
) -> Float[np.ndarray, " row"]:
    """The times or positions of a column's rows `at`, from 0, without the wraps of a counter."""
    found = unwrapped(values)
    if found.bits:
        rows = ", ".join(str(table.row_of(at[row])) for row in found.rows[:3])
        notes.append(
            f"{quoted(column)} begins anew at data row {rows}, as a counter of {found.bits} bits "
            "does: it is continued there."
        )
    return found.values


def _motion(
    table: ColumnTable,
    facts: Mapping[str, Any],
    time_s: Float[np.ndarray, " sample"],
    notes: list[str],
    doubted: list[str],
) -> dict[str, Float[np.ndarray, " _"]]:
    """The measured speed [m/s] and position [m], as far as the file has them."""
    motion = {}
    quantities: tuple[tuple[str, Quantity, Mapping[str, int]], ...] = (
        (SPEED, "speed", PER_M_PER_S),
        (POSITION, "position", PER_M),
    )
    for key, quantity, per_si in quantities:
        column = column_of(table, facts, quantity)
        if column is not None:
            unit = _unit(table, facts, column, quantity, per_si)
            is_speed = key == SPEED
            raw = table.numbers(column) if is_speed else _positions(table, column, time_s, notes)
            motion[key] = raw / per_si[unit]
    if POSITION in motion and (held := between_reports(motion[POSITION])) is not None:
        motion[POSITION] = held.position_m
        said = (
            f"The position is reported at every {held.interval}th sample and held in between: it "
            "is interpolated from report to report"
        )
        if held.may_be_counts:
            doubted.append(
                f"{said}. All steps are equal: if they are an encoder's counts and no reports, the "
                "positions are off by half a step; record the encoder with finer counts."
            )
        else:
            notes.append(f"{said}.")
    return motion


def _speed_m_per_s(
    table: ColumnTable, facts: Mapping[str, Any], columns: Mapping[str, Float[np.ndarray, " _"]]
) -> Float[np.ndarray, " sample"]:
    if SPEED in columns:
        return columns[SPEED]
    if POSITION in columns:
        return speed_of_positions(table.name, columns[TIME], columns[POSITION])
    column = next((c for c in table.columns if quantity_of(table, c) == "position"), None)
    no_unit = f", and the unit of column {quoted(column)} is not stated" if column else ""
    refuse(
        facts.get(SPEED) is None,
        f"{table.name}: no column of speeds or positions is recognised among "
        f"{listing(table.columns)}{no_unit}: give "
        f"recording.position_column={_typed_column(table, facts, 'position')} and its "
        f"unit, recording.position_unit, or recording.{SPEED}=...",
    )
    return np.full(columns[TIME].size, float(facts[SPEED]))


def _typed_column(table: ColumnTable, facts: Mapping[str, Any], quantity: Quantity) -> str:
    """The one column that its unit shows to be a quantity's, as it is typed; dots where none is, or
    several are."""
    column = unnamed_columns(table, facts).get(f"{quantity}_column")
    if column is None:
        return "..."
    words = bracketed(column)[0]
    bare = words if resolve(table, words) == column else column
    return bare if bare.isascii() and bare.isidentifier() else f"'{bare}'"


def _check_lengths(table: ColumnTable, columns: Mapping[str, np.ndarray]) -> None:
    lengths = listing(f"{column} {values.size}" for column, values in columns.items())
    refuse(
        len({values.size for values in columns.values()}) > 1,
        f"{table.name}: the columns differ in length ({lengths}): give each the same number of "
        "samples.",
    )


def _signal(
    table: ColumnTable,
    facts: Mapping[str, Any],
    channels: tuple[str, ...],
    values: list[Float[np.ndarray, " sample"]],
) -> tuple[tuple[str, ...], Float[np.ndarray, "element sample"], str]:
    """The channels' names, their signals corrected for polarity and gain, and their unit."""
    stated = [signal_unit(table, facts, channel) or "counts" for channel in channels]
    for channel in channels:
        two = units_that_differ(table, channel, PER_V)
        if two and facts.get("signal_unit") is None:
            raise BadInput(
                f"{table.name}: the unit of column {channel!r} is {two[0]} by its name and "
                f"{two[1]} by the file: correct one of them, or give recording.signal_unit=..."
            )
    names = tuple(map(in_volts, channels, stated))
    per_unit = np.array([PER_V.get(unit, 1) for unit in stated])
    gain = per_channel(table.name, facts, "gain", len(channels))
    polarity = per_channel(table.name, facts, "polarity", len(channels))
    converted = np.isfinite(gain)
    _check_scaling(table, channels, bool(converted.all()))
    gain, polarity = np.where(converted, gain, 1.0), np.nan_to_num(polarity, nan=1.0)
    signal = np.stack(values)
    with np.errstate(over="ignore"):  # in place: a long recording fits into memory a few times
        signal /= per_unit[:, None]
        signal *= polarity[:, None]
        signal /= gain[:, None]
    is_volt = [unit in PER_V or bool(by) for unit, by in zip(stated, converted, strict=True)]
    units = {"V" if volt else unit for unit, volt in zip(stated, is_volt, strict=True)}
    return names, signal, units.pop() if len(units) == 1 else "counts"


def _check_scaling(table: ColumnTable, channels: tuple[str, ...], has_gain: bool) -> None:
    """Refuse a gain, a scale or an offset that the file states, and that is not applied, unless the
    experimenter states the gain."""
    stated = [f"a gain of {table.gains[c]:g} for {quoted(c)}" for c in channels if c in table.gains]
    stated += [f"{key} {echo(value)}" for key, value in table.scaling.items()]
    refuse(
        bool(stated) and not has_gain,
        f"{table.name}: the file states {listing(stated)}, but not whether it is "
        "applied: give recording.gain=..., the recorded units per volt of the film's "
        "amplifier.",
    )


def per_channel(
    name: str, facts: Mapping[str, Any], key: str, channels: int
) -> Float[np.ndarray, " element"]:
    """A fact that is one number, or one for each channel; NaN where it is not given."""
    given = facts.get(key)
    listed = given if isinstance(given, list | tuple) else [given] * channels
    refuse(
        len(listed) != channels,
        f"{name}: {key} lists {len(listed)} numbers for {channels} signal columns: give one number "
        "for all, or one for each.",
    )
    return np.array([np.nan if number is None else float(number) for number in listed])
