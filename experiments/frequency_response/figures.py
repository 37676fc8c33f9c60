"""Figures of frequency_response: amplitude, slope and phase."""

from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.plot.style import GREY, TRUTH

from .sweeps import ALL, IDEAL

PALE = "#b9c1c8"
STEEPEST_DB = -30.0  # that the figure of slopes goes down to


def draw_cases(ds: xarray.Dataset) -> Figure:
    """Amplitude, slope and phase over frequency of every case, and where samples show the wave."""

    def one(name: str, quantity: str, **settings: Any) -> plot.Panel:
        lines = {str(case).replace("_", " "): ds[name].sel(case=case) for case in ds["case"].values}
        looks = {IDEAL: {"color": PALE, "linewidth": 4}, ALL: {"color": TRUTH, "linestyle": "--"}}
        return plot.panel(lines, looks=looks, quantity=quantity, along="frequency", **settings)

    apparent = plot.panel(
        {"": ds["apparent_frequency"]}, looks={"": {"color": GREY}}, log="xy",
        quantity="frequency in samples", along="frequency",
    )  # fmt: skip
    is_folded = bool(np.any(ds["apparent_frequency"].values != ds["frequency"].values))
    return plot.panels([
        one("amplitude", "amplitude", log="xy"),
        one("slope", "slope per octave", log="x", limits=(STEEPEST_DB, -STEEPEST_DB / 2)),
        one("phase", "phase from the load", log="x"),
        *([apparent] if is_folded else []),
    ])  # fmt: skip


def draw_drives(ds: xarray.Dataset) -> Figure:
    """Amplitude and slope of the ideal signal, by what the shaker holds constant."""

    def one(name: str, quantity: str, log: str) -> plot.Panel:
        lines = {f"constant {each}": ds[name].sel(drive=each) for each in ds["drive"].values}
        return plot.panel(lines, quantity=quantity, along="frequency", log=log)

    return plot.panels([
        one("drive_amplitude", "amplitude", "xy"), one("drive_slope", "slope per octave", "x")
    ])  # fmt: skip
