"""Figures of fig08_knife_edge: curves over the edge's place."""

import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.plot.style import TRUTH
from srsinv.report.text import quantity

MEASURED = "rig, as measured"
FITTED = "theory, fitted in amplitude"
LOOKS = {MEASURED: {"linestyle": "none", "marker": ".", "color": TRUTH}}
ALONG = "position of the edge from the film"


def draw_rig(ds: xarray.Dataset) -> Figure:
    """Integrated signal and its phase over the edge's place, a column for each direction."""

    def one(direction: float, end: str, word: str) -> plot.Panel:
        own = ds.sel(direction=direction)
        return plot.panel(
            {FITTED: own[f"fitted{end}"], MEASURED: own[f"measured{end}"]}, looks=LOOKS,
            quantity=word, along=ALONG, title=f"{word.capitalize()}, load at {direction:g}°",
        )  # fmt: skip

    kinds = ("", "integrated signal"), ("_phase", "phase")
    return plot.panels([[one(float(a), *kind) for a in ds["direction"].values] for kind in kinds])


def draw_skins(ds: xarray.Dataset) -> Figure:
    """The two skins, and strips of other widths, a column for each direction."""

    def one(direction: float, name: str, of: str, title: str) -> plot.Panel:
        own = ds[name].sel(direction=direction)
        words = {w: quantity(w, "m") if of == "width" else f"skin of {w}" for w in ds[of].values}
        lines = {word: own.sel({of: each}) for each, word in words.items()}
        return plot.panel(
            lines, quantity="integrated signal", along=ALONG, title=f"{title}, {direction:g}°"
        )

    kinds = ("response", "skin", "Skins"), ("response_of_width", "width", "Strip widths")
    return plot.panels([[one(float(a), *kind) for a in ds["direction"].values] for kind in kinds])


def draw_slid(ds: xarray.Dataset) -> Figure:
    """The rig's quasi-static curve and that of a scan, mirrored, a column for each direction."""

    def one(direction: float) -> plot.Panel:
        own = ds.sel(direction=direction)
        lines = {
            "rig at rest": own["response"].sel(skin="theory"),
            "scan, mirrored": own["sliding"],
        }
        return plot.panel(
            lines, looks={"scan, mirrored": {"linestyle": "--", "color": TRUTH}}, along=ALONG,
            quantity="integrated signal", title=f"Load at {direction:g}°",
        )  # fmt: skip

    return plot.panels([[one(float(a)) for a in ds["direction"].values]])
