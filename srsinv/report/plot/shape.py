"""Profiles recovered inside the contact, and the pressures behind them."""

from collections.abc import Iterator

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import (
    MM_PER_M,
    NORMAL_90,
    PALETTE,
    SHADE,
    TRUTH,
    grid_of_axes,
    legend_below,
    names_of,
    pressure_scale,
    stretches_mm,
    styled,
    units_of,
)

UM_PER_M = 1e6
_AROUND = 3.0  # of a contact's half-width that is drawn
_LEAST_MM = 3.0  # drawn on each side


@styled
def shapes(dataset: xarray.Dataset) -> Figure:
    """For each scene surface, skin and the profile from the signal; beside it the error in the
    contact with its band."""
    figure, grid = grid_of_axes(dataset.sizes["scene"], 2, 2.9, width_ratios=[3, 2])
    panels = zip(_by_scene(grid[:, 0], dataset), _by_scene(grid[:, 1], dataset), strict=True)
    for (axes, name, ds), (beside, _, _) in panels:
        at = ds["x"].values * MM_PER_M
        um = {key: ds[key].values * UM_PER_M for key in ds if units_of(ds[key]) == "m"}
        axes.plot(at, um["height"], color=TRUTH, label="surface")
        axes.plot(at, um["skin"], "--", color=PALETTE[1], label="skin")
        axes.plot(at, um["shape"], color=PALETTE[2], label="recovered")
        axes.plot(at, um["shape_resolved"], ":", color=TRUTH, linewidth=1.8, label="without noise")
        shown = np.abs(at) <= axes.get_xlim()[1]
        visible = np.concatenate([um["shape"][shown], um["skin"][shown]])
        margin = 0.1 * np.ptp(visible)
        axes.set_ylim(visible.min() - margin, visible.max() + margin)
        axes.set(title=name.replace("_", " ").capitalize(), ylabel="height [µm]")
        touching = ds["touching"].values == 1
        half = np.where(touching, NORMAL_90 * um["shape_stderr"], np.nan)
        look = {"color": PALETTE[2], "alpha": 0.25, "linewidth": 0}
        beside.fill_between(at, -half, half, **look, label="90 % band")
        for key, style, colour in (("shape", "-", PALETTE[2]), ("shape_resolved", ":", TRUTH)):
            error = np.where(touching, um[key] - um["height"], np.nan)
            beside.plot(at, error, style, color=colour, linewidth=1.6)
        held = float(np.mean(np.abs((um["shape"] - um["height"])[touching]) <= half[touching]))
        beside.set(title=f"Error; the band covers {held:.0%} of the contact", ylabel="error [µm]")
    for axes in grid[-1]:
        axes.set_xlabel("position x [mm]")
    figure.suptitle("Profile from the signal, less its mean over the contact (shaded)")
    legend_below(figure, grid[0])
    return figure


@styled
def pressures(dataset: xarray.Dataset) -> Figure:
    """For each scene the true and the recovered deviation of p from its mean."""
    figure, grid = grid_of_axes(dataset.sizes["scene"], 1, 2.6)
    for axes, name, ds in _by_scene(grid[:, 0], dataset):
        at, level = ds["x"].values * MM_PER_M, float(ds["pressure"].mean())
        values = ds["pressure_estimate"].values - ds["pressure_estimate"].values.mean()
        unit = pressure_scale(units_of(dataset["pressure"]), values)
        middle = values * unit.factor
        half = NORMAL_90 * ds["pressure_estimate_stderr"].values * unit.factor
        truth = (ds["pressure"].values - level) * unit.factor
        smoothed = ds["pressure_resolved"].values
        axes.plot(at, truth, color=TRUTH, linewidth=0.9, label="truth")
        axes.plot(
            at, (smoothed - smoothed.mean()) * unit.factor, ":", color=TRUTH, linewidth=1.8,
            label="truth, resolved",
        )  # fmt: skip
        axes.fill_between(
            at, middle - half, middle + half, color=PALETTE[0], alpha=0.25, linewidth=0,
            label="p, 90 %",
        )  # fmt: skip
        axes.plot(at, middle, color=PALETTE[0], label="p recovered")
        low, high = (middle - half).min(), (middle + half).max()
        axes.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
        top = f"; the truth reaches {truth.max():.0f} {unit.unit}"
        remark = top if truth.max() > 1.2 * high else ""
        axes.set(
            title=f"{name.replace('_', ' ').capitalize()}{remark}", ylabel=unit.label("p - mean")
        )
    grid[-1, 0].set_xlabel("position x [mm]")
    figure.suptitle("Pressure less its mean; contact shaded")
    legend_below(figure, grid[:, 0])
    return figure


def _by_scene(column, dataset: xarray.Dataset) -> Iterator[tuple[Axes, str, xarray.Dataset]]:
    """Panels with their scene, the contact shaded, about the middle."""
    for axes, name in zip(column, names_of(dataset["scene"]), strict=True):
        ds = dataset.sel(scene=name)
        touching = ds["touching"].values == 1
        x = ds["x"].values
        spans = stretches_mm(x, touching)
        for left, right in spans:
            axes.axvspan(left, right, color=SHADE, alpha=0.6, linewidth=0)
        inner = [max(abs(left), abs(right)) for left, right in spans if left < 0 < right]
        reach = max(_LEAST_MM, _AROUND * max(inner, default=0.0))
        reach = min(reach, x[-1] * MM_PER_M)
        axes.set_xlim(-reach, reach)
        yield axes, name, ds
