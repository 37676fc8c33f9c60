"""Inspection of a file without the facts that `load` requires: guesses are marked as such."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from srsinv.errors import LARGEST, BadInput, refuse

from ._ahead import take_table
from ._guard import path_of, within_memory
from ._health import (
    SHORTEST,
    ClippedSamples,
    SignalSpectrum,
    clipping,
    quantisation_step,
    segment_length,
    spectrum,
)
from ._read import choose_channels, read_facts, stated_time_unit, time_column
from ._recording import SPEED
from ._table import ColumnTable, listing
from ._timing import Timing, timing
from ._units import PER_M, PER_M_PER_S, PER_S, PER_V, POSITIONS, SPEEDS, TIMES, unit_of_name
from .formats import BY_SUFFIX
from .reader import Reader

Role = Literal["time", "speed", "position", "signal", "other"]
UNKNOWN = "not stated"
_NAMES: Mapping[Role, re.Pattern[str]] = {
    "speed": re.compile(r"speed|veloc", re.IGNORECASE),
    "position": re.compile(r"^x$|(^|[ _-])pos(ition)?($|[ _-])|displace|encoder", re.IGNORECASE),
    "signal": re.compile(
        r"^(volt(age)?|ch(an(nel)?)?|ai|adc|sig(nal)?|sensor|taxel|force|pressure)[ _-]?\d*($|_)",
        re.IGNORECASE,
    ),
}
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

    @property
    def mean_speed_m_per_s(self) -> float | None:
        """The scan's mean speed [m/s], measured or stated."""
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
    **known: Any,
) -> Inspection:
    """Look at the file `path`, in any format of `load`, whose arguments these are.

    Raises `BadInput` for a file that cannot be read or has no column of numbers, for an invalid
    sidecar, and for `channels` that are absent.
    """
    path = path_of(path, "recording.path")
    with within_memory(path):
        return _inspect(path, take_table(path, reader), sidecar, known)


def _inspect(
    path: Path,
    table: ColumnTable,
    sidecar: str | os.PathLike[str] | None,
    known: Mapping[str, Any],
) -> Inspection:
    facts = read_facts(path, table, sidecar, known)
    refuse(
        not any(np.isfinite(table.finite(name)).any() for name in table.columns),
        f"{path.name}: no column holds a number, among {listing([*table.columns, *table.unusable])}"
        ": store each quantity as a column of real numbers.",
    )
    signals = _signal_columns(table, facts)
    columns = tuple(
        _column(table, facts, name, signals) for name in [*table.columns, *table.unusable]
    )
    time_s, unit, source = _time(table, facts)
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
        speed_m_per_s=_stated(table, SPEEDS),
        position_m=_stated(table, POSITIONS),
        facts=facts,
    )


def _signal_columns(table: ColumnTable, facts: Mapping[str, Any]) -> tuple[str, ...]:
    """Signal columns as `load` chooses them; else those named like a signal; else all others."""
    if facts.get("channels") is not None:
        channels = choose_channels(table, facts)
        for channel in channels:
            table.check_usable(channel)
        return channels
    try:
        return choose_channels(table, facts)
    except BadInput:
        numeric = [name for name in table.columns if np.isfinite(table.finite(name)).any()]
        left = [name for name in numeric if _role_of_name(table, name) in ("signal", "other")]
        named = [name for name in left if _role_of_name(table, name) == "signal"]
        return tuple(named or left)


def _role_of_name(table: ColumnTable, name: str) -> Role:
    if name == time_column(table) or name in TIMES:
        return "time"
    fitting: list[Role] = [role for role, pattern in _NAMES.items() if pattern.search(name)]
    return fitting[0] if fitting else "other"


def _column(
    table: ColumnTable, facts: Mapping[str, Any], name: str, signals: tuple[str, ...]
) -> Column:
    if name in table.unusable:
        return Column(name, "other", UNKNOWN, table.unusable[name])
    values = table.finite(name)
    present = values[np.isfinite(values)]
    if not present.size:
        return Column(name, "other", UNKNOWN, "no numbers", values.size, values.size)
    role: Role = "signal" if name in signals else _role_of_name(table, name)
    if role == "signal" and name not in signals:
        role = "other"
    unit, reason = _unit(table, facts, name, role, present)
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


def _unit(
    table: ColumnTable, facts: Mapping[str, Any], name: str, role: Role, present: np.ndarray
) -> tuple[str, str]:
    """A column's unit and why."""
    if role == "time":
        return _time_unit(table, facts, name)
    if role == "signal" and facts.get("signal_unit"):
        return str(facts["signal_unit"]), "stated as signal_unit"
    if name in table.units:
        return table.units[name], "stated in the file"
    for quantity, units in (("speed", PER_M_PER_S), ("position", PER_M)):
        unit = name.removeprefix(f"{quantity}_")
        if role == quantity and unit in units:
            return unit.replace("_per_", "/"), "the column's name"
    if unit := unit_of_name(name):
        return unit, "the column's name"
    if role == "signal" and np.all(present == np.round(present)):
        return "counts", "whole numbers only: a converter's raw counts"
    return UNKNOWN, "neither the name nor the file states one"


def _time_unit(table: ColumnTable, facts: Mapping[str, Any], name: str) -> tuple[str, str]:
    unit = stated_time_unit(table, facts, name)
    if unit in PER_S:
        source = "the column's name" if name in TIMES else "stated in the file"
        stated = name not in TIMES and facts.get("time_unit")
        return str(unit), "stated as time_unit" if stated else source
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


def _time(
    table: ColumnTable, facts: Mapping[str, Any]
) -> tuple[Float[np.ndarray, " sample"] | None, str | None, str]:
    """The stamps [s], their unit, and its origin."""
    name = time_column(table)
    if name is None or name in table.unusable:
        return None, None, "no column of times"
    unit, reason = _time_unit(table, facts, name)
    if unit == UNKNOWN:
        return None, None, f"column {name}: {reason}"
    return table.finite(name, LARGEST) / PER_S[unit], unit, f"column {name} in {unit} ({reason})"


def _stated(table: ColumnTable, names: Mapping[str, int]) -> Float[np.ndarray, " _"] | None:
    """The first column of these names, in SI units."""
    column = next((name for name in names if name in table.columns), None)
    return None if column is None else table.finite(column, LARGEST) / names[column]


def _signals(
    table: ColumnTable, facts: Mapping[str, Any], names: tuple[str, ...], rate_hz: float | None
) -> dict[str, Signal]:
    signals = {}
    values = {name: table.finite(name, LARGEST) for name in names if name in table.columns}
    # One for all, so that the spectra share their frequencies.
    sizes = [v.size for v in values.values() if v.size >= SHORTEST]
    segment = segment_length(min(sizes, default=SHORTEST))
    for name, raw in values.items():
        unit = _unit(table, facts, name, "signal", raw[np.isfinite(raw)])[0]
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
