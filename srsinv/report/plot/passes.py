"""Signals over position, averaged over the passes of each direction of motion."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from .panels import Curve, Panel, PanelAxis, panels
from .stages import X
from .style import names_of, units_of

_DATA = {"color": "#9aa5ae", "linewidth": 2.2}
_FIT = {"color": "#d55e00", "linewidth": 1.2}


def passes(
    dataset: xarray.Dataset, signal: str = "hum_free_signal", fit: str = "hum_free_fit"
) -> Figure:
    """Draw the mean signal of the passes over the position on the surface, and its fit.

    - `dataset`: of a fit to several passes; `signal`, `fit`: names of its variables (direction,
      element, place).

    A column stands for each direction of motion that has a pass, a row for each element.
    """
    up, at = PanelAxis("signal", units_of(dataset[signal])), dataset["place"].values
    directions = [
        d for d in range(dataset.sizes["direction"])
        if np.isfinite(dataset[signal].values[d]).any()
    ]  # fmt: skip
    names = names_of(dataset["direction"])
    rows = [
        [
            Panel(
                [Curve(dataset[signal].values[d, e], "signal less hum", look=_DATA),
                 Curve(dataset[fit].values[d, e], "fit", look=_FIT)],
                X, up, at, f"Element {short_name}, {names[d]}",
            )
            for d in directions
        ]
        for e, short_name in enumerate(names_of(dataset["element"]))
    ]  # fmt: skip
    return panels(rows, height_in=2.0)
