"""Histograms of ranks, and the coverage of passes by two kinds of bands."""

import textwrap

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.plot.style import names_of

COLUMNS, WIDTH_OF_TITLE = 3, 30
MOST = 3.0  # density drawn: bands half as wide as they should be have 4 at the ends
LINE = {"color": "#000000", "linestyle": ":", "linewidth": 0.8}
SHADE = {"color": "#999999", "alpha": 0.25}
ACROSS = plot.PanelAxis("rank of the truth")


def histograms(ds: xarray.Dataset) -> Figure:
    """The density of the ranks of each method; the shade is the band of uniform ranks."""
    up = plot.PanelAxis("density of ranks", limits=(0.0, MOST))
    edges, parts = np.linspace(0.0, 1.0, ds.sizes["bin"] + 1), []
    for method in names_of(ds["method"]):
        own = ds.isel(row=ds["of_method"].values == method)
        density = np.append(own["density"].values, own["density"].values[:, -1:], axis=1)
        look = {"drawstyle": "steps-post"}
        curves = [plot.Curve(row, f"quantity {i}", look=look) for i, row in enumerate(density, 1)]
        least, most = own["band"].values[0]
        marks = (
            plot.Mark(least, "uniform ranks", "y", most, look=SHADE),
            plot.Mark(1.0, "", "y", look=LINE),
        )
        title = "\n".join(textwrap.wrap(method, WIDTH_OF_TITLE))
        parts.append(plot.Panel(curves, ACROSS, up, edges, title, marks))
    rows = [parts[i : i + COLUMNS] for i in range(0, len(parts), COLUMNS)]
    return plot.panels(rows, height_in=1.7)


def held_passes(ds: xarray.Dataset) -> Figure:
    """The share of each further scan within the bands, in order."""
    names = {"coverage_model": "bands of the model", "coverage_conformal": "conformal bands"}
    up = plot.PanelAxis("share of cells within the band", limits=(None, 1.0))
    across = plot.PanelAxis("share of scans", limits=(0.0, 1.0))
    parts = []
    for component in names_of(ds["component"]):
        own = ds.sel(component=component)
        curves = [plot.Curve(np.sort(own[key].values), words) for key, words in names.items()]
        share = (np.arange(ds.sizes["repeat"]) + 0.5) / ds.sizes["repeat"]
        marks = plot.Mark(0.9, "stated", "y", look=LINE), plot.Mark(0.1, "", "x", look=LINE)
        parts.append(plot.Panel(curves, across, up, share, component, marks))
    return plot.panels([parts], height_in=2.6)
