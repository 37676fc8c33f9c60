"""Figures of contact events."""

import xarray
from matplotlib.figure import Figure

from srsinv import plot

DASHED = {"linestyle": "--"}
ALARM = {"linestyle": ":", "color": "#555555"}


def draw_shear(ds: xarray.Dataset) -> Figure:
    """Shear over the contact as its force grows, with Coulomb's limit."""
    limit = ds.attrs["friction"] * ds["pressure"]
    lines = {"limit, μp": limit.assign_attrs(units="Pa")} | {
        f"Q = {float(r):.2g} μP": ds["shear"].sel(ratio=r) for r in ds["ratio"].values
    }
    looks = {"limit, μp": {"color": "#000000", "linestyle": "--"}}
    return plot.panels([plot.panel(lines, looks=looks, quantity="shear", along="position")])


def draw_episode(ds: xarray.Dataset) -> Figure:
    """The contact and the part that sticks, over time."""
    a, c = ds["contact_half_width"].values, ds["stick_half_width"].values
    slips, sticks = {"color": "#d55e00"}, {"color": "#0072b2"}
    curves = [
        plot.Curve(a, band=(c, a), band_label="slips", look=slips),
        plot.Curve(-a, band=(-a, -c), look=slips),
        plot.Curve(c, band=(-c, c), band_label="sticks", look=sticks),
        plot.Curve(-c, look=sticks),
    ]
    across, up = plot.PanelAxis("time", "s"), plot.PanelAxis("position from the middle", "m")
    return plot.panels([plot.Panel(curves, across, up, ds["time"].values)])


def draw_signal(ds: xarray.Dataset) -> Figure:
    """The signal of each element, with the alarms of the matched filters."""
    onset = [plot.Mark(float(t), "alarm", look=ALARM) for t in ds["alarm"].values]

    def one(element: int) -> plot.Panel:
        own = ds["signal"].sel(element=element)
        return plot.panel({"": own}, quantity="signal", title=f"Element {element}", marks=onset)

    return plot.panels([[one(int(e))] for e in ds["element"].values])


def draw_operating(ds: xarray.Dataset) -> Figure:
    """Probability of detection over the rate of false alarms, a panel for each kind."""

    def one(kind: str) -> plot.Panel:
        own, lines, looks = ds.sel(kind=kind), {}, {}
        colours = _colours(ds["strength"].size)
        for colour, strength in zip(colours, ds["strength"].values, strict=True):
            label = f"d′ = {float(strength):g}"
            lines[f"{label}, matched"] = own["matched_operating"].sel(strength=strength)
            lines[f"{label}, threshold"] = own["threshold_operating"].sel(strength=strength)
            looks[f"{label}, matched"] = {"color": colour}
            looks[f"{label}, threshold"] = {"color": colour, **DASHED}
        return plot.panel(
            lines, looks=looks, quantity="detected", along="false alarms", log="x",
            limits=(-0.03, 1.03), title=kind.capitalize(),
        )  # fmt: skip

    kinds = [str(kind) for kind in ds["kind"].values]
    return plot.panels([[one(kind) for kind in kinds[i : i + 2]] for i in range(0, 5, 2)])


def _colours(count: int) -> list[str]:
    """Colours of so many strengths, repeated after four."""
    colours = ["#0072b2", "#009e73", "#d55e00", "#cc79a7"]
    return [colours[i % 4] for i in range(count)]
