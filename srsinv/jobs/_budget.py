"""Uncertainty budgets in a result: their parts, in words, and what would reduce a fit's most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from ..inverse.estimate import COMPONENTS, Estimate, TractionEstimate
from ..inverse.line.problem import LineProblem
from ..inverse.line.rig_bands import stderr_by_source
from ..inverse.quality import Quality
from ..inverse.rig.error import (
    CALIBRATION,
    CELLS,
    FOUND,
    MISFIT,
    NOISE,
    OTHER_MINIMUM,
    RigError,
    SensorError,
)
from ..inverse.rig.tolerance import RELATIVE_DEFAULTS
from ..quantities import best_unit, quantity, significant, suffix
from ..report.text import unit_of, without_unit
from .estimates import Variables

if TYPE_CHECKING:  # with all that fits features
    from ..inverse.features.estimate import FeatureEstimate

BETTER = 5.0  # by which a fact is measured better in what would help most
SAID = 0.1  # of a standard error: smaller parts are not named in the summary
NAMED = {
    NOISE: "noise",
    CELLS: "width of the cells",
    MISFIT: "misfit",
    OTHER_MINIMUM: "another minimum",
    CALIBRATION: "calibration",
    FOUND: "facts found and tolerances",
    "poisson_ratio": "Poisson's ratio",
    "youngs_modulus_Pa": "Young's modulus",
}
OTHER_REMEDIES = {
    NOISE: "more passes, or less noise",
    CELLS: "narrower cells",
    MISFIT: "the cause of the misfit",
    OTHER_MINIMUM: "widths of the films' strips that are measured",
    CALIBRATION: "a calibration at less noise",
}
_IN_PER_CENT = ("gain", "speed", *(name.removesuffix("_m") for name in RELATIVE_DEFAULTS))


def source_in_words(source: str) -> str:
    """A source of errors in words: "depth", "gain 2"."""
    return NAMED.get(source) or without_unit(source)


def budget_variables(best: FeatureEstimate, rig: SensorError | None) -> Variables:
    """The parts of each standard error by their source, the largest sources first, with what the
    page reports of them; nothing where there is no budget."""
    sources = _sources(best)
    if not sources:
        return {}
    parts = [
        [best.budget.parts[name].get(source, 0.0) for source in sources] for name in best.parameters
    ]
    each = [
        _in_words(best.budget.parts[name], *best.parameters[name], unit_of(name))
        for name in best.parameters
    ]
    return {
        "budget": (("reported", "source"), parts, "SI", "{reported!s}_stderr_{source!s}"),
        "budget_words": ("reported", each, "1"),
        "remedy": ("reported", [_remedy(best, rig, name) for name in best.parameters], "1"),
        **_facts_of(sources, rig),
    }


def budget_coordinates(best: FeatureEstimate) -> Variables:
    """The sources of the errors."""
    sources = _sources(best)
    return {"source": (sources, "1")} if sources else {}


def highest_budget(
    estimates: Mapping[str, Estimate],
    problem: LineProblem,
    unit: str,
) -> tuple[Variables, Variables]:
    """The parts of the standard errors of the highest p and q by each method, as variables, and the
    coordinate of their sources, the largest first; nothing of a rig that is exact."""
    rig, cells = problem.rig, problem.observed_cells
    by_method = {
        name: stderr_by_source(estimate)
        if isinstance(estimate, TractionEstimate) and estimate.quality is not Quality.FAILED
        else {}
        for name, estimate in estimates.items()
    }
    names = list(dict.fromkeys(source for parts in by_method.values() for source in parts))
    if not names:
        return {}, {}
    unknown = np.full((len(COMPONENTS), len(names) + 2), np.nan)
    none = np.zeros((len(COMPONENTS), problem.line.n))
    each = [
        _at_the_highest(estimates[name], [parts.get(source, none) for source in names], cells)
        if parts
        else unknown
        for name, parts in by_method.items()
    ]
    _, whole, rows = np.split(np.stack(each), [1, 2], axis=-1)
    size = np.nanmax(rows / np.where(whole > 0, whole, np.nan), axis=(0, 1))
    order = np.argsort(-np.nan_to_num(size), kind="stable")
    sources = [names[i] for i in order]
    words = [
        [
            _in_words(dict(zip(names, row[2:], strict=True)), row[0], row[1], unit)
            for row in method.tolist()
        ]
        for method in each
    ]
    by, own = ("estimator", "component"), "Pa" if unit == "Pa" else "relative"
    key = f"{{component}}_peak_stderr_{{source!s}}_{own}_{{estimator}}"
    variables: Variables = {
        "peak_stderr": (by, whole[..., 0], unit, f"{{component}}_peak_stderr_{own}_{{estimator}}"),
        "peak_budget": ((*by, "source"), rows[..., order], unit, key),
        "peak_budget_words": (by, words, "1"),
        **_facts_of(sources, rig),
    }
    return variables, {"source": (sources, "1")}


def _at_the_highest(
    estimate: Estimate, parts: Sequence[Float[np.ndarray, "2 n"]], cells: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "2 column"]:
    """The highest p and q over `cells`, their standard errors, and the parts of these."""
    columns = np.stack([estimate.value, estimate.stderr, *parts], axis=-1)[:, cells]
    return np.stack([rows[np.argmax(rows[:, 0])] for rows in columns.astype(float)])


def _facts_of(sources: Sequence[str], rig: SensorError | None) -> Variables:
    """What the page reports of the sources: their names in words, their tolerances and their
    origins."""
    sized = [_tolerance_in_words(source, rig) for source in sources]
    origins = rig.origin_of if isinstance(rig, RigError) else {}
    return {
        "source_words": ("source", [source_in_words(source) for source in sources], "1"),
        "source_tolerance": ("source", sized, "1"),
        "source_origin": ("source", [origins.get(source, "") for source in sources], "1"),
    }


def _sources(best: FeatureEstimate) -> list[str]:
    """The sources, that with the largest part of any standard error first; none without an
    answer."""
    if not best.budget.parts or best.quality is Quality.FAILED:
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


def _in_words(parts: Mapping[str, float], value: float, stderr: float, unit: str) -> str:
    """The parts of one standard error, the largest first: `Young's modulus 1.7, gain 1 0.5 µm`."""
    if not np.isfinite(stderr) or stderr == 0:
        return ""
    factor, unit = best_unit(unit, value)
    largest = sorted(parts.items(), key=lambda each: -each[1])
    said = [
        f"{source_in_words(source)} {significant(part * factor, 2)}"
        for source, part in largest
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
    if largest in OTHER_REMEDIES:
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
