"""Which column of a table is what: time, speed, position along x, and the signals.

By the experimenter's word, else by the column's name and unit. The one place that decides it:
`load` and `inspect` both go by it.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from srsinv.errors import echo, refuse

from ._table import ColumnTable, listing
from ._units import (
    PER_M,
    PER_M_PER_S,
    PER_S,
    PER_V,
    bracketed,
    is_any_unit,
    is_foreign_unit,
    known_unit,
    split_unit,
)

Quantity = Literal["time", "speed", "position"]
_MOTION_KEYS = ("time_column", "speed_column", "position_column")
_VOLTAGE = re.compile(rf"voltage_(0|[1-9]\d*)_({'|'.join(PER_V)}|[µμ]V|Volts)", re.IGNORECASE)
_SIGNAL = re.compile(
    r"(.+[/_ ])?ai ?\d+"
    r"|(volts?|voltage|value|ampl(itude)?|ch(an(nel)?)?|ai|adc|sig(nal)?|sensor|film|taxel)"
    r"[ _-]?(\d+|[a-z])?",
    re.IGNORECASE,
)
# Of another axis, or not what the sensor did.
_ELSEWHERE = re.compile(
    r"(^|[\W_])(y|z|set|target|cmd|command(ed)?|demand(ed)?|desired|nominal|ref(erence)?"
    r"|err(or)?)($|[\W_])|set[ _-]?point|(?-i:[a-z][YZ]($|[\W_]))",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class _Names:
    """What a quantity's column may be called: exactly, and as a part of its name."""

    units: Mapping[str, int]
    exact: tuple[str, ...]
    pattern: re.Pattern[str]


_NAMES: Mapping[Quantity, _Names] = {
    "time": _Names(
        PER_S,
        ("time", "timestamp", "t", "x_value", "x-axis", "second", "seconds"),
        re.compile(r"(^|[ _/-])time([ _-]?stamps?)?($|[ _-])"),
    ),
    "speed": _Names(PER_M_PER_S, ("speed",), re.compile(r"speed|veloc")),
    "position": _Names(
        PER_M,
        ("position", "x"),
        re.compile(r"(^|[ _/-])pos(ition)?s?($|[ _-])|displace|encoder|(^|[ _/-])x$"),
    ),
}


def quantity_of(table: ColumnTable, column: str) -> Quantity | None:
    """The quantity that a column is of by its name, or None; a unit of anything else overrules
    the name."""
    if column in table.stamps:
        return "time"
    for quantity in _NAMES:
        if _is_called(column, quantity) and _may_be(table, column, quantity):
            return quantity
    return None


def is_time(column: str) -> bool:
    """Whether a column is called what times are."""
    return _is_called(column, "time")


def _is_called(column: str, quantity: Quantity) -> bool:
    names = _NAMES[quantity]
    words = split_unit(column, names.units)[0].casefold()
    return words in names.exact or bool(names.pattern.search(words))


def written_unit(table: ColumnTable, column: str) -> str | None:
    """The unit that a column's file or its name states in brackets, as it is written."""
    return table.units.get(column) or bracketed(column)[1]


def _may_be(table: ColumnTable, column: str, quantity: Quantity) -> bool:
    """Whether a column's unit allows a quantity: it is one of the quantity's, none, or one that is
    not known."""
    unit = written_unit(table, column)
    if unit is None:
        return split_unit(column, PER_V)[1] is None
    if known_unit(unit, _NAMES[quantity].units):
        return True
    return not is_any_unit(unit) and not is_foreign_unit(unit)


def is_named_signal(column: str) -> bool:
    """Whether a column is called what signals are, as `Ch A`, `AI0` or `channel_1`."""
    return bool(_SIGNAL.fullmatch(bracketed(column)[0]))


def resolve(table: ColumnTable, given: str) -> str:
    """The column that the experimenter names, in full, or without its unit and in any case.

    Raises `BadInput` where there is none, or more than one.
    """
    if given in table:
        return given
    folded = given.casefold()
    near = [c for c in table if folded in (c.casefold(), bracketed(c)[0].casefold())]
    refuse(
        len(near) > 1,
        f"{table.name}: {echo(given)} may be any of the columns {listing(near)}: give "
        "the column's whole name.",
    )
    return near[0] if near else given


def unit_of(
    table: ColumnTable, facts: Mapping[str, Any], column: str, quantity: Quantity
) -> tuple[str | None, str]:
    """The unit of a column of times, speeds or positions, and who states it: its name, else the
    experimenter, else the file; None: nobody, or an unknown one."""
    units = _NAMES[quantity].units
    named = split_unit(column, units)[1]
    stated = facts.get(f"{quantity}_unit")
    if column in table.stamps and quantity == "time":
        return "s", "seconds, by the file"
    if named is not None:
        return named, "the column's name"
    if stated is not None:
        return stated, f"stated as {quantity}_unit"
    return known_unit(table.units.get(column), units), "stated in the file"


def column_of(table: ColumnTable, facts: Mapping[str, Any], quantity: Quantity) -> str | None:
    """The column of times, speeds or positions, or None; a position or speed without a unit is
    taken only where it is named in `facts`.

    Raises `BadInput` where the one that is named is absent, and where several may be it.
    """
    stated = facts.get(f"{quantity}_column")
    if stated is not None:
        column = resolve(table, stated)
        refuse(
            column not in table,
            f"{table.name}: recording.{quantity}_column is {echo(stated)}, which is not "
            f"among the columns {listing(table)}: name one of them.",
        )
        table.check_usable(column)
        return column
    names = _NAMES[quantity]
    own = [f"{names.exact[0]}_{unit}" for unit in names.units]
    signals = [resolve(table, c) for c in _listed(facts.get("channels"))]
    rest = [c for c in table if c not in own and c not in signals and _may_be(table, c, quantity)]
    taken = [c for c in own if c in table][:1] or _alike(table, facts, quantity, rest)
    refuse(
        len(taken) > 1,
        f"{table.name}: the {quantity} may be any of the columns {listing(taken)}: name one by "
        f"recording.{quantity}_column=...",
    )
    if not taken and quantity == "time" and len(table.stamps) == 1:
        return table.stamps[0]
    return taken[0] if taken else None


