"""Figures of a measured kernel: beside the theory's, and what both make of the signals."""

import xarray
from matplotlib.figure import Figure

from .. import plot
from ..report.plot.style import names_of

SHOWN_DEPTHS = 6.0  # on each side of the load
LOOKS = {
    "recorded": {"color": "#b5bcc2", "linewidth": 2.6},
    "theory": {"color": "#e69f00", "linestyle": "--"},
    "kernel": {"color": "#0072b2"},
}


def draw_kernels(ds: xarray.Dataset) -> Figure:
    """Measured kernels of each element with their bands, beside those of the theory as stated."""
    reach = min(SHOWN_DEPTHS * ds.attrs["stated_depth_m"], ds.attrs["reach_m"])

    def one(element: str, component: str) -> plot.Panel:
        own, error = (
            ds[name].sel(sensor=element, shown=component).assign_attrs(units="C")
            for name in ("response", "response_stderr")
        )
        return plot.panel(
            {name: own.sel(model=name) for name in ("kernel", "theory")}, looks=LOOKS,
            stderrs={"kernel": error}, within=(-reach, reach), quantity="charge under 1 N/m",
            along="position of the film from the load", title=f"Element {element}: {component}",
        )  # fmt: skip

    return plot.panels([[one(e, c) for c in names_of(ds["shown"])] for e in names_of(ds["sensor"])])


def draw_signals(ds: xarray.Dataset) -> Figure:
    """The mean signals over the known feature, with what theory and kernel make of them."""

    def one(row: str) -> plot.Panel:
        fitted = ds["fitted_signal"].sel(row=row)
        lines = {"recorded": ds["signal"].sel(row=row)}
        lines |= {name: fitted.sel(model=name) for name in ("kernel", "theory")}
        return plot.panel(lines, looks=LOOKS, along="position x", title=f"Element {row}")

    return plot.panels([one(row) for row in names_of(ds["row"])])
