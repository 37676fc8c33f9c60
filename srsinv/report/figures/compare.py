"""Comparison of methods over many draws of the noise."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import TRUTH, grid_of_axes, legend_below, method_lines, styled


@styled
def errors_against_noise(
    snr_dB: np.ndarray,
    error: np.ndarray,
    coverage: np.ndarray,
    methods: Sequence[str],
    components: Sequence[str],
) -> Figure:
    """Error, and coverage of the 90 % band, of each component over the signal-to-noise ratio.

    `error`, `coverage` (method, level, draw, component) [1]: dots are means over the draws, bars go
    from the least to the greatest.
    """
    figure, grid = grid_of_axes(2, len(components), 2.6, sharex=True, sharey="row")
    for c, (name, (above, below)) in enumerate(zip(components, grid.T, strict=True)):
        _spread(above, snr_dB, 100 * error[..., c], methods)
        above.set(title=f"Relative error of {name}", yscale="log")
        _spread(below, snr_dB, 100 * coverage[..., c], methods)
        below.axhline(90, color=TRUTH, linestyle="--", linewidth=0.9, label="90 %, expected")
        below.set(title=f"True {name} inside the 90 % band", ylim=(-4, 104))
        below.set_xticks(snr_dB, [f"{level:g}" for level in snr_dB])
        below.set_xlabel("signal-to-noise ratio [dB]")
    grid[0, 0].set_ylabel("error [%]")
    grid[1, 0].set_ylabel("coverage [%]")
    figure.suptitle("Error and coverage against noise: mean, least and greatest over the draws")
    legend_below(figure, grid.flat)
    return figure


@styled
def ranking(
    ranks: np.ndarray, methods: Sequence[str], levels: Sequence[str], caption: str
) -> Figure:
    """Rank (method, level, draw) of each method at each level: mean, least and greatest."""
    figure, grid = grid_of_axes(1, len(levels), 0.8 + 0.45 * len(methods), sharey=True)
    place = np.arange(len(methods))
    for axes, level, of_level in zip(grid[0], levels, np.moveaxis(ranks, 1, 0), strict=True):
        for m, (name, look) in enumerate(method_lines(methods).items()):
            mean = of_level[m].mean()
            reach = [[mean - of_level[m].min()], [of_level[m].max() - mean]]
            axes.errorbar(
                [mean], [place[m]], xerr=reach, fmt="o", color=look["color"], capsize=4,
                markersize=7, label=name,
            )  # fmt: skip
        axes.set(title=level, xlim=(0.6, len(methods) + 0.4), xticks=place + 1, xlabel="rank")
        axes.set_ylim(len(methods) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
    grid[0, 0].set_yticks(place, list(methods))
    figure.suptitle(caption)
    return figure


def _spread(axes: Axes, x: np.ndarray, values: np.ndarray, methods: Sequence[str]) -> None:
    """Mean, least and greatest of `values` (method, level, draw), side by side at each level."""
    step = 0.06 * np.min(np.diff(x)) if x.size > 1 else 0.5
    for m, (name, look) in enumerate(method_lines(methods).items()):
        mean = values[m].mean(axis=-1)
        reach = [mean - values[m].min(axis=-1), values[m].max(axis=-1) - mean]
        beside = x + step * (m - (len(methods) - 1) / 2)
        axes.errorbar(beside, mean, reach, **look, marker="o", capsize=3, label=name)
