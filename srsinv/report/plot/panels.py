"""Panels of curves as data, and their drawing: every figure of curves is made of these.

All values are in SI units. Axes that show the same quantity have one unit in a figure, chosen so
that its numbers read well; curves of the same label have one look and one entry of the legend.
"""

import itertools
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..text import typeset
from .style import (
    GREY,
    SHADE,
    WIDTH_IN,
    NotebookFigure,
    Scale,
    colours,
    has_values,
    legend_below,
    legend_beside,
    note,
    scale,
    stretches,
    styled,
    symbol,
)

LEAST_LOG = 1e-290  # matplotlib takes a log axis no further down than 1e-300
_BAND = {"alpha": 0.22, "linewidth": 0}
_MARGIN = 0.07  # of the range of the curves, above and below them
_LETTER_IN = 0.078  # width of a letter of a label, and of its share of a margin
_LABEL_LINES = 4  # of a label: more leave no room for the panel
_FEW_TICKS = 2.0  # decades: below, a logarithmic axis has numbers at 1, 2 and 5


@dataclass(frozen=True)
class PanelAxis:
    """An axis of a panel: the name of its `quantity`, and its SI unit, `units`.

    - `is_log`: whether it is logarithmic.
    - `limits`: least and greatest, in SI units, each None for the curves' own.
    """

    quantity: str
    units: str = "1"
    is_log: bool = False
    limits: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True)
class Curve:
    """A curve of a panel: values `y` (n,) over the panel's x (n,), or over an `x` of its own.

    - `label`, `band_label`: in the legend.
    - `band`: least and greatest (n,) about it, drawn as an area, or as bars where `has_bars`.
    - `look`: matplotlib's properties of the line; its colour is chosen by the label where it is not
      given.
    - `in_view`: whether the panel's limits make room for it; or (n,) for which of its values.
    """

    y: Any
    label: str = ""
    x: Any = None
    band: tuple[Any, Any] | None = None
    look: Mapping[str, Any] = field(default_factory=dict)
    band_label: str = ""
    has_bars: bool = False
    in_view: Any = True


@dataclass(frozen=True)
class Mark:
    """A line across a panel at a value of an axis, or an area.

    - `at`: the value, in SI units, on `axis`, "x" or "y".
    - `until`: where an area ends; None: a line.
    - `label`: in the legend; `look`: matplotlib's properties.
    """

    at: float
    label: str = ""
    axis: str = "x"
    until: float | None = None
    look: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Panel:
    """A panel of a figure as data: `curves` and `marks` over `values` (n,) of the x axis.

    All are in SI units; `x` and `y` are the axes, with their quantities and units; `title` stands
    above the panel.
    """

    curves: Sequence[Curve]
    x: PanelAxis
    y: PanelAxis
    values: Any = ()
    title: str = ""
    marks: Sequence[Mark] = ()


Grid = Sequence[Panel] | Sequence[Sequence[Panel]]


@styled
def panels(
    grid: Grid,
    title: str = "",
    *,
    height_in: float = 2.2,
    heights: Sequence[float] | None = None,
    widths: Sequence[float] | None = None,
    legend: str = "below",
) -> Figure:
    """Draw panels as one figure, in rows or in rows and columns.

    - `grid`: a list of [`Panel`][]s, or a list of such lists.
    - `title`: of the figure. `height_in` [inch]: of a row.
    - `heights`, `widths`: of the rows and the columns, relative.
    - `legend`: "below", one for all panels; "beside", one for each; or "" for none.

    Panels of a column that show the same quantity along x share it.
    """
    rows = [[row] if isinstance(row, Panel) else list(row) for row in grid]
    every = [panel for row in rows for panel in row]
    size = (WIDTH_IN, len(rows) * height_in + 0.4 + 0.5 * bool(title))
    figure = NotebookFigure(figsize=size, layout="constrained")
    is_shared = all(len({panel.x for panel in column}) == 1 for column in zip(*rows, strict=False))
    axes = figure.subplots(
        len(rows), max(map(len, rows)), squeeze=False, sharex="col" if is_shared else False,
        height_ratios=heights, width_ratios=widths,
    )  # fmt: skip
    units = _units(every)
    palette = colours(dict.fromkeys(c.label for panel in every for c in panel.curves))
    for i, (row, beside) in enumerate(zip(axes, rows, strict=True)):
        for c, (place, panel) in enumerate(itertools.zip_longest(row, beside)):
            if panel is None:
                place.remove()
                continue
            column = [each[c] for each in rows if c < len(each)] if is_shared else [panel]
            is_lowest = not is_shared or all(len(below) <= c for below in rows[i + 1 :])
            place.tick_params(labelbottom=is_lowest)
            _draw(place, panel, column, units, palette, is_lowest)
            if c and panel.y == beside[c - 1].y:
                place.set_ylabel("")
    for place in figure.axes:
        _wrap_labels(place, size[1] - 0.9)
    if legend == "below":
        legend_below(figure, figure.axes)
    elif legend == "beside":
        for place in figure.axes:
            legend_beside(place)
    figure.suptitle(title)
    return figure


