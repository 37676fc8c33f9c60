"""Figures of linearity: the first harmonic and its distortion."""

from typing import Any

import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.text import quantity


def draw_gain(ds: xarray.Dataset) -> Figure:
    """Deviation from proportionality and distortion over amplitude, a column for each control."""
    marks = [plot.Mark(1.0, "the edge leaves the skin")]

    def one(control: str, name: str, word: str, **settings: Any) -> plot.Panel:
        own = ds[name].sel(control=control)
        lines = {f"radius {quantity(r, 'm')}": own.sel(radius=r) for r in ds["radius"].values}
        return plot.panel(
            lines, quantity=word, along="amplitude / preload",
            title=f"{word.capitalize()}, given {control}", marks=marks, **settings,
        )  # fmt: skip

    kinds = (
        ("first_harmonic", "first harmonic", {"log": "xy"}),
        ("deviation", "deviation", {"log": "x"}),
        ("distortion", "distortion", {"log": "xy"}),
    )
    return plot.panels([
        [one(str(c), name, word, **more) for c in ds["control"].values]
        for name, word, more in kinds
    ])  # fmt: skip
