"""The units that a column's name, a file or the experimenter may state, each per SI unit.

Divided by, not multiplied with 1e-3: that rounds correctly. A column's name ends in its unit: as
`Name (unit)`, `Name [unit]` or `name_unit`.
"""

import re
from collections.abc import Mapping

PER_S: Mapping[str, int] = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
PER_M: Mapping[str, int] = {
    "m": 1, "cm": 100, "mm": 1_000, "um": 1_000_000, "nm": 1_000_000_000,
}  # fmt: skip
PER_M_PER_S: Mapping[str, int] = {f"{unit}_per_s": per_m for unit, per_m in PER_M.items()}
PER_V: Mapping[str, int] = {"V": 1, "mV": 1_000, "uV": 1_000_000}
# Other spellings, in small letters.
_SPELT: Mapping[str, str] = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("micron", "microns"), "um"),
    **dict.fromkeys(("volt", "volts"), "V"),
}
# Units, in small letters, of quantities that are neither a film's signal nor its motion.
_FOREIGN_WORDS = """
    degc °c ℃ c celsius degf °f f fahrenheit k kelvin n mn un kn newton newtons pa hpa kpa
    mpa bar mbar psi deg ° degree degrees rad mrad % rh %rh hz khz mhz w mw g mg kg db lux
    m/s^2 m/s2 n/m nm/s^2 ohm kohm
"""
_FOREIGN = frozenset(_FOREIGN_WORDS.split())
_MICRO = str.maketrans("\u00b5\u03bc", "uu")
_BRACKETS = re.compile(r"(.*\S)\s*(?:\(([^()]*)\)|\[([^][]*)\])\s*")
_GLUED = re.compile(
    r"((?:ch(?:an(?:nel)?)?|ai)[ _-]?\d+) ?([mu\u00b5\u03bc]?V)", re.IGNORECASE
)  # CH1V, as scopes write it
_AFTER_STROKE = re.compile(r"(.*\S)\s+/\s+(\S+)")  # as DIN 1313 writes a unit: U / V


def known_unit(text: str | None, units: Mapping[str, int]) -> str | None:
    """The one of `units` that a text means, whatever its spelling and its case; None: none.

    No film gives megavolts and no stamp is in megaseconds: a capital M is milli.
    """
    if text is None:
        return None
    # As netCDF writes an axis of time: microseconds since 2025-02-11.
    text = text.partition(" since ")[0]
    name = text.strip().translate(_MICRO).replace("/", "_per_").replace(" ", "")
    folded = {unit.casefold(): unit for unit in units}
    spelt = _SPELT.get(name.casefold())
    return name if name in units else folded.get(name.casefold(), spelt if spelt in units else None)


def is_any_unit(text: str) -> bool:
    """Whether a text is a unit of time, length, speed or voltage."""
    return any(known_unit(text, units) for units in (PER_S, PER_M, PER_M_PER_S, PER_V))


def is_foreign_unit(text: str) -> bool:
    """Whether a text is a unit of what is neither a film's signal nor its motion."""
    return text.strip().casefold() in _FOREIGN


def bracketed(column: str) -> tuple[str, str | None]:
    """A column's name before a unit in brackets, and that unit as it is written; a channel's number
    may stand right before its unit."""
    parts = _BRACKETS.fullmatch(column)
    if glued := _GLUED.fullmatch(column):
        return glued[1], glued[2]
    if not parts:
        stroke = _AFTER_STROKE.fullmatch(column)
        is_unit = stroke and (is_any_unit(stroke[2]) or is_foreign_unit(stroke[2]))
        return (stroke[1], stroke[2]) if stroke and is_unit else (column, None)
    return parts[1], (parts[2] or parts[3] or "").strip() or None


def split_unit(column: str, units: Mapping[str, int]) -> tuple[str, str | None]:
    """A column's name without its unit, and that unit where it is one of `units`."""
    words, unit = bracketed(column)
    if unit is not None:
        return words, known_unit(unit, units)
    # From the left, as a unit may hold the mark itself: speed_mm_per_s.
    for mark in re.finditer("_", column):
        if mark.start() and (unit := known_unit(column[mark.end() :], units)):
            return column[: mark.start()], unit
    return column, None


def in_volts(column: str, unit: str) -> str:
    """The name of a signal's column in `unit` once a voltage's values are in V."""
    words, in_brackets = bracketed(column)
    if in_brackets is not None:
        return words
    words, in_name = split_unit(column, PER_V)
    return f"{words}_V" if in_name and in_name == known_unit(unit, PER_V) else column
