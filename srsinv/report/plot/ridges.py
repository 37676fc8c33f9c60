"""Ridges on a pitch: contact, signal and noise, and the least detectable height."""

from collections.abc import Iterable

import numpy as np
import xarray
from matplotlib.figure import Figure

from .style import (
    GREY,
    MM_PER_M,
    PALETTE,
    SHADE,
    TRUTH,
    colours,
    grid_of_axes,
    legend_beside,
    scale,
    styled,
)

UM_PER_M = 1e6
UV_PER_V = 1e6
_RIDGES_RAW, _RIDGES_SMOOTH = 5, 15  # drawn of the noisy trace, and of the smoothed one


@styled
def contact(dataset: xarray.Dataset, pitch_m: float) -> Figure:
    """`height` and `gap` [m], and `pressure` [Pa] along x, up to three pitches."""
    shown = dataset.sel(x=slice(None, float(dataset["x"][0]) + 3 * pitch_m))
    at, h = shown["x"].values * MM_PER_M, shown["height"].values * UM_PER_M
    figure, grid = grid_of_axes(2, 1, 2.2, sharex=True)
    above, below = grid[:, 0]
    above.fill_between(at, -0.1 * h.max(), h, color=SHADE, linewidth=0)
    above.plot(at, h, color=TRUTH, label="surface")
    skin = h + shown["gap"].values * UM_PER_M
    above.plot(at, skin, color=PALETTE[1], linestyle="--", label="skin")
    above.set(ylabel="height [µm]", title="The skin on the ridges, heights enlarged")
    legend_beside(above)
    p = shown["pressure"].values
    unit = scale("Pa", p)
    below.plot(at, p * unit.factor, color=colours(["p"])["p"], label="pressure p")
    below.axhline(p.mean() * unit.factor, color=GREY, linestyle=":", label="its mean")
    below.set(
        xlabel="position x [mm]",
        ylabel=unit.label("p"),
        title="Pressure: on the ridges, and on the plate between them",
        xlim=(at[0], at[-1]),
    )
    legend_beside(below)
    return figure


@styled
def signal(dataset: xarray.Dataset, pitch_m: float, band_hz: float) -> Figure:
    """`signal` and `data` [V] along `position`, and the amplitude of every wave in the data."""
    figure, grid = grid_of_axes(3, 1, 2.2)
    for axes, key, ridges, title in (
        (grid[0, 0], "data", _RIDGES_RAW, "Signal in the whole band: the ridges drown"),
        (grid[1, 0], "data_in_band", _RIDGES_SMOOTH, f"The same up to {band_hz:.3g} Hz"),
    ):
        near = dataset.sel(position=slice(0, ridges * pitch_m))
        at = near["position"].values * MM_PER_M
        axes.plot(at, UV_PER_V * near[key], color=GREY, linewidth=0.8, label="with noise")
        axes.plot(at, UV_PER_V * near["signal"], color=PALETTE[1], label="without")
        axes.set(ylabel="signal [µV]", xlabel="position [mm]", title=title, xlim=(at[0], at[-1]))
        legend_beside(axes)
    axes = grid[2, 0]
    frequency = dataset["frequency"].values
    axes.plot(frequency, UV_PER_V * dataset["data_amplitude"], color=GREY, label="data")
    by_chance = UV_PER_V * dataset["amplitude_by_chance"]
    axes.plot(frequency, by_chance, color=TRUTH, linestyle="--", label="by chance")
    axes.axvline(band_hz / 2, color=PALETTE[1], linestyle=":", label="pitch")
    axes.set(
        xlabel="frequency [Hz]",
        ylabel="amplitude [µV]",
        title="Amplitude of each wave over the whole scan",
        xlim=(frequency[0], frequency[-1]),
        ylim=(0, None),
    )
    legend_beside(axes)
    return figure


@styled
def size(dataset: xarray.Dataset, heights_m: Iterable[float], nominal_Pa: float) -> Figure:
    """The signal's amplitude [V] against the height [m] and against the nominal pressure [Pa]."""
    figure, grid = grid_of_axes(1, 2, 3.2)
    left, right = grid[0]
    h, size = dataset["ridge_height"].values, dataset["amplitude_by_height"].values
    left.loglog(h * UM_PER_M, size * UV_PER_V, color=PALETTE[0], label="contact")
    line = size[0] / h[0] * h
    left.loglog(h * UM_PER_M, line * UV_PER_V, color=GREY, linestyle="--", label="linear")
    _mark(left, heights_m, along_y=False)
    left.set(xlabel="ridge height [µm]", ylabel="amplitude [µV]")
    left.set(title=f"Against the height, at {nominal_Pa * 1e-3:g} kPa")
    left.legend()
    pressure = dataset["nominal_pressure"].values * 1e-3
    by_pressure = UV_PER_V * dataset["amplitude_by_pressure"]
    right.semilogx(pressure, by_pressure, color=PALETTE[0], marker="o", markersize=4)
    right.axvline(nominal_Pa * 1e-3, color=GREY, linestyle=":", label="here")
    right.set(xlabel="nominal pressure [kPa]", ylabel="amplitude [µV]", ylim=(0, None))
    right.set(title="Against the pressure")
    right.legend()
    figure.suptitle("The signal's amplitude at the pitch")
    return figure


@styled
def detection(dataset: xarray.Dataset, heights_m: Iterable[float]) -> Figure:
    """The least detectable height [m] against the length averaged over."""
    figure, grid = grid_of_axes(1, 1, 3.2)
    axes = grid[0, 0]
    at = dataset["averaging_length"].values * MM_PER_M
    least = UM_PER_M * dataset["least_height"].values
    axes.loglog(at, least, color=PALETTE[0], label="least detectable")
    _mark(axes, heights_m, along_y=True)
    axes.set(xlabel="averaging length [mm]", ylabel="ridge height [µm]", xlim=(at[0], at[-1]))
    axes.set(title="Least detectable height against the length averaged over")
    legend_beside(axes)
    return figure


def _mark(axes, heights_m: Iterable[float], along_y: bool) -> None:
    line = axes.axhline if along_y else axes.axvline
    for height, style in zip(heights_m, ("--", ":"), strict=False):
        um = np.round(height * UM_PER_M, 6)
        line(um, color=PALETTE[1], linestyle=style, label=f"{um:g} µm")
