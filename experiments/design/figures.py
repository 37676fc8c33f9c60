"""Figures of a design: the error over each quantity, and the descent of every start."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot

LOOKS = {
    "optimum": {"color": "#d55e00", "linestyle": "none", "marker": "*", "markersize": 9},
    "grid": {"color": "#666666", "linestyle": "none", "marker": ".", "markersize": 4},
}
QUANTITIES = {"depth": "depth", "width": "strip width", "angle": "angle", "offset": "offset"}


def profiles(ds: xarray.Dataset) -> Figure:
    """The error over each quantity through the optimum, a panel for each and a curve for each
    element that has its own."""
    names = [str(each) for each in ds["parameter"].values]
    up = plot.PanelAxis(str(ds.attrs["words"]).lower(), ds.attrs["units_of_error"])
    return plot.panels([[_profile(ds, name, up) for name in names]], height_in=2.8)


def _profile(ds: xarray.Dataset, name: str, up: plot.PanelAxis) -> plot.Panel:
    rows, at = ds[f"{name}_profile"].values, ds[name].sel(design="optimum").values
    is_shared = name in str(ds.attrs["shared"]).split(", ")
    shown = range(1 if is_shared else int(ds.attrs["elements"]))
    curves = [
        plot.Curve(rows[e], "all elements" if is_shared else f"element {e + 1}") for e in shown
    ]
    best = float(ds["expected"].sel(design="optimum"))
    grid, places = (ds[f"{name}_grid_{each}"].values for each in ("error", "place"))
    curves += [
        plot.Curve(grid, "best on the grid", x=places, look=LOOKS["grid"]),
        *(plot.Curve([best], "optimum", x=[at[e]], look=LOOKS["optimum"]) for e in shown),
    ]
    own = ds[name].sel(design="given").values
    marks = [
        plot.Mark(float(value), "given sensor", look={"color": "#000000", "linestyle": ":"})
        for value in np.unique(own[np.isfinite(own)])
    ]
    across = plot.PanelAxis(QUANTITIES[name], ds[name].attrs["units"])
    return plot.Panel(curves, across, up, ds[f"{name}_place"].values, "", marks)


def descents(ds: xarray.Dataset) -> Figure:
    """The error above the least one, over the steps of every start."""
    paths = ds["path"].values
    best = float(ds["expected"].sel(design="optimum"))
    above = np.maximum(paths / best - 1, 1e-9)
    curves = [
        plot.Curve(path, "other starts" if start else "given sensor",
                   look={"linewidth": 0.8 if start else 1.6}) for start, path in enumerate(above)
    ]  # fmt: skip
    across = plot.PanelAxis("step")
    up = plot.PanelAxis("error over the least one, less 1", is_log=True)
    return plot.panels([[plot.Panel(curves, across, up, np.arange(paths.shape[1]))]], height_in=2.6)
