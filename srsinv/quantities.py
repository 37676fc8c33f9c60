"""Quantities as text: with the digits that count, in the unit that reads best."""

import math
import re
from typing import Any

import numpy as np

_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
_PREFIXED = {"Pa", "V", "V m", "V s", "A", "C", "s", "m", "m/s"}


def significant(value: float, digits: int = 3) -> str:
    """The value to so many significant digits, without an exponent where it reads well so."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else str(value)
    if value == 0 or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits}g}"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, places):.{max(places, 0)}f}"


def best_unit(units: str, *values: Any) -> tuple[float, str]:
    """The factor on SI values and the unit with the prefix that brings the largest of `values`
    between 1 and 1000. Units that take no prefix (counts, powers) are only written out."""
    if units not in _PREFIXED:
        return 1.0, re.sub(r"\((\w+)\)", r"\1", units).replace("^2", "²").replace(
            "^3", "³"
        ).removesuffix("/1")
    arrays = [np.asarray(each, float) for each in values]
    tops = [np.max(np.abs(v), where=np.isfinite(v), initial=0.0) for v in arrays]
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
    return f"{significant(value * factor, digits)}{suffix(unit)}"


def suffix(unit: str) -> str:
    """A unit as it stands behind a number, nothing for 1."""
    return "" if unit == "1" else f" {unit}"
