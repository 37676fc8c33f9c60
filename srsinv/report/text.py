"""Numbers as text: with the digits that count, the unit that reads best, and their errors."""

import math
from collections.abc import Iterable
from numbers import Integral, Real

import numpy as np

from ..quantities import best_unit, quantity, significant, suffix

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


def sized(size: int | float) -> str:
    """A size in full: 1048576 cells, a tolerance of 1e-08."""
    return f"{int(size)}" if float(size).is_integer() else f"{size:g}"


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


def listed(names: Iterable[str]) -> str:
    """Names in a row, or "none"."""
    return ", ".join(names) or "none"


def format_with_error(value: float, stderr: float) -> str:
    """Value and standard error, to the second digit of the latter; to three decimals if it is 0."""
    if not math.isfinite(stderr):
        return f"{significant(value)} (error not known)"
    decimals = max(0, 1 - math.floor(math.log10(stderr))) if stderr > 0 else 3
    return f"{value:.{decimals}f} ± {stderr:.{decimals}f}"


def quantity_with_error(value: float, stderr: float, units: str) -> str:
    """A value of SI `units` with its standard error: `25.89 ± 0.32 µm`."""
    if not math.isfinite(stderr):
        return f"{quantity(value, units)} (error not known)"
    factor, unit = best_unit(units, value)
    return f"{format_with_error(value * factor, stderr * factor)}{suffix(unit)}"


def interval(value: float, half: float, units: str) -> str:
    """From `value - half` to `value + half`, of SI `units`: `25.4 to 26.4 µm`."""
    if not math.isfinite(half):
        return "not known"
    factor, unit = best_unit(units, value)
    decimals = max(0, 1 - math.floor(math.log10(half * factor))) if half > 0 else 3
    low, high = ((value + sign * half) * factor for sign in (-1, 1))
    return f"{low:.{decimals}f} to {high:.{decimals}f}{suffix(unit)}"


def is_numeric(cells: tuple[object, ...]) -> bool:
    """Whether a column holds numbers only, and so is aligned on the right."""
    return bool(cells) and all(
        isinstance(cell, Real) and not isinstance(cell, bool) for cell in cells
    )


def _digits(number: float) -> str:
    return f"{number:.0f}" if abs(number) >= 1000 else f"{number:.4g}"
