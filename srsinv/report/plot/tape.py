"""A tape's signal, its edges' symmetry, and the traction under it."""

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import (
    GREY,
    MM_PER_M,
    NORMAL_90,
    PALETTE,
    TRUTH,
    along_x,
    colours,
    grid_of_axes,
    legend_below,
    names_of,
    pressure_scale,
    scale,
    styled,
    units_of,
)

_NO_FRICTION = "no friction"
_SOLID = {"even": PALETTE[1], "odd": PALETTE[0]}


@styled
def signals(dataset: xarray.Dataset) -> Figure:
    """Each element's signal over the tape with noise, and the one without friction."""
    names = names_of(dataset["element"])
    unit = scale(units_of(dataset["signal"]), dataset["signal"].values)
    x = dataset["x"].values
    figure, grid = grid_of_axes(len(names), 1, 2.3, sharex=True)
    for axes, name in zip(grid[:, 0], names, strict=True):
        for case, label, look in (
            ("with noise", "with friction and noise", {"color": PALETTE[2]}),
            (_NO_FRICTION, _NO_FRICTION, {"color": GREY, "linestyle": "--"}),
        ):
            values = dataset["signal"].sel(case=case, element=name).values
            axes.plot(x * MM_PER_M, unit.factor * values, label=label, **look)
        _mark_edges(axes, dataset)
        axes.set(title=f"Element {name}", ylabel=unit.label("signal"))
        along_x(axes, x)
    grid[-1, 0].set_xlabel("position x [mm]")
    figure.suptitle("Both edges of the tape show; the leading one drags")
    legend_below(figure, grid[:1, 0])
    return figure


@styled
def symmetry(dataset: xarray.Dataset) -> Figure:
    """Even and odd parts of the signals about each edge, a column for each edge."""
    edges, names = names_of(dataset["edge"]), names_of(dataset["element"])
    at = dataset["from_edge"].values * MM_PER_M
    unit = scale(units_of(dataset["even"]), dataset["even"].values)
    cases = names_of(dataset["case"])
    index = dict(zip(cases, dataset["antisymmetry"].values, strict=True))
    figure, grid = grid_of_axes(len(names), len(edges), 2.6, sharex=True, sharey="row")
    for row, name in zip(grid, names, strict=True):
        for axes, edge in zip(row, edges, strict=True):
            for part, colour in _SOLID.items():
                for case, look, label in (
                    (cases[0], "-", part),
                    (_NO_FRICTION, "--", f"{part}, without friction"),
                ):
                    values = dataset[part].sel(case=case, edge=edge, element=name).values
                    axes.plot(at, unit.factor * values, look, color=colour, label=label)
            axes.set_title(f"{edge.capitalize()} edge, element {name}")
            axes.set_xlim(at[0], at[-1])
        row[0].set_ylabel(unit.label("part"))
    for axes in grid[-1]:
        axes.set_xlabel("distance from the edge [mm]")
    said = [f"{edge} {index[cases[0]][i]:.3g}" for i, edge in enumerate(edges)]
    frictionless = f"without friction {index[_NO_FRICTION][0]:.3g} at both"
    figure.suptitle(f"Antisymmetry, rms of even over odd: {', '.join(said)}; {frictionless}")
    legend_below(figure, grid[0])
    return figure


@styled
def traction(dataset: xarray.Dataset) -> Figure:
    """Recovered p and q with their bands; the truth, and its resolvable part."""
    x, components = dataset["x"].values, names_of(dataset["component"])
    values, stderr = dataset["estimate"].values, dataset["estimate_stderr"].values
    truth, resolved = dataset["traction"].values, dataset["traction_resolved"].values
    unit = pressure_scale(units_of(dataset["estimate"]), values)
    palette = colours(components)
    figure, grid = grid_of_axes(len(components), 1, 2.7, sharex=True)
    for i, (axes, name) in enumerate(zip(grid[:, 0], components, strict=True)):
        middle, half = values[i] * unit.factor, NORMAL_90 * stderr[i] * unit.factor
        shade = {"color": palette[name], "alpha": 0.25, "linewidth": 0}
        at = x * MM_PER_M
        axes.plot(at, truth[i] * unit.factor, color=TRUTH, linewidth=0.9, label="truth")
        axes.plot(
            at, resolved[i] * unit.factor, ":", color=TRUTH, linewidth=1.8, label="truth, resolved"
        )
        axes.fill_between(at, middle - half, middle + half, **shade, label=f"{name}, 90 %")
        axes.plot(at, middle, color=palette[name], label=f"{name} recovered")
        _mark_edges(axes, dataset)
        band = np.concatenate([middle - half, middle + half])
        axes.set_ylim(band.min() - 0.1 * np.ptp(band), band.max() + 0.1 * np.ptp(band))
        top = truth[i].max() * unit.factor
        remark = f"; the truth's peaks reach {top:.0f} {unit.unit}" if top > band.max() else ""
        axes.set(title=f"{name} beyond the background{remark}", ylabel=unit.label(name))
        along_x(axes, x)
    grid[-1, 0].set_xlabel("position x [mm]")
    figure.suptitle("Pressure and shear under the tape, as recovered from the noisy signal")
    legend_below(figure, grid[:, 0])
    return figure


def _mark_edges(axes: Axes, dataset: xarray.Dataset) -> None:
    for edge, place in zip(names_of(dataset["edge"]), dataset["edge_position"].values, strict=True):
        look = "-." if edge == "leading" else ":"
        axes.axvline(place * MM_PER_M, color=GREY, linestyle=look, label=f"{edge} edge")
