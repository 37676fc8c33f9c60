"""The units that a column's name, a file or the experimenter may state, each per SI unit.

Divided by, not multiplied with 1e-3: that rounds correctly.
"""

from collections.abc import Mapping

PER_S: Mapping[str, int] = {"s": 1, "ms": 1_000, "us": 1_000_000}
PER_M: Mapping[str, int] = {"m": 1, "mm": 1_000, "um": 1_000_000}
PER_M_PER_S: Mapping[str, int] = {"m_per_s": 1, "mm_per_s": 1_000}
PER_V: Mapping[str, int] = {"V": 1, "mV": 1_000, "uV": 1_000_000, "µV": 1_000_000, "Volts": 1}


def names(quantity: str, units: Mapping[str, int]) -> dict[str, int]:
    """The names that a column of `quantity` may have, with the divisor of each."""
    return {f"{quantity}_{unit}": per_si for unit, per_si in units.items()}


TIMES = names("time", PER_S)
UNITLESS_TIMES = ("time", "timestamp", "t")
SPEEDS = names("speed", PER_M_PER_S)
POSITIONS = names("position", PER_M)


def may_be_signal(column: str) -> bool:
    """Whether a column's name allows a signal: it names no time, speed or position."""
    return column not in {*TIMES, *UNITLESS_TIMES, *SPEEDS, *POSITIONS}


def unit_of_name(column: str) -> str | None:
    """The unit of voltage that a column's name ends in, or None."""
    head, _, unit = column.rpartition("_")
    return unit if head and unit in PER_V else None


def in_volts(column: str, unit: str) -> str:
    """The name of a column in `unit` once a voltage's values are in V."""
    return f"{column.removesuffix(unit)}V" if unit_of_name(column) == unit else column
