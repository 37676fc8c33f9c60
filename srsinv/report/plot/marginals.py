"""Marginal posteriors: a histogram of draws for each parameter, beside Laplace's normal curve."""

import numpy as np
import xarray

from .. import text
from .panels import Curve, Panel, PanelAxis
from .style import PALETTE, TRUTH

_BINS, _COLUMNS = 40, 3
_TRIMMED = (0.001, 0.999)  # of the draws: long tails would leave a few bins for all others


def marginal_panels(dataset: xarray.Dataset) -> list[list[Panel]]:
    """A panel for each parameter, in rows."""
    parts = [_marginal(dataset.isel(reported=i)) for i in range(dataset.sizes["reported"])]
    return [parts[at : at + _COLUMNS] for at in range(0, len(parts), _COLUMNS)]


def _marginal(of: xarray.Dataset) -> Panel:
    draws = of["posterior_draws"].values.ravel()
    low, high = np.quantile(draws, _TRIMMED)
    density, edges = np.histogram(draws, _BINS, (low, high) if high > low else None, density=True)
    look, unit_density = {"color": PALETTE[0], "drawstyle": "steps-mid"}, density.max()
    curves = [Curve(density / unit_density, "draws", x=(edges[1:] + edges[:-1]) / 2, look=look)]
    value, stderr = float(of["laplace_value"]), float(of["laplace_stderr"])
    if 0 < stderr < np.inf:
        at = np.linspace(low, high, 200)
        normal = np.exp(-(((at - value) / stderr) ** 2) / 2) / (stderr * np.sqrt(2 * np.pi))
        label = "normal, by the standard error"
        curves.append(Curve(normal / unit_density, label, x=at, look={"color": TRUTH}))
    name, unit = str(of["reported"].item()), str(of["parameter_unit"].item())
    up = PanelAxis("relative density", limits=(0.0, None))
    return Panel(curves, PanelAxis(text.without_unit(name), unit), up)
