"""Time stamps in words: ISO 8601, other dates, and clock times, as seconds since the first."""

import datetime
import math
import re
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

_DATE = r"(?:(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})|\d{1,2}[-/.]\d{1,2}[-/.]\d{2,4})"
_CLOCK = (
    r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,](?P<fraction>\d{1,12}))?)?"
)
_STAMP = re.compile(
    rf"\s*(?:{_DATE}[T ,]\s*)?{_CLOCK}\s*(?P<half>[AaPp][Mm])?\s*"
    r"(?P<zone>Z|[+-]\d{2}:?\d{2})?\s*",
    re.ASCII,
)
_DAY_S = 86_400


def is_stamp(cell: str) -> bool:
    """Whether a cell holds a clock time, with or without a date."""
    return _STAMP.fullmatch(cell) is not None


def stamps_s(cells: Iterable[str]) -> tuple[Float[np.ndarray, " row"], bool]:
    """Seconds (row,) of each stamp since midnight of the first stamp's day, and whether every
    stamp has a date that is certain.

    NaN where a cell is empty, infinite where it is no stamp. Only a date that begins with its year
    is certain: of another the day is not read, as its order differs from country to country.
    """
    values, first, is_dated = [], None, True
    for cell in cells:
        parts = _STAMP.fullmatch(cell)
        if parts is None:
            values.append(math.inf if cell.strip() else math.nan)
            continue
        day = _day(parts)
        is_dated &= day is not None
        first = day if first is None else first
        days = 0 if day is None or first is None else day - first
        values.append(days * _DAY_S + _seconds_of_day(parts))
    return np.array(values), is_dated


def past_midnight(seconds: Float[np.ndarray, " row"]) -> Float[np.ndarray, " row"]:
    """Clock times [s] with a day added wherever they fall back by more than half a day."""
    valid = np.isfinite(seconds)
    steps = np.diff(seconds[valid], prepend=seconds[valid][:1])
    unwrapped = seconds.copy()
    unwrapped[valid] += _DAY_S * np.cumsum(steps < -_DAY_S / 2)
    return unwrapped


def _day(parts: re.Match[str]) -> int | None:
    if parts["y"] is None:
        return None
    try:
        return datetime.date(int(parts["y"]), int(parts["m"]), int(parts["d"])).toordinal()
    except ValueError:
        return None


def _seconds_of_day(parts: re.Match[str]) -> float:
    hour = int(parts["hour"])
    if parts["half"]:
        hour = hour % 12 + (12 if parts["half"].lower() == "pm" else 0)
    whole = 3600 * hour + 60 * int(parts["minute"]) + int(parts["second"] or 0)
    if parts["zone"] and parts["zone"] != "Z":
        sign, digits = parts["zone"][0], parts["zone"][1:].replace(":", "")
        east = 3600 * int(digits[:2]) + 60 * int(digits[2:])
        whole += -east if sign == "+" else east
    return whole + float(f"0.{parts['fraction'] or 0}")
