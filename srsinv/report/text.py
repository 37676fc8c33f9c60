"""Numbers as text: with the digits that count, the unit that reads best, and their errors."""

import math
import re
from collections.abc import Iterable
from numbers import Integral, Real

import numpy as np

from ..quantities import best_unit, significant, suffix
from ..quantities import quantity as quantity

# The unit at the end of a quantity's name, the longest first.
_UNITS = {
    "_N_per_m": "N/m", "_m_per_s": "m/s", "_rad": "rad", "_deg": "deg", "_dB": "dB", "_Hz": "Hz",
    "_hz": "Hz", "_Pa": "Pa", "_V": "V", "_m": "m", "_s": "s",
}  # fmt: skip

_UNITS_WITHIN = {"Pa", "Hz", "dB"}  # words of a metric's name that are its unit
_TERMS = {
    "snr": "signal-to-noise ratio", "dof": "degrees of freedom", "stderr": "standard error",
    "chi2": "chi-square", "mu": "friction", "tikhonov": "Tikhonov", "wiener": "Wiener",
}  # fmt: skip
_NOISES = {
    "snr": "white noise at a given signal-to-noise ratio",
    "white": "white noise",
    "johnson": "Johnson noise of the feedback resistor",
    "sliding": "noise of sliding",
}
_PERSONS = {"youngs_modulus_Pa": "Young's modulus", "poisson_ratio": "Poisson's ratio"}
_OF_COMPONENT = re.compile(r"(.+?) ([pq])(?: (.+))?")
# A power of ten as a program writes it; no part of a name, of a setting (`key=1e-5`) or of a path.
_POWER = re.compile(r"(?<![\w.=/\-])(-?)(\d+(?:\.\d+)?)e([+-]?\d+)(?![\w.]*\w)")
_MINUS = re.compile(r"(?<![\w.=/)\]+*-])-(?=\d|[xyzpq]\b|inf\b)")
_RAISED_TO = re.compile(r"(?<=\d)\^(-?\d+)")  # 10^3
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LEAST_IN_UNIT = 0.1  # of a unit: the least number in it beside larger ones


def unit_of(name: str) -> str:
    """The SI unit at the end of a quantity's name: `height_m`, `height_m_stderr`."""
    return _UNITS.get(_unit_end(name.removesuffix("_stderr")), "1")


def spoken(label: object) -> str:
    """A label or a name in words."""
    return f"{label:g}" if isinstance(label, float) else str(label).replace("_", " ")


def typeset(text: str) -> str:
    """Text with powers of ten and minus signs as they are printed: `-2.5e-06` is −2.5 × 10⁻⁶."""
    powers = _POWER.sub(_printed_power, text)
    return _MINUS.sub("−", _RAISED_TO.sub(lambda match: match[1].translate(_RAISED), powers))


def _printed_power(match: re.Match[str]) -> str:
    sign, digits, power = match[1], match[2], str(int(match[3])).translate(_RAISED)
    factor = "" if float(digits) == 1 else f"{digits}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}"
    return f"{sign}{factor}10{power}"


def facts_in_words(names: str) -> str:
    """Facts of a rig by their names, as a rig lists them: `depth_m, poisson_ratio (assumed)`."""
    pairs = (each.partition(" ") for each in names.split(", "))
    return ", ".join(
        f"{_PERSONS.get(name, without_unit(name))}{space}{rest}" for name, space, rest in pairs
    )


def noise_in_words(names: str) -> str:
    """The noises of a configuration by what they are: `snr, sliding`."""
    return ", ".join(_NOISES.get(name, name) for name in names.split(", "))


def class_in_words(name: str) -> str:
    """A class's name in words: `CurrentAmplifier` is "current amplifier"."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).split()
    return " ".join(word if word.isupper() else word.lower() for word in words)


def units_for_rows(values: Iterable[float], units: Iterable[str]) -> list[tuple[float, str]]:
    """The factor and the unit of each row of a table, by its value of SI `units`.

    Rows of the same SI unit share a prefix as long as no number in it falls below 0.1: lengths of
    1.03 mm and 0.93 mm, but of 20 µm beside 2 mm.
    """
    rows = [(abs(value) if math.isfinite(value) else 0.0, unit) for value, unit in
            zip(values, units, strict=True)]  # fmt: skip
    chosen: dict[tuple[float, str], tuple[float, str]] = {}
    last: dict[str, tuple[float, str]] = {}
    for size, unit in sorted(set(rows), reverse=True):
        if unit not in last or 0 < last[unit][0] * size < _LEAST_IN_UNIT:
            last[unit] = best_unit(unit, size)
        chosen[size, unit] = last[unit]
    return [chosen[row] for row in rows]


def sized(size: int | float) -> str:
    """A size in full: 1048576 cells, a tolerance of 1e-08."""
    return f"{int(size)}" if float(size).is_integer() else f"{size:g}"


def without_unit(name: str) -> str:
    """A quantity's name in words, without the unit at its end: `ridge.height_m` is "ridge
    height"."""
    return name.removesuffix(_unit_end(name)).replace("_", " ").replace(".", " ")


