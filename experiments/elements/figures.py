"""Figures of elements: errors and bursts over their number, and bursts against their truth."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.plot.panels import Curve, Mark, Panel, PanelAxis
from srsinv.report.plot.style import GREY, TRUTH, names_of

DOTS = {"linestyle": "", "marker": "o", "markersize": 3}


def draw_errors(ds: xarray.Dataset) -> Figure:
    """The error of p over the number of elements in each case, and 1/sqrt(K)."""
    means, first = ds["error_mean"], ds["elements"].values[0]
    lines = {case: means.sel(case=case) for case in names_of(ds["case"])}
    ideal = means.sel(case="no bursts")[:1].values * np.sqrt(first / ds["elements"].values)
    lines["1/√K"] = means.sel(case="no bursts").copy(data=ideal)
    looks = {
        "bursts found": {"marker": "o"},
        "bursts ignored": {"marker": "s"},
        "no bursts": {"linestyle": "--", "color": TRUTH},
        "1/√K": {"linestyle": ":", "color": GREY},
    }
    floor = Mark(float(ds["floor_error_p"]), "a hundredth of the noise", "y", look={"color": GREY})
    return plot.panels([
        plot.panel(
            lines, looks=looks, quantity="relative error of p", along="number of elements K",
            log="xy", marks=[floor],
        )
    ], height_in=2.8)  # fmt: skip


def draw_counts(ds: xarray.Dataset) -> Figure:
    """Bursts that happened, that are claimed and that are located, over the number of elements."""
    lines = {"happened": ds["true_bursts"], "claimed": ds["claimed"], "located": ds["located"]}
    looks = {"happened": {"color": TRUTH}, "claimed": {"marker": "o"}, "located": {"marker": "s"}}
    return plot.panels([
        plot.panel(
            lines, looks=looks, quantity="bursts", along="number of elements K", limits=(0, None)
        )
    ], height_in=2.2)  # fmt: skip


def draw_bursts(ds: xarray.Dataset) -> Figure:
    """Place and size of the bursts found against their truth, with 90 % intervals."""
    located = ds["is_located"].values > 0
    return plot.panels([[_against(ds, name, located) for name in ("place", "size")]], height_in=2.8)


def _against(ds: xarray.Dataset, name: str, located: np.ndarray) -> Panel:
    """A quantity of bursts with its interval over its truth."""
    truth, value = ds[f"true_{name}"], ds[f"{name}_value"]
    ends = np.array([truth.min(), truth.max()]) if truth.size else np.zeros(2)
    ends = ends + 0.05 * np.ptp(ends) * np.array([-1, 1])  # so that no bar is on the frame
    curves = [Curve(ends, "truth", x=ends, look={"color": TRUTH, "linestyle": "--"})]
    for label, mask, marker in (("located", located, "o"), ("not located", ~located, "s")):
        if not mask.any():
            continue
        band = ds[f"{name}_low"].values[mask], ds[f"{name}_high"].values[mask]
        look = DOTS | {"marker": marker}
        curves.append(
            Curve(value.values[mask], label, x=truth.values[mask], band=band, look=look,
                  has_bars=True)
        )  # fmt: skip
    unit = str(truth.attrs["units"])
    quantity = {"place": "place on the finger", "size": "size"}[name]
    return Panel(curves, PanelAxis(f"true {quantity}", unit), PanelAxis(quantity, unit))
