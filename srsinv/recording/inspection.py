"""Inspection of a file without the facts that `load` requires: guesses are marked as such."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from srsinv.errors import LARGEST, BadInput, refuse

from ..files import path_of, within_memory
from ._columns import (
    Quantity,
    column_of,
    quantity_of,
    signal_columns,
    signal_unit,
    unit_of,
    unnamed_columns,
    written_unit,
)
from ._doubts import samples_per_depth
from ._health import (
    SHORTEST,
    ClippedSamples,
    SignalSpectrum,
    clipping,
    quantisation_step,
    segment_length,
    spectrum,
)
from ._read import MISSING, TIMES_OF_ROWS, read_facts, recording_of_table
from ._recording import SPEED, Recording
from ._sidecar import Sidecars
from ._table import ColumnTable, listing
from ._timing import Timing, timing
from ._units import PER_M, PER_M_PER_S, PER_S, PER_V
from .disturbances import Disturbances, disturbances
from .even import usable
from .formats import BY_SUFFIX
from .reader import Reader, take_table

Role = Literal["time", "speed", "position", "signal", "other"]
UNKNOWN = "not stated"
_NO_UNIT = "neither the name nor the file states one"
_FEW_TICKS = 100  # whole time stamps this close together are milliseconds: 10 Hz and faster


@dataclass(frozen=True)
class Column:
    """One column: its inferred role, and its numbers in its own unit (None: it has none)."""

    name: str
    role: Role
    unit: str
    reason: str
    samples: int = 0
    missing: int = 0
    least: float | None = None
    greatest: float | None = None
    mean: float | None = None
    rms: float | None = None


@dataclass(frozen=True, eq=False)
class Signal:
    """One signal (sample,), in V where its unit is one of voltage, NaN where a sample is missing or
    beyond `LARGEST` of the column's unit.

    `polarity` and `gain` of the sidecar are not applied.
    """

    values: Float[np.ndarray, " sample"]
    unit: str
    clipping: ClippedSamples
    step: float | None
    spectrum: SignalSpectrum | None


@dataclass(frozen=True, eq=False)
class Inspection:
    """Contents of the file `name`.

    - `time_s`: (sample,) stamps [s] where their unit is determined, else None; `timing` their
      evenness, `time_unit` the unit assumed, `time_source` its origin.
    - `rate_hz`: from the stamps, or stated; None without either.
    - `speed_m_per_s`, `position_m`: (sample,) where a column states them.
    - `facts`: those of the sidecar and the caller.
    - `refusal`: the sentence by which `load` refuses the file; None: it takes it as it is;
      `overrides`: the settings with which it would take it all the same.
    - `notes`: what is done while the file is read; `doubts`: what is improbable in it, so that no
      answer from it is sure; both in sentences.
    - `disturbances`: hum, drift and turns of the recording as it is taken so; None where it is not.
    """

    name: str
    columns: tuple[Column, ...]
    time_s: Float[np.ndarray, " sample"] | None
    timing: Timing | None
    time_unit: str | None
    time_source: str
    rate_hz: float | None
    signals: dict[str, Signal]
    speed_m_per_s: Float[np.ndarray, " _"] | None
    position_m: Float[np.ndarray, " _"] | None
    facts: dict[str, Any]
    refusal: str | None = None
    overrides: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    disturbances: Disturbances | None = None

    @property
    def mean_speed_m_per_s(self) -> float | None:
        """The scan's mean speed [m/s] while it slides, measured or stated."""
        if self.disturbances is not None:
            return self.disturbances.speed_m_per_s
        if self.speed_m_per_s is not None and np.isfinite(self.speed_m_per_s).any():
            return float(np.nanmean(self.speed_m_per_s))
        return self.facts.get(SPEED)

    def of_role(self, role: Role) -> list[Column]:
        """The columns of a role, in the file's order."""
        return [column for column in self.columns if column.role == role]


def inspect(
    path: str | os.PathLike[str],
    *,
    reader: Reader = BY_SUFFIX,
    sidecar: str | os.PathLike[str] | None = None,
    calibration: str | os.PathLike[str] | None = None,
    missing: str = MISSING[0],
    times: str = TIMES_OF_ROWS[0],
    **known: Any,
) -> Inspection:
    """Look at the file `path`, in any format of `load`, whose arguments these are.

    Raises `BadInput` for a file that cannot be read or has no column of numbers, for an invalid
    sidecar, and for `channels` that are absent.
    """
    path = path_of(path, "recording.path")
    with within_memory(path):
        table = take_table(path, reader)
        given = Sidecars(sidecar, calibration)
        taken = _taken(path, table, given, missing, times, known)
        inspection = _inspect(path, table, given, known)
        if isinstance(taken, Recording):
            return _with(inspection, taken)
        try:
            named = unnamed_columns(table, inspection.facts)
        except BadInput:  # the table is refused for something else
            named = {}
        if named:
            inspection = _inspect(path, table, given, known | named)
        refusal, unit = taken, {}
        if inspection.time_unit is not None:
            unit = {"time_unit": inspection.time_unit}
        for allowed, more in ((False, {}), (True, {}), (False, unit), (True, unit)):
            how, stated = "allow" if allowed else missing, named | more
            taken = _taken(path, table, given, how, times, known | stated)
            if isinstance(taken, Recording):
                words = ["recording.missing=allow"] * allowed
                words += [f"recording.{key}={_typed(value)}" for key, value in stated.items()]
                found = replace(inspection, refusal=refusal, overrides=tuple(words))
                return _with(found, taken)
        return replace(inspection, refusal=refusal)


