"""Plots of a recording as in its file: signals, spectra and motion, with suspect parts marked."""

import math

import numpy as np
import xarray
from matplotlib.figure import Figure

from .. import plot
from ..report.plot.long import MOST_POINTS
from ..report.plot.style import GREY, PALETTE, SHADE, TRUTH

MOST_PANELS = 24  # signals that are drawn
_MOST_GAPS = 200  # gaps that are shaded, the longest ones
_BLUE, _RED = {"color": PALETTE[0], "linewidth": 1.0}, PALETTE[1]


def signals(ds: xarray.Dataset) -> Figure:
    """Each signal over time; gaps of the times shaded, flat stretches at the extremes marked."""
    time, gaps = ds["time"].values, _gaps(ds)
    parts = []
    for row, name in enumerate(ds["signal"].values[:MOST_PANELS]):
        values = ds["value"].values[row]
        curves = [_curve(time, values, "signal")]
        at = np.flatnonzero(ds["flat"].values[row])
        if at.size:
            at = at[:: math.ceil(at.size / MOST_POINTS)]
            look = {"color": _RED, "linestyle": "none", "marker": "o", "markersize": 4, "zorder": 3}
            label = "flat at the extreme: clipped?"
            curves.append(plot.Curve(values[at], label, x=time[at], look=look))
        up = plot.PanelAxis("signal", str(ds["signal_unit"].values[row]))
        parts.append(plot.Panel(curves, _along(ds), up, (), str(name), gaps))
    return plot.panels(plot.in_columns(parts), height_in=1.5 if len(parts) <= 4 else 1.2)


def spectra(ds: xarray.Dataset) -> Figure:
    """Amplitude density of each signal with its noise floor and its strongest lines."""
    frequency, per = ds["frequency"].values, str(ds["frequency"].attrs["units"])
    across = plot.PanelAxis("frequency", per, True)
    parts = []
    for row, name in enumerate(ds["signal"].values[:MOST_PANELS]):
        density = ds["density"].values[row]
        density = np.where(density > 0, density, np.nan)
        at = ds["line_frequency"].values[row]
        at = at[np.isfinite(at)]
        curves = [plot.Curve(density, "density", look=_BLUE)]
        if at.size:
            heights = density[np.searchsorted(frequency, at * (1 - 1e-9))]
            look = {"color": _RED, "linestyle": "none", "marker": "v", "markersize": 5}
            curves.append(plot.Curve(heights, "strongest lines", x=at, look=look))
        floor = float(ds["noise_floor"].values[row])
        look = {"color": TRUTH, "linestyle": "--"}
        marks = [plot.Mark(floor, "noise floor", "y", look=look)] if floor > 0 else []
        up = plot.PanelAxis(f"density per √{per}", str(ds["signal_unit"].values[row]), True)
        parts.append(plot.Panel(curves, across, up, frequency, str(name), marks))
    return plot.panels(plot.in_columns(parts), height_in=1.8 if len(parts) <= 4 else 1.5)


def motion(ds: xarray.Dataset) -> Figure:
    """Speed and position over time, as far as the file has them."""
    units = {"speed": "m/s", "position": "m"}
    return plot.panels([
        plot.Panel(
            [_curve(ds["time"].values, ds[name].values, "")],
            _along(ds), plot.PanelAxis(name, unit), (), "", _gaps(ds),
        )
        for name, unit in units.items() if name in ds
    ], height_in=1.7)  # fmt: skip


def _along(ds: xarray.Dataset) -> plot.PanelAxis:
    is_time = ds["time"].attrs["units"] == "s"
    return (
        plot.PanelAxis("time since the first sample", "s") if is_time else plot.PanelAxis("sample")
    )


def _curve(time: np.ndarray, values: np.ndarray, label: str) -> plot.Curve:
    x, y = plot.extremes(time, values)
    return plot.Curve(y, label, x=x, look=_BLUE if np.isfinite(y).any() else {"color": GREY})


def _gaps(ds: xarray.Dataset) -> list[plot.Mark]:
    """The longest gaps, over the curve, which joins a gap's ends."""
    starts, ends = ds["gap_start"].values, ds["gap_end"].values
    longest = np.sort(np.argsort(starts - ends, kind="stable")[:_MOST_GAPS])
    look = {"color": SHADE, "zorder": 2.5}
    return [
        plot.Mark(float(starts[i]), "gap in the times", until=float(ends[i]), look=look)
        for i in longest
    ]
