"""Matrices of cases and methods: one coloured cell for each pair, with its number."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from .style import GREY, SHADE, WIDTH_IN, styled

CELL_IN = 0.27


@styled
def matrices(
    panels: Mapping[str, tuple[np.ndarray, np.ndarray]],
    rows: Sequence[str],
    columns: Sequence[str],
    label: str,
    limits: tuple[float, float],
) -> Figure:
    """Panels by title beside each other: positive values (row, column), coloured on a logarithmic
    scale between `limits`, and the text (row, column) of each cell. NaN is grey."""
    height = CELL_IN * len(rows) + 2.4
    figure = Figure(figsize=(WIDTH_IN, height), layout="constrained")
    grid = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    norm, image = LogNorm(*limits, clip=True), None
    for axes, (title, (values, words)) in zip(grid, panels.items(), strict=True):
        axes.set_facecolor(SHADE)
        image = axes.imshow(values, norm=norm, cmap="cividis_r", aspect="auto")
        for (row, column), word in np.ndenumerate(words):
            value = values[row, column]
            dark = np.isfinite(value) and norm(value) > 0.55
            colour = GREY if np.isnan(value) else "white" if dark else "black"
            axes.text(column, row, word, ha="center", va="center", fontsize=7.5, color=colour)
        axes.set_xticks(range(len(columns)), columns, rotation=40, ha="right")
        axes.set_yticks(range(len(rows)), rows)
        axes.set_title(title)
        axes.grid(visible=False)
        axes.tick_params(length=0)
    assert image is not None
    figure.colorbar(image, ax=list(grid), label=label, location="bottom", fraction=0.03, pad=0.01)
    return figure
