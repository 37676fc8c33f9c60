"""Signals along the circle, and errors of the directions."""

import xarray
from matplotlib.figure import Figure

from srsinv import plot


def on_the_circle(ds: xarray.Dataset) -> Figure:
    """The signals with noise of the directions shown, and the fit to each."""
    along, up = plot.PanelAxis("distance along the circle", "m"), plot.PanelAxis("signal", "V")
    data = {"color": "#b5bcc2", "linewidth": 1.0}
    return plot.panels([
        [
            plot.Panel(
                [plot.Curve(noisy.values, "with noise", look=data), plot.Curve(fit.values, "fit")],
                along, up, ds["way"].values, f"Ridge at {angle:g}°, element {name}",
            )
            for name, noisy, fit in zip(ds["element"].values, *of_angle, strict=True)
        ]
        for angle, *of_angle in zip(
            ds["direction"].values, ds["signal"], ds["fitted_signal"], strict=True
        )
    ], height_in=1.7)  # fmt: skip


def errors(ds: xarray.Dataset) -> Figure:
    """The error of each direction with its standard error, over the Cramer-Rao bound."""
    error, stderr, bound = (ds[f"angle_{key}"].values for key in ("error", "stderr", "bound"))
    look = {"linestyle": "none", "marker": "o", "markersize": 4.5}
    zero = plot.Curve(
        0 * bound, "", x=ds["bound_angle"].values, band=(-bound, bound),
        band_label="expected standard error", look={"color": "#6b747c", "linewidth": 0.8},
    )  # fmt: skip
    dots = plot.Curve(
        error, "one draw, ± its standard error", band=(error - stderr, error + stderr),
        has_bars=True, look=look,
    )  # fmt: skip
    across = plot.PanelAxis("true angle of the ridge's normal from x", "deg", limits=(-5.0, 185.0))
    up = plot.PanelAxis("error of the angle", "deg")
    return plot.panels([plot.Panel([zero, dots], across, up, ds["direction"].values)])
