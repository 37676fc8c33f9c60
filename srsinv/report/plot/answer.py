"""One answer as a figure: what an estimate recovers, and how a fit explains its data."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from ..answers import as_dataset
from .contact import feature_panels
from .estimates import estimate_panels, with_truth
from .marginals import marginal_panels
from .panels import Mark, Panel, panels
from .signals import fit_panels

_HIGH, _UNIT_IN = 2.2, 1.0  # a panel of p or q over a residual's, and the latter's height


def answer(
    given: Any, *, truth: Any = None, x: Any = None, marks: Sequence[Mark] = (), title: Any = None
) -> Figure:
    """Draw an estimate or a fit as one figure.

    Where it has them: p and q with their 90 % bands along x; each signal with what is fitted to it,
    and the residual below. Of samples: a histogram of each parameter.

    - `given`: an estimate, a fit, samples, or the dataset of either.
    - `truth` (2, n) [Pa]: the true p and q on the line of an estimate.
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
    if "estimate" in dataset:
        of_estimate = feature_panels if "signal" in dataset else estimate_panels
        parts = of_estimate(with_truth(dataset, truth), marks)
        heights = [_HIGH] * len(parts)
    if "signal" in dataset:
        more, own = fit_panels(dataset, x)
        parts, heights = [*parts, *more], [*heights, *own]
    each_in = _UNIT_IN * sum(heights) / len(heights)
    return panels(parts, title or "", heights=heights, height_in=each_in)
