"""A pitch common to many channels: its pattern, its uncertainty, and other spectral lines."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from .style import (
    GREY,
    MM_PER_M,
    PALETTE,
    SHADE,
    TRUTH,
    along_x,
    grid_of_axes,
    legend_below,
    names_of,
    styled,
)

_SPACING = 1.1  # between channels drawn from -0.5 to 0.5
_PITCH, _LINE = PALETTE[1], PALETTE[0]


@styled
def channel_fits(dataset: xarray.Dataset) -> Figure:
    """Every channel less its drift, each to its own scale, with the pattern fitted to it."""
    channels = names_of(dataset["channel"])
    figure, grid = grid_of_axes(1, 1, 1.5 + 0.4 * len(channels))
    axes, x_m = grid[0, 0], dataset["x"].values
    pattern = dataset["pattern"].values
    shown = pattern + dataset["signal"].values - dataset["fitted_signal"].values
    size = np.ptp(shown, axis=1, keepdims=True)
    below = -_SPACING * np.arange(len(channels))
    for c in range(len(channels)):
        first = c == 0
        label = "signal less drift" if first else None
        axes.plot(x_m * MM_PER_M, below[c] + shown[c] / size[c], color=GREY, label=label)
        label = "fit" if first else None
        axes.plot(x_m * MM_PER_M, below[c] + pattern[c] / size[c], "--", color=_PITCH, label=label)
    axes.set_yticks(below, channels)
    axes.set(xlabel="position x [mm]", ylabel="channels, each to its own scale [1]")
    along_x(axes, x_m)
    figure.suptitle("Signals less their drift, and the pattern of one pitch")
    legend_below(figure, [axes])
    return figure


@styled
def pattern_shifts(dataset: xarray.Dataset) -> Figure:
    """Forward shift along x of the pattern of all channels from the fit, period by period."""
    figure, grid = grid_of_axes(1, 1, 2.6)
    axes = grid[0, 0]
    at, shift = dataset["period_x"].values, dataset["shift"].values
    axes.plot(at * MM_PER_M, shift * MM_PER_M, "o-", color=_LINE)
    axes.axhline(0, color=TRUTH, linewidth=0.9)
    axes.set(xlabel="position x [mm]", ylabel="shift [mm]")
    along_x(axes, dataset["x"].values)
    figure.suptitle("Shift of the pattern from the fit, one reading for each period")
    return figure


@styled
def line_spectrum(dataset: xarray.Dataset) -> Figure:
    """The channels' common periodogram, with and without the lines found, over wavelength."""
    figure, grid = grid_of_axes(1, 1, 4.0)
    axes, wavelength = grid[0, 0], MM_PER_M / dataset["per_m"].values
    lower, upper = dataset["pitch_range"].values * MM_PER_M
    axes.axvspan(lower, upper, color=SHADE, label="range of the pitch")
    axes.plot(wavelength, dataset["power"], color=GREY, label="signals less drift")
    axes.plot(wavelength, dataset["power_left"], color=_LINE, label="without the lines")
    axes.plot(wavelength, dataset["false_alarm_level"], ":", color=TRUTH, label="false-alarm level")
    axes.axvline(float(dataset["pitch"]) * MM_PER_M, color=_PITCH, label="pitch")
    for i, at in enumerate(dataset["line_wavelength"].values * MM_PER_M):
        label = None if i else "other lines"
        axes.axvline(at, color=PALETTE[2], linestyle="--", linewidth=1.0, label=label)
    axes.set(xscale="log", yscale="log", xlabel="wavelength [mm]", ylabel="power [1]")
    axes.set_xlim(wavelength[-1], wavelength[0])
    axes.set_ylim(bottom=0.3 * float(np.quantile(dataset["power_left"], 0.05)))
    axes.xaxis.set_major_formatter("{x:g}")
    figure.suptitle("Periodogram summed over channels, each in units of what the lines leave")
    legend_below(figure, [axes])
    return figure


@styled
def channel_pitches(dataset: xarray.Dataset) -> Figure:
    """The pitch of each channel alone, beside that of all together."""
    channels = names_of(dataset["channel"])
    figure, grid = grid_of_axes(1, 1, 3.4)
    axes = grid[0, 0]
    pitch, stderr = (float(dataset[name]) * MM_PER_M for name in ("pitch", "pitch_stderr"))
    axes.axhspan(pitch - stderr, pitch + stderr, color=SHADE, label="± one standard error")
    axes.axhline(pitch, color=_PITCH, label="all channels")
    alone, alone_stderr = (
        dataset[name].values * MM_PER_M for name in ("channel_pitch", "channel_pitch_stderr")
    )
    axes.errorbar(
        range(len(channels)), alone, alone_stderr, fmt="o", color=_LINE, capsize=3,
        label="one channel",
    )  # fmt: skip
    axes.set_xticks(range(len(channels)), channels, rotation=60, ha="right")
    # A channel with hardly any signal has bars that would dominate the scale.
    reach = 1.1 * float(np.max(np.abs(alone - pitch))) + max(np.median(alone_stderr), stderr)
    axes.set_ylim(pitch - reach, pitch + reach)
    axes.set_ylabel("pitch [mm]")
    figure.suptitle("Pitch of every channel alone, with standard errors, and of all together")
    legend_below(figure, [axes])
    return figure
