"""Reading of a `Recording` from a file and its sidecar."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from srsinv.errors import BadInput, choice, refuse

from ._ahead import store, take_table
from ._even_times import check_rate
from ._guard import path_of, within_memory
from ._recording import POSITION, SPEED, TIME, Recording, check_range, check_samples, check_times
from ._schema import RecordingFacts, check_facts
from ._sidecar import check_elements, merge, read_sidecar
from ._table import ColumnTable, listing
from ._units import PER_S, PER_V, POSITIONS, SPEEDS, TIMES, UNITLESS_TIMES, in_volts, unit_of_name
from .formats import BY_SUFFIX
from .reader import Reader

_VOLTAGE = re.compile(rf"voltage_(0|[1-9]\d*)_({'|'.join(PER_V)})")
# Facts on the file that are in the Recording's own fields once it is read.
_LAYOUT = ("time_unit", "channels", "signal_unit", "polarity", "gain")
_QUINTIC = 5
MISSING = ("refuse", "allow")  # treatment of an empty cell, the default first
TIMES_OF_ROWS = ("use", "ignore")  # treatment of a column of times


def load(
    path: str | os.PathLike[str],
    *,
    reader: Reader = BY_SUFFIX,
    sidecar: str | os.PathLike[str] | None = None,
    missing: str = MISSING[0],
    times: str = TIMES_OF_ROWS[0],
    **known: Any,
) -> Recording:
    """The recording in `path`: CSV (.csv, .txt, .tsv), NPZ, HDF5 (.h5, .hdf5), netCDF (.nc), MATLAB
    5 or 7.3 (.mat), WAV or TDMS (the last with `pip install srsinv[tdms]`); or what `reader` reads.

    Columns (1-D, of equal length; in MATLAB row or column vectors):
    - time: `time_s`, `time_ms` or `time_us`; or `time`, `timestamp` or `t` with the file's own unit
      or `time_unit`; or none, with `sample_rate_hz`, which WAV and TDMS may hold themselves. Beside
      times, `sample_rate_hz` has to agree with them, and changes nothing.
    - speed: `speed_m_per_s` or `speed_mm_per_s`; or none, with a position or the number
      `speed_m_per_s`.
    - position: `position_m`, `position_mm` or `position_um`, or none. Without a speed column the
      speed is the derivative of the quintic spline through the positions (of lower degree for
      fewer than six samples), which follows every rounding of them: a measured speed is better.
    - signals: `voltage_0_V`, `voltage_1_mV`, ... in the order of their numbers; or those that
      `channels` lists; or all that is left in WAV (`channel_0`, ...) and TDMS.

    `sidecar` names a JSON or YAML mapping of further facts; without it NAME.json, NAME.yaml or
    NAME.yml beside the file is read if it is there. `known` holds facts too (None: not given) and
    overrides the sidecar, in depth, and the file's speed and position.

    A signal's unit is `signal_unit`, or the file's own, or that of its column's name, or else
    "counts"; values in mV or uV are converted to V. It is multiplied by `polarity` (1 or -1) and
    divided by `gain`, each one number or one for each channel; a gain is in the signal's unit per
    volt, so that the result is in V whatever that unit is.

    `missing="allow"` takes an empty cell of a signal (NaN in an array) for a missing sample, NaN in
    the result; by default it is refused. `times="ignore"` leaves a column of times out, for stamps
    that are wrong: the rows are taken as even at `sample_rate_hz`, none missing. Raises `BadInput`
    for files that cannot be read as such a recording.
    """
    path = path_of(path, "recording.path")
    choice(f"{path.name}: recording.missing", missing, MISSING)
    choice(f"{path.name}: recording.times", times, TIMES_OF_ROWS)
    with within_memory(path):
        return _load(path, take_table(path, reader), sidecar, missing, times, known)


def _load(
    path: Path,
    table: ColumnTable,
    sidecar: str | os.PathLike[str] | None,
    missing: str,
    times: str,
    known: Mapping[str, Any],
) -> Recording:
    facts = read_facts(path, table, sidecar, known)
    channels = choose_channels(table, facts)
    check_elements(path.name, facts, channels)
    columns = {c: table.numbers(c, allow_missing=missing == "allow") for c in channels}
    samples = columns[channels[0]].size
    column = time_column(table) if times == "use" else None
    columns[TIME] = _time_s(table, facts, column, samples)
    if known.get(SPEED) is None:
        columns |= _motion(table)
    _check_lengths(table, columns)
    check_samples(path.name, samples)
    check_times(path.name, columns[TIME])
    for quantity in {SPEED, POSITION} & columns.keys():
        check_range(path.name, quantity, columns[quantity])
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
    )


def check_settings(settings: Mapping[str, Any], reader: Reader = BY_SUFFIX) -> None:
    """Refuse settings of a recording (`path`, `sidecar` and facts) that name no readable table or
    state invalid facts. Columns are not checked: not every job needs the same ones."""
    path = path_of(settings["path"], "recording.path")
    known = {key: value for key, value in settings.items() if key in RecordingFacts.model_fields}
    with within_memory(path):
        table = take_table(path, reader)
        read_facts(path, table, settings.get("sidecar"), known)
    store(path, reader, table)


def read_facts(
    path: Path, table: ColumnTable, sidecar: str | os.PathLike[str] | None, known: Mapping[str, Any]
) -> dict[str, Any]:
    """Facts beside the columns: from the file's own sidecar, the one beside it, and `known`."""
    given = None if sidecar is None else path_of(sidecar, "recording.sidecar")
    facts = merge(merge(table.sidecar, read_sidecar(path, given)), _with_listed_elements(known))
    check_facts(path.name, facts)
    return facts


