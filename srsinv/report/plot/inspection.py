"""A recording as in its file: signals, spectra and motion, with suspect parts marked."""

import math
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import (
    PALETTE,
    SHADE,
    TRUTH,
    WIDTH_IN,
    grid_of_axes,
    legend_below,
    names_of,
    note,
    scale,
    shown,
    styled,
    units_of,
)

_MOST_POINTS = 6000  # of one curve: more than the page has pixels
_MOST_PANELS = 24  # signals that are drawn
_MOST_GAPS = 200  # gaps that are shaded, the longest ones
_TALL = 4  # signals that each get the full width
_BLUE, _RED = PALETTE[0], PALETTE[1]


@styled
def recorded_signals(dataset: xarray.Dataset) -> Figure:
    """Each signal over time; gaps of the times shaded, flat stretches at the extremes marked."""
    names = names_of(dataset["signal"])[:_MOST_PANELS]
    figure, panels = _panels(len(names), 1.7)
    for row, (axes, name) in enumerate(zip(panels, names, strict=True)):
        values = dataset["value"].values[row]
        unit = scale(str(dataset["signal_unit"].values[row]), values)
        _curve(axes, dataset["time"].values, values * unit.factor, _BLUE, "signal")
        _flat(axes, dataset, row, unit.factor)
        _shade_gaps(axes, dataset)
        axes.set_title(name)
        axes.set_ylabel(f"[{unit.unit}]")
    _label_below(figure, panels, _time_label(dataset))
    figure.suptitle(f"The signals as recorded{_of_how_many(dataset)}")
    legend_below(figure, panels)
    return figure


@styled
def noise_spectra(dataset: xarray.Dataset) -> Figure:
    """Amplitude density of each signal with its noise floor and its strongest lines."""
    names = names_of(dataset["signal"])[:_MOST_PANELS]
    figure, panels = _panels(len(names), 2.0)
    frequency = dataset["frequency"].values
    for row, (axes, name) in enumerate(zip(panels, names, strict=True)):
        density = dataset["density"].values[row]
        axes.set_title(name)
        if not np.any(density > 0):
            note(axes, "constant, too short for a spectrum, or too small to draw")
            continue
        unit = scale(str(dataset["signal_unit"].values[row]), density)
        axes.loglog(frequency, density * unit.factor, color=_BLUE, linewidth=1.0, label="density")
        floor = float(dataset["noise_floor"].values[row]) * unit.factor
        axes.axhline(floor, color=TRUTH, linestyle="--", linewidth=1.0, label="noise floor")
        _mark_lines(axes, dataset, row, unit.factor)
        per = "Hz" if units_of(dataset["frequency"]) == "Hz" else "(1/sample)"
        axes.set_ylabel(f"[{unit.unit}/√{per}]")
    _label_below(figure, panels, f"frequency [{units_of(dataset['frequency'])}]")
    figure.suptitle(
        f"How much there is at which frequency: amplitude density{_of_how_many(dataset)}"
    )
    legend_below(figure, panels)
    return figure


@styled
def recorded_motion(dataset: xarray.Dataset) -> Figure:
    """Speed and position over time, as far as the file has them."""
    names = [name for name in ("speed", "position") if name in dataset]
    figure, grid = grid_of_axes(len(names), 1, 1.9, sharex=True)
    for axes, name in zip(grid[:, 0], names, strict=True):
        values = dataset[name].values
        time = dataset["time"].values[: values.size]
        _curve(axes, time, values[: time.size] * 1e3, _BLUE, name)
        _shade_gaps(axes, dataset)
        unit = {"speed": "mm/s", "position": "mm"}[name]
        axes.set(title=f"Measured {name}", ylabel=f"{name} [{unit}]")
        if not shown(values):
            note(axes, "no values")
    grid[-1, 0].set_xlabel(_time_label(dataset))
    figure.suptitle("How the sensor moved")
    legend_below(figure, grid[:, 0])
    return figure


