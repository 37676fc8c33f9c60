"""The figure of fig06_spectra: transfer, power and inverse filters over the wavenumber."""

from functools import partial

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.plot.spectra import (
    gain_limits,
    over_wavenumber,
    power,
    wavelength_mm,
    wavenumbers,
)
from srsinv.report.plot.style import names_of

INVERSE = "inverse 1/|G|"


def filters(ds: xarray.Dataset) -> Figure:
    """The sensor's transfer, the power of signal and noise, and the inverse filters."""
    k, gain, cutoff = (ds[name].values for name in ("wavenumber", "sensor_gain", "cutoff"))
    across, at = wavenumbers(k, gain, cutoff), float(cutoff[0])
    marks = [plot.Mark(at, f"cut-off, {wavelength_mm(at):.3g} mm")] if np.isfinite(at) else []
    waves = ds.isel(wavenumber=slice(1, None))
    lines = {name: waves["filter"].sel({"method": name}) for name in names_of(ds["method"])}
    # An unregularised inverse grows without bound: the lowest filter sets the limits.
    lowest = min(float(line.max()) for line in lines.values())
    panel = partial(plot.panel, along=across.quantity, within=across.limits, log="xy", marks=marks)
    signal, noise = ds["signal_power"], ds["noise_power"].values
    return over_wavenumber([
        panel({f"p with q = {ds.attrs['friction']:g} p": waves["sensor_gain"]}, quantity="|G|",
              limits=gain_limits(gain), title="Sensor transfer"),
        power({"signal": signal.values}, noise, signal.attrs["units"], across, k, marks),
        panel({**lines, INVERSE: waves["inverse_gain"]}, looks={INVERSE: {"linestyle": "--"}},
              quantity="|H|", limits=(lowest * 1e-5, lowest * 1e3), title="Inverse filter"),
    ])  # fmt: skip
