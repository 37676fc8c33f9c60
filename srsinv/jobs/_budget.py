"""Uncertainty budget of a fit in a result: its parts, in words, and what would reduce it most."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..inverse.features.budget import CELLS, NOISE
from ..inverse.features.estimate import FeatureEstimate
from ..inverse.rig.error import CALIBRATION, RigError, SensorError
from ..inverse.rig.tolerance import RELATIVE_DEFAULTS
from ..quantities import best_unit, quantity, significant, suffix
from ..report.text import unit_of, without_unit

BETTER = 5.0  # by which a fact is measured better in what would help most
SAID = 0.1  # of a standard error: smaller parts are not named in the summary
NAMED = {
    NOISE: "noise",
    CELLS: "width of the cells",
    CALIBRATION: "calibration",
    "poisson_ratio": "Poisson's ratio",
    "youngs_modulus_Pa": "Young's modulus",
}
OTHER_REMEDIES = {
    NOISE: "more passes, or less noise",
    CELLS: "narrower cells",
    CALIBRATION: "a calibration at less noise",
}
_IN_PER_CENT = ("gain", "speed", *(name.removesuffix("_m") for name in RELATIVE_DEFAULTS))


def source_in_words(source: str) -> str:
    """A source of errors in words: "depth", "gain 2"."""
    return NAMED.get(source) or without_unit(source)


def budget_variables(best: FeatureEstimate, rig: SensorError | None) -> dict[str, tuple[Any, ...]]:
    """The parts of each standard error by their source, the largest sources first, with what is
    said of them; nothing where there is no budget."""
    sources = _sources(best)
    if not sources:
        return {}
    parts = [
        [best.budget.parts[name].get(source, 0.0) for source in sources] for name in best.parameters
    ]
    sized = [_tolerance_in_words(source, rig) for source in sources]
    origins = rig.origin_of if isinstance(rig, RigError) else {}
    each = [_in_words(best, name) for name in best.parameters]
    return {
        "budget": (("reported", "source"), parts, "SI", "{reported!s}_stderr_{source!s}"),
        "budget_words": ("reported", each, "1"),
        "remedy": ("reported", [_remedy(best, rig, name) for name in best.parameters], "1"),
        "source_words": ("source", [source_in_words(source) for source in sources], "1"),
        "source_tolerance": ("source", sized, "1"),
        "source_origin": ("source", [origins.get(source, "") for source in sources], "1"),
    }


def budget_coordinates(best: FeatureEstimate) -> dict[str, tuple[Any, ...]]:
    """The sources of the errors."""
    sources = _sources(best)
    return {"source": (sources, "1")} if sources else {}


def _sources(best: FeatureEstimate) -> list[str]:
    """The sources, that with the largest part of any standard error first."""
    if not best.budget.parts:
        return []
    listed = list(dict.fromkeys(source for parts in best.budget.parts.values() for source in parts))

    def share(source: str) -> float:
        each = [
            parts.get(source, 0.0) / best.parameters[name][1]
            for name, parts in best.budget.parts.items()
            if np.isfinite(best.parameters[name][1]) and best.parameters[name][1] > 0
        ]
        return max(each, default=0.0)

    return sorted(listed, key=share, reverse=True)


def _in_words(best: FeatureEstimate, name: str) -> str:
    """The parts of one standard error, the largest first: `Young's modulus 1.7, gain 1 0.5 µm`."""
    value, stderr = best.parameters[name]
    if not np.isfinite(stderr) or stderr == 0:
        return ""
    parts = sorted(best.budget.parts[name].items(), key=lambda each: -each[1])
    factor, unit = best_unit(unit_of(name), value)
    said = [
        f"{source_in_words(source)} {significant(part * factor, 2)}"
        for source, part in parts
        if part > SAID * stderr
    ]
    return f"{', '.join(said)}{suffix(unit)}"


def _remedy(best: FeatureEstimate, rig: SensorError | None, name: str) -> str:
    """The fact that is worth measuring, to what, and the standard error that this would leave."""
    stderr = best.parameters[name][1]
    if not np.isfinite(stderr):
        return ""
    parts: Mapping[str, float] = best.budget.parts[name]
    largest = max(parts, key=lambda source: parts[source])
    if largest in (NOISE, CELLS, CALIBRATION):
        return OTHER_REMEDIES[largest]
    reached = quantity(best.budget.reduced(name, largest, BETTER), unit_of(name))
    to = _tolerance_in_words(largest, rig, 1 / BETTER)
    return f"{source_in_words(largest)} to {to}: {reached}"


def _tolerance_in_words(source: str, rig: SensorError | None, factor: float = 1.0) -> str:
    if not isinstance(rig, RigError) or source not in rig.names:
        return ""
    at = rig.names.index(source)
    size, value = factor * float(rig.stderr[at]), float(rig.values[at])
    if source.startswith(_IN_PER_CENT) and value:
        return f"{significant(100 * size / abs(value), 2)} %"
    return quantity(size, unit_of(source))