def _with_listed_elements(known: Mapping[str, Any]) -> dict[str, Any]:
    """`known`, film elements that a configuration has by name in their order."""
    sensor = known.get("sensor")
    elements = sensor.get("elements") if isinstance(sensor, Mapping) else None
    if not isinstance(sensor, Mapping) or not isinstance(elements, Mapping):
        return dict(known)
    return {**known, "sensor": {**sensor, "elements": list(elements.values())}}


def choose_channels(table: ColumnTable, facts: Mapping[str, Any]) -> tuple[str, ...]:
    """The columns that are the signals, in order."""
    chosen = facts.get("channels")
    if chosen is not None:
        return (chosen,) if isinstance(chosen, str) else tuple(chosen)
    # An unusable one too: it is refused, as leaving it out would be silent.
    named = [*table.columns, *table.unusable]
    voltages = [(int(m[1]), c) for c in named if (m := _VOLTAGE.fullmatch(c))]
    refuse(
        not voltages and not table.signals,
        f"{table.name}: there is no column voltage_0_V, voltage_1_V, ... among the columns "
        f"{listing(table.columns)}: name the signals by recording.channels=[...].",
    )
    return tuple(column for _, column in sorted(voltages)) or tuple(table.signals)


def _time_s(
    table: ColumnTable, facts: Mapping[str, Any], column: str | None, samples: int
) -> Float[np.ndarray, " sample"]:
    if column is not None:
        return table.numbers(column) / PER_S[_time_unit(table, facts, column)]
    refuse(
        facts.get("sample_rate_hz") is None and time_column(table) is not None,
        f"{table.name}: recording.times=ignore leaves the times out: give "
        "recording.sample_rate_hz=...",
    )
    refuse(
        facts.get("sample_rate_hz") is None,
        f"{table.name}: there is no time column (time_s, time_ms or time_us) among the columns "
        f"{listing(table.columns)}: add one or give recording.sample_rate_hz=...",
    )
    with np.errstate(over="ignore"):  # at so low a rate that the times are refused
        return np.arange(samples) / float(facts["sample_rate_hz"])


def time_column(table: ColumnTable) -> str | None:
    """The column of times, those first whose name states the unit."""
    return next((column for column in (*TIMES, *UNITLESS_TIMES) if column in table), None)


def stated_time_unit(table: ColumnTable, facts: Mapping[str, Any], column: str) -> str | None:
    """The unit of a column of times, as its name, the experimenter or the file has it."""
    if column in TIMES:
        return column.removeprefix("time_")
    return facts.get("time_unit") or table.units.get(column)


