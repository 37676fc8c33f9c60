"""Style of all figures: colours, scaled units, legends beside the curves."""

import functools
import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ParamSpec

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from xarray import DataArray, Dataset

from ...numerics import runs
from ..text import best_unit
from .lettering import SYMBOLS, show_as_written

WIDTH_IN = 8.0
MM_PER_M = 1e3

TRUTH = "#000000"
GREY = "#6b747c"
SHADE = "#dfe3e7"

# Okabe and Ito's palette, distinguishable without red-green vision.
_ORANGE, _SKY, _GREEN, _BLUE = "#e69f00", "#56b4e9", "#009e73", "#0072b2"
_VERMILLION, _PURPLE = "#d55e00", "#cc79a7"
PALETTE = (_BLUE, _VERMILLION, _GREEN, _PURPLE, _ORANGE, _SKY, TRUTH)
_NAMED = {
    "p": _BLUE,
    "q": _VERMILLION,
    "mu": GREY,
    "Wiener": _GREEN,
    "Tikhonov": _PURPLE,
    "truth": TRUTH,
    "sigma_x": _ORANGE,
    "sigma_z": _SKY,
    "tau_xz": TRUTH,
    "sigma_y": GREY,
}
LINE_STYLES = ("-", "--", ":", "-.")
# Font sizes in points, not in words: words are looked up in the user's settings when saved.
_POINTS = 10
_HANDLE_IN, _LEGEND_LETTER_IN = 0.68, 0.076  # of a legend's entry: its line, and each letter
_LOOK = {
    "font.size": _POINTS,
    "axes.labelsize": _POINTS,
    "axes.titlesize": _POINTS,
    "xtick.labelsize": _POINTS,
    "ytick.labelsize": _POINTS,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": "#e3e6e9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "figure.titlesize": 12,
    "figure.constrained_layout.w_pad": 0.08,
    "figure.constrained_layout.h_pad": 0.08,
}

_Inputs = ParamSpec("_Inputs")


class NotebookFigure(Figure):
    """A figure that a notebook shows, whether or not pyplot is imported there."""

    def _repr_png_(self) -> bytes:
        image = io.BytesIO()
        self.savefig(image, format="png")
        return image.getvalue()


def styled(draw: Callable[_Inputs, Figure]) -> Callable[_Inputs, Figure]:
    """`draw` under this look alone: the user's own settings neither matter nor change."""

    @functools.wraps(draw)
    def under_style(*args: _Inputs.args, **kwargs: _Inputs.kwargs) -> Figure:
        with matplotlib.style.context(["default", _LOOK]):
            figure = draw(*args, **kwargs)
        for axes in figure.axes:
            for panel in (axes, *axes.child_axes):
                # The number of ticks is set when saving, after this style's context has ended.
                panel.tick_params(labelsize=_POINTS)
        show_as_written(figure)
        return figure

    return under_style


def symbol(name: str) -> str:
    """`name` as it is written on a figure."""
    return SYMBOLS.get(name, name)


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour for each name: its own where it has one, else the next that is free."""
    names = [str(name) for name in names]
    taken = {_NAMED[name] for name in names if name in _NAMED}
    # From the end: names without a colour of their own start far from p and q.
    free = [colour for colour in PALETTE[-2::-1] if colour not in taken] or list(PALETTE)
    others = [name for name in names if name not in _NAMED]
    cycled = {name: free[i % len(free)] for i, name in enumerate(others)}
    return {name: _NAMED.get(name) or cycled[name] for name in names}


@dataclass(frozen=True)
class Scale:
    """Factor on SI values for drawing, and the resulting unit."""

    factor: float
    unit: str

    def label(self, quantity: str) -> str:
        """An axis label: the quantity and its unit."""
        return f"{quantity} [{self.unit}]"


def scale(units: str, *values: Any) -> Scale:
    """The prefix that brings the largest of `values` (in SI `units`) between 1 and 1000.

    Units that take no prefix (counts, powers) are only written out.
    """
    return Scale(*best_unit(units, *values))


def pressure_scale(units: str, *values: Any) -> Scale:
    """Like [`scale`][]; a pressure without a unit comes from a sensor of unknown gain."""
    return Scale(1.0, "relative") if units == "1" else scale(units, *values)


def peak(values: Any) -> float:
    """The largest finite magnitude; zero where there is none."""
    values = np.asarray(values, dtype=float)
    return float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))


def units_of(variable: DataArray) -> str:
    """The variable's SI unit as a `str`."""
    return str(variable.attrs["units"])


def names_of(coordinate: DataArray) -> list[str]:
    """A coordinate's labels as `str`."""
    return [str(name) for name in coordinate.values]


def has_values(values: np.ndarray) -> bool:
    """Whether there is anything to draw: components not solved for are all NaN."""
    return bool(np.isfinite(values).any())


def short(element: str) -> str:
    """An element's number, without its orientation: for legends."""
    return element.partition(":")[0]


def along_x(axes: Axes, x_m: np.ndarray) -> None:
    """Show the whole line, samples or not."""
    axes.set_xlim(x_m[0] * MM_PER_M, x_m[-1] * MM_PER_M)


def grid_of_axes(
    rows: int, columns: int, height_in: float, **layout: Any
) -> tuple[Figure, np.ndarray]:
    """A figure of the common width with (rows, columns) axes, each row `height_in` high."""
    figure = NotebookFigure(figsize=(WIDTH_IN, rows * height_in + 0.9), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **layout)


def note(axes: Axes, sentence: str) -> None:
    """Note in the panel's middle why nothing is drawn in it."""
    axes.text(0.5, 0.5, sentence, transform=axes.transAxes, ha="center", va="center", color=GREY)


def legend_beside(axes: Axes, least: int = 2) -> None:
    """A legend of `least` entries or more to the right of the panel, where it covers no curve."""
    if len(axes.get_legend_handles_labels()[1]) >= least:
        axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), borderaxespad=0.0)


def legend_below(figure: Figure, axes: Iterable[Axes], columns: int = 6) -> None:
    """One legend under panels with common labels, each label once."""
    entries: dict[str, Any] = {}
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        figure.legend(
            list(entries.values()), list(entries), loc="outside lower center",
            ncols=_columns(list(entries), columns),
        )  # fmt: skip


def _columns(labels: list[str], most: int) -> int:
    """The number of columns, `most` or fewer, in which a legend of these labels fits the
    figure."""
    for count in range(min(most, len(labels)), 1, -1):
        rows, longer = divmod(len(labels), count)
        sizes = [rows + (i < longer) for i in range(count)]
        starts = np.cumsum([0, *sizes])
        widths = [
            max(len(label) for label in labels[at : at + size])
            for at, size in zip(starts, sizes, strict=False)
        ]
        if sum(_HANDLE_IN + _LEGEND_LETTER_IN * width for width in widths) <= WIDTH_IN - 0.2:
            return count
    return 1


def stretches(x_m: np.ndarray, mask: np.ndarray) -> list[tuple[float, float]]:
    """The stretches [m] of the line whose cells `mask` picks, cell edge to cell edge."""
    half = (x_m[1] - x_m[0]) / 2
    return [
        (float(x_m[start] - half), float(x_m[stop - 1] + half))
        for start, stop in runs(np.asarray(mask, bool))
    ]


def observed_anywhere(dataset: Dataset) -> np.ndarray:
    """Whether any element has a sample at x (x,); everywhere where the dataset does not say."""
    if "observed" not in dataset:
        return np.ones(dataset.sizes["x"], bool)
    return np.asarray(dataset["observed"].any("element").values, bool)
