"""Variables of a dataset as curves over one of their dimensions."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from ..text import spoken
from .panels import Curve, Mark, Panel, PanelAxis, panels
from .style import LINE_STYLES, NORMAL_90, TRUTH, colours, units_of


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
    limits: tuple[float | None, float | None] = (None, None),
    height_in: float = 2.2,
) -> Figure:
    """Curves of variables over the coordinate `x`, by default their last dimension.

    - `names`: one panel holds them all; they have the same units. Of a variable NAME that has a
      NAME_stderr beside it the band of 90 % is drawn.
    - `rows`: a dimension of which every label has a panel of its own; each label of the other
      dimensions is a line.
    - `quantity`, `along`: the words on the axes, by default the variable's name and the
      coordinate's; `labels`: words in the legend for the variables' names.
    - `log`: the axes with a logarithmic scale, "x", "y" or "xy"; `limits` of y, in SI units.
    """
    names = [names] if isinstance(names, str) else list(names)
    first = dataset[names[0]]
    x = x or str(first.dims[-1])
    across = PanelAxis(along or spoken(x), units_of(dataset[x]), "x" in log)
    up = PanelAxis(quantity or spoken(names[0]), units_of(first), "y" in log, limits)
    parts = [
        Panel(
            _distinct(list(_curves(part, names, x, labels or {}))),
            across, up, np.asarray(dataset[x].values, float), panel, marks,
        )
        for panel, part in _by(dataset, rows)
    ]  # fmt: skip
    return panels(parts, title, height_in=height_in)


def _by(dataset: xarray.Dataset, rows: str | None) -> Iterator[tuple[str, xarray.Dataset]]:
    if rows is None:
        yield "", dataset
        return
    for i, label in enumerate(dataset[rows].values):
        yield spoken(label), dataset.isel({rows: i})


def _curves(
    dataset: xarray.Dataset, names: Sequence[str], x: str, labels: Mapping[str, str]
) -> Iterator[Curve]:
    for name in names:
        array = dataset[name].transpose(..., x)
        stderr = dataset.get(f"{name}_stderr")
        word = labels.get(name, spoken(name) if len(names) > 1 else "")
        others = [dim for dim in array.dims if dim != x]
        for at in np.ndindex(array.shape[:-1]):
            place = dict(zip(others, at, strict=True))
            own = [spoken(dataset[dim].values[i]) for dim, i in place.items()]
            band = None
            if stderr is not None:
                half = NORMAL_90 * stderr.transpose(..., x).values[at]
                band = array.values[at] - half, array.values[at] + half
            label = ", ".join(filter(None, [*own, word]))
            yield Curve(array.values[at], label, band=band)


def _distinct(lines: list[Curve]) -> list[Curve]:
    """Each line with a colour and a style of its own; the truth is black."""
    palette = colours([line.label for line in lines])
    styles = itertools.cycle(LINE_STYLES)
    looks: dict[str, dict[str, Any]] = {
        label: {"color": TRUTH if label.startswith("true") else colour, "linestyle": next(styles)}
        for label, colour in palette.items()
    }
    return [
        Curve(line.y, line.label, band=line.band, look=looks[line.label], band_label="90 % band")
        if line.band is not None
        else Curve(line.y, line.label, look=looks[line.label])
        for line in lines
    ]
