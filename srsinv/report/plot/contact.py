"""Contact of the skin with a surface: heights, gaps and pressure."""

from collections.abc import Sequence

import numpy as np
import xarray
from matplotlib.figure import Figure

from ...numerics import BAND_90
from .panels import Curve, Mark, Panel, PanelAxis, panels
from .stages import QUANTITIES, X
from .style import TRUTH, names_of, peak, units_of

_AROUND = 2.0  # of the length of the raised part, at each end
_RAISED = 1e-3  # of the greatest height: less is the plate
_SKIN = {"color": "#d55e00", "linestyle": "--"}


def contact(dataset: xarray.Dataset, traction: str = "estimate") -> Figure:
    """Draw the surface and the skin about the raised part, and the traction below them.

    `dataset`: `height`, `gap` [m] along x; `traction` names p, or p and q, along x [Pa].
    """
    x, inside = dataset["x"].values, _scanned(dataset)
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
    """Mask of the cells of the scan, all where it is not known or lies within a cell."""
    x = dataset["x"].values
    if "position" not in dataset:
        return np.ones(x.size, bool)
    position = dataset["position"].values
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
    """Draw p and q of fitted features over the scan, with their 90 % bands.

    `dataset`: `estimate`, `estimate_stderr` (component, x) [Pa] and, where it is known, the truth
    `traction` (component, x) [Pa].
    """
    return panels(feature_panels(dataset))


def feature_panels(dataset: xarray.Dataset, marks: Sequence[Mark] = ()) -> list[Panel]:
    """The panels of [`feature_traction`][], with marks across them."""
    near, parts = dataset.isel(x=_scanned(dataset)), []
    for name in names_of(near["component"]):
        value = near["estimate"].sel(component=name).values
        half = BAND_90 * near["estimate_stderr"].sel(component=name).values
        half = np.where(np.isfinite(half), half, 0.0)
        curves = [Curve(value, name, band=(value - half, value + half), band_label="90 % band")]
        if "traction" in near:
            truth = near["traction"].sel(component=name).values
            curves.insert(0, Curve(truth, "truth", look={"color": TRUTH}))
        reach = peak(value) or 1.0
        limits = (min(0.0, value.min()) - 0.15 * reach, max(0.0, value.max()) + 0.15 * reach)
        up = PanelAxis(QUANTITIES[name], units_of(near["estimate"]), limits=limits)
        parts.append(Panel(curves, X, up, near["x"].values, QUANTITIES[name].capitalize(), marks))
    return parts