def _time_unit(table: ColumnTable, facts: Mapping[str, Any], column: str) -> str:
    unit = stated_time_unit(table, facts, column)
    refuse(
        unit not in list(PER_S),
        f"{table.name}: the unit of column {column!r} is {unit or 'not stated'}: give it by "
        f"recording.time_unit=..., one of {', '.join(PER_S)}.",
    )
    return str(unit)


def _motion(table: ColumnTable) -> dict[str, Float[np.ndarray, " _"]]:
    """The measured speed [m/s] and position [m], as far as the file has them."""
    motion = {}
    for quantity, names in ((SPEED, SPEEDS), (POSITION, POSITIONS)):
        column = next((name for name in names if name in table), None)
        if column is not None:
            motion[quantity] = table.numbers(column) / names[column]
    return motion


def _speed_m_per_s(
    table: ColumnTable, facts: Mapping[str, Any], columns: Mapping[str, Float[np.ndarray, " _"]]
) -> Float[np.ndarray, " sample"]:
    if SPEED in columns:
        return columns[SPEED]
    if POSITION in columns:
        return _derivative(table.name, columns[TIME], columns[POSITION])
    refuse(
        facts.get(SPEED) is None,
        f"{table.name}: no speed: there is no column {SPEED} or {POSITION} among the columns "
        f"{listing(table.columns)}: add one or give recording.{SPEED}=...",
    )
    return np.full(columns[TIME].size, float(facts[SPEED]))


def _derivative(
    name: str, time_s: Float[np.ndarray, " sample"], position_m: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, " sample"]:
    """Speed [m/s] along the spline through the positions."""
    # From the first time on: far from zero the knots would lose digits.
    since_s = time_s - time_s[0]
    steps_m = np.diff(position_m)
    if np.ptp(position_m) <= 2 * np.spacing(np.max(np.abs(position_m))):
        return np.zeros_like(time_s)  # at rest: differences are rounding
    try:
        with np.errstate(all="ignore"):
            degree = min(_QUINTIC, time_s.size - 1)
            spline = scipy.interpolate.make_interp_spline(since_s, position_m, degree)
            speed = np.asarray(spline.derivative()(since_s))
            goes_one_way = bool(np.all(steps_m >= 0) or np.all(steps_m <= 0))
            if goes_one_way and np.ptp(np.sign(speed)) > 1:
                # The spline overshoots at a start or a stop; a monotone curve does not.
                speed = scipy.interpolate.pchip_interpolate(since_s, position_m, since_s, der=1)
            return speed
    except (ValueError, np.linalg.LinAlgError) as error:
        raise BadInput(
            f"{name}: no speed can be derived from the positions at these times, as some are too "
            f"close together: add a column {SPEED} or give recording.{SPEED}=..."
        ) from error


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
    names = tuple(map(in_volts, channels, stated))
    per_unit = np.array([PER_V.get(unit, 1) for unit in stated])
    gain = _per_channel(table.name, facts, "gain", len(channels))
    polarity = _per_channel(table.name, facts, "polarity", len(channels))
    converted = np.isfinite(gain)
    gain, polarity = np.where(converted, gain, 1.0), np.nan_to_num(polarity, nan=1.0)
    signal = np.stack(values)
    with np.errstate(over="ignore"):  # in place: a long recording fits into memory a few times
        signal /= per_unit[:, None]
        signal *= polarity[:, None]
        signal /= gain[:, None]
    is_volt = [unit in PER_V or bool(by) for unit, by in zip(stated, converted, strict=True)]
    units = {"V" if volt else unit for unit, volt in zip(stated, is_volt, strict=True)}
    return names, signal, units.pop() if len(units) == 1 else "counts"


def signal_unit(table: ColumnTable, facts: Mapping[str, Any], column: str) -> str | None:
    """The unit of a signal's column, as the experimenter, the file or its name has it."""
    return facts.get("signal_unit") or table.units.get(column) or unit_of_name(column)


def _per_channel(
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
