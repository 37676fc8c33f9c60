"""Limits of detection over the parameters that they depend on, one panel for each."""

from collections.abc import Mapping

import numpy as np
import xarray
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from .style import GREY, PALETTE, TRUTH, grid_of_axes, legend_below, styled

_AXES = {
    "depth": ("film depth [mm]", 1e3),
    "noise": ("noise of a sample, rms [µV]", 1e6),
    "speed": ("speed [cm/s]", 1e2),
}


@styled
def heights(dataset: xarray.Dataset, base: Mapping[str, float]) -> Figure:
    """`least_height_against_NAME` [m] for each axis; `base`: the sensor's own values."""
    lines = {"least_height": ("least detectable height", PALETTE[0], "-")}
    figure = _panels(dataset, base, lines, "ridge height [µm]", 1e6)
    figure.suptitle("Ridges below the line are lost in the noise")
    return figure


@styled
def pairs(dataset: xarray.Dataset, base: Mapping[str, float], least_m: float) -> Figure:
    """`narrowest_pair_against_NAME` and `resolved_wavelength_against_NAME` [m], and `least_m`, the
    least distance tried."""
    lines = {
        "narrowest_pair": ("narrowest pair, by a fit", PALETTE[0], "-"),
        "resolved_wavelength": ("wavelength kept, without a model", PALETTE[1], "--"),
    }
    figure = _panels(dataset, base, lines, "distance [mm]", 1e3, least_m)
    figure.suptitle("A fit tells ridges apart that lie closer than the wavelengths kept")
    return figure


def _panels(dataset, base, lines, ylabel: str, factor: float, least_m: float | None = None):
    figure, grid = grid_of_axes(1, len(_AXES), 3.0, sharey=True)
    for panel, (name, (xlabel, scale)) in zip(grid[0], _AXES.items(), strict=True):
        at = dataset[name].values
        for key, (label, colour, style) in lines.items():
            y = dataset[f"{key}_against_{name}"].values
            panel.loglog(at * scale, y * factor, style, color=colour, label=label)
            here = np.exp(np.interp(np.log(base[name]), np.log(at), np.log(y)))
            panel.plot([base[name] * scale], [here * factor], "o", color=colour, markersize=5)
        if least_m is not None:
            label = "least tried: the ridges all but touch"
            panel.axhline(least_m * factor, color=TRUTH, linestyle=":", label=label)
        panel.axvline(base[name] * scale, color=GREY, linewidth=0.7)
        panel.set(xlabel=xlabel, title=f"Against {name}")
        panel.set_xlim(at[0] * scale, at[-1] * scale)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
    grid[0, 0].set_ylabel(ylabel)
    legend_below(figure, grid[0])
    return figure
