"""Contact of the skin with a surface: heights, gaps and pressure."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from ...numerics import BAND_90
from .panels import Curve, Panel, PanelAxis, panels
from .stages import QUANTITIES, X
from .style import TRUTH, names_of, peak, units_of

_AROUND = 2.0  # of the length of the raised part, at each end
_RAISED = 1e-3  # of the greatest height: less is the plate
_SKIN = {"color": "#d55e00", "linestyle": "--"}


def contact(dataset: xarray.Dataset, traction: str = "estimate") -> Figure:
    """Surface and skin about the raised part, and pressure and shear below them.

    `dataset`: `height`, `gap` [m] along x; `traction` names p, or p and q, along x [Pa].
    """
    x = dataset["x"].values
    inside = _scanned(dataset) if "position" in dataset else np.ones(x.size, bool)
    near = dataset.isel(x=_around(x, dataset["height"].values, inside))
    height, gap = near["height"].values, near["gap"].values
    heights = [
        Curve(height, "surface", look={"color": TRUTH}),
        Curve(height + gap, "skin", look=_SKIN),
    ]
    values = near[traction]
    names = names_of(near["component"]) if "component" in values.dims else ["p"]
    tractions = [Curve(row, name) for name, row in zip(names, np.atleast_2d(values), strict=True)]
    at, up = near["x"].values, PanelAxis("traction", units_of(values))
    return panels(
        [
            Panel(heights, X, PanelAxis("height", "m"), at, "Heights, enlarged"),
            Panel(tractions, X, up, at, "Traction"),
        ]
    )


def _scanned(dataset: xarray.Dataset) -> np.ndarray:
    """Mask of the cells of the scan, all where it lies within a cell."""
    x, position = dataset["x"].values, dataset["position"].values
    inside = (x >= position.min()) & (x <= position.max())
    return inside if inside.any() else np.ones(x.size, bool)


def _around(x: np.ndarray, height: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Mask of cells to draw: those raised from the plate within the scan, and a margin."""
    level = np.abs(height - np.median(height))
    out = inside & (level > _RAISED * max(float(level.max()), 1e-300))
    places = x[out] if out.any() else x[inside]
    middle, half = (places[0] + places[-1]) / 2, (places[-1] - places[0]) / 2
    near = (np.abs(x - middle) <= (1 + _AROUND) * half) & inside
    return near if near.sum() > 2 else inside


def feature_traction(dataset: xarray.Dataset) -> Figure:
    """p and q of fitted features over the scan, with their 90 % bands."""
    near, parts = dataset.isel(x=_scanned(dataset)), []
    for name in names_of(near["component"]):
        value = near["estimate"].sel(component=name).values
        half = BAND_90 * near["estimate_stderr"].sel(component=name).values
        half = np.where(np.isfinite(half), half, 0.0)
        curve = Curve(value, name, band=(value - half, value + half), band_label="90 % band")
        reach = peak(value) or 1.0
        limits = (min(0.0, value.min()) - 0.15 * reach, max(0.0, value.max()) + 0.15 * reach)
        up = PanelAxis(QUANTITIES[name], units_of(near["estimate"]), limits=limits)
        parts.append(Panel([curve], X, up, near["x"].values, QUANTITIES[name].capitalize()))
    return panels(parts)