def _wrap_labels(axes: Axes, high_in: float) -> None:
    """Break the labels of axes that are longer than their panel; `high_in` is the height of all
    panels together."""
    spec = axes.get_subplotspec()
    if spec is None:
        return
    grid = spec.get_gridspec()
    for ratios, span, length_in, axis in (
        (grid.get_height_ratios(), spec.rowspan, high_in, axes.yaxis),
        (grid.get_width_ratios(), spec.colspan, WIDTH_IN - 0.5, axes.xaxis),
    ):
        sizes = np.asarray(ratios, float)
        share = float(sizes[span.start : span.stop].sum() / sizes.sum())
        label = axis.get_label_text()
        if "$" not in label:  # a formula is one word
            words = textwrap.wrap(label, max(int(share * length_in / _LETTER_IN), 10),
                                  break_long_words=False, break_on_hyphens=False,
                                  max_lines=_LABEL_LINES, placeholder=" …")  # fmt: skip
            axis.set_label_text("\n".join(words))


def unobserved(x: np.ndarray, observed: np.ndarray) -> list[Mark]:
    """Marks of the stretches of `x` without samples."""
    look = {"color": SHADE, "zorder": 0}
    return [
        Mark(start, "no samples here", until=stop, look=look)
        for start, stop in stretches(x, ~observed)
    ]


def _units(every: Sequence[Panel]) -> dict[PanelAxis | tuple[str, str], Scale]:
    """The unit of each quantity over all panels that show it."""
    values: dict[tuple[str, str], list[Any]] = {}
    for panel in every:
        for axis, own in ((panel.x, _along_x(panel)), (panel.y, _along_y(panel))):
            values.setdefault((axis.quantity, axis.units), []).extend(own)
    return {key: scale(key[1], *own) for key, own in values.items()}


def _along_x(panel: Panel) -> Iterator[Any]:
    yield panel.values
    yield from (curve.x for curve in panel.curves if curve.x is not None)


def _along_y(panel: Panel) -> Iterator[Any]:
    for curve in panel.curves:
        for values in (curve.y, *(curve.band or ())):
            yield np.where(curve.in_view, np.asarray(values, float), np.nan)


def _draw(
    axes: Axes,
    panel: Panel,
    column: Sequence[Panel],
    units: Mapping[Any, Scale],
    palette: Mapping[str, str],
    is_lowest: bool,
) -> None:
    x, y = (units[axis.quantity, axis.units] for axis in (panel.x, panel.y))
    for curve in panel.curves:
        _curve(axes, curve, panel, (x.factor, y.factor), palette[curve.label])
    for mark in panel.marks:
        _mark(axes, mark, (x if mark.axis == "x" else y).factor)
    if not any(has_values(np.asarray(curve.y, float)) for curve in panel.curves):
        note(axes, "no values")
    axes.set_title(panel.title)
    axes.set_ylabel(y.label(symbol(panel.y.quantity)))
    if is_lowest:
        axes.set_xlabel(x.label(symbol(panel.x.quantity)))
    _finish(axes, panel, column, x.factor, y.factor)


