"""Error against time of methods and of their sizes."""

from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .panels import log_ticks
from .style import PALETTE, WIDTH_IN, legend_below, names_of, scale, styled, units_of

_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">")


@styled
def cost(
    dataset: xarray.Dataset,
    error: str = "error",
    time: str = "steady_call_s",
    *,
    family: str = "family",
    size: str = "size",
    quantity: str = "",
    title: str = "",
) -> Figure:
    """Error against time, one line for each family, from its smallest size to its largest.

    `error`, `time`, `family` and `size` name variables of one dimension, the cases; errors that
    are zero by definition, and unknown ones, are left out. The size is written at both ends of a
    family's line; `quantity` is the label of the error, by default the variable's name and unit.
    """
    figure = Figure(figsize=(WIDTH_IN, 4.8), layout="constrained")
    axes = figure.subplots()
    families, values = names_of(dataset[family]), dataset[error].values
    usable = np.isfinite(values) & (values > 0)
    unit = scale(units_of(dataset[time]), dataset[time].values[usable])
    for i, name in enumerate(dict.fromkeys(np.array(families)[usable].tolist())):
        own = dataset.isel({dataset[error].dims[0]: usable & (np.array(families) == name)})
        own = own.sortby(size)
        labels = [_spoken(f"{each:g}") for each in own[size].values]
        _family(axes, unit.factor * own[time].values, own[error].values, labels, name, i)
    axes.set(xscale="log", yscale="log", xlabel=unit.label("time of a further call"))
    axes.set_ylabel(quantity or f"{error.replace('_', ' ')} [{units_of(dataset[error])}]")
    axes.margins(0.1)
    log_ticks(axes.xaxis, *axes.get_xlim())
    axes.set_title("Lower left is better")
    figure.suptitle(title)
    legend_below(figure, [axes])
    return figure


def _family(
    axes: Axes, time: np.ndarray, error: np.ndarray, labels: list[Any], family: str, index: int
) -> None:
    colour = PALETTE[index % len(PALETTE)]
    style = "-" if index < len(PALETTE) else "--"
    marker = _MARKERS[index % len(_MARKERS)]
    axes.plot(time, error, style, marker=marker, color=colour, markersize=6, label=_spoken(family))
    left, right = (0, -1) if time[0] < time[-1] else (-1, 0)
    ends = ((left, (-5, 4), "right"), (right, (6, -3), "left"))
    for end, offset, side in ends if len(time) > 1 else ends[1:]:
        axes.annotate(
            labels[end], (time[end], error[end]), offset, textcoords="offset points", ha=side,
            color=colour, fontsize=8,
        )  # fmt: skip


def _spoken(number: str) -> str:
    """Without the zero of an exponent: 1e-8."""
    return number.replace("e-0", "e-")
