"""The columns of a table as `load` takes them, with their units and why, for who looks at it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from srsinv.errors import LARGEST, BadInput

from ._columns import (
    Quantity,
    column_of,
    quantity_of,
    signal_columns,
    signal_unit,
    unit_of,
    written_unit,
)
from ._table import ColumnTable
from ._timing import timing
from ._units import PER_S

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


def shown_signals(table: ColumnTable, facts: Mapping[str, Any]) -> tuple[str, ...]:
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


def motion_column(table: ColumnTable, facts: Mapping[str, Any], quantity: Quantity) -> str | None:
    """The column that `load` takes, or None where several may be it; raises `BadInput` for one that
    is stated and absent."""
    try:
        return column_of(table, facts, quantity)
    except BadInput:
        if facts.get(f"{quantity}_column") is not None:
            raise
        return None


def roles_of(
    table: ColumnTable, facts: Mapping[str, Any], signals: tuple[str, ...]
) -> dict[str, Role]:
    """What `load` takes each column for; those that it leaves out are not named."""
    roles: dict[str, Role] = dict.fromkeys(signals, "signal")
    for quantity in get_args(Quantity):
        if (column := motion_column(table, facts, quantity)) is not None:
            roles[column] = quantity
    return roles


def described_column(
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
    unit, reason = unit_and_reason(table, facts, name, role, present)
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


def unit_and_reason(
    table: ColumnTable, facts: Mapping[str, Any], name: str, role: Role, present: np.ndarray
) -> tuple[str, str]:
    """A column's unit and why."""
    if role == "time":
        return time_unit_or_guess(table, facts, name)
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


def time_unit_or_guess(table: ColumnTable, facts: Mapping[str, Any], name: str) -> tuple[str, str]:
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
