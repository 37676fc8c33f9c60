"""Figures of skin_acceleration: noise floors, one scan, accuracies, and detection of events."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import plot

TOGETHER = {"linestyle": "--"}


def floors(ds: xarray.Dataset) -> Figure:
    """The pressure that equals the noise of each sensor, over the wavelength of a texture."""
    floor = ds["noise_floor"]
    lines = {str(each): floor.sel(reading=each) for each in ds["reading"].values}
    return plot.panels([plot.panel(
        lines, log="xy", along="wavelength", quantity="pressure that equals the noise in 1 Hz",
    )], height_in=3.0)  # fmt: skip


def signals(ds: xarray.Dataset) -> Figure:
    """One scan by film and accelerometer."""
    parts = {"film_signal": "film signal", "acceleration": "acceleration"}
    return plot.panels(
        [plot.panel({"": ds[name]}, along="position x", quantity=words)
         for name, words in parts.items()], height_in=1.8,
    )  # fmt: skip


def by_pressure(ds: xarray.Dataset) -> Figure:
    """Accuracy of classification over the nominal pressure, a panel for each set."""
    every = ds["accuracy_at_pressure"].sortby("pressure")
    sensors, dots = ds["sensors"].values, {"marker": "o"}
    parts = [
        plot.panel(
            {str(each): every.sel(set=name, sensors=each) for each in sensors},
            looks={str(each): dots for each in sensors},
            along="nominal pressure", quantity="classified correctly", log="x", limits=(0, 1),
            title=str(name),
        )
        for name in ds["set"].values
    ]  # fmt: skip
    return plot.panels([parts[i : i + 3] for i in range(0, len(parts), 3)], height_in=2.4)


def probabilities(ds: xarray.Dataset) -> Figure:
    """Probability of detection over the size of an event, a panel for each."""
    every = ds["detection_probability"]
    parts = []
    for event in ds["event"].values:
        own = every.sel(event=event)
        some = np.flatnonzero((own > 0.01).any("detector") & (own < 0.99).any("detector"))
        within = tuple(ds["size"].values[some[[0, -1]]]) if some.size else (None, None)
        lines = {str(each): own.sel(detector=each) for each in ds["detector"].values}
        parts.append(plot.panel(
            lines, log="x", looks={each: TOGETHER for each in lines if " and " in each},
            along="size", quantity="probability of detection", within=within, title=str(event),
        ))  # fmt: skip
    return plot.panels([parts], height_in=2.8)
