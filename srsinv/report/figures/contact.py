"""Contact of the skin with a surface: heights, gaps and pressure."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from .style import (
    MM_PER_M,
    SHADE,
    TRUTH,
    colours,
    grid_of_axes,
    legend_beside,
    pressure_scale,
    styled,
    units_of,
)

UM_PER_M = 1e6
_AROUND = 2.0  # of the length of the raised part, at each end
_RAISED = 1e-3  # of the greatest height: less is the plate


@styled
def contact(dataset: xarray.Dataset) -> Figure:
    """Surface and skin about the raised part, and pressure and shear below them.

    `dataset`: `height`, `gap` [m] along x; `estimate` (component, x) [Pa] as deviations.
    """
    x = dataset["x"].values
    height, gap = dataset["height"].values, dataset["gap"].values
    shown = _around(x, height, dataset["position"].values)
    at = x[shown] * MM_PER_M
    figure, grid = grid_of_axes(2, 1, 2.2, sharex=True)
    above, below = grid[:, 0]
    h, skin = height[shown] * UM_PER_M, (height + gap)[shown] * UM_PER_M
    floor = h.min() - 0.1 * max(np.ptp(skin), 1e-9)
    above.fill_between(at, floor, h, color=SHADE, linewidth=0)
    above.plot(at, h, color=TRUTH, label="surface h")
    above.plot(at, skin, color="#d55e00", linestyle="--", label="skin h + gap")
    above.set(ylabel="height [µm]", title="The skin on the surface, heights enlarged")
    above.set_ylim(floor, None)
    legend_beside(above)
    components = [str(name) for name in dataset["component"].values]
    values = dataset["estimate"].values[:, shown]
    unit = pressure_scale(units_of(dataset["estimate"]), values)
    for row, name in zip(values, components, strict=True):
        below.plot(at, row * unit.factor, color=colours([name])[name], label=name)
    below.set(
        ylabel=unit.label("traction"),
        xlabel="position x [mm]",
        title="Traction, beyond that on the bare plate",
        xlim=(at[0], at[-1]),
    )
    legend_beside(below)
    figure.suptitle("Contact: where the skin touches, and how hard")
    return figure


def _around(x: np.ndarray, height: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Mask of cells to draw: those raised from the plate within the scan, and a margin."""
    inside = (x >= position.min()) & (x <= position.max())
    level = np.abs(height - np.median(height))
    out = inside & (level > _RAISED * max(float(level.max()), 1e-300))
    places = x[out] if out.any() else x[inside]
    middle, half = (places[0] + places[-1]) / 2, (places[-1] - places[0]) / 2
    shown = (np.abs(x - middle) <= (1 + _AROUND) * half) & inside
    return shown if shown.sum() > 2 else inside
