"""Profiles and pressures of each scene, drawn about its contact."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.numerics import BAND_90
from srsinv.report.plot.style import SHADE, TRUTH, stretches
from srsinv.report.text import quantity, spoken

LEAST_M, AROUND = 3e-3, 3.0  # drawn on each side: at least, and in half-widths of the contact
SURFACE, DOTTED = {"color": TRUTH}, {"color": TRUTH, "linestyle": ":", "linewidth": 1.8}
RECOVERED, SKIN = {"color": "#009e73"}, {"color": "#d55e00", "linestyle": "--"}
Scene = tuple[str, dict[Any, np.ndarray], np.ndarray, Callable[..., plot.Panel]]


def shapes(ds: xarray.Dataset) -> Figure:
    """For each scene surface, skin and the profile from the signal; beside it the error in the
    contact with its band."""
    rows = []
    for name, own, near, panel in _scenes(ds):
        heights = [
            plot.Curve(own["skin"], "skin", look=SKIN, in_view=near),
            plot.Curve(own["height"], "surface", look=SURFACE, in_view=False),
            plot.Curve(own["shape"], "recovered", look=RECOVERED, in_view=near),
            plot.Curve(own["shape_resolved"], "without noise", look=DOTTED, in_view=near),
        ]
        inside = np.where(own["touching"], 1.0, np.nan)
        error, missed = ((own[key] - own["height"]) * inside for key in ("shape", "shape_resolved"))
        half = BAND_90 * own["shape_stderr"] * inside
        errors = [
            plot.Curve(0 * error, band=(-half, half), look={**RECOVERED, "linewidth": 0.0},
                       band_label="90 % band"),
            plot.Curve(error, "recovered", look=RECOVERED),
            plot.Curve(missed, "without noise", look=DOTTED),
        ]  # fmt: skip
        rows.append(
            [panel(heights, "height", "m", name), panel(errors, "error", "m", "Error in contact")]
        )
    return plot.panels(rows, widths=(3, 2), height_in=2.6)


def pressures(ds: xarray.Dataset) -> Figure:
    """For each scene the true and the recovered deviation of p from its mean."""
    rows = []
    for name, own, near, panel in _scenes(ds):
        p, resolved, value = (
            own[key] - own[key].mean()
            for key in ("pressure", "pressure_resolved", "pressure_estimate")
        )
        half = BAND_90 * own["pressure_estimate_stderr"]
        is_cut = p.max() > 1.5 * (value + half)[near].max()
        remark = f"; the truth reaches {quantity(p.max(), 'Pa', digits=2)}" if is_cut else ""
        curves = [
            plot.Curve(p, "truth", look={**SURFACE, "linewidth": 0.9}, in_view=near & (not is_cut)),
            plot.Curve(value, "p", band=(value - half, value + half), band_label="90 % band",
                       in_view=near),
            plot.Curve(resolved, "truth, as resolved", look=DOTTED, in_view=near),
        ]  # fmt: skip
        rows.append(panel(curves, "p less its mean", "Pa", name + remark))
    return plot.panels(rows, height_in=2.2)


def _scenes(ds: xarray.Dataset) -> Iterator[Scene]:
    """Of each scene the name, the variables, a mask of the cells drawn about the contact in the
    middle, and what makes a panel of curves there: curves, quantity, unit and title."""
    x = ds["x"].values
    for name in ds["scene"].values:
        own = {key: each.values for key, each in ds.sel(scene=name).data_vars.items()}
        spans = stretches(x, own["touching"] == 1)
        inner = [max(abs(left), abs(right)) for left, right in spans if left < 0 < right]
        reach = min(max(LEAST_M, AROUND * max(inner, default=0.0)), float(x[-1]))
        across = plot.PanelAxis("position x", "m", limits=(-reach, reach))
        look = {"color": SHADE, "alpha": 0.6, "zorder": 0}
        marks = [
            plot.Mark(max(left, -reach), "contact", until=min(right, reach), look=look)
            for left, right in spans if left < reach and right > -reach
        ]  # fmt: skip

        def panel(curves, of, unit, title, across=across, marks=marks) -> plot.Panel:
            return plot.Panel(curves, across, plot.PanelAxis(of, unit), x, title, marks)

        yield spoken(name).capitalize(), own, np.abs(x) <= reach, panel
