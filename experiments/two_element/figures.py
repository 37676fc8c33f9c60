"""Figures of two_element: errors over the angle, and p and q recovered."""

import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.inverse.estimate import COMPONENTS, deviation
from srsinv.report.plot.stages import QUANTITIES, method_looks
from srsinv.report.plot.style import TRUTH, names_of


def against_angle(ds: xarray.Dataset) -> Figure:
    """Error of each component over the angle: the draws and their prediction."""
    looks, parts = {}, []
    for m, (method, look) in enumerate(method_looks(names_of(ds["estimator"])).items()):
        looks[method] = {"color": look["color"], "linestyle": "", "marker": "os^D"[m % 4]}
        looks[f"predicted, {method}"] = {"color": look["color"], "linestyle": "--"}
    for component in COMPONENTS:
        lines, bars = {}, {}
        for method in names_of(ds["estimator"]):
            own = ds.sel({"component": component, "estimator": method})
            lines[method] = own["error"].mean("seed", keep_attrs=True)
            lines[f"predicted, {method}"] = own["error_predicted"]
            bars[method] = own["error"].min("seed"), own["error"].max("seed")
        parts.append(plot.panel(
            lines, looks=looks, bars=bars, along="angle between the two elements",
            quantity="relative error", title=QUANTITIES[component].capitalize(),
            within=(0, 1.03 * float(ds["angle"].max())), limits=(0, None),
        ))  # fmt: skip
    return plot.panels(parts)


def recovered(ds: xarray.Dataset) -> Figure:
    """p and q less their means by each method, a column for each angle shown."""
    looks = {"truth": {"color": TRUTH}, **method_looks(names_of(ds["estimator"]))}
    truth, estimate = (
        ds[name].copy(data=deviation(ds[name].values)) for name in ("traction", "estimate")
    )

    def one(component: str, angle: float) -> plot.Panel:
        own = estimate.sel(component=component, angle_shown=angle)
        lines = {"truth": truth.sel(component=component)}
        lines |= {name: own.sel({"estimator": name}) for name in names_of(ds["estimator"])}
        return plot.panel(
            lines, looks=looks, along="position x", quantity=f"{component} less its mean",
            title=f"{component}, elements {angle:g}° apart",
        )  # fmt: skip

    angles = ds["angle_shown"].values
    return plot.panels([[one(component, angle) for angle in angles] for component in COMPONENTS])
