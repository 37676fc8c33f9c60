"""What a file states of its numbers besides them: rate, start, scale and offset.

Each format has a place of its own for it (attributes of a dataset, properties of a channel, a
preamble, arrays of one number); the words are the same in all. What is stated is applied, or the
column cannot be used: nothing is dropped.
"""

import math
import re
from collections.abc import Mapping
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from srsinv.errors import echo

from ._units import PER_S, known_unit

_RATE = (
    "rate", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency", "samplefreq",
    "samplingfreq", "fs", "sr", "samplespersecond", "samplespersec", "frequencyofsampling",
)  # fmt: skip
_INTERVAL = (
    "interval", "sampleinterval", "samplinginterval", "sampleperiod", "samplingperiod",
    "timeinterval", "timeincrement", "timestep", "timedelta", "increment", "xincrement", "xincr",
    "xinc", "deltax", "deltat", "dt", "dx", "tinterval", "tinc", "tsample", "ts", "wfincrement",
    "horizontalinterval",
)  # fmt: skip
_START = (
    "start", "starttime", "startingtime", "startoffset", "t0", "x0", "xorigin", "xstart", "tstart",
    "toffset", "timeoffset", "wfstartoffset", "wfstarttime", "horizontalstart",
)  # fmt: skip
_SCALE = (
    "scalefactor", "scale", "scaling", "scalingfactor", "conversion", "conversionfactor",
    "calibrationfactor", "factor", "multiplier", "slope", "lsb", "lsbsize", "voltspercount",
    "vpercount", "voltsperbit", "voltspercode",
)  # fmt: skip
_GAIN = (
    "gain", "amplification", "amplifiergain", "adcgain", "countspervolt", "unitspervolt",
    "sensitivity",
)  # fmt: skip
# Words that also stand for other things, as "Scale" for that of a screen.
_AMBIGUOUS = (
    "rate", "sr", "interval", "ts", "dx", "scale", "scaling", "factor", "slope", "offset",
    "intercept", "start", "increment",
)  # fmt: skip
_OFFSET = ("addoffset", "offset", "intercept", "scaleoffset", "conversionoffset")
_UNITS = ("units", "unit", "unitstring", "yunit", "yunits", "physicalunit")
_PER_HZ = {"": 1.0, "hz": 1.0, "s/s": 1.0, "sa/s": 1.0, "sps": 1.0, "1/s": 1.0, "samples/s": 1.0}
_PREFIX = {"k": 1e3, "m": 1e6, "g": 1e9}
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*", re.ASCII)
_GAIN_OF = re.compile(r"(gain|scale[ _]?factor|amplification)[ _:]", re.IGNORECASE)
_SAME = 1e-6  # relative: what a rate and an interval, each rounded, may differ by


def plain(word: str) -> str:
    """A key word without case, marks and a unit in brackets."""
    return re.sub(r"[^a-z0-9]", "", re.sub(r"[(\[].*?[)\]]", "", word).casefold())


class Clock(NamedTuple):
    """The times of a column's samples [s]: they start at `start_s` after the date `moment_s`, and
    come at `interval_s` (0: not stated)."""

    moment_s: float
    start_s: float
    interval_s: float


class Stated(NamedTuple):
    """What is stated of a column: `unit`; the `scale` and `offset` that its numbers are to be
    multiplied by and added; the `gain` that they were recorded with; `start_s` and `interval_s` of
    its samples, and the date `moment_s` from which they start; None: not stated.
    `refused`: what is stated and cannot be used."""

    unit: str | None = None
    scale: float | None = None
    offset: float | None = None
    gain: float | None = None
    start_s: float | None = None
    moment_s: float | None = None
    interval_s: float | None = None
    refused: str | None = None

    @property
    def clock(self) -> Clock | None:
        """The times of the samples, or None where nothing is stated of them."""
        if self.start_s is None and self.moment_s is None and self.interval_s is None:
            return None
        return Clock(self.moment_s or 0.0, self.start_s or 0.0, self.interval_s or 0.0)

    @property
    def is_scaled(self) -> bool:
        """Whether the numbers change."""
        return self.scale not in (None, 1.0) or self.offset not in (None, 0.0)

    def applied(self, values: np.ndarray) -> np.ndarray:
        """The numbers with scale and offset."""
        if not self.is_scaled:
            return values
        scale = 1.0 if self.scale is None else self.scale
        return scale * values.astype(np.float64) + (self.offset or 0.0)


