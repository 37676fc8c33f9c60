"""The figure of fig13_tape: even and odd parts of the signals about the edges."""

import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.plot.style import short

EDGES = ("leading", "trailing")
CASES = {"": "as it is", ", no friction": "no friction"}
COLOURS = {"even": "#d55e00", "odd": "#0072b2"}


def symmetry(ds: xarray.Dataset) -> Figure:
    """Even and odd parts of the signals about each edge, a column for each edge."""
    looks = {
        f"{part}{end}": {"color": colour, "linestyle": "--" if end else "-"}
        for part, colour in COLOURS.items()
        for end in CASES
    }

    def edge_panel(edge: str, element: str) -> plot.Panel:
        own, number = ds.sel(edge=edge, element=element), short(element)
        lines = {
            f"{part}{end}": own[part].sel(case=case)
            for part in COLOURS
            for end, case in CASES.items()
        }
        return plot.panel(
            lines, looks=looks, along="distance from the edge",
            quantity=f"signal of element {number}",
            title=f"{edge.capitalize()} edge, element {number}",
        )  # fmt: skip

    return plot.panels(
        [[edge_panel(edge, each) for edge in EDGES] for each in ds["element"].values]
    )