def _panels(count: int, height_in: float) -> tuple[Figure, list[Axes]]:
    """A panel for each signal: full width for a few, two beside each other for many."""
    columns = 1 if count <= _TALL else 2
    rows = math.ceil(count / columns)
    # Many signals are compared in small panels.
    height_in *= 1.0 if columns == 1 else 0.75
    figure, grid = grid_of_axes(rows, columns, height_in, sharex=True)
    panels = list(grid.flat)
    for axes in panels[count:]:
        axes.remove()
    figure.set_size_inches(WIDTH_IN, rows * height_in + 1.1)
    return figure, panels[:count]


def _of_how_many(dataset: xarray.Dataset) -> str:
    count = dataset.sizes["signal"]
    return f" (the first {_MOST_PANELS} of {count})" if count > _MOST_PANELS else ""


def _label_below(figure: Figure, panels: list[Axes], label: str) -> None:
    """The label under the lowest panel of each column."""
    columns = 1 if len(panels) <= _TALL else 2
    for axes in panels[-columns:]:
        axes.set_xlabel(label)
        axes.tick_params(labelbottom=True)


def _time_label(dataset: xarray.Dataset) -> str:
    unit = units_of(dataset["time"])
    return "time since the first sample [s]" if unit == "s" else "sample [1]"


def _curve(axes: Axes, time: np.ndarray, values: np.ndarray, colour: str, label: str) -> None:
    """A curve; of a long one the least and the greatest value in each of many short stretches."""
    block = math.ceil(2 * values.size / _MOST_POINTS)
    if block > 2:
        used = values.size // block * block
        blocks = values[:used].reshape(-1, block)
        low = np.min(blocks, axis=1, where=np.isfinite(blocks), initial=np.inf)
        high = np.max(blocks, axis=1, where=np.isfinite(blocks), initial=-np.inf)
        values = np.stack([low, high], axis=1).ravel()
        values = np.where(np.isfinite(values), values, np.nan)
        time = np.repeat(time[:used:block], 2)
    axes.plot(time, values, color=colour, linewidth=1.0, label=label)


def _flat(axes: Axes, dataset: xarray.Dataset, row: int, factor: float) -> None:
    flat = dataset["flat"].values[row].astype(bool)
    if flat.any():
        at = np.flatnonzero(flat)
        at = at[:: math.ceil(at.size / _MOST_POINTS)]
        time, values = dataset["time"].values[at], dataset["value"].values[row][at]
        look: dict[str, Any] = {"color": _RED, "markersize": 4, "zorder": 3}
        axes.plot(time, values * factor, "o", **look, label="flat at the extreme: clipped?")


def _shade_gaps(axes: Axes, dataset: xarray.Dataset) -> None:
    starts, ends = dataset["gap_start"].values, dataset["gap_end"].values
    longest = np.sort(np.argsort(starts - ends, kind="stable")[:_MOST_GAPS])
    for i, (start, end) in enumerate(zip(starts[longest], ends[longest], strict=True)):
        label = "gap in the times" if i == 0 else None
        # Over the curve, which joins the gap's ends.
        axes.axvspan(start, end, color=SHADE, linewidth=0, zorder=2.5, label=label)


def _mark_lines(axes: Axes, dataset: xarray.Dataset, row: int, factor: float) -> None:
    at = dataset["line_frequency"].values[row]
    at = at[np.isfinite(at)]
    if not at.size:
        return
    frequency, density = dataset["frequency"].values, dataset["density"].values[row] * factor
    heights = density[np.searchsorted(frequency, at * (1 - 1e-9))]
    unit = units_of(dataset["frequency"])
    axes.plot(at, heights, "v", color=_RED, markersize=5, label=f"strongest lines [{unit}]")
    for x, y in zip(at, heights, strict=True):
        axes.annotate(
            f"{x:.3g}", (x, y), (5, 3), textcoords="offset points", color=_RED, fontsize=8
        )