def stated(attributes: Mapping[str, Any]) -> Stated:
    """What attributes of a column, or of a whole file, state."""
    found: dict[str, Any] = {}
    for key, given in attributes.items():
        word, unit = _split(key)
        name, value = _field(word), plain_value(given)
        if name == "unit" and isinstance(value, str):
            found.setdefault(name, value)
        if name in (None, "unit"):
            continue
        moment_s = _moment_s(value) if name == "start_s" and isinstance(value, str) else None
        name = name if moment_s is None else "moment_s"
        number = _number(word, name, value, unit) if moment_s is None else moment_s
        if number is None or not math.isclose(found.get(name, number), number, rel_tol=_SAME):
            return Stated(refused=f"states {key} {echo(value)}, which cannot be applied")
        found[name] = number
    return Stated(**found)


def is_stated_word(key: str, may_be_ambiguous: bool = True) -> bool:
    """Whether a key states a rate, a start, a scale, an offset or a gain; `may_be_ambiguous`: by a
    word that has other meanings, too."""
    word = _split(key)[0]
    return _field(word) not in (None, "unit") and (may_be_ambiguous or word not in _AMBIGUOUS)


def is_scaling_word(key: str) -> bool:
    """Whether a key states a scale or a gain, also of one channel, as `Gain Ch 0`, or within a
    struct, as `info.gain`."""
    last = key.rpartition(".")[2]
    return _field(_split(last)[0]) in ("scale", "gain") or is_gain_of(last)


def is_gain_of(key: str) -> bool:
    """Whether a key states a gain or a scale of one channel, as `Gain Ch 0`."""
    return bool(_GAIN_OF.match(key))


def is_neutral(key: str, value: Any) -> bool:
    """Whether a scale, gain or offset changes nothing: 1, or 0 of an offset; of several, all."""
    nothing = 0.0 if _field(_split(key)[0]) == "offset" else 1.0
    value = value.split(";") if isinstance(value, str) else value
    values = value if isinstance(value, list) else [value]
    return all(_number("scale", "offset", each, "") == nothing for each in values)


def is_of_time(key: str) -> bool:
    """Whether a key states a rate, an interval or a start."""
    return _field(_split(key)[0]) in ("interval_s", "start_s")


def is_word(key: str) -> bool:
    """Whether a key states anything of a column, its unit included."""
    return _field(_split(key)[0]) is not None


def _split(key: str) -> tuple[str, str]:
    """A key's plain word, and the unit that it ends in, as `dt_ms` or `Sample rate (kHz)`."""
    in_brackets = re.search(r"[(\[](.*?)[)\]]", key)
    if in_brackets:
        return plain(key), in_brackets[1].strip()
    head, _, last = key.rpartition("_")
    is_unit = last in PER_S or _hertz(last) is not None
    return (plain(head), last) if head and last and is_unit else (plain(key), "")


def _field(word: str) -> str | None:
    """The field of [`Stated`][] that a plain word is of, or None."""
    names = {
        "interval_s": (*_RATE, *_INTERVAL), "start_s": _START, "scale": _SCALE,
        "offset": _OFFSET, "gain": _GAIN, "unit": _UNITS,
    }  # fmt: skip
    return next((name for name, words in names.items() if word in words), None)


def plain_value(value: Any) -> Any:
    """An attribute as Python has it: text, and one number not as an array of one."""
    if isinstance(value, np.ndarray):
        value = value.flat[0] if value.size == 1 else value.tolist()
    if isinstance(value, np.generic):
        value = value.item() if value.dtype.kind != "M" else str(value)
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _number(word: str, name: str, value: Any, unit: str) -> float | None:
    """The number that is stated, in SI units; None: none that can be used."""
    if isinstance(value, str):
        parts = _QUANTITY.fullmatch(value)
        if parts is None:
            return None
        value, unit = float(parts[1]), parts[2] or unit
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    if name in ("scale", "offset", "gain"):
        return None if name != "offset" and value == 0 else float(value)
    if word in _RATE:
        per_hz = _hertz(unit)
        return None if per_hz is None or value <= 0 else 1 / (value * per_hz)
    named = known_unit(unit or "s", PER_S)
    if named is None or (name == "interval_s" and value <= 0):
        return None
    return float(value) / PER_S[named]


def _hertz(unit: str) -> float | None:
    """How many hertz a unit of rates is, or None."""
    text = unit.casefold().replace(" ", "")
    if text in _PER_HZ:
        return _PER_HZ[text]
    return _PREFIX[text[0]] if text[:1] in _PREFIX and text[1:] in _PER_HZ else None


def _moment_s(text: str) -> float | None:
    """An ISO date with its time, in seconds since 1970."""
    try:
        moment = datetime.fromisoformat(text[:26])
    except ValueError:
        return None
    return (moment.replace(tzinfo=None) - datetime(1970, 1, 1)).total_seconds()