def _with(inspection: Inspection, taken: Recording) -> Inspection:
    """The inspection with what the recording shows once it is read."""
    coarse = samples_per_depth(taken)
    return replace(
        inspection,
        notes=taken.notes,
        doubts=taken.doubts + ((coarse,) if coarse else ()),
        disturbances=disturbances(taken),
    )


def _typed(value: Any) -> str:
    """A fact as it is typed: a unit as it is, a column's name in quotation marks."""
    text = str(value)
    return text if text.isidentifier() else json.dumps(text, ensure_ascii=False)


def _taken(path: Path, table: ColumnTable, *settings: Any) -> Recording | str:
    """The recording at even times as `load` takes it, or the sentence by which it refuses it."""
    try:
        return usable(recording_of_table(path, table, *settings))
    except BadInput as refusal:
        return str(refusal)


def _inspect(
    path: Path,
    table: ColumnTable,
    sidecar: Sidecars,
    known: Mapping[str, Any],
) -> Inspection:
    facts = read_facts(path, table, sidecar, known)
    if _motion_column(table, facts, "time"):
        table = table.without_blank_rows()
    refuse(
        not any(np.isfinite(table.finite(name)).any() for name in table.columns),
        f"{path.name}: no column holds a number, among {listing([*table.columns, *table.unusable])}"
        ": store each quantity as a column of real numbers.",
    )
    signals = _shown_signals(table, facts)
    roles = _roles_of(table, facts, signals)
    columns = tuple(_described_column(table, facts, name, roles) for name in table)
    time_s, unit, source = _time(table, facts, roles)
    stamps = None if time_s is None else timing(time_s)
    stated_hz = facts.get("sample_rate_hz")
    if stamps is not None:
        rate_hz = stamps.rate_hz
    else:
        rate_hz = None if stated_hz is None else float(stated_hz)
    return Inspection(
        name=path.name,
        columns=columns,
        time_s=time_s,
        timing=stamps,
        time_unit=unit,
        time_source=source,
        rate_hz=rate_hz,
        signals=_signals(table, facts, signals, rate_hz),
        speed_m_per_s=_measured(table, facts, "speed", roles, PER_M_PER_S),
        position_m=_measured(table, facts, "position", roles, PER_M),
        facts=facts,
    )


def _time(
    table: ColumnTable, facts: Mapping[str, Any], roles: Mapping[str, Role]
) -> tuple[Float[np.ndarray, " sample"] | None, str | None, str]:
    """The stamps [s], their unit, and its origin."""
    name = next((name for name, role in roles.items() if role == "time"), None)
    if name is None or name in table.unusable:
        return None, None, "no column of times"
    unit, reason = _time_unit_or_guess(table, facts, name)
    if unit == UNKNOWN:
        return None, None, f"column {name}: {reason}"
    return table.finite(name, LARGEST) / PER_S[unit], unit, f"column {name} in {unit} ({reason})"


def _measured(
    table: ColumnTable,
    facts: Mapping[str, Any],
    quantity: Quantity,
    roles: Mapping[str, Role],
    per_si: Mapping[str, int],
) -> Float[np.ndarray, " _"] | None:
    """The file's speeds or positions, in SI units."""
    column = next((name for name, role in roles.items() if role == quantity), None)
    unit = None if column is None else unit_of(table, facts, column, quantity)[0]
    if column is None or unit is None or column in table.unusable:
        return None
    return table.finite(column, LARGEST) / per_si[unit]


def _signals(
    table: ColumnTable, facts: Mapping[str, Any], names: tuple[str, ...], rate_hz: float | None
) -> dict[str, Signal]:
    signals = {}
    values = {name: table.finite(name, LARGEST) for name in names if name in table.columns}
    # One for all, so that the spectra share their frequencies.
    sizes = [v.size for v in values.values() if v.size >= SHORTEST]
    segment = segment_length(min(sizes, default=SHORTEST))
    for name, raw in values.items():
        unit = _unit_and_reason(table, facts, name, "signal", raw[np.isfinite(raw)])[0]
        signal = raw / PER_V.get(unit, 1)
        signals[name] = Signal(
            values=signal,
            unit="V" if unit in PER_V else unit,
            clipping=clipping(signal),
            step=quantisation_step(signal),
            # Without a rate, frequencies are in cycles a sample.
            spectrum=spectrum(signal, rate_hz or 1.0, segment),
        )
    return signals


