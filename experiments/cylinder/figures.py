"""Width of the contact, errors over the radius, intervals, and a fitted signal."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot

DOTS = {"linestyle": "none", "marker": "o", "markersize": 4.5}
DASHED = {"color": "#000000", "linestyle": ":"}


def _radius(ds: xarray.Dataset) -> plot.PanelAxis:
    limits = float(ds["radius"].min()) / 1.3, float(ds["radius"].max()) * 1.3
    return plot.PanelAxis("radius", "m", True, limits)


def widths(ds: xarray.Dataset) -> Figure:
    """Width of the contact over the radius, and the resolution limit."""
    resolved = float(ds["resolved_wavelength_m"])
    limit = plot.Mark(resolved, "shortest wave, without a model", "y", look=DASHED)
    limits = float(ds["contact_width"].min()) / 1.3, 1.3 * resolved
    up = plot.PanelAxis("width of the contact", "m", True, limits)
    curve = plot.Curve(ds["contact_width"].values, "width of the contact", look={"marker": "o"})
    return plot.panels([[plot.Panel([curve], _radius(ds), up, ds["radius"].values, "", [limit])]])


def errors(ds: xarray.Dataset) -> Figure:
    """Rms errors of radius and angle over the radius, with their bounds."""
    panels = []
    for name, unit in (("radius", "m"), ("angle", "rad")):
        curves = [
            plot.Curve(ds[f"{name}_bound"].values, "Cramér–Rao bound"),
            plot.Curve(ds[f"{name}_rms"].values, "rms error of the draws", look=DOTS),
        ]
        up = plot.PanelAxis(f"error of the {name}", unit, True)
        panels.append(plot.Panel(curves, _radius(ds), up, ds["radius"].values))
    return plot.panels([panels])


def estimates(ds: xarray.Dataset) -> Figure:
    """Every draw's radius with its 90 % interval, relative to the truth."""
    truth, draws = ds["radius"].values, ds.sizes["draw"]
    beside = np.linspace(-0.06, 0.06, draws)
    x = (truth[:, None] * 10**beside).ravel()
    value, low, high = (
        (ds[f"radius_{key}"].values / truth[:, None]).ravel() for key in ("estimate", "low", "high")
    )
    dots = plot.Curve(
        value, "draws, with 90 % intervals", band=(low, high), has_bars=True,
        look=DOTS | {"markersize": 2.5},
    )  # fmt: skip
    one = plot.Mark(1.0, "truth", "y", look=DASHED)
    up = plot.PanelAxis("radius over its truth")
    return plot.panels([[plot.Panel([dots], _radius(ds), up, x, "", [one])]])


def signals(ds: xarray.Dataset) -> Figure:
    """The first draw of one radius, its fit, and what is left in units of the noise."""
    along, x = plot.PanelAxis("position", "m"), ds["position"].values
    noisy = {"color": "#b5bcc2", "linewidth": 1.0}
    rows = []
    for element in ds["element"].values:
        own = ds.sel(element=element)
        data = plot.Curve(own["signal"].values, "with noise", look=noisy)
        fit = plot.Curve(own["fitted_signal"].values, "fit")
        rest = plot.Curve(own["whitened_residual"].values, "residual", look=noisy)
        rows.append([
            plot.Panel([data, fit], along, plot.PanelAxis("signal", "V"), x, f"Element {element}"),
            plot.Panel([rest], along, plot.PanelAxis("residual over noise"), x,
                       f"Element {element}"),
        ])  # fmt: skip
    return plot.panels(rows, height_in=1.7)
