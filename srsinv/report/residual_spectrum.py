"""A section that any page with a residual can have: `section=[residual_spectrum]`."""

import numpy as np
import scipy
import xarray
from matplotlib.figure import Figure

from .plot import Curve, Mark, Panel, PanelAxis, panels
from .plot.style import names_of
from .section import Section

_BINS = 40  # of neighbouring frequencies
_CHANCE = 0.99  # of the bins of white noise are below the line


class ResidualSpectrum(Section):
    """Periodogram of the whitened residual of each element, of each method where there are several.

    White noise of the stated level has a power of one at every frequency.
    """

    heading = "Spectrum of the residual"
    needs = {"whitened_residual": ("element",)}  # noqa: RUF012  as its base has it
    words = """
{{ figure("residual_spectrum", own.draw, "Power of the residual over that of the stated noise, in
bins of neighbouring frequencies from none to half the sampling rate. What rises above the line at
low frequencies is signal that the model leaves out, or noise that is correlated.") }}
"""

    def draw(self, data: xarray.Dataset) -> Figure:
        """The figure of a dataset with `whitened_residual` (..., element, sample)."""
        residual = data["whitened_residual"]
        across = PanelAxis("frequency, of the sampling rate", "1")
        rows = np.nan_to_num(residual.values.reshape(-1, *residual.shape[-2:]))
        names = names_of(data["estimator"]) if "estimator" in residual.dims else ["residual"]
        parts = []
        for e, element in enumerate(names_of(data["element"])):
            binned = [_binned(np.abs(np.fft.rfft(each[e])) ** 2 / each.shape[-1]) for each in rows]
            curves = [Curve(power, name) for power, name in zip(binned, names, strict=True)]
            count = 2 * rows.shape[-1] / 2 / _BINS
            level = float(2 * scipy.special.gammaincinv(count / 2, _CHANCE) / count)
            marks = [Mark(level, f"{100 * _CHANCE:.0f} % of white noise is below", "y")]
            at = 0.5 * (np.arange(_BINS) + 0.5) / _BINS
            parts.append(Panel(curves, across, PanelAxis("power"), at, f"Element {element}", marks))
        return panels(parts)


def _binned(power: np.ndarray) -> np.ndarray:
    """Means over `_BINS` stretches, without the mean of the signal."""
    return np.array(
        [each.mean() if each.size else np.nan for each in np.array_split(power[1:], _BINS)]
    )
