"""Metrics of a sweep against what was varied."""

from collections.abc import Iterator, Sequence

import numpy as np
import xarray
from matplotlib.figure import Figure

from ..text import in_words, spoken, suffix
from .long import in_columns
from .panels import Curve, Panel, PanelAxis, panels
from .style import units_of

_MOST_GROUPS = 6  # with a colour each; beyond, all jobs have one
_DECADES = {"x": 30.0, "y": 100.0}  # of positive values: ratios from which an axis is logarithmic
_ROOM = 0.04  # of the axis, beside the first and the last job
_DIM = "job"


def sweep(dataset: xarray.Dataset, x: str, names: Sequence[str]) -> Figure:
    """Draw metrics of a sweep's jobs against a setting, a panel of each.

    `dataset`: of a sweep; `names`: of its metrics (job,); `x`: of the setting (job,). Jobs that
    agree in all other settings are one curve, with bars of one standard error where a metric
    NAME has a NAME_stderr.
    """
    at = dataset[x].values
    is_drawn = np.isfinite(at) & np.any([np.isfinite(dataset[name].values) for name in names], 0)
    dataset = dataset.isel({_DIM: is_drawn})
    groups = dict(_groups(dataset, x))
    axis = PanelAxis(in_words(x), units_of(dataset[x]), *_scale(dataset[x].values))
    drawn = [_panel(dataset, x, str(name), groups, axis) for name in names]
    return panels(in_columns(drawn), height_in=2.4)


def _groups(dataset: xarray.Dataset, x: str) -> Iterator[tuple[str, np.ndarray]]:
    """Which jobs (job,) agree in all settings but `x`, by what they agree in."""
    others = [
        str(name)
        for name, each in dataset.coords.items()
        if each.dims == (_DIM,) and name not in (_DIM, x)
    ]
    words = [[_setting(dataset[name], each) for each in dataset[name].values] for name in others]
    jobs = zip(*words, strict=True) if words else [()] * dataset.sizes[_DIM]
    labels = np.array([", ".join(each) for each in jobs])
    distinct = list(dict.fromkeys(labels.tolist()))
    if len(distinct) > _MOST_GROUPS:
        yield "", np.ones(labels.size, bool)
        return
    for label in distinct:
        yield label, labels == label


def _panel(
    dataset: xarray.Dataset, x: str, name: str, groups: dict[str, np.ndarray], axis: PanelAxis
) -> Panel:
    at, values = dataset[x].values, dataset[name].values
    stderr = dataset.get(f"{name}_stderr")
    curves = []
    for label, chosen in groups.items():
        order = np.flatnonzero(chosen)
        order = order[np.argsort(at[order], kind="stable")]
        is_line = np.unique(at[order]).size == order.size
        look = {"marker": "o", "markersize": 4.5, "linestyle": "-" if is_line else ""}
        band = None
        if stderr is not None and stderr.dtype.kind == "f":
            half = stderr.values[order]
            band = (values[order] - half, values[order] + half)
        y = values[order]
        curves.append(Curve(y, label, x=at[order], band=band, look=look, has_bars=band is not None))
    return Panel(
        curves, axis, PanelAxis(in_words(name), units_of(dataset[name]), _is_log(values, "y")), at
    )


def _scale(values: np.ndarray) -> tuple[bool, tuple[float | None, float | None]]:
    """Whether the axis of a setting is logarithmic, and its ends, with room for marks."""
    is_log = _is_log(values, "x")
    low, high = np.min(values, initial=np.inf), np.max(values, initial=-np.inf)
    if not low < high:
        return is_log, (None, None)
    if is_log:
        room = (high / low) ** _ROOM
        return is_log, (low / room, high * room)
    return is_log, (low - _ROOM * (high - low), high + _ROOM * (high - low))


def _setting(of: xarray.DataArray, value: object) -> str:
    """A setting with its unit, in words."""
    number = spoken(float(value)) if isinstance(value, float) else str(value)
    return f"{in_words(str(of.name))} {number}{suffix(units_of(of))}"


def _is_log(values: np.ndarray, axis: str) -> bool:
    finite = values[np.isfinite(values)]
    return bool(finite.size and finite.min() > 0 and finite.max() >= _DECADES[axis] * finite.min())
