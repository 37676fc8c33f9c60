"""Measured signals, the fit of each method, and the residual."""

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import (
    GREY,
    MM_PER_M,
    NORMAL_90,
    TRUTH,
    along_x,
    colours,
    grid_of_axes,
    legend_below,
    method_lines,
    names_of,
    peak,
    scale,
    shade_unobserved,
    styled,
    units_of,
)


@styled
def signals(dataset: xarray.Dataset) -> Figure:
    """Film current, where it is known, and the signal with the fit of each method."""
    elements, methods = names_of(dataset["element"]), names_of(dataset["method"])
    with_current = "current" in dataset
    figure, grid = grid_of_axes(len(elements), 1 + with_current, 2.0, sharex=True)
    for row, name in enumerate(elements):
        if with_current:
            _current(grid[row, 0], dataset, row)
        _signal(grid[row, -1], dataset, row, methods)
        for axes in grid[row]:
            axes.set_title(f"Element {name}")
            along_x(axes, dataset["x"].values)
    for axes in grid[-1]:
        axes.set_xlabel("position x [mm]")
    beginning = "Film current, and the signal" if with_current else "Signal"
    figure.suptitle(f"{beginning} with what each method fits to it")
    legend_below(figure, grid.flat)
    return figure


@styled
def residual(dataset: xarray.Dataset) -> Figure:
    """Signal less fit, in standard deviations of the noise: white and normal where the noise limits
    the fit."""
    elements, methods = names_of(dataset["element"]), names_of(dataset["method"])
    rows = [(e, m) for e in range(len(elements)) for m in range(len(methods))]
    figure, grid = grid_of_axes(len(rows), 2, 1.6, sharex="col", sharey="row", width_ratios=(4, 1))
    palette = colours(methods)
    for (trace, histogram), (e, m) in zip(grid, rows, strict=True):
        values = dataset["whitened_residual"].values[m, e]
        inside = _percent_inside(values)
        trace.set_title(f"Element {elements[e]}, {methods[m]}{inside}")
        _residual_trace(trace, dataset["x"].values, values, palette[methods[m]])
        _residual_histogram(histogram, values, palette[methods[m]])
    grid[0, 1].set_title("Histogram")
    grid[0, 1].set_xlim(left=0)
    grid[-1, 0].set_xlabel("position x [mm]")
    grid[-1, 1].set_xlabel("density [1]")
    figure.suptitle("Whitened residual: what the fit leaves, in standard deviations of the noise")
    legend_below(figure, grid.flat)
    return figure


def _current(axes: Axes, dataset: xarray.Dataset, row: int) -> None:
    current = dataset["current"].values[row]
    unit = scale(units_of(dataset["current"]), current)
    axes.plot(dataset["x"].values * MM_PER_M, current * unit.factor, color=GREY, label="current")
    axes.set_ylabel(unit.label("current"))


def _signal(axes: Axes, dataset: xarray.Dataset, row: int, methods: list[str]) -> None:
    x = dataset["x"].values * MM_PER_M
    signal = dataset["signal"].values[row]
    fits = dataset["fitted_signal"].values[:, row]
    unit = scale(units_of(dataset["signal"]), signal, fits)
    axes.plot(x, signal * unit.factor, color="#b5bcc2", linewidth=3.0, label="signal")
    if "signal_noise_free" in dataset:
        clean = dataset["signal_noise_free"].values[row]
        axes.plot(x, clean * unit.factor, color=TRUTH, linewidth=0.8, label="signal without noise")
    for (name, look), fit in zip(method_lines(methods).items(), fits, strict=True):
        axes.plot(x, fit * unit.factor, **look, label=f"fit, {name}")
    shade_unobserved(axes, dataset["x"].values, dataset["observed"].values[row].astype(bool))
    axes.set_ylabel(unit.label("signal"))


def _residual_trace(axes: Axes, x_m: np.ndarray, values: np.ndarray, colour: str) -> None:
    axes.plot(x_m * MM_PER_M, values, color=colour, linewidth=0.7)
    along_x(axes, x_m)
    shade_unobserved(axes, x_m, np.isfinite(values))
    axes.set_ylim(-_reach(values), _reach(values))
    axes.set_ylabel("residual [1]")
    for sign in (-1, 1):
        label = f"±{NORMAL_90}: 90 % of normal noise lies between" if sign > 0 else None
        axes.axhline(sign * NORMAL_90, color=TRUTH, linewidth=0.9, linestyle="--", label=label)


def _residual_histogram(axes: Axes, values: np.ndarray, colour: str) -> None:
    edges = np.linspace(-_reach(values), _reach(values), 33)
    present = values[np.isfinite(values)]
    if present.size:
        density = np.histogram(present, edges, density=True)[0]
        axes.stairs(density, edges, orientation="horizontal", fill=True, color=colour, alpha=0.6)
    at = np.linspace(edges[0], edges[-1], 400)
    normal = np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi)
    axes.plot(normal, at, color=TRUTH, linewidth=1.0, label="standard normal")


def _reach(values: np.ndarray) -> float:
    return max(4.0, 1.05 * peak(values))


def _percent_inside(values: np.ndarray) -> str:
    present = values[np.isfinite(values)]
    if not present.size:
        return ""
    percent = 100 * np.mean(np.abs(present) < NORMAL_90)
    return f": {percent:.1f} % of samples between the dashed lines"
