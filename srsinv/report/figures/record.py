"""Signals in time: with an effect and without it, and a recording with its speed."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from .style import (
    GREY,
    MM_PER_M,
    TRUTH,
    colours,
    grid_of_axes,
    legend_below,
    names_of,
    scale,
    styled,
    units_of,
)

ACTIVE_FRACTION = 0.02  # of a signal's peak: below, the signal is not drawn


@styled
def with_and_without(
    time_s: np.ndarray, with_effect: np.ndarray, ideal: np.ndarray, unit: str
) -> Figure:
    """For each element (rows) the signals (element, sample) with an effect and without, and beside
    them their difference, over the interval with a signal."""
    figure, grid = grid_of_axes(len(with_effect), 2, 1.7, sharex=True)
    signals, made = scale(unit, with_effect, ideal), scale(unit, with_effect - ideal)
    for e, (left, right) in enumerate(grid):
        left.plot(time_s, signals.factor * ideal[e], color=GREY, label="without")
        left.plot(time_s, signals.factor * with_effect[e], "--", color=colours(["with"])["with"],
                  label="with")  # fmt: skip
        right.plot(
            time_s, made.factor * (with_effect[e] - ideal[e]), color=TRUTH, label="difference"
        )
        left.set(
            ylabel=signals.label(f"element {e}"),
            xlim=_active_interval_s(time_s, with_effect, ideal),
        )
        right.set(ylabel=made.label("change"))
    grid[0, 0].set_title("Signal")
    grid[0, 1].set_title("What the effect makes of it")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    legend_below(figure, grid.flat)
    return figure


def _active_interval_s(time_s: np.ndarray, *signals: np.ndarray) -> tuple[float, float]:
    """Interval in which any signal (element, sample) is above `ACTIVE_FRACTION` of its peak, and a
    margin."""
    size = np.abs(np.concatenate(signals)).max(axis=0)
    active = time_s[size >= ACTIVE_FRACTION * size.max()]
    margin = 0.3 * (active[-1] - active[0]) + (time_s[-1] - time_s[0]) / 50
    return max(active[0] - margin, time_s[0]), min(active[-1] + margin, time_s[-1])


@styled
def record(dataset: xarray.Dataset) -> Figure:
    """The recorded samples of every element, over the speed of sliding."""
    figure, grid = grid_of_axes(2, 1, 2.0, sharex=True)
    upper, lower = grid[:, 0]
    time_s, signals = dataset["sample_time"].values, dataset["recorded_signal"].values
    shown = scale(units_of(dataset["recorded_signal"]), signals)
    names = names_of(dataset["element"])
    for values, (name, colour) in zip(signals, colours(names).items(), strict=True):
        upper.plot(time_s, shown.factor * values, color=colour, label=name)
    lower.plot(time_s, MM_PER_M * dataset["sample_speed"].values, color=TRUTH)
    upper.set(ylabel=shown.label("signal"), title="As recorded", xlim=(time_s[0], time_s[-1]))
    lower.set(ylabel="speed [mm/s]", xlabel="time [s]")
    legend_below(figure, [upper])
    return figure
