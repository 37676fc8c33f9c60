"""What is recovered of the scene and of sinusoids, with each sensor as the true one."""

import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.inverse.estimate import COMPONENTS, deviation
from srsinv.report.plot.stages import QUANTITIES, X, method_curves
from srsinv.report.plot.style import TRUTH, names_of

GAINS = {  # by component out and in, the upper two 1 if all is right, the lower two 0
    ("p", "p"): "p recovered of p",
    ("q", "q"): "q recovered of q",
    ("q", "p"): "q recovered where there is p",
    ("p", "q"): "p recovered where there is q",
}


def recovered(ds: xarray.Dataset) -> Figure:
    """p and q less their means, recovered from the data of each sensor."""
    cases, parts = names_of(ds["case"]), []
    for component in COMPONENTS:
        own, up = ds.sel(component=component), plot.PanelAxis(f"{component} less its mean", "Pa")
        truth = plot.Curve(deviation(own["traction"].values), "truth", look={"color": TRUTH})
        curves = [truth, *method_curves(cases, deviation(own["estimate"].values))]
        parts.append(plot.Panel(curves, X, up, ds["x"].values, QUANTITIES[component].capitalize()))
    return plot.panels(parts, height_in=2.6)


def by_wavelength(ds: xarray.Dataset) -> Figure:
    """The size of what is recovered of a sinusoid, over its wavelength."""
    across = plot.PanelAxis("wavelength", "m", is_log=True)
    up = plot.PanelAxis("gain", limits=(0, None))
    parts = []
    for (out, into), title in GAINS.items():
        gain = ds["gain"].sel(component_out=out, component_in=into).values
        curves = method_curves(names_of(ds["case"]), gain)
        parts.append(plot.Panel(curves, across, up, ds["wavelength"].values, title))
    return plot.panels([parts[:2], parts[2:]])
