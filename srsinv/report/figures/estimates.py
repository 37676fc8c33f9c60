"""The recovered traction and its resolution."""

import itertools
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import (
    MM_PER_M,
    NORMAL_90,
    TRUTH,
    Scale,
    along_x,
    grid_of_axes,
    legend_below,
    method_lines,
    names_of,
    note,
    note_alone,
    observed_anywhere,
    peak,
    pressure_scale,
    shade_unobserved,
    shown,
    styled,
    units_of,
)

_QUANTITY = {"p": "pressure", "q": "shear"}


@styled
def estimates(dataset: xarray.Dataset) -> Figure:
    """p and q as each method recovers them, with 90 % bands, over the truth where it is known.

    A component whose mean is unobservable is drawn as its deviation from its own mean over the
    observed stretch, truth and estimates alike.
    """
    components = names_of(dataset["component"])
    figure, grid = grid_of_axes(len(components), 1, 2.6, sharex=True)
    for axes, name in zip(grid[:, 0], components, strict=True):
        _component(axes, dataset, name)
    grid[-1, 0].set_xlabel("position x [mm]")
    figure.suptitle("Recovered pressure and shear with 90 % bands")
    legend_below(figure, grid[:, 0])
    return figure


@styled
def averaging_kernel(dataset: xarray.Dataset) -> Figure:
    """Averaging kernel of one point of the estimate: a row for each component estimated, a column
    for each that contributes; only those that were solved for."""
    lag, kernels = dataset["lag"].values, dataset["averaging_kernel"].values
    solved = [c for c in range(kernels.shape[1]) if shown(kernels[:, c, c])]
    if not solved:
        return note_alone("Averaging kernels", "Not known for these methods.")
    components = names_of(dataset["component"])
    methods = method_lines(names_of(dataset["method"]))
    size = len(solved)
    figure, grid = grid_of_axes(size, size, 2.3, sharex=True, sharey="row")
    for axes, (out, into) in zip(grid.flat, itertools.product(solved, solved), strict=True):
        # By position: `sel` keeps the word "method" for itself.
        for (method, look), kernel in zip(methods.items(), kernels[:, out, into], strict=True):
            axes.plot(lag * MM_PER_M, kernel / MM_PER_M, **look, label=method)
        axes.set_title(f"Into the estimate of {components[out]}, from {components[into]}")
    for axes in grid[:, 0]:
        axes.set_ylabel("kernel [1/mm]")
    widths = np.array([[full_width_at_half_maximum(lag, k[c, c]) for c in solved] for k in kernels])
    reach = _reach_m(dataset, widths) * MM_PER_M
    for axes in grid[-1]:
        axes.set(xlim=(-reach, reach), xlabel="lag along x [mm]")
    named = [components[c] for c in solved]
    lines = [_say_widths(m, named, w) for m, w in zip(methods, widths, strict=True)]
    figure.suptitle(
        "\n".join(["Averaging kernels, with their full widths at half maximum", *lines])
    )
    legend_below(figure, grid[0])
    return figure


def full_width_at_half_maximum(lag_m: np.ndarray, kernel: np.ndarray) -> float:
    """Width [m] of the peak of `kernel` (n,) over `lag_m` (n,), between its two crossings of half
    the maximum, straight lines between samples; NaN where it does not fall that far."""
    if not np.isfinite(kernel).all() or kernel.max() <= 0:
        return float("nan")
    top, half = int(np.argmax(kernel)), kernel.max() / 2
    left = np.flatnonzero(kernel[:top] < half)
    right = np.flatnonzero(kernel[top:] < half)
    if not left.size or not right.size:
        return float("nan")

    def crossing(i: Any, j: Any) -> float:
        fraction = (half - kernel[i]) / (kernel[j] - kernel[i])
        return float(lag_m[i] + fraction * (lag_m[j] - lag_m[i]))

    return crossing(top + right[0] - 1, top + right[0]) - crossing(left[-1], left[-1] + 1)


