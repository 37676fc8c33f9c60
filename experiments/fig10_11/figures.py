"""Figures of fig10_11: kernels beside each other, and p and q by each of them."""

import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.inverse.estimate import COMPONENTS, deviation
from srsinv.report.plot.style import TRUTH, names_of

SHOWN_DEPTHS = 6.0  # on each side of the load
LOOKS = {
    "theoretical": {"color": "#e69f00"},
    "measured": {"color": "#0072b2"},
    "fitted": {"color": "#009e73"},
    "true": {"color": TRUTH, "linestyle": "--"},
    "truth": {"color": TRUTH, "linestyle": "--"},
}
FIGURES = {"theoretical": "Fig. 10", "measured": "Fig. 11"}


def draw_kernels(ds: xarray.Dataset) -> Figure:
    """Kernels of p and of q of each element: theoretical, measured with its band, and true."""
    reach = SHOWN_DEPTHS * ds.attrs["stated_depth_m"]

    def one(element: str, component: str) -> plot.Panel:
        own, error = (
            ds[name].sel(element=element, component=component).assign_attrs(units="C")
            for name in ("response", "response_stderr")
        )
        return plot.panel(
            {name: own.sel(kernel=name) for name in ("theoretical", "measured", "true")},
            looks=LOOKS, stderrs={"measured": error}, within=(-reach, reach),
            quantity="charge under 1 N/m", along="position of the film from the load",
            title=f"Element {element}: {component}",
        )  # fmt: skip

    return plot.panels([[one(e, c) for c in COMPONENTS] for e in names_of(ds["element"])])


def draw_recovered(ds: xarray.Dataset) -> Figure:
    """p and q less their means, by the theoretical kernel (Fig. 10), the measured one (Fig. 11) and
    the one that was fitted."""
    truth, estimate = (
        ds[name].copy(data=deviation(ds[name].values)) for name in ("traction", "estimate")
    )

    def one(kernel: str, component: str) -> plot.Panel:
        lines = {
            "truth": truth.sel(component=component),
            kernel: estimate.sel(kernel=kernel, component=component),
        }
        error = ds["estimate_stderr"].sel(kernel=kernel, component=component)
        figure = f" ({FIGURES[kernel]})" if kernel in FIGURES else ""
        return plot.panel(
            lines, looks=LOOKS, stderrs={kernel: error}, along="position x",
            quantity=f"{component} less its mean", title=f"{component}, {kernel} kernel{figure}",
        )  # fmt: skip

    return plot.panels([
        [one(kernel, component) for component in COMPONENTS] for kernel in ds["model"].values
    ])  # fmt: skip
