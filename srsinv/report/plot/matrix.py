"""Matrices: one coloured cell for each pair of labels, with its number."""

from collections.abc import Hashable
from typing import Any

import numpy as np
import xarray
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from ..text import spoken, typeset, without_unit
from .style import GREY, SHADE, WIDTH_IN, names_of, styled, symbol, units_of

_CELL_IN, _LARGE_CELL_IN = 0.27, 0.5
_MANY = 12  # rows, from which on they are low
_FAINT = 0.005  # of the largest value of linear colours: less is written as 0
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
    """Draw a matrix of values, a colour and a number in each cell; NaN is grey.

    - `dataset`: of a result. `name`: the variable (row, column). `title`: of the figure.
    - `words`: the name of a variable of the same dimensions with the text of each cell; by default
      the value, see [`compact`][].
    - `panels`: a third dimension, of which every label has a panel beside the others.
    - `limits` of the colours, symmetric ones for values of either sign; `label` of the colours;
      `is_log`: whether they are logarithmic.
    """
    array = dataset[name]
    array = array.expand_dims("panel") if panels is None else array.transpose(panels, ...)
    shape = array.shape
    texts = None if words is None else dataset[words].transpose(*array.dims, missing_dims="ignore")
    own = [None] * shape[0] if texts is None else np.broadcast_to(texts.values, shape)
    low, high = limits or (float(np.nanmin(array)), float(np.nanmax(array)))
    norm = LogNorm(low, high, clip=True) if is_log else Normalize(low, high, clip=True)
    palette = "RdBu_r" if low < 0 < high else "cividis_r" if is_log else "Blues"
    colours = ScalarMappable(norm, palette)
    cell = _CELL_IN if shape[1] > _MANY else _LARGE_CELL_IN
    figure = Figure(figsize=(WIDTH_IN, cell * shape[1] + 2.2), layout="constrained")
    grid = figure.subplots(1, shape[0], squeeze=False, sharey=True)[0]
    for p, axes in enumerate(grid):
        axes.imshow(array.values[p], norm=colours.norm, cmap=colours.cmap, aspect="auto")
        faint = 0.0 if is_log else _FAINT * max(abs(low), abs(high))
        _letter(axes, array.values[p], own[p], colours.norm, faint, is_signed=low < 0 < high)
        axes.set_title("" if panels is None else spoken(dataset[panels].values[p]))
    _name(grid, dataset, array.dims[1:])
    text = label or f"{spoken(name)} [{units_of(array)}]"
    figure.colorbar(colours, ax=list(grid), label=text, location="bottom", fraction=0.05, pad=0.02)
    figure.suptitle(title)
    return figure


def compact(value: float) -> str:
    """The value in four letters, so that it fits into a cell: 0.03, 1.2, 120, 10⁵; a dash for what
    is no number."""
    if not np.isfinite(value):
        return "–" if np.isnan(value) else str(value)
    size = abs(value)
    text = f"{value:.0f}" if 10 <= size < 1000 else f"{value:.{1 + (0.1 <= size < 10)}g}"
    text = f"{value:.0e}" if 0 < size < 1e-3 else text
    return typeset(text).replace("\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}", "·")


def _letter(
    axes, values: np.ndarray, words: np.ndarray | None, norm, faint: float, is_signed: bool
) -> None:
    """In each cell its words, or else its value, 0 up to `faint`, white where the colour is
    dark."""
    size = 7.5 if len(values) > _MANY else 9
    for (row, column), value in np.ndenumerate(values):
        value = 0.0 if abs(value) < faint else value
        text = compact(float(value)) if words is None else str(words[row, column])
        depth = abs(2 * norm(value) - 1) if is_signed else norm(value)
        is_dark = np.isfinite(value) and float(depth) > _DARK
        colour = GREY if not np.isfinite(value) else "white" if is_dark else "black"
        axes.text(column, row, text, ha="center", va="center", fontsize=size, color=colour)


def _name(grid, dataset: xarray.Dataset, dims: tuple[Hashable, ...]) -> None:
    """Labels of the rows and columns, which are of these dimensions, on all panels."""
    rows, columns = (
        [symbol(without_unit(each)) for each in names_of(dataset[dim])] for dim in dims
    )
    for axes in grid:
        axes.set_facecolor(SHADE)
        axes.set_xticks(range(len(columns)), columns, rotation=35, ha="right")
        axes.set_yticks(range(len(rows)), rows)
        axes.grid(visible=False)
        axes.tick_params(length=0)
    up, along = (str(dataset[dim].attrs.get("long_name", "")) for dim in dims)
    grid[0].set(xlabel=along, ylabel=up)