def in_words(name: str) -> str:
    """The quantity that a setting or a metric is named after: `noise.snr.snr_dB` is
    "signal-to-noise ratio", `error_p_wiener` "error of p, Wiener"."""
    words = [
        _TERMS.get(word, word)
        for word in without_unit(name.rpartition(".")[2]).split()
        if word not in _UNITS_WITHIN
    ]
    text = " ".join(words) or name
    component = _OF_COMPONENT.fullmatch(text)
    if component is None:
        return text
    what, of, rest = component.groups()
    return f"{what} of {of}" + (f", {rest}" if rest else "")


def heading(name: str) -> str:
    """A quantity's name in words, with its unit: `film_angle.tilt_deg` is "film angle tilt
    [deg]"."""
    unit = unit_of(name)
    return without_unit(name) + ("" if unit == "1" else f" [{unit}]")


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
    decimals = _decimals(stderr)
    return f"{value:z.{decimals}f} ± {stderr:.{decimals}f}"


def quantity_with_error(
    value: float, stderr: float, units: str, scale: tuple[float, str] | None = None
) -> str:
    """A value of SI `units` with its standard error: `25.89 ± 0.32 µm`, `(1.20 ± 0.11) × 10⁻⁹`.

    `scale`: the factor and the unit; None: those in which the larger of both reads best.
    """
    factor, power, unit = _scaled(units, value, stderr, scale)
    if not math.isfinite(stderr):
        return f"{significant(value * factor)}{power}{unit} (error not known)"
    written = format_with_error(value * factor, stderr * factor)
    return f"({written}){power}{unit}" if power else f"{written}{unit}"


def interval(value: float, half: float, units: str, scale: tuple[float, str] | None = None) -> str:
    """From `value - half` to `value + half`, of SI `units`: `25.4 to 26.4 µm`; `scale` as
    [`quantity_with_error`][] has it."""
    return between(value - half, value + half, units, scale)


def between(low: float, high: float, units: str, scale: tuple[float, str] | None = None) -> str:
    """From `low` to `high`, of SI `units`, as [`interval`][] writes it."""
    known = math.isfinite(low) + math.isfinite(high)
    if known < 2:
        return _one_sided(low, high, units, scale) if known else "not known"
    half = (high - low) / 2
    factor, power, unit = _scaled(units, low + half, half, scale)
    decimals = _decimals(half * factor)
    written = f"{low * factor:z.{decimals}f} to {high * factor:z.{decimals}f}"
    return f"({written}){power}{unit}" if power else f"{written}{unit}"


def _one_sided(low: float, high: float, units: str, scale: tuple[float, str] | None) -> str:
    """An interval without one end."""
    end, word = (low, "above") if math.isfinite(low) else (high, "below")
    factor, power, unit = _scaled(units, end, math.inf, scale)
    return f"{word} {significant(end * factor)}{power}{unit}"


def _decimals(stderr: float) -> int:
    """Those that end with the second digit of a standard error."""
    return max(0, 1 - math.floor(math.log10(stderr))) if stderr > 0 else 3


def _scaled(
    units: str, value: float, stderr: float, scale: tuple[float, str] | None
) -> tuple[float, str, str]:
    """The factor on SI values, the power of ten that is written behind, empty for 1, and the unit.
    Units that take no prefix (counts, 1/m) leave a power."""
    top = max(abs(value), stderr) if math.isfinite(stderr) else abs(value)
    factor, unit = best_unit(units, top) if scale is None else scale
    size = top * factor
    if scale is not None or not math.isfinite(size) or size == 0 or 1e-3 <= size < 1e6:
        return factor, "", suffix(unit)
    power = max(3 * math.floor(math.log10(size) / 3), -270)
    return factor / 10.0**power, f" × 10{str(power).translate(_RAISED)}", suffix(unit)


def is_numeric(cells: tuple[object, ...]) -> bool:
    """Whether a column holds numbers only, and so is aligned on the right."""
    return bool(cells) and all(
        isinstance(cell, Real) and not isinstance(cell, bool) for cell in cells
    )


def _digits(number: float) -> str:
    return f"{number:.0f}" if abs(number) >= 1000 else f"{number:.4g}"
