"""Signals of rough surfaces, the spectra estimated from them, and confusion of textures."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from .style import (
    GREY,
    MM_PER_M,
    PALETTE,
    TRUTH,
    along_x,
    grid_of_axes,
    legend_below,
    names_of,
    scale,
    styled,
    units_of,
)

_OF_CONTACT = {"full": PALETTE[0], "light": PALETTE[1]}


@styled
def signals(dataset: xarray.Dataset) -> Figure:
    """One recording of each texture under each pressure."""
    names = names_of(dataset["texture"])
    unit = scale(units_of(dataset["signal"]), dataset["signal"].values)
    x = dataset["x"].values
    figure, grid = grid_of_axes(len(names), 1, 1.9, sharex=True, sharey=True)
    for t, (axes, name) in enumerate(zip(grid[:, 0], names, strict=True)):
        for c, contact in enumerate(names_of(dataset["contact"])):
            values = unit.factor * dataset["signal"].values[c, t]
            label = f"{contact} contact"
            axes.plot(x * MM_PER_M, values, color=_OF_CONTACT[contact], label=label)
        fraction = float(dataset["contact_fraction"].values[-1, t])
        axes.set(
            title=f"{name.capitalize()}; under light pressure {fraction:.0%} touches",
            ylabel=unit.label("signal"),
        )
        along_x(axes, x)
    grid[-1, 0].set_xlabel("position x [mm]")
    figure.suptitle("The same surfaces pressed on fully and lightly, with noise")
    legend_below(figure, grid[0])
    return figure


@styled
def spectra(dataset: xarray.Dataset) -> Figure:
    """Density of heights: true, from one recording with its band, and by light pressure."""
    names, k = names_of(dataset["texture"]), dataset["wavenumber"].values
    band = dataset["band"].values
    figure, grid = grid_of_axes(1, len(names), 4.2, sharex=True, sharey=True)
    to_um2_mm = 1e12 * MM_PER_M
    drawn = []
    for t, (axes, name) in enumerate(zip(grid[0], names, strict=True)):
        truth = dataset["height_density_true"].values[t] * to_um2_mm
        axes.plot(k[1:], np.where(truth > 0, truth, np.nan)[1:], color=TRUTH, label="true")
        value, low, high = (
            dataset[key].values[0, t] * to_um2_mm
            for key in ("height_density", "height_density_low", "height_density_high")
        )
        usable = dataset["usable"].values[t] == 1
        for which, colour, label in (
            (usable, _OF_CONTACT["full"], "full contact, one recording, 90 %"),
            (~usable, GREY, "the same beyond the limit"),
        ):
            middle = np.where(value > 0, value, np.nan)[which]
            reach = np.stack([middle - low[which], high[which] - middle])
            axes.errorbar(
                band[which], middle, reach, fmt="o", color=colour, capsize=3, markersize=4,
                label=label,
            )  # fmt: skip
        light = dataset["height_density_mean"].values[1, t] * to_um2_mm
        axes.plot(
            band[usable], light[usable], "D", color=_OF_CONTACT["light"], markersize=5,
            label="light pressure, mean of the draws",
        )  # fmt: skip
        ends = dataset["limits"].values[t]
        for end in ends:
            axes.axvline(end, color=GREY, linestyle="--", label="limits of what is seen")
        drawn.append(np.concatenate([low[usable], high[usable], light[usable]]))
        longest, shortest = 2 * np.pi / ends * MM_PER_M
        axes.set(xscale="log", yscale="log", xlabel="wavenumber k [rad/m]")
        axes.set_title(f"{name.capitalize()}: from {longest:.2g} down to {shortest:.2g} mm")
    visible = np.concatenate(drawn)
    visible = visible[visible > 0]
    grid[0, 0].set(
        ylabel="density of height [µm² mm]",
        xlim=(band[0] / 1.5, 1.3 * band[-1]),
        ylim=(visible.min() / 5, 5 * visible.max()),
    )
    figure.suptitle(
        "Height spectra from the signal: right in full contact, too low under light pressure"
    )
    legend_below(figure, grid[0])
    return figure


@styled
def confusion(dataset: xarray.Dataset) -> Figure:
    """Confusion matrices: chosen texture (columns) for the true one (rows), a panel for each
    classifier."""
    ways, names = names_of(dataset["classification"]), names_of(dataset["texture"])
    figure, grid = grid_of_axes(1, len(ways), 2.9, sharey=True)
    for axes, way, counts, right in zip(
        grid[0], ways, dataset["chosen"].values, dataset["accuracy"].values, strict=True
    ):
        fraction = counts / counts.sum(axis=1, keepdims=True)
        axes.imshow(fraction, cmap="Blues", vmin=0, vmax=1, aspect="auto")
        for (row, column), count in np.ndenumerate(counts):
            colour = "white" if fraction[row, column] > 0.55 else TRUTH
            axes.text(column, row, str(count), ha="center", va="center", color=colour)
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(names)), names)
        axes.set(xlabel="chosen", title=f"{way.capitalize()}:\n{right:.0%} right")
        axes.grid(visible=False)
    grid[0, 0].set_ylabel("there")
    figure.suptitle("Textures told apart by the spectrum of a short stretch, in draws")
    return figure
