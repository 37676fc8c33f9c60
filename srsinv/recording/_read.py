"""From a file and its sidecar to a `Recording`."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from srsinv.errors import refuse

from ._recording import SPEED, TIME, Recording
from ._sidecar import check_elements, check_sidecar, merge, read_sidecar
from ._table import Table, listing, read_table

# Divided by, not multiplied with 1e-3: that rounds correctly.
_TICKS_PER_S = {"s": 1, "ms": 1_000, "us": 1_000_000}
_BARE_TIMES = ("time", "timestamp", "t")
_VOLTAGE = re.compile(r"voltage_(0|[1-9]\d*)_V")
# What these say of the file is in the Recording's own fields once it is read.
_LAYOUT = ("time_unit", "channels", "signal_unit")


def load(
    path: str | os.PathLike[str],
    *,
    sidecar: str | os.PathLike[str] | None = None,
    missing: str = "refuse",
    **known: Any,
) -> Recording:
    """The recording in `path`: CSV (.csv, .txt, .tsv), NPZ, HDF5 (.h5, .hdf5) or netCDF (.nc).

    Columns (1-D, of equal length):
    - time: `time_s`, `time_ms` or `time_us`; or `time`, `timestamp` or `t` with the file's own unit
      or `time_unit`; or none, with `sample_rate_hz`.
    - speed: `speed_m_per_s`; or none, with the number `speed_m_per_s`.
    - signals: `voltage_0_V`, `voltage_1_V`, ... in the order of their numbers; or those that
      `channels` lists.

    `sidecar` names a JSON or YAML mapping of further facts; without it NAME.json, NAME.yaml or
    NAME.yml beside the file is read if it is there. `known` holds facts too (None: not given) and
    wins over the sidecar, in depth, and over the file's times and speed. A signal's unit is
    `signal_unit`, or the file's own, or "V" if the columns' names end in _V, or else "counts".

    `missing="allow"` takes an empty cell of a signal (NaN in an array) for a missing sample, NaN in
    the result; by default it is refused. Raises `BadInput` for everything that cannot be read as
    such a recording.
    """
    path = Path(path).expanduser()
    refuse(
        missing not in ("refuse", "allow"),
        f"{path.name}: recording.missing={missing!r} is not known: use refuse or allow.",
    )
    table = read_table(path)
    beside = read_sidecar(path, None if sidecar is None else Path(sidecar).expanduser())
    facts = merge(merge(table.sidecar, beside), known)
    check_sidecar(path.name, facts)
    channels = _channels(table, facts)
    check_elements(path.name, facts, channels)
    columns = {c: table.numbers(c, allow_missing=missing == "allow") for c in channels}
    samples = columns[channels[0]].size
    columns[TIME] = _time_s(table, facts, known, samples)
    columns[SPEED] = _speed_m_per_s(table, facts, known, samples)
    _check_lengths(table, columns)
    return Recording(
        signal=np.stack([columns[c] for c in channels]),
        time_s=columns[TIME],
        speed_m_per_s=columns[SPEED],
        channels=channels,
        sidecar={key: value for key, value in facts.items() if key not in _LAYOUT},
        signal_unit=_signal_unit(table, facts, channels),
        name=path.name,
    )


def _channels(table: Table, facts: Mapping[str, Any]) -> tuple[str, ...]:
    named = facts.get("channels")
    if named is not None:
        listed = [named] if isinstance(named, str) else named
        refuse(
            not isinstance(listed, list | tuple) or not listed,
            f"{table.name}: channels is {named!r} where a list of column names is expected: choose "
            f"from {listing(table.columns)} by recording.channels=[...].",
        )
        return tuple(str(channel) for channel in listed)
    voltages = {int(m[1]): c for c in table.columns if (m := _VOLTAGE.fullmatch(c))}
    refuse(
        not voltages,
        f"{table.name}: there is no column voltage_0_V, voltage_1_V, ... among the columns "
        f"{listing(table.columns)}: name the signals by recording.channels=[...].",
    )
    return tuple(voltages[index] for index in sorted(voltages))


def _time_s(
    table: Table, facts: Mapping[str, Any], known: Mapping[str, Any], samples: int
) -> np.ndarray:
    column = _time_column(table)
    if column is not None and known.get("sample_rate_hz") is None:
        return table.numbers(column) / _TICKS_PER_S[_time_unit(table, facts, column)]
    refuse(
        facts.get("sample_rate_hz") is None,
        f"{table.name}: there is no time column (time_s, time_ms or time_us) among the columns "
        f"{listing(table.columns)}: add one or give recording.sample_rate_hz=...",
    )
    return np.arange(samples) / facts["sample_rate_hz"]


def _time_column(table: Table) -> str | None:
    stated = [f"time_{unit}" for unit in _TICKS_PER_S]
    return next((column for column in (*stated, *_BARE_TIMES) if column in table), None)


def _time_unit(table: Table, facts: Mapping[str, Any], column: str) -> str:
    if column not in _BARE_TIMES:
        return column.removeprefix("time_")
    unit = facts.get("time_unit") or table.units.get(column)
    choices = ", ".join(_TICKS_PER_S)
    refuse(
        unit not in list(_TICKS_PER_S),
        f"{table.name}: the unit of column {column!r} is {unit or 'not stated'}: give it by "
        f"recording.time_unit=..., one of {choices}.",
    )
    return str(unit)


def _speed_m_per_s(
    table: Table, facts: Mapping[str, Any], known: Mapping[str, Any], samples: int
) -> np.ndarray:
    if SPEED in table and known.get(SPEED) is None:
        return table.numbers(SPEED)
    refuse(
        facts.get(SPEED) is None,
        f"{table.name}: no speed: there is no column {SPEED} among the columns "
        f"{listing(table.columns)}: add one or give recording.{SPEED}=...",
    )
    return np.full(samples, facts[SPEED])


def _check_lengths(table: Table, columns: Mapping[str, np.ndarray]) -> None:
    lengths = ", ".join(f"{column} {values.size}" for column, values in columns.items())
    refuse(
        len({values.size for values in columns.values()}) > 1,
        f"{table.name}: the columns differ in length ({lengths}): give each the same number of "
        "samples.",
    )


def _signal_unit(table: Table, facts: Mapping[str, Any], channels: tuple[str, ...]) -> str:
    units = {table.units.get(channel) for channel in channels}
    in_file = units.pop() if len(units) == 1 else None
    by_name = "V" if all(channel.endswith("_V") for channel in channels) else "counts"
    return str(facts.get("signal_unit") or in_file or by_name)