def _alike(
    table: ColumnTable, facts: Mapping[str, Any], quantity: Quantity, rest: list[str]
) -> list[str]:
    """The columns that may be a quantity's: by exact names in small or large letters, if any is,
    or else by a part of the name. A time needs no unit to be one."""
    names = _NAMES[quantity]
    words = {c: split_unit(c, names.units)[0].casefold() for c in rest}
    has_unit = [c for c in rest if quantity == "time" or unit_of(table, facts, c, quantity)[0]]
    exact = [c for c in has_unit if words[c] in names.exact]
    if exact and quantity == "time":
        # Those that increase first: a clock of whole seconds stands still between its ticks.
        order = {c: (not _increases(table, c), names.exact.index(words[c])) for c in exact}
        return sorted(exact, key=order.__getitem__)[:1]
    if exact:
        return exact
    return [
        c
        for c in has_unit
        if names.pattern.search(words[c]) and not _ELSEWHERE.search(split_unit(c, names.units)[0])
    ]


def _increases(table: ColumnTable, column: str) -> bool:
    """Whether a column's numbers increase strictly."""
    if column in table.unusable:
        return False
    values = table.finite(column)
    values = values[np.isfinite(values)]
    return values.size > 1 and bool(np.all(np.diff(values) > 0))


def unnamed_columns(table: ColumnTable, facts: Mapping[str, Any]) -> dict[str, str]:
    """The settings that name times and positions by their units alone, as `Weg [mm]`, where no
    name, speed or rate is of use and one column alone has such a unit."""
    is_known = {
        "time": facts.get("sample_rate_hz") is not None,
        "position": facts.get("speed_m_per_s") is not None
        or column_of(table, facts, "speed") is not None,
    }
    signals = [resolve(table, channel) for channel in _listed(facts.get("channels"))]
    named = {}
    for quantity in ("time", "position"):
        if is_known[quantity] or column_of(table, facts, quantity) is not None:
            continue
        rest = [c for c in table.columns if c not in signals and quantity_of(table, c) is None]
        alike = [c for c in rest if unit_of(table, {}, c, quantity)[0]]
        if len(alike) == 1 and not _ELSEWHERE.search(alike[0]):
            named[f"{quantity}_column"] = alike[0]
    return named


def _listed(channels: Any) -> tuple[str, ...]:
    return (channels,) if isinstance(channels, str) else tuple(channels or ())


def signal_columns(table: ColumnTable, facts: Mapping[str, Any]) -> tuple[str, ...]:
    """The columns that are the signals, in order: those that are stated; else `voltage_0_V`, ...,
    all in a unit of voltage, whatever their names, and all that are called what signals are; else
    what the format has for signals. Raises `BadInput` where there is none."""
    stated = facts.get("channels")
    if stated is not None:
        return tuple(resolve(table, channel) for channel in _listed(stated))
    # An unusable one too: it is refused, as leaving it out would be silent.
    voltages = sorted((int(m[1]), c) for c in table if (m := _VOLTAGE.fullmatch(c)))
    first = [column for _, column in voltages]
    motion = [resolve(table, facts[key]) for key in _MOTION_KEYS if facts.get(key) is not None]
    left = [c for c in table if c not in (*motion, *first) and quantity_of(table, c) is None]
    chosen = [*first, *(c for c in left if _is_signal(table, c))] or table.signals
    refuse(
        not chosen,
        f"{table.name}: no signal is recognised among the columns "
        f"{listing(table.columns)}: name the signals by recording.channels=[...].",
    )
    return tuple(chosen)


def _is_signal(table: ColumnTable, column: str) -> bool:
    """Whether a column is in a unit of voltage, or called what signals are and in none of a motion
    or of another quantity."""
    unit = _unit_by_file(table, column)
    if unit in PER_V:
        return True
    return is_named_signal(column) and not is_of_other(unit)


def is_of_other(unit: str | None) -> bool:
    """Whether a unit is one of a motion, or of what is neither a motion nor a film's signal."""
    if unit is None or known_unit(unit, PER_V):
        return False
    return is_any_unit(unit) or is_foreign_unit(unit)


def units_that_differ(
    table: ColumnTable, column: str, units: Mapping[str, int]
) -> tuple[str, str] | None:
    """A column's unit by its name and by its file, where these are two of `units`."""
    own, by_file = split_unit(column, units)[1], known_unit(table.units.get(column), units)
    return None if own is None or by_file is None or own == by_file else (own, by_file)


def _unit_by_file(table: ColumnTable, column: str) -> str | None:
    """A signal's unit as its name or the file has it: of voltage, or as it is written."""
    written = written_unit(table, column)
    return known_unit(written, PER_V) or written or split_unit(column, PER_V)[1]


def signal_unit(table: ColumnTable, facts: Mapping[str, Any], column: str) -> str | None:
    """The unit of a signal's column, as the experimenter, the file or its name has it."""
    stated = facts.get("signal_unit")
    return known_unit(stated, PER_V) or stated or _unit_by_file(table, column)
