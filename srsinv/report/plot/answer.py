"""One answer as a figure: what an estimate recovers, and how a fit explains its data."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from ...errors import refuse
from ...numerics import BAND_90
from ..answers import as_dataset
from .contact import feature_panels
from .estimates import estimate_panels, with_truth
from .marginals import marginal_panels
from .panels import Curve, Mark, Panel, PanelAxis, panels
from .signals import fit_panels
from .style import TRUTH

_HIGH, _UNIT_IN = 2.2, 1.0  # a panel of p or q over a residual's, and the latter's height


def answer(
    given: Any, *, truth: Any = None, x: Any = None, marks: Sequence[Mark] = (), title: Any = None
) -> Figure:
    """Draw an estimate or a fit as one figure.

    Where it has them: p and q with their 90 % bands along x; each signal with what is fitted to it,
    and the residual below. Of samples: a histogram of each parameter.

    - `given`: an estimate, a fit, samples, or the dataset of either.
    - `truth` (2, n) [Pa]: the true p and q on the line of an estimate; of a linear problem the true
      unknown, in its shape.
    - `x` (sample,): what the data are drawn over; None: position, time or number of the samples.
    - `marks`: lines and areas across the panels of p and q.
    - `title`: of the figure; None: what the answer is, and its quality.

    Raises `BadInput` for what cannot be drawn, and for a truth or an `x` of another shape.
    """
    dataset = as_dataset(given)
    if title is None and "title" in dataset.attrs:
        title = f"{dataset.attrs['title']}: {dataset['quality'].item()}"
    if "posterior_draws" in dataset:
        return panels(marginal_panels(dataset), title or "")
    parts: list[Panel] = []
    heights: list[float] = []
    if "value_stderr" in dataset:
        parts, heights = [_unknown(dataset, truth)], [_HIGH]
    if "estimate" in dataset:
        of_estimate = feature_panels if "signal" in dataset else estimate_panels
        parts = of_estimate(with_truth(dataset, truth), marks)
        heights = [_HIGH] * len(parts)
    if "signal" in dataset:
        more, own = fit_panels(dataset, x)
        parts, heights = [*parts, *more], [*heights, *own]
    each_in = _UNIT_IN * sum(heights) / len(heights)
    return panels(parts, title or "", heights=heights, height_in=each_in)


def _unknown(dataset: xarray.Dataset, truth: Any) -> Panel:
    """The unknown of a linear problem with its 90 % band over the number of each, as a flat
    array."""
    value, stderr = (dataset[name].values for name in ("value", "value_stderr"))
    half = BAND_90 * np.where(np.isfinite(stderr), stderr, np.nan).ravel()
    flat = value.ravel()
    curves = [
        Curve(flat, "estimate", band=(flat - half, flat + half), band_label="90 % band")
    ]  # fmt: skip
    if truth is not None:
        own = np.asarray(truth, float)
        refuse(
            own.shape != value.shape,
            f"truth has the shape {own.shape}: give the unknown's, {value.shape}.",
        )
        curves.insert(0, Curve(own.ravel(), "truth", look={"color": TRUTH}))
    up = PanelAxis("value", "1")
    return Panel(curves, PanelAxis("index"), up, np.arange(flat.size), "The unknown")
