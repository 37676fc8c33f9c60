"""Error against time of methods and of their sizes."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..text import format_value
from .style import PALETTE, WIDTH_IN, legend_below, names_of, styled, units_of

_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">")


@styled
def cost(
    dataset: xarray.Dataset,
    error: str = "error",
    time: str = "steady_call_s",
    *,
    family: str = "family",
    size: str = "size",
    title: str = "",
    words: Mapping[str, str] | None = None,
) -> Figure:
    """Error against time, one line for each family, from its smallest size to its largest.

    `error`, `time`, `family` and `size` name variables of one dimension, the cases; errors that
    are zero by definition, and unknown ones, are left out. The size is written at both ends of a
    family's line, in `words` by its number where that has it.
    """
    figure = Figure(figsize=(WIDTH_IN, 4.8), layout="constrained")
    axes = figure.subplots()
    families, values = names_of(dataset[family]), dataset[error].values
    usable = np.isfinite(values) & (values > 0)
    for i, name in enumerate(dict.fromkeys(np.array(families)[usable].tolist())):
        own = dataset.isel({dataset[error].dims[0]: usable & (np.array(families) == name)})
        own = own.sortby(size)
        labels = [(words or {}).get(f"{each:g}", format_value(each)) for each in own[size].values]
        _family(axes, own[time].values, own[error].values, labels, name, i)
    quantity = error.replace("_", " ")
    axes.set(
        xscale="log", yscale="log", xlabel=f"time of a further call [{units_of(dataset[time])}]"
    )
    axes.set_ylabel(f"{quantity} [{units_of(dataset[error])}]")
    axes.margins(0.1)
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
    axes.plot(time, error, style, marker=marker, color=colour, markersize=6, label=family)
    ends = ((0, (-5, 4), "right"), (len(time) - 1, (6, -3), "left"))
    for end, offset, side in ends if len(time) > 1 else ends[1:]:
        axes.annotate(
            labels[end], (time[end], error[end]), offset, textcoords="offset points", ha=side,
            color=colour, fontsize=8,
        )  # fmt: skip
