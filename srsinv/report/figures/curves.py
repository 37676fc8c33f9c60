"""Curves over other quantities than x, in the style of the page."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .style import LINE_STYLES, colours, grid_of_axes, legend_below, legend_beside, styled


@styled
def figure(
    x: np.ndarray,
    lines: Mapping[str, Any],
    xlabel: str,
    ylabel: str,
    *,
    logarithmic: str = "",
) -> Figure:
    """One panel of curves (x,) by label; `logarithmic` names the logarithmic axes, "xy" both."""
    picture, grid = grid_of_axes(1, 1, 3.2)
    axes = grid[0, 0]
    for name, colour in colours(lines).items():
        axes.plot(x, lines[name], color=colour, label=name)
    axes.set(xlabel=xlabel, ylabel=ylabel, xlim=(x[0], x[-1]))
    axes.set(**{f"{axis}scale": "log" for axis in logarithmic})
    legend_beside(axes)
    return picture


@styled
def with_spread(
    x: np.ndarray,
    panels: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]],
    levels: Mapping[str, Mapping[str, float]],
    xlabel: str,
    ylabel: str,
) -> Figure:
    """Panels by title: curves by label with samples (x, draw) and predictions (x,).

    Samples are drawn as their mean with least and greatest, predictions dashed in the same colour;
    `levels` are horizontal lines by title and label. The y axis is logarithmic.
    """
    picture, grid = grid_of_axes(len(panels), 1, 2.9, sharex=True)
    for axes, (title, lines) in zip(grid[:, 0], panels.items(), strict=True):
        for name, colour in colours(lines).items():
            samples, predicted = lines[name]
            mean = samples.mean(axis=-1)
            reach = np.stack([mean - samples.min(axis=-1), samples.max(axis=-1) - mean])
            axes.errorbar(x, mean, reach, color=colour, marker="o", capsize=3, label=name)
            axes.plot(x, predicted, "--", color=colour, label=f"{name}, predicted")
        for label, level in levels[title].items():
            axes.axhline(level, color="black", linestyle=":", label=label)
        axes.set(title=title, ylabel=ylabel, yscale="log")
        legend_beside(axes)
    grid[-1, 0].set_xlabel(xlabel)
    return picture


@styled
def stacked(
    x: np.ndarray,
    panels: Mapping[str, Mapping[str, np.ndarray]],
    xlabel: str,
    ylabel: str,
) -> Figure:
    """Panels by title, of curves (x,) by label, over one logarithmic x; with common labels."""
    picture, grid = grid_of_axes(len(panels), 1, 1.9, sharex=True)
    for axes, (title, lines) in zip(grid[:, 0], panels.items(), strict=True):
        for i, (name, colour) in enumerate(colours(lines).items()):
            style = LINE_STYLES[i % len(LINE_STYLES)]
            axes.plot(x, lines[name], style, color=colour, label=name)
        axes.set(title=title, ylabel=ylabel, xscale="log")
    grid[-1, 0].set_xlabel(xlabel)
    legend_below(picture, [grid[0, 0]])
    return picture


@styled
def levels(names: Sequence[str], series: Mapping[str, np.ndarray], ylabel: str) -> Figure:
    """Positive values (name,) by label as marks over names, on a logarithmic axis; a label that
    ends with a number has that number as a dashed level of its own."""
    picture, grid = grid_of_axes(1, 1, 3.4)
    axes = grid[0, 0]
    for label, colour in colours(series).items():
        values = np.where(series[label] > 0, series[label], np.nan)
        axes.plot(names, values, "o", color=colour, label=label)
        axes.axhline(float(label.split()[-1]), color=colour, linestyle="--", linewidth=1.0)
    axes.set(ylabel=ylabel, yscale="log")
    axes.tick_params(axis="x", rotation=30)
    legend_beside(axes)
    return picture