def _component(axes: Axes, dataset: xarray.Dataset, name: str) -> None:
    x, observed = dataset["x"].values, observed_anywhere(dataset)
    values, truth, band = _curves(dataset, name)
    unknown_mean = name in str(dataset.attrs.get("mean_unobserved", "")).split(",")
    if unknown_mean:
        values, truth = _without_mean(values, observed), _without_mean(truth, observed)
    unit = pressure_scale(units_of(dataset["estimate"]), values, truth)
    shade_unobserved(axes, x, observed)
    for curve in truth:
        axes.plot(x * MM_PER_M, curve * unit.factor, color=TRUTH, label="truth", zorder=3)
    methods = method_lines(names_of(dataset["method"]))
    for (method, look), centre, half in zip(methods.items(), values, band, strict=True):
        low, high = (centre - half) * unit.factor, (centre + half) * unit.factor
        shade = {"color": look["color"], "alpha": 0.25, "linewidth": 0}
        axes.fill_between(x * MM_PER_M, low, high, **shade, label=f"{method}, 90 %")
        axes.plot(x * MM_PER_M, centre * unit.factor, **look, label=method, zorder=4)
    axes.set_title(_title(name, unknown_mean))
    axes.set_ylabel(unit.label(f"{name} - mean" if unknown_mean else name))
    along_x(axes, x)
    _limit(axes, unit, observed, truth, values, band)
    if not shown(values):
        note(axes, "not estimated")


def _curves(dataset: xarray.Dataset, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimates (method, x), truth (1 or 0, x) and half-widths of the bands (method, x)."""
    values = dataset["estimate"].sel(component=name).values
    stderr = dataset["estimate_stderr"].sel(component=name).values
    truth = np.empty((0, values.shape[-1]))
    if "traction" in dataset:
        truth = dataset["traction"].sel(component=name).values[None]
    return values, truth, NORMAL_90 * np.where(np.isfinite(stderr), stderr, np.nan)


def _title(name: str, unknown_mean: bool) -> str:
    quantity = _QUANTITY.get(name, name).capitalize()
    if not unknown_mean:
        return quantity
    return f"{quantity}, less its mean over the observed stretch: the mean is not in the data"


def _without_mean(curves: np.ndarray, observed: np.ndarray) -> np.ndarray:
    filled = np.where(observed & np.isfinite(curves), curves, 0.0)
    count = np.sum(observed & np.isfinite(curves), axis=-1, keepdims=True)
    return curves - filled.sum(axis=-1, keepdims=True) / np.maximum(count, 1)


def _limit(
    axes: Axes,
    unit: Scale,
    observed: np.ndarray,
    truth: np.ndarray,
    values: np.ndarray,
    band: np.ndarray,
) -> None:
    # A band may be huge where nothing was measured: it must not set the scale.
    where = observed if observed.any() else np.ones_like(observed)
    band = np.nan_to_num(band)
    in_view = np.concatenate([truth, (values - band)[:, where], (values + band)[:, where]], None)
    in_view = in_view[np.isfinite(in_view)] * unit.factor
    if in_view.size:
        margin = 0.06 * np.ptp(in_view) or 1.0
        axes.set_ylim(in_view.min() - margin, in_view.max() + margin)


def _say_widths(method: str, components: list[str], widths: np.ndarray) -> str:
    parts = [
        f"{c} from {c} {width * MM_PER_M:.3g} mm" if np.isfinite(width) else f"{c} from {c} none"
        for c, width in zip(components, widths, strict=True)
    ]
    return f"{method}: {', '.join(parts)}"


def _reach_m(dataset: xarray.Dataset, widths: np.ndarray) -> float:
    few_depths = 5 * float(dataset["element_depth"].max())
    return min(max(few_depths, 3 * peak(widths)), peak(dataset["lag"].values))
