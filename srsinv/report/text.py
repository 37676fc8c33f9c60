"""Numbers as text: with the digits that count, the unit that reads best, and their errors."""

import math
import re
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

import numpy as np

_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
_PREFIXED = {"Pa", "V", "V m", "A", "C", "s", "m", "m/s"}


# The unit at the end of a quantity's name, the longest first.
_UNITS = {
    "_N_per_m": "N/m", "_m_per_s": "m/s", "_rad": "rad", "_deg": "deg", "_dB": "dB", "_Hz": "Hz",
    "_hz": "Hz", "_Pa": "Pa", "_V": "V", "_m": "m", "_s": "s",
}  # fmt: skip


def unit_of(name: str) -> str:
    """The SI unit at the end of a quantity's name: `height_m`, `height_m_stderr`."""
    return _UNITS.get(_unit_end(name.removesuffix("_stderr")), "1")


def spoken(label: object) -> str:
    """A label or a name in words."""
    return f"{label:g}" if isinstance(label, float) else str(label).replace("_", " ")


def without_unit(name: str) -> str:
    """A quantity's name in words, without the unit at its end: `ridge.height_m` is "ridge
    height"."""
    return name.removesuffix(_unit_end(name)).replace("_", " ").replace(".", " ")


def _unit_end(name: str) -> str:
    return next((end for end in _UNITS if name.endswith(end)), "")


def format_value(value: object) -> str:
    """A cell as text: whole numbers in full, others to four significant digits.

    Outside 1e-3 to 1e5 the exponent is a multiple of three, so that it reads as a unit's prefix:
    `0.00075` is `750e-6`. None and what is not a number are a dash.
    """
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if value is None:
        return "–"
    if isinstance(value, Integral) or not isinstance(value, Real):
        return str(value)
    number = float(value) + 0.0  # no negative zero
    if math.isnan(number):
        return "–"
    if not math.isfinite(number) or number == 0 or 1e-3 <= abs(number) < 1e5:
        return _digits(number)
    # Rounded first: 999.96e-6 belongs to 1e-3.
    mantissa, _, power = f"{number:.3e}".partition("e")
    shift = int(power) % 3
    return f"{_digits(float(mantissa) * 10**shift)}e{int(power) - shift}"


def significant(value: float, digits: int = 3) -> str:
    """The value to so many significant digits, without an exponent where it reads well so."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else str(value)
    if value == 0 or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits}g}"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, places):.{max(places, 0)}f}"


def listed(names: Iterable[str]) -> str:
    """Names in a row, or "none"."""
    return ", ".join(names) or "none"


def format_with_error(value: float, stderr: float) -> str:
    """Value and standard error, to the second digit of the latter; to three decimals if it is 0."""
    if not math.isfinite(stderr):
        return f"{significant(value)} (error not known)"
    decimals = max(0, 1 - math.floor(math.log10(stderr))) if stderr > 0 else 3
    return f"{value:.{decimals}f} ± {stderr:.{decimals}f}"


def best_unit(units: str, *values: Any) -> tuple[float, str]:
    """The factor on SI values and the unit with the prefix that brings the largest of `values`
    between 1 and 1000. Units that take no prefix (counts, powers) are only written out."""
    if units not in _PREFIXED:
        return 1.0, re.sub(r"\((\w+)\)", r"\1", units).replace("^2", "²").replace(
            "^3", "³"
        ).removesuffix("/1")
    tops = [np.max(np.abs(v), where=np.isfinite(v), initial=0.0) for v in map(_numbers, values)]
    top = float(max(tops, default=0.0))
    # Rounded first: 0.99996e-3 is 1e-3.
    power = 3 * (int(f"{top:.3e}".partition("e")[2]) // 3) if top > 0 else 0
    power = min(max(power, min(_PREFIXES)), max(_PREFIXES))
    if units in ("m", "m/s"):
        power = min(power, 0)  # kilometres are no lengths of a scan
    return 10.0**-power, _PREFIXES[power] + units


def quantity(value: float, units: str, digits: int = 3) -> str:
    """A value of SI `units` in the unit that reads best: `25.9 µm`."""
    factor, unit = best_unit(units, value)
    return f"{significant(value * factor, digits)}{_after(unit)}"


def quantity_with_error(value: float, stderr: float, units: str) -> str:
    """A value of SI `units` with its standard error: `25.89 ± 0.32 µm`."""
    if not math.isfinite(stderr):
        return f"{quantity(value, units)} (error not known)"
    factor, unit = best_unit(units, value)
    return f"{format_with_error(value * factor, stderr * factor)}{_after(unit)}"


def interval(value: float, half: float, units: str) -> str:
    """From `value - half` to `value + half`, of SI `units`: `25.4 to 26.4 µm`."""
    if not math.isfinite(half):
        return "not known"
    factor, unit = best_unit(units, value)
    decimals = max(0, 1 - math.floor(math.log10(half * factor))) if half > 0 else 3
    low, high = ((value + sign * half) * factor for sign in (-1, 1))
    return f"{low:.{decimals}f} to {high:.{decimals}f}{_after(unit)}"


def _after(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def is_numeric(cells: tuple[object, ...]) -> bool:
    """Whether a column holds numbers only, and so is aligned on the right."""
    return bool(cells) and all(
        isinstance(cell, Real) and not isinstance(cell, bool) for cell in cells
    )


def _numbers(values: Any) -> np.ndarray:
    return np.asarray(values, float)


def _digits(number: float) -> str:
    return f"{number:.0f}" if abs(number) >= 1000 else f"{number:.4g}"
