"""Curves over x in stacked panels, and the two figures made of these alone."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np
import xarray
from matplotlib.figure import Figure

from .style import (
    LINE_STYLES,
    MM_PER_M,
    along_x,
    colours,
    grid_of_axes,
    legend_beside,
    names_of,
    note,
    note_alone,
    pressure_scale,
    shown,
    styled,
    symbol,
    units_of,
)


class Panel(TypedDict):
    """One panel: curves (x,) by label, in the unit of `ylabel`."""

    title: str
    ylabel: str
    lines: Mapping[str, Any]


@styled
def panels(
    x_m: np.ndarray, panels: Sequence[Panel], xlabel: str = "position x", title: str = ""
) -> Figure:
    """Stacked panels over one x (x,) [m], drawn in mm; `xlabel` goes without its unit.

    A curve named as a component, a stress or a method has that one's colour.
    """
    figure, grid = grid_of_axes(len(panels), 1, 1.9, sharex=True)
    for axes, panel in zip(grid[:, 0], panels, strict=True):
        palette = colours(panel["lines"])
        for i, (label, values) in enumerate(panel["lines"].items()):
            style = LINE_STYLES[i % len(LINE_STYLES)]
            axes.plot(
                np.asarray(x_m) * MM_PER_M,
                np.asarray(values),
                color=palette[label],
                linestyle=style,
                label=symbol(label),
            )
        if not any(shown(np.asarray(values)) for values in panel["lines"].values()):
            note(axes, "no values")
        axes.set(title=panel["title"], ylabel=panel["ylabel"])
        along_x(axes, np.asarray(x_m))
        legend_beside(axes)
    grid[-1, 0].set_xlabel(f"{xlabel} [mm]")
    figure.suptitle(title)
    return figure


def traction(dataset: xarray.Dataset) -> Figure:
    """The true p and q on the skin, and the friction between them where it is known."""
    title = "Traction on the skin"
    if "traction" not in dataset:
        return note_alone(title, "Not known: a recording comes without its traction.")
    parts = [
        _component(dataset, "p", "Pressure, positive into the finger"),
        _component(dataset, "q", "Shear, positive along +x on the finger"),
    ]
    if "friction" in dataset:
        friction = dataset["friction"].values
        parts.append(Panel(title="Friction", ylabel=f"{symbol('mu')} [1]", lines={"mu": friction}))
    return panels(dataset["x"].values, parts, title=title)


def stress(dataset: xarray.Dataset) -> Figure:
    """Stress at the film, one panel for each depth: elements at the same depth have the same."""
    title = "Stress at the film, tension positive"
    if "stress" not in dataset:
        return note_alone(title, "Not known: a recording comes without the stress at the film.")
    depths = dataset["element_depth"].values
    parts = [_stress_at(dataset, np.flatnonzero(depths == depth)) for depth in np.unique(depths)]
    return panels(dataset["x"].values, parts, title=title)


def _component(dataset: xarray.Dataset, name: str, title: str) -> Panel:
    values = dataset["traction"].sel(component=name)
    unit = pressure_scale(units_of(dataset["traction"]), values)
    return Panel(title=title, ylabel=unit.label(name), lines={name: values.values * unit.factor})


def _stress_at(dataset: xarray.Dataset, elements: np.ndarray) -> Panel:
    values = dataset["stress"].isel(element=elements[0])
    unit = pressure_scale(units_of(dataset["stress"]), values)
    depth_mm = float(dataset["element_depth"].values[elements[0]]) * MM_PER_M
    which = ", ".join(str(i) for i in elements)
    return Panel(
        title=f"At depth {depth_mm:.4g} mm (element{'s' * (len(elements) > 1)} {which})",
        ylabel=unit.label("stress"),
        lines={
            name: values.sel(stress_name=name).values * unit.factor
            for name in names_of(dataset["stress_name"])
        },
    )