def _shown_signals(table: ColumnTable, facts: Mapping[str, Any]) -> tuple[str, ...]:
    """Signal columns as `load` chooses them; else all that are no time, speed or position."""
    try:
        channels = signal_columns(table, facts)
    except BadInput:
        if facts.get("channels") is not None:
            raise
        numeric = [name for name in table.columns if np.isfinite(table.finite(name)).any()]
        return tuple(name for name in numeric if quantity_of(table, name) is None)
    if facts.get("channels") is not None:
        for channel in channels:
            table.check_usable(channel)
    return channels


def _motion_column(table: ColumnTable, facts: Mapping[str, Any], quantity: Quantity) -> str | None:
    """The column that `load` takes, or None where several may be it; raises `BadInput` for one that
    is stated and absent."""
    try:
        return column_of(table, facts, quantity)
    except BadInput:
        if facts.get(f"{quantity}_column") is not None:
            raise
        return None


def _roles_of(
    table: ColumnTable, facts: Mapping[str, Any], signals: tuple[str, ...]
) -> dict[str, Role]:
    """What `load` takes each column for; those that it leaves out are not named."""
    roles: dict[str, Role] = dict.fromkeys(signals, "signal")
    for quantity in get_args(Quantity):
        if (column := _motion_column(table, facts, quantity)) is not None:
            roles[column] = quantity
    return roles


def _described_column(
    table: ColumnTable, facts: Mapping[str, Any], name: str, roles: Mapping[str, Role]
) -> Column:
    """A column with its role, its unit and its numbers."""
    if name in table.unusable:
        return Column(name, "other", UNKNOWN, table.unusable[name])
    values = table.finite(name)
    present = values[np.isfinite(values)]
    if not present.size:
        return Column(name, "other", UNKNOWN, "no numbers", values.size, values.size)
    role = roles.get(name, "other")
    unit, reason = _unit_and_reason(table, facts, name, role, present)
    # By a power of two, which rounds nothing: sums and squares may leave float64's range.
    size = float(np.ldexp(0.5, np.frexp(np.max(np.abs(present)))[1]))
    scaled = present / size if size > 0 else present
    return Column(
        name,
        role,
        unit,
        reason,
        values.size,
        values.size - present.size,
        float(present.min()),
        float(present.max()),
        size * float(scaled.mean()),
        size * float(np.sqrt(np.mean(scaled**2))),
    )


def _unit_and_reason(
    table: ColumnTable, facts: Mapping[str, Any], name: str, role: Role, present: np.ndarray
) -> tuple[str, str]:
    """A column's unit and why."""
    if role == "time":
        return _time_unit_or_guess(table, facts, name)
    if role == "speed" or role == "position":
        unit, reason = unit_of(table, facts, name, role)
        return (unit.replace("_per_", "/"), reason) if unit else (UNKNOWN, _NO_UNIT)
    if role == "signal":
        if facts.get("signal_unit"):
            return str(facts["signal_unit"]), "stated as signal_unit"
        if unit := signal_unit(table, facts, name):
            return unit, "stated in the file" if name in table.units else "the column's name"
        if np.all(present == np.round(present)):
            return "counts", "whole numbers only: a converter's raw counts"
        return UNKNOWN, _NO_UNIT
    quantity = quantity_of(table, name)
    unit = written_unit(table, name) or UNKNOWN
    if not quantity:
        return unit, "in no unit of voltage, and not called a channel: not taken for a signal"
    if unit == UNKNOWN:
        return unit, f"its name is of a {quantity}, and its unit is not stated: left out"
    return unit, f"its name is of a {quantity}, and another was taken, or several may be: left out"


def _time_unit_or_guess(table: ColumnTable, facts: Mapping[str, Any], name: str) -> tuple[str, str]:
    """The unit of a column of times and why; a guess by its values where nobody states it."""
    unit, source = unit_of(table, facts, name, "time")
    if unit is not None:
        return unit, source
    if written_unit(table, name) is not None:
        return UNKNOWN, f"its unit {written_unit(table, name)} is none of {', '.join(PER_S)}"
    stamps = timing(table.finite(name, LARGEST))
    if stamps is None:
        return UNKNOWN, "the stamps do not increase"
    tick = 1 / stamps.rate_hz
    values = table.finite(name)
    if np.any(values != np.round(values), where=np.isfinite(values)):
        return "s", f"a guess: stamps {tick:.3g} apart, not whole numbers"
    if tick < _FEW_TICKS:
        return "ms", f"a guess: whole numbers {tick:.3g} apart"
    return "us", f"a guess: whole numbers as far as {tick:.3g} apart"
