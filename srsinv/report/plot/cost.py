"""Error against time of methods and of their sizes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..text import sized
from .panels import log_ticks
from .style import GREY, PALETTE, WIDTH_IN, legend_below, names_of, scale, styled, units_of

_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">")
_LEAST_SPAN = 5.0  # from the least to the greatest error, and from both to the panel's ends


@styled
def cost(
    dataset: xarray.Dataset,
    error: str = "error",
    time: str = "steady_call_s",
    *,
    family: str = "family",
    size: str = "size",
    spread: tuple[str, str] | None = None,
    failure: str | None = None,
    quantity: str = "",
    title: str = "",
) -> Figure:
    """Draw error against time of computing, with the front of cases that no other beats in both.

    - `dataset`: of a result. `title`: of the figure.
    - `error`, `time` [s], `family`, `size`: names of variables (case,). Each family is a line from
      its smallest size to its largest, written at both ends.
    - `spread`: names of the lower and the upper end of the time, drawn as bars.
    - `failure`: name of the reason of a case that has failed, "" of others. Such a case is a cross,
      at the panel's top where it has no error, and at its right where it has no time.
    - `quantity`: label of the error, by default the variable's name and unit.

    Errors that are zero by definition, and unknown ones, are left out.
    """
    figure = Figure(figsize=(WIDTH_IN, 4.8), layout="constrained")
    axes = figure.subplots()
    names, values = np.array(names_of(dataset[family])), dataset[error].values
    failed = np.zeros(next(iter(dataset.sizes.values()), 0), bool)
    if failure is not None:
        failed = np.array([bool(each) for each in names_of(dataset[failure])], bool)
    usable = np.isfinite(values) & (values > 0) & ~failed
    unit = scale(units_of(dataset[time]), dataset[time].values[usable])
    (dim,) = dataset[error].dims
    look = {name: i for i, name in enumerate(dict.fromkeys(names[usable | failed].tolist()))}
    for name, i in look.items():
        own = dataset.isel({dim: usable & (names == name)}).sortby(size)
        ends = None if spread is None else [unit.factor * own[each].values for each in spread]
        labels = [sized(each) for each in own[size].values.tolist()]
        _family(axes, unit.factor * own[time].values, own[error].values, ends, labels, name, i)
    _front(axes, unit.factor * dataset[time].values[usable], values[usable])
    axes.set(xscale="log", yscale="log", xlabel=unit.label("time of a further call"))
    axes.set_ylabel(quantity or f"{error.replace('_', ' ')} [{units_of(dataset[error])}]")
    axes.margins(0.12)
    _widen(axes, values[usable])
    times = unit.factor * dataset[time].values
    for at in np.flatnonzero(failed):
        _cross(axes, times[at], values[at], PALETTE[look[names[at]] % len(PALETTE)])
    log_ticks(axes.xaxis, *axes.get_xlim())
    axes.set_title("Error against time: lower left is better")
    figure.suptitle(title)
    legend_below(figure, [axes], columns=4)
    return figure


def pareto(time: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The indices, in the order of time, of those of (n,) points that no other beats in one of both
    and equals or beats in the other."""
    order = np.lexsort((error, time))
    least = np.minimum.accumulate(error[order])
    is_first = np.concatenate([[True], error[order][1:] < least[:-1]]) if order.size else []
    return order[np.asarray(is_first, bool)]


def _widen(axes: Axes, error: np.ndarray) -> None:
    """Let equal errors, which differ by rounding alone, lie on one level."""
    if not error.size or error.max() >= _LEAST_SPAN * error.min():
        return
    middle = np.sqrt(error.min() * error.max())
    axes.set_ylim(middle / _LEAST_SPAN, middle * _LEAST_SPAN)


def _front(axes: Axes, time: np.ndarray, error: np.ndarray) -> None:
    """The front as steps, drawn from the panel's left to its right."""
    front = pareto(time, error)
    if not front.size:
        return
    look = {"color": GREY, "linewidth": 5, "alpha": 0.25, "zorder": 0.5, "solid_capstyle": "butt"}
    axes.step(time[front], error[front], where="post", label="not beaten", **look)


def _cross(axes: Axes, time: float, error: float, colour: str) -> None:
    """A failure where it ended, or at the panel's rim."""
    has_time, has_error = np.isfinite(time), np.isfinite(error) and error > 0
    x = time if has_time else axes.get_xlim()[1]
    y = error if has_error else axes.get_ylim()[1]
    label = "failed" if "failed" not in axes.get_legend_handles_labels()[1] else None
    axes.plot(x, y, "x", color=colour, markersize=9, markeredgewidth=2, clip_on=False, label=label)


def _family(
    axes: Axes,
    time: np.ndarray,
    error: np.ndarray,
    ends: Sequence[np.ndarray] | None,
    labels: list[Any],
    family: str,
    index: int,
) -> None:
    if not time.size:
        return
    colour = PALETTE[index % len(PALETTE)]
    style = "-" if index < len(PALETTE) else "--"
    marker = _MARKERS[index % len(_MARKERS)]
    look = {"linestyle": style, "marker": marker, "color": colour, "markersize": 6}
    axes.plot(time, error, label=family, **look)
    if ends is not None:
        axes.hlines(error, ends[0], ends[1], color=colour, linewidth=2.5, alpha=0.4)
    left, right = (0, -1) if time[0] < time[-1] else (-1, 0)
    places = ((left, (-5, 5), "right"), (right, (5, -10), "left"))
    for end, offset, side in places if len(time) > 1 else places[1:]:
        axes.annotate(
            labels[end], (time[end], error[end]), offset, textcoords="offset points", ha=side,
            color=colour, fontsize=8,
        )  # fmt: skip
