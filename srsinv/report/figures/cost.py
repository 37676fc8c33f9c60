"""Errors, interval coverage and time of methods."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..text import format_value
from .style import (
    GREY,
    PALETTE,
    TRUTH,
    WIDTH_IN,
    Scale,
    colours,
    grid_of_axes,
    legend_below,
    note,
    scale,
    styled,
)

_PERCENT = Scale(100.0, "%")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">")

Row = Mapping[str, Any]


@styled
def errors_and_time(rows: Sequence[Row]) -> Figure:
    """Relative error, coverage of the 90 % band and time of each method.

    `rows`: one mapping for each method, with `method`, `error_p`, `error_q`, `coverage_p`,
    `coverage_q` [1], `first_call_s` and `steady_call_s` [s]; None where unknown.
    """
    figure, grid = grid_of_axes(1, 3, 0.7 + 0.55 * len(rows), sharey=True)
    error, coverage, time = grid[0]
    components = colours(("p", "q"))
    _dots(error, rows, "error_{}", components, _PERCENT)
    error.set(title="Relative error against the truth", xlabel=_PERCENT.label("error"))
    error.set_xlim(left=0)
    _dots(coverage, rows, "coverage_{}", components, _PERCENT)
    coverage.axvline(90, color=TRUTH, linestyle="--", linewidth=0.9, label="90 %, expected")
    coverage.set(title="Truth inside the 90 % band", xlabel=_PERCENT.label("coverage"))
    coverage.set_xlim(-4, 118)  # room for a number beside 100 %
    unit = scale("s", *(row["steady_call_s"] or 0.0 for row in rows))
    _dots(time, rows, "{}_call_s", {"first": GREY, "steady": PALETTE[4]}, unit)
    time.set(title="Time, with and without compiling", xlabel=unit.label("time"))
    if any(row[f"{name}_call_s"] for row in rows for name in ("first", "steady")):
        time.set_xscale("log")
        time.margins(x=0.25)
    error.set_yticks(range(len(rows)), [str(row["method"]) for row in rows])
    error.set_ylim(len(rows) - 0.4, -0.6)
    figure.suptitle("Errors, coverage of the 90 % band, and time")
    legend_below(figure, grid[0])
    return figure


@styled
def accuracy_cost(
    rows: Sequence[Row], title: str, error: str = "relative error [1]", ends: str = "sizes"
) -> Figure:
    """Error against steady time, one line for each family, from its smallest size to its largest.

    `rows`: mappings with `family`, `label`, `size`, `error` and `time_s` [s]. The label (the size
    where it is empty) is written at both ends of a family's line; `ends` is its meaning.
    """
    figure = Figure(figsize=(WIDTH_IN, 5.2), layout="constrained")
    axes = figure.subplots()
    families = list(dict.fromkeys(str(row["family"]) for row in rows))
    for i, family in enumerate(families):
        members = sorted(
            (row for row in rows if str(row["family"]) == family), key=lambda row: row["size"]
        )
        _family(axes, members, family, i)
    axes.set(xscale="log", yscale="log", xlabel="steady time [s]", ylabel=error)
    axes.margins(0.08)
    axes.set_title(f"Lower left is better; {ends} at the ends of each line")
    axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0.0)
    figure.suptitle(title)
    return figure


@styled
def fit_counts(starts: Sequence[Row], together: Sequence[Row]) -> Figure:
    """Frequency of convergence to the minimum and time of a fit over the number of starts, and time
    over the number of signals fitted together.

    Rows have `family`, `count`, `converged` [1] and `time_s` [s], for each signal.
    """
    figure, grid = grid_of_axes(1, 3, 3.4)
    success, time, batch = grid[0]
    for axes, rows, quantity, factor in (
        (success, starts, "converged", 100.0), (time, starts, "time_s", 1e3),
        (batch, together, "time_s", 1e3),
    ):  # fmt: skip
        families = list(dict.fromkeys(str(row["family"]) for row in rows))
        for i, family in enumerate(families):
            members = [row for row in rows if str(row["family"]) == family]
            counts = [row["count"] for row in members]
            values = [factor * row[quantity] for row in members]
            axes.plot(counts, values, color=PALETTE[i], marker=_MARKERS[i], label=family)
        counts = sorted({row["count"] for row in rows})
        axes.set_xscale("log", base=2)
        axes.set_xticks(counts, [str(count) for count in counts])
        axes.minorticks_off()
    success.set(title="Minimum found", xlabel="starts", ylabel="share of the signals [%]")
    success.set_ylim(-4, 104)
    time.set(title="Time", xlabel="starts", ylabel="steady time [ms per signal]", yscale="log")
    batch.set(title="Time, one start", xlabel="signals in one call", ylim=(0, None))
    batch.set_ylabel("steady time [ms per signal]")
    figure.suptitle("Feature fit: what more starts bring, and what they and many signals cost")
    legend_below(figure, grid[0])
    return figure


def _dots(
    axes: Axes, rows: Sequence[Row], quantity: str, palette: Mapping[str, str], unit: Scale
) -> None:
    """A dot for every known value under `quantity`, filled in with each name of the palette, with
    its number written beside it."""
    known = False
    for i, (name, colour) in enumerate(palette.items()):
        place = [row_at + 0.3 * (i - (len(palette) - 1) / 2) for row_at in range(len(rows))]
        values = [row[quantity.format(name)] for row in rows]
        pairs = [
            (v * unit.factor, y)
            for v, y in zip(values, place, strict=True)
            if v is not None and np.isfinite(v)
        ]
        axes.plot(*np.reshape(pairs, (-1, 2)).T, "o", color=colour, markersize=7, label=name)
        for value, y in pairs:
            text = format_value(float(f"{value:.3g}"))
            axes.annotate(
                text, (value, y), (7, 0), textcoords="offset points", va="center", color=colour,
                fontsize=9,
            )  # fmt: skip
        known = known or bool(pairs)
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.2)
    if not known:
        axes.tick_params(labelbottom=False)
        note(axes, "not known")


def _family(axes: Axes, members: Sequence[Row], family: str, index: int) -> None:
    time = np.array([row["time_s"] for row in members], float)
    error = np.array([row["error"] for row in members], float)
    colour = PALETTE[index % len(PALETTE)]
    style = "-" if index < len(PALETTE) else "--"
    marker = _MARKERS[index % len(_MARKERS)]
    axes.plot(time, error, style, marker=marker, color=colour, markersize=6, label=family)
    for end, offset, side in ((0, (-5, 4), "right"), (len(members) - 1, (6, -3), "left")):
        text = str(members[end]["label"]) or format_value(members[end]["size"])
        axes.annotate(
            text, (time[end], error[end]), offset, textcoords="offset points", ha=side,
            color=colour, fontsize=8,
        )  # fmt: skip
