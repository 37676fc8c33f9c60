"""Time stamps in words: ISO 8601, other dates and clock times, as seconds from a midnight on."""

import datetime
import math
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_MONTH = rf"(?P<name>{'|'.join(_MONTHS)})[a-z]*"
_ISO = r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})"
_NAMED = (rf"(?P<d>\d{{1,2}})[- /.]+{_MONTH}[- /.,]+(?P<y>\d{{2}}|\d{{4}})",
          rf"{_MONTH}[- /.]+(?P<d>\d{{1,2}})[- /.,]+(?P<y>\d{{4}})")  # fmt: skip
_SHORT = r"(?P<a>\d{1,2})[-/.](?P<b>\d{1,2})[-/.](?P<c>\d{2}|\d{4})"  # in an order of the country
_DATES = tuple(re.compile(date, re.ASCII | re.IGNORECASE) for date in (_ISO, *_NAMED, _SHORT))
_ORDERS = ("abc", "bac", "cba")  # of day, month and year in a short date
_WEEKDAY = r"(?:[a-z]{3,9},? )?"
_ANY_DATE = "|".join(re.sub(r"\?P<\w+>", "?:", date.pattern) for date in _DATES)
_CLOCK = (
    r"(?P<hour>\d{1,2}):(?P<minute>\d{2})"
    r"(?::(?P<second>\d{2})(?:[.,](?P<fraction>\d{1,12})|:(?P<millisecond>\d{3}))?)?"
)
_STAMP = re.compile(
    rf"\s*(?:{_WEEKDAY}(?P<date>{_ANY_DATE})[T ,]\s*)?{_CLOCK}\s*(?P<half>[AP]M)?\s*"
    r"(?P<zone>Z|[+-]\d{2}:?\d{2})?\s*",
    re.ASCII | re.IGNORECASE,
)
_DAY_S = 86_400


def is_stamp(cell: str) -> bool:
    """Whether a cell holds a clock time, with or without a date."""
    return _STAMP.fullmatch(cell) is not None


def has_date(cell: str) -> bool:
    """Whether a stamp has a date before its clock time."""
    parts = _STAMP.fullmatch(cell)
    return parts is not None and parts["date"] is not None


def is_date(cell: str) -> bool:
    """Whether a cell holds a date alone."""
    return any(pattern.fullmatch(cell.strip()) for pattern in _DATES)


def stamps_s(cells: Iterable[str]) -> Float[np.ndarray, " row"] | None:
    """Seconds (row,) of each stamp since midnight of the first stamp's day: NaN where a cell is
    empty, infinite where it is no stamp.

    A clock time without a date that falls back by more than half a day is of the next day. None:
    the dates change, and it is not certain by how many days.
    """
    values, dates = [], []
    for cell in cells:
        parts = _STAMP.fullmatch(cell)
        if parts is None:
            values.append(math.inf if cell.strip() else math.nan)
        else:
            values.append(_seconds_of_day(parts))
            dates.append(parts["date"])
    seconds = np.array(values)
    if len({*dates} - {None}) <= 1:
        is_certain = None not in dates and len(_days(dates[:1])) == 1
        return seconds if is_certain else _past_midnight(seconds)
    days = None if None in dates else _certain(_days(list(dict.fromkeys(dates))))
    if days is None:
        return None
    of_date = dict(zip(dict.fromkeys(dates), days, strict=True))
    seconds[np.isfinite(seconds)] += _DAY_S * np.array([of_date[date] for date in dates])
    return seconds


def _days(dates: Sequence[str]) -> set[tuple[int, ...]]:
    """What dates may mean, in days since the first."""
    meanings = set()
    for order in _ORDERS:
        days = [day for date in dates if (day := _day(date, order)) is not None]
        if len(days) == len(dates):
            meanings.add(tuple(day - days[0] for day in days))
    return meanings


def _certain(meanings: set[tuple[int, ...]]) -> tuple[int, ...] | None:
    """The one meaning, or the one by which each date is the day after the one before."""
    following = {each for each in meanings if all(b - a == 1 for a, b in pairwise(each))}
    certain = meanings if len(meanings) == 1 else following
    return next(iter(certain)) if len(certain) == 1 else None


def _day(date: str, order: str) -> int | None:
    """The number of a date's day, a short one's in this order; None: there is no such day."""
    parts = next(filter(None, (pattern.fullmatch(date) for pattern in _DATES))).groupdict()
    if "a" in parts:
        day, month, year = (parts[each] for each in order)
        if len(day) > 2:
            return None
    else:
        month = parts.get("m") or 1 + _MONTHS.index(parts["name"].lower())
        day, year = parts["d"], parts["y"]
    century = 2000 if len(year) == 2 else 0
    try:
        return datetime.date(century + int(year), int(month), int(day)).toordinal()
    except ValueError:
        return None


def _past_midnight(seconds: Float[np.ndarray, " row"]) -> Float[np.ndarray, " row"]:
    """Clock times [s] with a day added wherever they fall back by more than half a day."""
    valid = np.isfinite(seconds)
    steps = np.diff(seconds[valid], prepend=seconds[valid][:1])
    unwrapped = seconds.copy()
    unwrapped[valid] += _DAY_S * np.cumsum(steps < -_DAY_S / 2)
    return unwrapped


def _seconds_of_day(parts: re.Match[str]) -> float:
    hour = int(parts["hour"])
    if parts["half"]:
        hour = hour % 12 + (12 if parts["half"].lower() == "pm" else 0)
    whole = 3600 * hour + 60 * int(parts["minute"]) + int(parts["second"] or 0)
    if parts["zone"] and parts["zone"] != "Z":
        sign, digits = parts["zone"][0], parts["zone"][1:].replace(":", "")
        east = 3600 * int(digits[:2]) + 60 * int(digits[2:])
        whole += -east if sign == "+" else east
    return whole + float(f"0.{parts['fraction'] or parts['millisecond'] or 0}")
