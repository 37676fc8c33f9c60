"""Spectra of sensor gain, signal and noise, and resolution of the methods."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from .style import (
    GREY,
    LINE_STYLES,
    MM_PER_M,
    PALETTE,
    TRUTH,
    colours,
    grid_of_axes,
    legend_beside,
    names_of,
    note,
    peak,
    scale,
    short,
    shown,
    styled,
    units_of,
)

_DEEPEST = 1e-8  # of the largest gain: below, no recording has a signal


@styled
def spectra(dataset: xarray.Dataset) -> Figure:
    """Sensor gain; power of signal and noise; resolution of each method with its cut-off.

    k = 0 is not on a logarithmic axis; the mean is described with the estimates.
    """
    figure, grid = grid_of_axes(3, 1, 2.4, sharex=True)
    gain_axes, power_axes, resolution_axes = grid[:, 0]
    _gain(gain_axes, dataset)
    _power(power_axes, dataset)
    _resolution(resolution_axes, dataset)
    gain = dataset["sensor_gain"].values
    _finish(grid[:, 0], dataset["wavenumber"].values, gain, dataset["cutoff"].values)
    figure.suptitle("What the sensor passes, and how much of it each method recovers")
    return figure


@styled
def filter_spectra(
    wavenumber: np.ndarray,
    sensor: Mapping[str, Any],
    signal: Any,
    noise: Any,
    filters: Mapping[str, Any],
    cutoff: float,
    *,
    signal_unit: str = "V",
    title: str = "Sensor, noise and the inverse filter between them",
) -> Figure:
    """The sensor's transfer, the power of signal and noise, and the inverse filter |H|.

    - `wavenumber` (k,) [rad/m]; `sensor`: |G| (k,) [signal unit/Pa] by label; `filters`: |H| (k,)
      [Pa/signal unit] by label.
    - `signal` and `noise` (k,) [signal unit squared].
    - `cutoff` [rad/m]: where the resolution falls through one half; NaN where it never does.
    """
    figure, grid = grid_of_axes(3, 1, 2.3, sharex=True)
    gain_axes, power_axes, filter_axes = grid[:, 0]
    _draw(gain_axes, wavenumber, sensor)
    gain_axes.set(title="Sensor transfer |G|", ylabel=f"|G| [{signal_unit}/Pa]")
    gains = np.stack([np.asarray(values) for values in sensor.values()])
    _deepest(gain_axes, gains)
    _power_lines(power_axes, wavenumber, {"signal": np.asarray(signal)}, np.asarray(noise))
    power_axes.set(title="Power", ylabel=f"power [{signal_unit}²]")
    _draw(filter_axes, wavenumber, filters)
    filter_axes.set(title="Inverse filter |H|", ylabel=f"|H| [Pa/{signal_unit}]")
    _around_filters(filter_axes, filters)
    if np.isfinite(cutoff):
        for axes in grid[:, 0]:
            label = f"cut-off, {_wavelength_mm(cutoff):.3g} mm"
            axes.axvline(cutoff, color=TRUTH, linewidth=0.9, linestyle=":", label=label)
    _finish(grid[:, 0], np.asarray(wavenumber), gains, np.asarray([cutoff]))
    figure.suptitle(title)
    return figure


def _gain(axes: Axes, dataset: xarray.Dataset) -> None:
    gain, k = dataset["sensor_gain"], dataset["wavenumber"].values
    palette = colours(names_of(dataset["component"]))
    for e, element in enumerate(names_of(dataset["element"])):
        for c, (component, colour) in enumerate(palette.items()):
            if not shown(gain.values[e, c]):
                continue
            axes.plot(
                k[1:],
                gain.values[e, c, 1:],
                color=colour,
                linestyle=LINE_STYLES[e % len(LINE_STYLES)],
                label=f"{component}, element {short(element)}",
            )
    axes.set(title="Sensor gain |G|", ylabel=f"|G| [{scale(units_of(gain)).unit}]")
    _deepest(axes, gain.values)


def _power(axes: Axes, dataset: xarray.Dataset) -> None:
    power = dataset["signal_power"]
    signal = dict(zip(names_of(dataset["element"]), power.values, strict=True))
    lines = {f"signal, element {short(name)}": values for name, values in signal.items()}
    _power_lines(axes, dataset["wavenumber"].values, lines, dataset["noise_power"].values)
    axes.set(title="Power of signal and noise", ylabel=f"power [{scale(units_of(power)).unit}]")


def _power_lines(axes: Axes, k: np.ndarray, signal: Mapping[str, Any], noise: np.ndarray) -> None:
    shades = PALETTE[-2::-1]  # far from p and q
    for i, (label, values) in enumerate(signal.items()):
        axes.plot(k[1:], values[1:], color=shades[i % len(shades)], linewidth=1.0, label=label)
    axes.plot(k[1:], noise[1:], color=TRUTH, label="noise")
    axes.set_yscale("log")
    powers = np.stack([*signal.values(), noise])[:, 1:]
    positive = powers[np.isfinite(powers) & (powers > 0)]
    if not positive.size:
        note(axes, "no power")
        return
    loud = noise[1:][np.isfinite(noise[1:]) & (noise[1:] > 0)]
    floor = loud.min() * 1e-2 if loud.size else positive.max() * _DEEPEST**2
    axes.set_ylim(floor, positive.max() * 5)


def _resolution(axes: Axes, dataset: xarray.Dataset) -> None:
    k, cutoff = dataset["wavenumber"].values, dataset["cutoff"].values
    palette = colours(names_of(dataset["method"]))
    for m, (method, colour) in enumerate(palette.items()):
        for c, component in enumerate(names_of(dataset["component"])):
            look: dict[str, Any] = {"color": colour, "linestyle": LINE_STYLES[c]}
            at = float(cutoff[m, c])
            values = dataset["resolution"].values[m, c]
            if not shown(values):
                continue
            label = f"{component}, {method}: {_say_cutoff(at)}"
            axes.plot(k[1:], values[1:], **look, label=label)
            if np.isfinite(at):
                axes.axvline(at, **look, linewidth=0.8, alpha=0.7)
                axes.plot([at], [0.5], "o", color=colour, markersize=4)
    axes.axhline(0.5, color=GREY, linewidth=0.6)
    axes.set(
        title="Resolution: share of the truth in the estimate; dots: cut-off, with its wavelength",
        ylabel="resolution [1]",
        ylim=(-0.03, np.clip(1.05 * peak(dataset["resolution"].values), 1.05, 1.5)),
    )


def _say_cutoff(cutoff: float) -> str:
    if not np.isfinite(cutoff):
        return "no cut-off"
    return f"{_wavelength_mm(cutoff):.3g} mm"


def _draw(axes: Axes, k: np.ndarray, lines: Mapping[str, Any]) -> None:
    palette = colours(lines)
    for i, (label, values) in enumerate(lines.items()):
        style = LINE_STYLES[i % len(LINE_STYLES)]
        axes.plot(k[1:], np.asarray(values)[1:], style, color=palette[label], label=label)


def _deepest(axes: Axes, gain: np.ndarray) -> None:
    axes.set_yscale("log")
    top = peak(gain)
    if top > 0:
        axes.set_ylim(top * _DEEPEST, top * 5)


def _around_filters(axes: Axes, filters: Mapping[str, Any]) -> None:
    # An unregularised inverse grows without bound: the lowest filter sets the limits.
    axes.set_yscale("log")
    tops = [peak(np.asarray(values)[1:]) for values in filters.values()]
    lowest = min((top for top in tops if top > 0), default=1.0)
    axes.set_ylim(lowest * 1e-5, lowest * 1e3)


def _wavelength_mm(k: Any) -> Any:
    with np.errstate(divide="ignore"):
        return 2 * np.pi / np.asarray(k, float) * MM_PER_M


def _finish(column: np.ndarray, k: np.ndarray, gain: np.ndarray, cutoff: np.ndarray) -> None:
    """Legends, the common k axis up to where the sensor has a response, and the wavelength on
    top."""
    for axes in column:
        legend_beside(axes, least=1)
    column[-1].set_xlabel("wavenumber k [rad/m]")
    column[0].set_xscale("log")
    column[0].set_xlim(k[1], _last_wavenumber(k, gain, cutoff))
    top = column[0].secondary_xaxis("top", functions=(_wavelength_mm, _wavelength_mm))
    top.set_xlabel("wavelength 2π/k [mm]")
    top.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    top.xaxis.set_minor_locator(NullLocator())
    top.xaxis.set_major_formatter(FuncFormatter(lambda mm, _: f"{mm:g}"))


def _last_wavenumber(k: np.ndarray, gain: np.ndarray, cutoff: np.ndarray) -> float:
    """The wavenumber where the gain has become negligible, but well past every cut-off."""
    gain = np.nan_to_num(gain)
    visible = k[(gain > gain.max() * _DEEPEST).any(axis=tuple(range(gain.ndim - 1)))]
    ends = [2 * visible.max() if visible.size else k[-1], *(3 * cutoff[np.isfinite(cutoff)])]
    return float(np.clip(max(ends), k[2], k[-1]))
