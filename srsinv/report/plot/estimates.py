"""The recovered traction with its bands, and its resolution."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from ...errors import refuse
from ...numerics import BAND_90
from ..answers import as_dataset
from .panels import Curve, Mark, Panel, PanelAxis, panels, unobserved
from .stages import QUANTITIES, X, method_curves, method_looks
from .style import (
    TRUTH,
    has_values,
    names_of,
    observed_anywhere,
    peak,
    scale,
    units_of,
)

_COMPONENTS = 2  # p and q
_BY_METHOD = ("estimate", "estimate_stderr", "estimate_low", "estimate_high")
_TOGETHER = 2  # methods whose bands are legible over each other
_MOST_REACH = 2.0  # of a band in view over the estimate's peak, where most of the band is narrower
_OUT_OF_VIEW = 1.5  # times the estimates' range, beyond which peaks of the truth are cut off


def estimates(
    given: Any, marks: Sequence[Mark] = (), title: str = "", *, truth: Any = None
) -> Figure:
    """Draw pressure p and shear q along x with their 90 % bands, over the truth if it is known.

    - `given`: an estimate; estimates by name, which are drawn on the line of the first; or the
      dataset of a result.
    - `truth` (2, n) [Pa]: the true p and q on the line; None: `traction` of the dataset, if any.
    - `marks`: lines and areas across the panels; `title`: of the figure.

    A component whose mean is not observable is drawn as its deviation from its own mean over the
    observed stretch, truth and estimates alike. More than two methods have a panel each.
    `traction_resolved` of a dataset is the truth at the estimate's resolution. Raises `BadInput`
    for what cannot be drawn, and for a truth of another shape.
    """
    parts = estimate_panels(with_truth(as_dataset(given), truth), marks)
    return panels(parts, title, height_in=2.4 if len(parts) <= _COMPONENTS else 1.7)


def with_truth(dataset: xarray.Dataset, truth: Any) -> xarray.Dataset:
    """The dataset with the true p and q (2, n) [Pa], None where they are not given."""
    if truth is None:
        return dataset
    shape = tuple(dataset.sizes[dim] for dim in ("component", "x"))
    own = np.asarray(truth, float)
    refuse(own.shape != shape, f"truth has the shape {own.shape}: give (component, cell) {shape}.")
    return dataset.assign(traction=(("component", "x"), own, {"units": "Pa"}))


def estimate_panels(dataset: xarray.Dataset, marks: Sequence[Mark] = ()) -> list[Panel]:
    """The panels of [`estimates`][]."""
    if "estimator" not in dataset["estimate"].dims:
        own = [name for name in _BY_METHOD if name in dataset]
        dataset = dataset.assign(
            {name: dataset[name].expand_dims(estimator=["estimate"]) for name in own}
        )
    methods = method_looks(names_of(dataset["estimator"]))
    each = [[name] for name in methods] if len(methods) > _TOGETHER else [list(methods)]
    return [
        _component(dataset, component, group, marks)
        for component, group in itertools.product(names_of(dataset["component"]), each)
    ]


def _component(
    dataset: xarray.Dataset, name: str, methods: Sequence[str], marks: Sequence[Mark]
) -> Panel:
    observed, looks = observed_anywhere(dataset), method_looks(names_of(dataset["estimator"]))
    own = dataset.sel(component=name)
    is_deviation = name in str(dataset.attrs.get("mean_unobserved", "")).split(",")

    def values(key: str) -> np.ndarray:
        array = own[key].values
        return _without_mean(array, observed) if is_deviation else array

    chosen = [list(looks).index(method) for method in methods]
    middle = values("estimate")[chosen]
    stderr = own["estimate_stderr"].values[chosen]
    half = BAND_90 * np.where(np.isfinite(stderr), stderr, np.nan)
    ends = middle - half, middle + half
    if "estimate_low" in own:  # which need not be symmetric
        centre = own["estimate"].values[chosen] - middle
        ends = tuple(own[f"estimate_{end}"].values[chosen] - centre for end in ("low", "high"))
    curves = list(_bands(methods, looks, middle, ends, observed))
    if len(looks) > _TOGETHER:  # alone in its panel, whose title names it
        look = {"color": looks[methods[0]]["color"]}
        curves = [replace(each, label="", band_label="", look=look) for each in curves]
    reach = peak(np.where(observed, middle, np.nan)) + peak(np.where(observed, half, np.nan))
    remark = ""
    if "traction" in dataset:
        truth = values("traction")
        is_cut = peak(truth) > _OUT_OF_VIEW * reach > 0
        curves.insert(0, Curve(truth, "truth", look={"color": TRUTH}, in_view=not is_cut))
        if is_cut:
            unit = scale(units_of(own["traction"]), truth)
            remark = f"; the truth reaches {np.nanmax(truth) * unit.factor:.3g} {unit.unit}"
    if "traction_resolved" in dataset:
        look = {"color": TRUTH, "linestyle": ":", "linewidth": 1.8}
        curves.append(Curve(values("traction_resolved"), "truth, as resolved", look=look))
    less = f"{name} less its mean over the scan" if is_deviation else QUANTITIES[name]
    title = "; ".join([*(methods if len(methods) < len(looks) else ()), f"{less}{remark}"])
    quantity = QUANTITIES[name].split()[0]
    units = units_of(dataset["estimate"])
    up = PanelAxis(f"{quantity}{' (relative)' if units == '1' else ''}", units)
    x = dataset["x"].values
    return Panel(curves, X, up, x, title, (*unobserved(x, observed), *marks))


def _bands(methods, looks, middle, ends, observed) -> Iterator[Curve]:
    for method, value, low, high in zip(methods, middle, *ends, strict=True):
        reach = (high - low) / 2
        # A band may be huge where nothing was measured: it must not set the scale.
        in_view = observed if observed.any() else True
        narrow = observed & (np.nan_to_num(reach) <= _MOST_REACH * peak(value))
        if 2 * narrow.sum() > observed.sum():  # not at the edges of a feature, where it is wide
            in_view = narrow
        if not has_values(reach):  # a method that a user wrote may give none
            yield Curve(value, method, look=looks[method], in_view=in_view)
            continue
        low, high = (np.where(np.isfinite(end), end, value) for end in (low, high))
        yield Curve(
            value, method, band=(low, high), look=looks[method],
            band_label=f"90 % band of {method}", in_view=in_view,
        )  # fmt: skip


def _without_mean(curves: np.ndarray, observed: np.ndarray) -> np.ndarray:
    filled = np.where(observed & np.isfinite(curves), curves, 0.0)
    count = np.sum(observed & np.isfinite(curves), axis=-1, keepdims=True)
    return curves - filled.sum(axis=-1, keepdims=True) / np.maximum(count, 1)


def averaging_kernel(dataset: xarray.Dataset) -> Figure:
    """Draw the averaging kernel [1/m] of one point of the estimate over the distance along x.

    A row for each component that is estimated, a column for each that contributes; only those that
    were solved for. `dataset`: `averaging_kernel` (estimator, component_out, component_in, lag),
    `kernel_width`, `element_depth` [m].
    """
    kernels, components = dataset["averaging_kernel"].values, names_of(dataset["component"])
    solved = [c for c in range(kernels.shape[1]) if has_values(kernels[:, c, c])]
    methods = names_of(dataset["estimator"])
    few_depths = 5 * float(dataset["element_depth"].max())
    reach = min(
        max(few_depths, 3 * peak(dataset["kernel_width"].values)), peak(dataset["lag"].values)
    )
    rows = [
        [
            Panel(
                method_curves(methods, kernels[:, out, into]),
                PanelAxis("distance along x", "m", limits=(-reach, reach)),
                PanelAxis("kernel", "1/m"),
                dataset["lag"].values,
                f"Into {components[out]} from {components[into]}",
            )
            for into in solved
        ]
        for out in solved
    ]
    return panels(rows)
