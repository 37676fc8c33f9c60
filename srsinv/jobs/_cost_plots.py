"""Figures of accuracy_cost that no general one serves."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from ..report.plot.panels import Curve, Panel, PanelAxis, log_ticks, panels
from ..report.plot.style import GREY, PALETTE, grid_of_axes, scale, styled


@styled
def effect_costs(ds: xarray.Dataset) -> Figure:
    """Of every effect the change of the signal without it, and the time that it costs; `ds` has the
    effects, the greatest change drawn first."""
    own = ds.sortby("error")
    names, at = (
        [str(name).replace("_", " ") for name in own["family"].values],
        range(own["size"].size),
    )
    figure, axes = grid_of_axes(1, 2, 0.3 * len(names) + 0.6, sharey=True)
    error, cost = own["error"].values, own["cost_s"].values
    left, right = axes[0]
    changes = error[error > 0]
    least = changes.min() / 3 if changes.size else 0.1
    left.hlines(at, least, np.where(error > 0, error, least), color=GREY, linewidth=1)
    left.plot(np.where(error > 0, error, np.nan), at, "o", color=PALETTE[0])
    left.plot(np.where(error > 0, np.nan, least), at, "o", color=PALETTE[0], markerfacecolor="none")
    left.set(xscale="log", xlabel="change of the signal [1]", yticks=at)
    left.set_yticklabels(names)
    left.set_xlim(least / 1.5, 1.5 * max(error.max(initial=0.0), least))
    log_ticks(left.xaxis, *left.get_xlim())
    left.set_title("Error of leaving it out")
    unit = scale("s", cost)
    low, high = (unit.factor * own[name].values for name in ("lower_cost_s", "upper_cost_s"))
    right.axvline(0, color=GREY, linewidth=0.9)
    right.hlines(at, low, high, color=PALETTE[1], linewidth=2.5, alpha=0.4)
    right.plot(unit.factor * cost, at, "o", color=PALETTE[1])
    right.set_xlabel(unit.label("time more"))
    right.set_title("Time that it costs")
    return figure


def fit_counts(ds: xarray.Dataset) -> Figure:
    """How often a fit is at its minimum and how long it takes, over the number of starts; and how
    long over the number of signals that are fitted together; `ds` has the fits."""
    success = PanelAxis("fits at the minimum", "1", limits=(-0.05, 1.05))
    alone, together = (
        PanelAxis(time, "s", limits=(0.0, None))
        for time in ("time for each signal", "time for each, together")
    )

    def panel(sweep: str, name: str, count: str, y: PanelAxis) -> Panel:
        own = ds.isel(case=np.flatnonzero(ds["line"] == sweep))
        curves = [
            Curve(each[name].values, str(family), each["size"].values, look={"marker": "o"})
            for family in dict.fromkeys(own["family"].values.tolist())
            for each in [own.isel(case=np.flatnonzero(own["family"] == family))]
        ]
        counts = own["size"].values
        ends = (0.95 * counts.min(), 1.05 * counts.max()) if counts.size else (None, None)
        return Panel(curves, PanelAxis(count, is_log=True, limits=ends), y)

    return panels(
        [
            panel("starts", "converged", "starts", success),
            panel("starts", "steady_call_s", "starts", alone),
            panel("batch", "steady_call_s", "signals in one call, one start each", together),
        ]
    )
