"""Variables of a dataset as curves over one of their dimensions."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from ...numerics import BAND_90
from ..text import spoken
from .panels import Curve, Mark, Panel, PanelAxis, panels
from .style import LINE_STYLES, TRUTH, colours, units_of

Limits = tuple[float | None, float | None]
Look = Mapping[str, Any]
Ends = tuple[xarray.DataArray, xarray.DataArray]


def panel(
    lines: Mapping[str, xarray.DataArray],
    *,
    looks: Mapping[str, Look] | None = None,
    stderrs: Mapping[str, xarray.DataArray] | None = None,
    bars: Mapping[str, Ends] | None = None,
    quantity: str | None = None,
    along: str | None = None,
    log: str = "",
    limits: Limits = (None, None),
    within: Limits = (None, None),
    title: str = "",
    marks: Sequence[Mark] = (),
) -> Panel:
    """Make a panel of lines, each an array over its only dimension, for [`panels`][].

    - `lines`: by their labels in the legend, arrays (n,) with their coordinate, of one unit, and so
      are the coordinates; a line's n is its own.
    - `looks`: matplotlib's properties of lines, by their labels; `stderrs`: standard errors (n,),
      drawn as a band of 90 %; `bars`: the least and the greatest (n,) about a line.
    - `quantity`, `along`: the words on the axes, by default the first line's name and its
      coordinate's; `log`: the axes with a logarithmic scale, "x", "y" or "xy"; `limits` of y and
      `within` of x, in SI units.
    - `marks`: lines and areas across the panel. `title`: above it.
    """
    first = next(iter(lines.values()))
    at = first[first.dims[0]]
    across = PanelAxis(along or spoken(at.name), units_of(at), "x" in log, within)
    up = PanelAxis(quantity or spoken(first.name), units_of(first), "y" in log, limits)
    looks, stderrs, bars = looks or {}, stderrs or {}, bars or {}
    drawn = [
        Curve(
            line.values, label, x=np.asarray(line[line.dims[0]].values, float),
            band=_ends(line, stderrs.get(label), bars.get(label)), look=looks.get(label, {}),
            band_label="90 % band" if label in stderrs else "", has_bars=label in bars,
        )
        for label, line in lines.items()
    ]  # fmt: skip
    return Panel(drawn, across, up, np.asarray(at.values, float), title, marks)


def _ends(
    line: xarray.DataArray, stderr: xarray.DataArray | None, bar: Ends | None
) -> tuple[np.ndarray, np.ndarray] | None:
    if stderr is None:
        return None if bar is None else (bar[0].values, bar[1].values)
    half = BAND_90 * stderr.values
    return line.values - half, line.values + half


def curves(
    dataset: xarray.Dataset,
    names: str | Sequence[str],
    x: str | None = None,
    *,
    rows: str | None = None,
    quantity: str | None = None,
    along: str | None = None,
    labels: Mapping[str, str] | None = None,
    log: str = "",
    marks: Sequence[Mark] = (),
    title: str = "",
    limits: Limits = (None, None),
    height_in: float = 2.2,
) -> Figure:
    """Draw variables of a dataset as curves over a coordinate.

    - `dataset`: of a result. `x`: the coordinate, by default the variables' last dimension.
    - `names`: one panel holds them all; they have the same units. Of a variable NAME that has a
      NAME_stderr beside it the band of 90 % is drawn.
    - `rows`: a dimension of which every label has a panel of its own; each label of the other
      dimensions is a line.
    - `quantity`, `along`: the words on the axes, by default the variable's name and the
      coordinate's; `labels`: words in the legend for the variables' names.
    - `log`: the axes with a logarithmic scale, "x", "y" or "xy"; `limits` of y, in SI units.
    - `marks`: lines and areas across the panels. `title`: of the figure. `height_in` [inch]: of a
      panel.
    """
    names = [names] if isinstance(names, str) else list(names)
    x = x or str(dataset[names[0]].dims[-1])
    parts = []
    for label, part in _by(dataset, rows):
        lines = dict(_lines(part, names, x, labels or {}))
        stderrs = dict(_lines(part, names, x, labels or {}, "_stderr"))
        parts.append(
            panel(
                lines, stderrs=stderrs, looks=_distinct(lines), title=label, marks=marks,
                quantity=quantity or spoken(names[0]), along=along, log=log, limits=limits,
            )
        )  # fmt: skip
    return panels(parts, title, height_in=height_in)


def _by(dataset: xarray.Dataset, rows: str | None) -> Iterator[tuple[str, xarray.Dataset]]:
    if rows is None:
        yield "", dataset
        return
    for i, label in enumerate(dataset[rows].values):
        named = f"Element {label}" if rows == "element" else spoken(label)
        yield named, dataset.isel({rows: i})


def _lines(
    dataset: xarray.Dataset, names: Sequence[str], x: str, labels: Mapping[str, str], end: str = ""
) -> Iterator[tuple[str, xarray.DataArray]]:
    """Lines of the variables NAME + `end`, those that there are, by their labels."""
    for name in names:
        word = labels.get(name, spoken(name) if len(names) > 1 else "")
        others = [dim for dim in dataset[name].dims if dim != x]
        for at in np.ndindex(*(dataset.sizes[dim] for dim in others)):
            place = dict(zip(others, at, strict=True))
            own = [spoken(dataset[dim].values[i]) for dim, i in place.items()]
            if name + end in dataset:
                yield ", ".join(filter(None, [*own, word])), dataset[name + end].isel(place)


def _distinct(labels: Iterable[str]) -> dict[str, Look]:
    """A colour and a style for each label; the truth is black."""
    styles = itertools.cycle(LINE_STYLES)
    return {
        label: {"color": TRUTH if label.startswith("true") else colour, "linestyle": next(styles)}
        for label, colour in colours(labels).items()
    }
