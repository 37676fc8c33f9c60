"""Many draws of the noise: errors over the bound, coverage of intervals, confusion of
candidates."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from .style import (
    GREY,
    LINE_STYLES,
    PALETTE,
    SHADE,
    TRUTH,
    grid_of_axes,
    legend_below,
    names_of,
    styled,
)

_BINS = np.linspace(-4, 4, 25)
_COLUMNS = 3
_OFFSET = 0.22  # of a row, between two marks of one quantity


@styled
def bound_and_coverage(dataset: xarray.Dataset) -> Figure:
    """For every quantity its error over the Cramer-Rao bound and the coverage of its intervals."""
    names = [name.replace("_", " ") for name in names_of(dataset["quantity"])]
    draws = dataset.sizes["draw"]
    rows = np.arange(len(names))
    figure, grid = grid_of_axes(1, 2, 0.9 + 0.34 * len(names), sharey=True)
    error, coverage = grid[0]
    scatter = 2 / np.sqrt(2 * draws)
    error.axvspan(1 - scatter, 1 + scatter, color=SHADE, label="± 2 standard deviations")
    error.axvline(1, color=TRUTH, linewidth=0.9)
    for shift, (name, label), mark in zip(
        (-_OFFSET / 2, _OFFSET / 2),
        {"rmse_over_crb": "root mean squared error", "stderr_over_crb": "standard error"}.items(),
        ("o", "D"),
        strict=True,
    ):
        look = {"color": PALETTE[0] if mark == "o" else PALETTE[2], "markersize": 6}
        error.plot(dataset[name].values, rows + shift, mark, label=label, **look)
    error.set(title="Over the Cramer-Rao bound", xlabel="ratio [1]")
    error.set_yticks(rows, names)
    error.set_ylim(len(names) - 0.4, -0.6)
    for i, level in enumerate(dataset["level"].values):
        colour = PALETTE[i]
        scatter = 2 * np.sqrt(level * (1 - level) / draws)
        band = 100 * np.array([level - scatter, level + scatter])
        coverage.axvspan(*band, color=colour, alpha=0.15, linewidth=0)
        coverage.axvline(100 * level, color=colour, linewidth=0.9)
        label = f"interval of {100 * level:.0f} %"
        held = 100 * dataset["coverage"].values[:, i]
        coverage.plot(held, rows, "o", color=colour, markersize=6, label=label)
    coverage.set(title="Truth inside the interval", xlabel="share of the draws [%]")
    figure.suptitle(f"Feature fit over {draws} draws of the noise")
    legend_below(figure, grid[0])
    return figure


@styled
def normalised_errors(dataset: xarray.Dataset) -> Figure:
    """Errors over their own standard errors, a panel for each feature, and the unit normal."""
    features = list(dict.fromkeys(names_of(dataset["feature"])))
    rows = -(-len(features) // _COLUMNS)
    figure, grid = grid_of_axes(rows, min(_COLUMNS, len(features)), 2.9, sharex=True, sharey=True)
    t = np.linspace(_BINS[0], _BINS[-1], 201)
    normal = np.exp(-(t**2) / 2) / np.sqrt(2 * np.pi)
    parameters = list(dict.fromkeys(names_of(dataset["parameter"])))
    looks = {
        name: {"color": PALETTE[i % len(PALETTE)], "linestyle": LINE_STYLES[i // len(PALETTE)]}
        for i, name in enumerate(parameters)
    }
    for axes, feature in zip(grid.flat, features, strict=False):
        members = dataset.isel(quantity=dataset["feature"].values == feature)
        for name, error in zip(
            names_of(members["parameter"]), members["normalised_error"].values, strict=True
        ):
            # Values beyond are counted in the last bin.
            shown = np.clip(error, _BINS[0], _BINS[-1])
            axes.hist(shown, _BINS, density=True, histtype="step", label=name, **looks[name])
        axes.plot(t, normal, color=TRUTH, linewidth=1.0, label="unit normal")
        axes.set_title(feature.replace("_", " "))
    for axes in grid.flat[len(features) :]:
        axes.set_axis_off()
    for axes in grid[:, 0]:
        axes.set_ylabel("density [1]")
    for axes in grid[-1]:
        axes.set_xlabel("error / standard error [1]")
    figure.suptitle("Errors in units of their own standard error")
    legend_below(figure, grid.flat[: len(features)])
    return figure


@styled
def confusion(dataset: xarray.Dataset) -> Figure:
    """Confusion matrix: the chosen candidate (columns) for the true one (rows), in % of each
    row."""
    truths, chosen = names_of(dataset["truth"]), names_of(dataset["candidate"])
    percent = 100 * dataset["chosen"].values / dataset["chosen"].values.sum(1, keepdims=True)
    figure, grid = grid_of_axes(1, 1, 0.8 + 0.6 * len(truths))
    axes = grid[0, 0]
    axes.imshow(percent, cmap="Blues", vmin=0, vmax=100, aspect="auto")
    for (row, column), value in np.ndenumerate(percent):
        if value > 0:
            colour = "white" if value > 55 else TRUTH
            axes.text(column, row, f"{value:.4g}", ha="center", va="center", color=colour)
    axes.set_xticks(range(len(chosen)), [name.replace("_", " ") for name in chosen])
    axes.set_yticks(range(len(truths)), [name.replace("_", " ") for name in truths])
    axes.set(xlabel="chosen", ylabel="there")
    axes.grid(visible=False)
    figure.suptitle("Most probable candidate, in % of the draws")
    return figure


@styled
def evidence_margins(dataset: xarray.Dataset) -> Figure:
    """Log evidence of the true candidate less that of the best other, every draw."""
    truths = names_of(dataset["truth"])
    margin = dataset["margin"].values
    figure, grid = grid_of_axes(1, 1, 0.8 + 0.5 * len(truths))
    axes = grid[0, 0]
    for row, values in enumerate(margin):
        place = row + np.linspace(-0.25, 0.25, values.size)
        axes.plot(values, place, "o", color=PALETTE[0], markersize=4, alpha=0.6)
        axes.plot(np.median(values), row, "|", color=TRUTH, markersize=22)
    axes.axvline(0, color=GREY, linewidth=1.0)
    axes.set_xscale("symlog", linthresh=1, linscale=0.5)
    axes.set_xlim(2 * min(float(margin.min()), -1.0), 2 * max(float(margin.max()), 1.0))
    axes.set_yticks(range(len(truths)), [name.replace("_", " ") for name in truths])
    axes.set_ylim(len(truths) - 0.4, -0.6)
    axes.set(xlabel="log evidence over that of the best other [1]", ylabel="there")
    figure.suptitle("Margin of what is there, each draw and the median; below 0 it is not chosen")
    return figure
