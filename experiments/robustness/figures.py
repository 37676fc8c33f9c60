"""The error of every fault over that of the best weights."""

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from srsinv.inverse.quality import Quality
from srsinv.report.plot.style import GREY, TRUTH, WIDTH_IN, colours, names_of, styled
from srsinv.report.text import spoken

from .answers import NO_ANSWER

MARKS = {  # by quality: marker, and whether it is filled
    str(Quality.GOOD): ("o", True),
    str(Quality.DOUBTFUL): ("o", False),
    str(Quality.NO_BANDS): ("s", False),
    str(Quality.FAILED): ("x", True),
}
WORDS = {str(Quality.FAILED): "no answer"}
ROW_IN, APART, MOST = 0.21, 0.34, 100.0  # MOST: larger ratios are drawn at the edge
TICKS = (1, 2, 5, 10, 20, 50, 100)


@styled
def by_fault(ds: xarray.Dataset) -> Figure:
    """A row for each fault, a panel for each scene: the median over the draws, with the least and
    the greatest; the rows by the first method's."""
    ds = ds.isel(fault=_order(ds))
    names = [spoken(each) for each in ds["fault"].values]
    figure = Figure(figsize=(WIDTH_IN, ROW_IN * len(names) + 1.8), layout="constrained")
    grid = figure.subplots(1, ds.sizes["scene"], squeeze=False, sharey=True)[0]
    for axes, scene in zip(grid, ds["scene"].values, strict=True):
        _panel(axes, ds.sel(scene=scene), float(ds.attrs["most_ratio"]))
        axes.set_title(str(scene))
    grid[0].set_yticks(range(len(names)), names)
    grid[0].set_ylim(len(names) - 0.4, -0.6)
    figure.legend(handles=_legend(ds), loc="outside lower center", ncols=3)
    return figure


def _order(ds: xarray.Dataset) -> np.ndarray:
    """The faults from the greatest ratio of the first method, over scenes and draws, down."""
    ratio = np.nan_to_num(ds["ratio"].isel(estimator=0).values, nan=-np.inf, posinf=np.inf)
    return np.argsort(-ratio.max(axis=(0, 2)), kind="stable")


def _panel(axes: Axes, ds: xarray.Dataset, limit: float) -> None:
    axes.axvline(1.0, color=TRUTH, linewidth=0.9)
    axes.axvline(limit, color=TRUTH, linewidth=0.9, linestyle="--")
    methods = names_of(ds["estimator"])
    for m, (method, colour) in enumerate(colours(methods).items()):
        own = ds.sel(estimator=method).transpose("fault", "draw", ...)
        at = np.arange(ds.sizes["fault"]) + APART * (m - (len(methods) - 1) / 2)
        each = own["ratio"].values, own["answer_quality"].values
        for y, ratio, quality in zip(at, *each, strict=True):
            ratio = np.minimum(ratio[np.isfinite(ratio)], MOST)
            if not ratio.size:
                continue
            marker, is_filled = MARKS[_worst(quality)]
            axes.plot([ratio.min(), ratio.max()], [y, y], color=colour, linewidth=0.8)
            face = colour if is_filled else "white"
            axes.plot(
                np.median(ratio), y, marker, color=colour, markerfacecolor=face, markersize=5,
                clip_on=False,
            )  # fmt: skip
    axes.set(xscale="log", xlabel="error over that of the best weights")
    axes.set_xlim(0.7, MOST)
    axes.set_xticks(TICKS, [f"{each:g}" for each in TICKS])


def _worst(quality: np.ndarray) -> str:
    """The worst of the draws' qualities, refused or failed alike."""
    found = [str(Quality.FAILED) if each in NO_ANSWER else str(each) for each in quality]
    return max(found, key=list(MARKS).index)


def _legend(ds: xarray.Dataset) -> list[Line2D]:
    """Methods by colour, then qualities by mark."""
    blank = {"linestyle": "none", "markersize": 6}
    methods = [
        Line2D([], [], marker="o", color=colour, label=name, **blank)
        for name, colour in colours(names_of(ds["estimator"])).items()
    ]
    found = set(np.unique(ds["answer_quality"].values).tolist())
    marks = [
        Line2D(
            [], [], marker=marker, color=GREY, label=WORDS.get(code, code),
            markerfacecolor=GREY if is_filled else "white", **blank,
        )
        for code, (marker, is_filled) in MARKS.items() if code in found
    ]  # fmt: skip
    limits = [
        Line2D([], [], color=TRUTH, linewidth=0.9, label="as with the best weights"),
        Line2D([], [], color=TRUTH, linewidth=0.9, linestyle="--",
               label=f"{ds.attrs['most_ratio']:g} times that"),
    ]  # fmt: skip
    return [*methods, *limits, *marks]
