"""A feature's fit: signal, residual, traction with its band, and correlation of parameters."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from .style import (
    GREY,
    MM_PER_M,
    NORMAL_90,
    TRUTH,
    colours,
    grid_of_axes,
    legend_below,
    legend_beside,
    names_of,
    peak,
    pressure_scale,
    scale,
    styled,
    symbol,
    units_of,
)

_FIT = "#d55e00"
_DATA = "#b5bcc2"


@styled
def feature_signals(dataset: xarray.Dataset) -> Figure:
    """Each element's signal with the fit, and below it the residual over the noise.

    Against position where the motion never turns back, else against time.
    """
    position, time = dataset["position"].values, dataset["time"].values
    onwards = np.all(np.diff(position) > 0) or np.all(np.diff(position) < 0)
    at, label = (position * MM_PER_M, "position x [mm]") if onwards else (time, "time [s]")
    elements = names_of(dataset["element"])
    heights = [2.2, 1.0] * len(elements)
    figure, grid = grid_of_axes(2 * len(elements), 1, 1.5, sharex=True, height_ratios=heights)
    for row, name in enumerate(elements):
        above, below = grid[2 * row, 0], grid[2 * row + 1, 0]
        signal, fitted = dataset["signal"].values[row], dataset["fitted_signal"].values[row]
        unit = scale(units_of(dataset["signal"]), signal, fitted)
        above.plot(at, signal * unit.factor, color=_DATA, linewidth=2.6, label="recorded")
        above.plot(at, fitted * unit.factor, color=_FIT, label="fitted")
        above.set(title=f"Element {name}", ylabel=unit.label("signal"))
        left = dataset["whitened_residual"].values[row]
        below.plot(at, left, color=GREY, linewidth=0.6, label="recorded less fitted, over noise")
        for sign in (-1, 1):
            below.axhline(
                sign * NORMAL_90, color=TRUTH, linewidth=0.9, linestyle="--",
                label=f"±{NORMAL_90}: 90 % of normal noise lies between",
            )  # fmt: skip
        reach = max(4.0, 1.05 * peak(left))
        below.set(ylim=(-reach, reach), ylabel="residual [1]")
    grid[-1, 0].set(xlabel=label, xlim=(at.min(), at.max()))
    figure.suptitle("Signal, the fitted feature's signal, and what is left")
    legend_below(figure, grid.flat)
    return figure


@styled
def feature_traction(dataset: xarray.Dataset) -> Figure:
    """p and q of the fitted feature over the scan, with their 90 % bands."""
    x, position = dataset["x"].values, dataset["position"].values
    inside = (x >= position.min()) & (x <= position.max())
    at, components = x[inside] * MM_PER_M, names_of(dataset["component"])
    figure, grid = grid_of_axes(len(components), 1, 2.0, sharex=True)
    for axes, name in zip(grid[:, 0], components, strict=True):
        value = dataset["estimate"].sel(component=name).values[inside]
        half = NORMAL_90 * dataset["estimate_stderr"].sel(component=name).values[inside]
        half = np.where(np.isfinite(half), half, np.nan)
        unit = pressure_scale(units_of(dataset["estimate"]), value)
        colour = colours([name])[name]
        low, high = (value - half) * unit.factor, (value + half) * unit.factor
        axes.fill_between(at, low, high, color=colour, alpha=0.25, linewidth=0, label="90 % band")
        axes.plot(at, value * unit.factor, color=colour, label=f"{name}, fitted")
        axes.set_ylabel(unit.label(name))
        margin = 0.15 * max(peak(value * unit.factor), 1e-9)
        axes.set_ylim(
            min(0.0, (value * unit.factor).min()) - margin,
            max(0.0, (value * unit.factor).max()) + margin,
        )
        legend_beside(axes)
    grid[0, 0].set_title("Pressure, positive into the finger")
    grid[-1, 0].set_title("Shear, positive along +x on the finger")
    grid[-1, 0].set(xlabel="position x [mm]", xlim=(at[0], at[-1]))
    failed = " (the fit failed)" if dataset.attrs.get("quality") == "failed" else ""
    figure.suptitle(f"Traction of the fitted feature, above its surroundings{failed}")
    return figure


@styled
def correlation(dataset: xarray.Dataset) -> Figure:
    """The correlation of the errors of every two parameters."""
    names = [symbol(name) for name in names_of(dataset["parameter"])]
    values = dataset["correlation"].values
    side = 1.6 + 0.55 * len(names)
    figure = Figure(figsize=(side + 3.2, side + 0.6), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(np.nan_to_num(values), vmin=-1, vmax=1, cmap="RdBu_r")
    axes.set_xticks(range(len(names)), names, rotation=35, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.grid(visible=False)
    for i, j in np.ndindex(values.shape):
        text = f"{values[i, j]:.2f}" if np.isfinite(values[i, j]) else "not known"
        dark = np.isfinite(values[i, j]) and abs(values[i, j]) > 0.6
        axes.text(j, i, text, ha="center", va="center", color="white" if dark else TRUTH)
    figure.colorbar(image, ax=axes, label="correlation of errors [1]")
    figure.suptitle("Which parameters are hard to tell apart")
    return figure
