"""Limits over depth, noise and speed."""

from collections.abc import Mapping

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot

AXES = {  # what is varied: key of its range, words, unit
    "depth": ("depth_range_m", "film depth", "m"),
    "noise": ("noise_range_V", "noise of a sample, rms", "V"),
    "speed": ("speed_range_m_per_s", "speed", "m/s"),
}


def least_height(ds: xarray.Dataset) -> Figure:
    """The least detectable height over each axis; a dot is this sensor."""
    return _against(ds, {"least_height": ""}, "least detectable height")


def narrowest_pair(ds: xarray.Dataset) -> Figure:
    """The narrowest pair resolved by a fit, and the wavelengths recovered without a model."""
    lines = {"narrowest_pair": "narrowest pair, by a fit",
             "resolved_wavelength": "shortest wave, without a model"}  # fmt: skip
    look = {"color": "#000000", "linestyle": ":"}
    least = plot.Mark(float(ds["least_distance_m"]), "least distance tried", "y", look=look)
    return _against(ds, lines, "distance", least)


def _against(ds: xarray.Dataset, lines: Mapping[str, str], words: str, *marks) -> Figure:
    shown = np.concatenate([ds[f"{key}_against_{name}"].values for key in lines for name in AXES])
    up = plot.PanelAxis(words, "m", True, (np.nanmin(shown) / 1.3, np.nanmax(shown) * 1.3))
    dot = {"marker": "o", "linestyle": "none"}
    parts = []
    for name, (_, what, unit) in AXES.items():
        here = [ds.attrs[f"{name}_here"]]
        curves = [
            *(plot.Curve(ds[f"{key}_against_{name}"].values, lines[key]) for key in lines),
            *(plot.Curve([float(ds[f"{key}_m"])], lines[key], x=here, look=dot) for key in lines),
        ]
        across = plot.PanelAxis(what, unit, True)
        parts.append(plot.Panel(curves, across, up, ds[name].values, "", marks))
    return plot.panels([parts], height_in=2.8)
