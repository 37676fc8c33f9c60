"""Uncertainty budgets: which part of each standard error comes from where."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from ..text import best_unit, without_unit
from .style import GREY, PALETTE, TRUTH, WIDTH_IN, names_of, styled

_ROW_IN, _MOST_ROWS = 0.24, 8
_LEAST = 0.02  # of the standard error: shorter bars are left out
_IN_A_ROW = 2  # panels


@styled
def budget(dataset: xarray.Dataset, name: str = "budget", *, title: str = "") -> Figure:
    """The parts (reported, source) of the standard errors, a panel for each parameter with its
    largest parts first, and the standard error itself as a line; `source_words` names the
    sources."""
    words = np.array(names_of(dataset["source_words"]))
    shown = [
        label
        for label in dataset["reported"].values.tolist()
        if np.isfinite(dataset[name].sel(reported=label)).all()
    ]
    columns = min(_IN_A_ROW, max(len(shown), 1))
    rows = -(-len(shown) // columns)
    bars = min(len(words), _MOST_ROWS)
    figure = Figure(figsize=(WIDTH_IN, rows * (_ROW_IN * bars + 0.9) + 0.2), layout="constrained")
    grid = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes, label in zip(grid, shown, strict=False):
        own = dataset.sel(reported=label)
        stderr = float(own["parameter_stderr"])
        factor, unit = best_unit(str(own["parameter_unit"].item()), stderr)
        parts = own[name].values
        order = np.argsort(-parts, kind="stable")[:_MOST_ROWS]
        order = order[parts[order] > _LEAST * stderr]
        colours = [GREY if source == "noise" else PALETTE[0] for source in words[order]]
        axes.barh(np.arange(len(order)), factor * parts[order], color=colours, height=0.7)
        axes.axvline(factor * stderr, color=TRUTH, linewidth=0.9)
        axes.set_yticks(np.arange(len(order)), words[order])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_title(without_unit(label))
        axes.set_xlabel("standard error" + ("" if unit == "1" else f" [{unit}]"))
    for axes in grid[len(shown) :]:
        axes.set_axis_off()
    figure.suptitle(title)
    return figure
