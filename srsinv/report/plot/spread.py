"""Values over many draws, or of several answers: dots with their spread, beside their names."""

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
import xarray
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..text import spoken
from .style import SHADE, TRUTH, WIDTH_IN, colours, legend_below, scale, styled, units_of

_MARKERS = ("o", "D", "s", "^", "v", "P", "X")
_ROW_IN = 0.36
_LABEL = 80  # characters below a panel that has the whole width
_SHORT = {"snr": "SNR"}
_APART = 0.22  # of a row, between two marks of one row


@styled
def spread(
    dataset: xarray.Dataset,
    names: Mapping[str, str | Sequence[str]],
    rows: str,
    *,
    draws: str | None = None,
    over: str | None = None,
    expected: Mapping[str, float] | None = None,
    expected_label: str = "expected",
    bands: Mapping[str, tuple[float, float]] | None = None,
    log: Sequence[str] = (),
    labels: Mapping[str, str] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    band_label: str = "chance",
    title: str = "",
) -> Figure:
    """Draw values with their spread over the labels of a dimension, a panel for each heading.

    - `dataset`: of a result. `names`: the variables that a panel shows, by its heading; `rows`: the
      dimension. Without draws, the bars of a variable NAME that has a NAME_stderr
      beside it are one standard error.
    - `draws`: the dimension of which the mean, the least and the greatest are drawn.
    - `over`: a further dimension of which every label has marks of its own.
    - `expected`: by heading a value that would be right, or one not to be exceeded,
      `expected_label` in the legend; `bands`: by heading the range of chance about it, both in SI
      units, `band_label` its words; `limits` by heading the ends of an axis in SI units.
    - `log`: the headings of logarithmic axes, linear about zero where not all values are positive.
    - `labels`: words in the legend for the variables' names. `title`: of the figure.
    """
    figure, grid = _grid(dataset, rows, len(dataset[over]) if over else 1, len(names))
    for axes, (heading, shown) in zip(grid, names.items(), strict=True):
        shown = [shown] if isinstance(shown, str) else list(shown)
        unit = scale(units_of(dataset[shown[0]]), *(dataset[name].values for name in shown))
        low, high = (bands or {}).get(heading, (np.nan, np.nan))
        right = np.array([(expected or {}).get(heading, np.nan), low, high]) * unit.factor
        if np.isfinite(right[1]):
            axes.axvspan(right[1], right[2], color=SHADE, label=band_label)
        if np.isfinite(right[0]):
            look = {"color": TRUTH, "linestyle": "--", "linewidth": 0.9}
            axes.axvline(right[0], label=expected_label, **look)
        _marks(axes, dataset, shown, rows, draws, over, unit.factor, labels or {})
        label = heading if unit.unit == "1" else unit.label(heading)
        axes.set_xlabel(_wrapped(label, len(names)))
        drawn = [right[:1], *(unit.factor * dataset[name].values.ravel() for name in shown)]
        _ticks(axes, np.concatenate(drawn), heading in log)
        if ends := (limits or {}).get(heading):
            axes.set_xlim([end * unit.factor for end in ends])
    figure.suptitle(title)
    legend_below(figure, grid)
    return figure


def _grid(dataset: xarray.Dataset, rows: str, marks: int, panels: int) -> tuple[Figure, np.ndarray]:
    """A figure with panels side by side, and in each a row for each label, of so many marks."""
    entries = [spoken(each) for each in dataset[rows].values]
    tall = max(_ROW_IN * len(entries) * max(1.0, 0.5 * marks) + 1.5, 2.4)
    figure = Figure(figsize=(WIDTH_IN, tall), layout="constrained")
    grid = figure.subplots(1, panels, squeeze=False, sharey=True)[0]
    for axes in grid:
        axes.set_yticks(range(len(entries)), entries)
        axes.set_ylim(len(entries) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
    if (unit := units_of(dataset[rows])) != "1":
        grid[0].set_ylabel(f"{_SHORT.get(rows, spoken(rows))} [{unit}]")
    return figure, grid


def _wrapped(label: str, panels: int) -> str:
    """A label in lines that fit below one of so many panels."""
    return "\n".join(textwrap.wrap(label, max(_LABEL // panels, 12)))


def _ticks(axes, values: np.ndarray, is_log: bool) -> None:
    """Whole numbers for counts; a logarithmic scale over more than a decade, linear from -1 to 1
    where not all values are positive."""
    values = values[np.isfinite(values)]
    if is_log and np.any(values <= 0):
        axes.set_xscale("symlog", linthresh=1, linscale=0.5)
        axes.set_xlim(2 * min(values.min(), -0.5), 2 * max(values.max(), 0.5))
    elif is_log and np.any(values > 10 * np.min(values, initial=np.inf)):
        axes.set_xscale("log")
    elif np.all(values % 1 == 0):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _marks(axes, dataset, shown, rows, draws, over, factor: float, labels) -> None:
    groups = [
        (name, i if over in dataset[name].dims else None)
        for name in shown
        for i in range(len(dataset[over]) if over in dataset[name].dims else 1)
    ]
    words = [_label(dataset, name, over, i, labels, len(shown) > 1) for name, i in groups]
    palette = colours(words)
    for g, ((name, i), word) in enumerate(zip(groups, words, strict=True)):
        array = dataset[name] if i is None else dataset[name].isel({over: i})
        has_draws = draws is not None and draws in array.dims
        values = factor * array.transpose(rows, *([draws] if has_draws else [])).values
        mean = values.mean(axis=-1) if has_draws else values
        ends = (values.min(axis=-1), values.max(axis=-1)) if has_draws else (mean, mean)
        stderr = dataset.get(f"{name}_stderr")
        if stderr is not None and not has_draws and stderr.dims == (rows,):
            ends = mean - factor * stderr.values, mean + factor * stderr.values
        has_bars = ends[0] is not mean
        at = np.arange(len(mean)) + _APART * (g - (len(groups) - 1) / 2)
        axes.errorbar(
            mean, at, xerr=[mean - ends[0], ends[1] - mean], fmt=_MARKERS[g % len(_MARKERS)],
            color=palette[word], capsize=3 if has_bars else 0, markersize=6, label=word or None,
        )  # fmt: skip


def _label(dataset, name, over, i, labels, several: bool) -> str:
    own = labels.get(name, spoken(name)) if several or over is None else ""
    label = "" if i is None else spoken(dataset[over].values[i])
    return ", ".join(filter(None, [own, label]))
