"""Measured signals, what is fitted to them, and the residual."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from ...errors import refuse
from ...numerics import BAND_90
from ..answers import as_dataset
from .panels import Curve, Mark, Panel, PanelAxis, panels, unobserved
from .stages import TIME, X, method_looks
from .style import GREY, TRUTH, colours, names_of, peak, units_of

_DATA = {"color": "#b5bcc2", "linewidth": 2.6}
_FIT = {"fitted": {"color": "#d55e00"}}
_LEAST_REACH = 4.0  # standard deviations of the noise that a residual's panel shows
_BINS = 33


def signals(given: Any) -> Figure:
    """Draw each element's signal with the fit of each method, and without noise if it is known.

    `given`: a fitted estimate, a fit, or the dataset of a result. Raises `BadInput` for what cannot
    be drawn.
    """
    dataset = as_dataset(given)
    methods = _methods(dataset)
    parts = [
        _signal(dataset, e, name, methods) for e, name in enumerate(names_of(dataset["element"]))
    ]
    return panels(parts)


def fit(given: Any, x: Any = None) -> Figure:
    """Draw each element's signal with the fit, and below it the residual over the noise.

    - `given`: a fit, a fitted estimate, or the dataset of a result.
    - `x` (sample,): what the data are drawn over; None: position, time or number of the samples.

    Raises `BadInput` for what cannot be drawn, and for an `x` of another length.
    """
    parts, heights = fit_panels(as_dataset(given), x)
    return panels(parts, heights=heights, height_in=1.6)


def fit_panels(dataset: xarray.Dataset, x: Any = None) -> tuple[list[Panel], list[float]]:
    """The panels of [`fit`][] and their relative heights."""
    if x is not None:
        own, count = np.asarray(x, float), dataset["signal"].shape[-1]
        refuse(own.shape != (count,), f"x has the shape {own.shape}: give one of {count} numbers.")
        dataset = dataset.assign(along=(dataset["signal"].dims[-1:], own))
    elements, methods = names_of(dataset["element"]), _methods(dataset)
    parts = []
    for e, name in enumerate(elements):
        parts += [_signal(dataset, e, name, methods), *_residuals(dataset, e, name, methods)]
    return parts, [2.2, *[1.0] * len(methods)] * len(elements)


def residual(given: Any) -> Figure:
    """Draw the residual of each element in standard deviations of the noise, with its histogram.

    It is white and normal where the noise limits the fit. `given`: a fitted estimate, a fit, or the
    dataset of a result. Raises `BadInput` for what cannot be drawn.
    """
    dataset = as_dataset(given)
    methods = _methods(dataset)
    rows = [
        (trace, _histogram(trace))
        for e, name in enumerate(names_of(dataset["element"]))
        for trace in _residuals(dataset, e, name, methods)
    ]
    return panels(rows, widths=(4.0, 1.0), height_in=1.6)


def _methods(dataset: xarray.Dataset) -> dict[str, dict[str, str]]:
    if "estimator" not in dataset["fitted_signal"].dims:
        return _FIT
    return method_looks(names_of(dataset["estimator"]))


def _along(dataset: xarray.Dataset) -> tuple[PanelAxis, np.ndarray]:
    """Where the samples are: as it is given, positions if the motion never turns back, times, or
    their numbers."""
    if "along" in dataset:
        return PanelAxis("x"), dataset["along"].values
    if "x" in dataset["signal"].dims:
        return X, dataset["x"].values
    if "position" not in dataset:
        return PanelAxis("sample"), np.arange(dataset["signal"].shape[-1])
    position = dataset["position"].values
    onwards = np.all(np.diff(position) > 0) or np.all(np.diff(position) < 0)
    return (X, position) if onwards else (TIME, dataset["time"].values)


def _signal(dataset: xarray.Dataset, e: int, name: str, methods: dict[str, dict]) -> Panel:
    across, at = _along(dataset)
    signal = dataset["signal"].values[e]
    observed = np.isfinite(signal)
    if "observed" in dataset:
        observed = dataset["observed"].values[e].astype(bool)
    curves = [Curve(signal, "recorded" if name else "data", look=_DATA)]
    if "signal_noise_free" in dataset:
        look = {"color": TRUTH, "linewidth": 0.8}
        curves.append(Curve(dataset["signal_noise_free"].values[e], "without noise", look=look))
    fits = dataset["fitted_signal"].values.reshape(-1, *dataset["signal"].shape)[:, e]
    for (method, look), values in zip(methods.items(), fits, strict=True):
        # Where nothing was observed a fit may be huge, and must not set the scale.
        label = method if method == "fitted" else f"fit, {method}"
        curves.append(Curve(values, label, look=look, in_view=observed))
    up = PanelAxis("signal", units_of(dataset["signal"]))
    title = f"Element {name}" if name else "Data and fit"
    return Panel(curves, across, up, at, title, unobserved(at, observed))


def _residuals(
    dataset: xarray.Dataset, e: int, name: str, methods: dict[str, dict]
) -> Iterator[Panel]:
    across, at = _along(dataset)
    all_values = dataset["whitened_residual"].values.reshape(-1, *dataset["signal"].shape)[:, e]
    for method, values in zip(methods, all_values, strict=True):
        own = "" if method == "fitted" else f", {method}"
        reach = max(_LEAST_REACH, 1.05 * peak(values))
        curve = Curve(values, look={"color": GREY, "linewidth": 0.7})
        marks = [
            Mark(sign * BAND_90, label, "y", look={"color": TRUTH, "linestyle": "--"})
            for sign, label in ((1, "90 % of normal noise is within"), (-1, ""))
        ]
        up = PanelAxis("residual / noise", "1", limits=(-reach, reach))
        of = f" of element {name}" if name else ""
        title, present = f"Residual{of}{own}", values[np.isfinite(values)]
        if present.size:
            inside = 100 * np.mean(np.abs(present) < BAND_90)
            title = f"{title}: {inside:.1f} % within the dashed lines"
        missing = unobserved(at, np.isfinite(values))
        yield Panel([curve], across, up, at, title, [*missing, *marks])


def _histogram(trace: Panel) -> Panel:
    """The distribution of a residual, turned to stand beside it."""
    values = np.asarray(trace.curves[0].y)
    reach = trace.y.limits[1]
    assert reach is not None
    edges = np.linspace(-reach, reach, _BINS)
    present = values[np.isfinite(values)]
    density = np.histogram(present, edges)[0] / (max(present.size, 1) * (edges[1] - edges[0]))
    at = np.linspace(-reach, reach, 400)
    normal = np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi)
    colour = colours(["residual"])["residual"]
    look = {"color": colour, "drawstyle": "steps-mid"}
    curves = [
        Curve((edges[1:] + edges[:-1]) / 2, "histogram", x=density, look=look),
        Curve(at, "standard normal", x=normal, look={"color": TRUTH}),
    ]
    return Panel(curves, PanelAxis("density", limits=(0.0, None)), trace.y, title="Histogram")
