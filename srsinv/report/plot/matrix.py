"""Matrices: one coloured cell for each pair of labels, with its number."""

from typing import Any

import numpy as np
import xarray
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from ..text import spoken, without_unit
from .style import GREY, SHADE, WIDTH_IN, names_of, styled, symbol, units_of

_CELL_IN, _LARGE_CELL_IN = 0.27, 0.5
_MANY = 12  # rows, from which on they are low
_DARK = 0.55  # of the colours' range, from which on words are white


@styled
def matrix(
    dataset: xarray.Dataset,
    name: str,
    words: Any = None,
    *,
    panels: str | None = None,
    label: str = "",
    limits: tuple[float, float] | None = None,
    is_log: bool = False,
    title: str = "",
) -> Figure:
    """Values (row, column) of the variable `name`, a colour and a number in each cell; NaN is grey.

    - `words`: the name of a variable of the same dimensions with the text of each cell; by default
      the value, see [`compact`][].
    - `panels`: a third dimension, of which every label has a panel beside the others.
    - `limits` of the colours, symmetric ones for values of either sign; `label` of the colours.
    """
    array = dataset[name]
    array = array.expand_dims("panel") if panels is None else array.transpose(panels, ...)
    dims = array.dims[1:]
    texts = None if words is None else dataset[words].transpose(*array.dims, missing_dims="ignore")
    rows, columns = (
        [symbol(without_unit(each)) for each in names_of(dataset[dim])] for dim in dims
    )
    cell = _CELL_IN if len(rows) > _MANY else _LARGE_CELL_IN
    figure = Figure(figsize=(WIDTH_IN, cell * len(rows) + 2.2), layout="constrained")
    grid = figure.subplots(1, array.shape[0], squeeze=False, sharey=True)[0]
    low, high = limits or (float(np.nanmin(array)), float(np.nanmax(array)))
    norm = LogNorm(low, high, clip=True) if is_log else Normalize(low, high, clip=True)
    is_signed = low < 0 < high
    image = None
    for p, axes in enumerate(grid):
        values = array.values[p]
        axes.set_facecolor(SHADE)
        colours = "RdBu_r" if is_signed else "cividis_r" if is_log else "Blues"
        image = axes.imshow(values, norm=norm, cmap=colours, aspect="auto")
        for at, value in np.ndenumerate(values):
            own = None if texts is None else texts.values.reshape(array.shape)[p][at]
            _letter(axes, at, value, own, norm, is_signed, len(rows))
        axes.set_xticks(range(len(columns)), columns, rotation=35, ha="right")
        axes.set_yticks(range(len(rows)), rows)
        axes.set_title("" if panels is None else spoken(dataset[panels].values[p]))
        axes.grid(visible=False)
        axes.tick_params(length=0)
    for d, put in zip(dims, (grid[0].set_ylabel, grid[0].set_xlabel), strict=True):
        put(str(dataset[d].attrs.get("long_name", "")))
    assert image is not None
    text = label or f"{spoken(name)} [{units_of(array)}]"
    figure.colorbar(image, ax=list(grid), label=text, location="bottom", fraction=0.05, pad=0.02)
    figure.suptitle(title)
    return figure


def compact(value: float) -> str:
    """The value in four letters, so that it fits into a cell: 0.03, 1.2, 120, 1e5; a dash for what
    is no number."""
    if not np.isfinite(value):
        return "–" if np.isnan(value) else str(value)
    size = abs(value)
    text = f"{value:.0f}" if 10 <= size < 1000 else f"{value:.{1 + (0.1 <= size < 10)}g}"
    text = f"{value:.0e}" if 0 < size < 1e-3 else text
    return text.replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")


def _letter(axes, at, value, words, norm, is_signed: bool, rows: int) -> None:
    text = str(words) if words is not None else compact(float(value))
    depth = abs(2 * norm(value) - 1) if is_signed else norm(value)
    is_dark = np.isfinite(value) and float(depth) > _DARK
    colour = GREY if not np.isfinite(value) else "white" if is_dark else "black"
    size = 7.5 if rows > _MANY else 9
    axes.text(at[1], at[0], text, ha="center", va="center", fontsize=size, color=colour)
