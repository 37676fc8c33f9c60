"""Uncertainty budgets: which part of each standard error comes from where."""

import numpy as np
import xarray
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..text import best_unit, without_unit
from .style import GREY, PALETTE, TRUTH, WIDTH_IN, names_of, styled

_ROW_IN, _MOST_ROWS = 0.24, 8
_LEAST = 0.02  # of the standard error: shorter bars are left out
_BEYOND = 1.12  # of the standard error: the end of the axis
_IN_A_ROW = 2  # panels
MIXED = "SI"  # each has a unit of its own


@styled
def budget(
    dataset: xarray.Dataset,
    name: str = "budget",
    stderr: str = "parameter_stderr",
    *,
    title: str = "",
) -> Figure:
    """Draw the uncertainty budget: the parts of standard errors as bars, the largest source first.

    - `dataset`: of a result, or of an estimate. `title`: of the figure.
    - `name`: the variable of the parts (*of, source), in SI units; `source_words` (source) names
      the sources.
    - `stderr`: the variable of the standard errors (*of), each a line in a panel of its own.
    """
    words = np.array(names_of(dataset["source_words"]))
    parts, whole = dataset[name], dataset[stderr]
    panels = [
        at
        for at in np.ndindex(whole.shape)
        if np.isfinite(parts.values[at]).all() and np.isfinite(whole.values[at])
    ]
    columns = min(_IN_A_ROW, max(len(panels), 1))
    rows = -(-len(panels) // columns)
    bars = min(len(words), _MOST_ROWS)
    figure = Figure(figsize=(WIDTH_IN, rows * (_ROW_IN * bars + 0.9) + 0.2), layout="constrained")
    grid = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes, at in zip(grid, panels, strict=False):
        own, error = parts.values[at], float(whole.values[at])
        labels = [str(whole[dim].values[i]) for dim, i in zip(whole.dims, at, strict=True)]
        units = str(dataset["parameter_unit"].values[at]) if parts.units == MIXED else parts.units
        factor, unit = best_unit(units, error)
        order = np.argsort(-own, kind="stable")[:_MOST_ROWS]
        order = order[own[order] > _LEAST * error]
        colours = [GREY if source == "noise" else PALETTE[0] for source in words[order]]
        axes.barh(np.arange(len(order)), factor * own[order], color=colours, height=0.7)
        axes.axvline(factor * error, color=TRUTH, linewidth=0.9)
        axes.set_xlim(0.0, _BEYOND * factor * error if error > 0 else None)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.set_yticks(np.arange(len(order)), words[order])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_title(", ".join(map(without_unit, labels)))
        axes.set_xlabel("standard error" + ("" if unit == "1" else f" [{unit}]"))
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    figure.suptitle(title)
    return figure