def _curve(axes: Axes, curve: Curve, panel: Panel, factors, colour: str) -> None:
    at = np.asarray(panel.values if curve.x is None else curve.x, float) * factors[0]
    values = np.asarray(curve.y, float) * factors[1]
    look = {"color": colour, **curve.look}
    label = symbol(curve.label) or None
    if curve.band is None:
        axes.plot(at, values, label=label, **look)
        return
    low, high = (np.asarray(end, float) * factors[1] for end in curve.band)
    if curve.has_bars:
        reach = np.stack([values - low, high - values])
        axes.errorbar(at, values, reach, **{"capsize": 3, **look}, label=label)
        return
    axes.fill_between(at, low, high, color=look["color"], **_BAND, label=curve.band_label or None)
    axes.plot(at, values, label=label, **look)


def _mark(axes: Axes, mark: Mark, factor: float) -> None:
    look = {"color": GREY, **mark.look}
    label = mark.label or None
    if mark.until is not None:
        span = axes.axvspan if mark.axis == "x" else axes.axhspan
        span(mark.at * factor, mark.until * factor, label=label, **{"linewidth": 0, **look})
        return
    line = axes.axvline if mark.axis == "x" else axes.axhline
    line(mark.at * factor, label=label, **{"linewidth": 0.9, **look})


def _finish(axes: Axes, panel: Panel, column: Sequence[Panel], x_factor: float, y_factor: float):
    """Scales and limits; those of x are of all panels in the `column` that shares it. An axis with
    no number that a logarithm takes is linear."""
    ends = [limits for each in column if (limits := _along(each)) is not None]
    own = (min(low for low, _ in ends), max(high for _, high in ends)) if ends else (None, None)
    for axis, drawn, limits, put in (
        (panel.x, axes.xaxis, tuple(_limited(own, panel.x, x_factor)), axes.set_xlim),
        (panel.y, axes.yaxis, tuple(_limited(_up(panel), panel.y, y_factor)), axes.set_ylim),
    ):
        if not axis.is_log:
            put(*limits)
        elif None not in limits:
            axes.set(**{f"{drawn.axis_name}scale": "log"})
            if limits[0] != limits[1]:
                put(*limits)
            log_ticks(drawn, *drawn.get_view_interval())


def _limited(own: tuple[Any, Any], axis: PanelAxis, factor: float) -> Iterator[float | None]:
    """The axis's own limits where it has any, else those given, in the unit that is drawn; none
    where a number is too small for a logarithm."""
    for given, end in zip(own, axis.limits, strict=True):
        chosen = given if end is None else end
        drawn = None if chosen is None else chosen * factor
        yield None if axis.is_log and drawn is not None and drawn < LEAST_LOG else drawn


def _finite(values: Iterator[Any]) -> np.ndarray:
    every = [np.ravel(np.asarray(each, float)) for each in values]
    joined = np.concatenate(every) if every else np.zeros(0)
    return joined[np.isfinite(joined)]


def _along(panel: Panel) -> tuple[float, float] | None:
    values = _finite(_along_x(panel))
    values = values[values > 0] if panel.x.is_log else values
    if not values.size or values.min() == values.max():
        return None
    return float(values.min()), float(values.max())


def _up(panel: Panel) -> tuple[float | None, float | None]:
    values = _finite(_along_y(panel))
    if panel.y.is_log:
        values = values[values > 0]
        return (values.min() / 1.5, values.max() * 1.5) if values.size else (None, None)
    if not values.size or np.ptp(values) == 0:
        return None, None
    margin = _MARGIN * np.ptp(values)
    return values.min() - margin, values.max() + margin


def log_ticks(axis: Any, low: float, high: float) -> None:
    """Numbers as they are spoken, where the axis spans few decades."""
    if not 0 < low < high or np.log10(high / low) > _FEW_TICKS:
        return
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: typeset(f"{value:g}")))
    axis.set_minor_formatter(NullFormatter())
