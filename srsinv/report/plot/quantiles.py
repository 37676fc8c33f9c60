"""Errors over their standard errors against the standard normal, quantile by quantile."""

import numpy as np
import scipy
import xarray
from matplotlib.figure import Figure

from .panels import Curve, Panel, PanelAxis, panels
from .style import PALETTE, TRUTH, names_of

_COLUMNS = 5
_CENTRAL = (0.05, 0.95)  # of the k-th of n normal values


def quantiles(dataset: xarray.Dataset, name: str, panels_of: str, draws: str = "draw") -> Figure:
    """Draw values in order against quantiles of the standard normal distribution.

    - `dataset`: of a result. `name`: the variable; `draws`: its dimension along which the values
      are.
    - `panels_of`: its other dimension, of which every label has a panel.

    Values that are standard normal lie on the diagonal, each in the band with probability 0.9.
    """
    array = dataset[name].transpose(panels_of, draws)
    n = array.shape[1]
    order = np.arange(1, n + 1)
    at = scipy.special.ndtri((order - 0.5) / n)
    low, high = (scipy.special.ndtri(scipy.special.betaincinv(order, n + 1 - order, end))
                 for end in _CENTRAL)  # fmt: skip
    reach = 1.1 * max(float(np.nanmax(np.abs(array))), float(high[-1]))
    across = PanelAxis("quantile", limits=(-1.1 * float(at[-1]), 1.1 * float(at[-1])))
    up = PanelAxis("error / standard error", limits=(-reach, reach))
    normal = Curve(
        at, "standard normal", band=(low, high), look={"color": TRUTH, "linewidth": 0.9},
        band_label="90 % band of chance",
    )  # fmt: skip
    dots = {"linestyle": "", "marker": "o", "markersize": 3, "color": PALETTE[0]}
    parts = [
        Panel([normal, Curve(np.sort(values), "draws", look=dots)], across, up, at, words)
        for words, values in zip(names_of(dataset[panels_of]), array.values, strict=True)
    ]
    rows = [parts[at : at + _COLUMNS] for at in range(0, len(parts), _COLUMNS)]
    return panels(rows, height_in=2.4)
