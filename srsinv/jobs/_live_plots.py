"""Figures of a live inversion that was played back."""

import xarray
from matplotlib.figure import Figure

from .. import plot
from ..report.text import quantity

ALL = "all samples at once"


def draw_estimates(ds: xarray.Dataset) -> Figure:
    """p and q at the lag that was asked for with their bands, and from all samples."""
    lag = float(ds["lag_m"])
    own = {name: ds[name].sel(lag=lag) for name in ("live_estimate", "live_stderr")}
    label = f"{quantity(lag, 'm', 3)} behind"

    def one(component: str) -> plot.Panel:
        of = {name: each.sel(component=component) for name, each in own.items()}
        whole = ds["estimate"].sel(component=component)
        return plot.panel(
            {label: of["live_estimate"], ALL: whole}, stderrs={label: of["live_stderr"]},
            looks={ALL: {"color": "black", "linewidth": 1.0}},
            quantity=component, along="position x",
        )  # fmt: skip

    return plot.panels([one(str(c)) for c in ds["component"].values])


def draw_latency(ds: xarray.Dataset) -> Figure:
    """Standard error, and rms difference from the longest lag's estimate, against the lag."""

    def one(component: str) -> plot.Panel:
        of = ds.sel(component=component).isel(lag=slice(0, -1))
        lines = {
            "standard error": of["typical_stderr"],
            "rms difference from the longest lag": of["difference_rms"],
        }
        along = "lag behind the sensor"
        return plot.panel(lines, quantity=f"error of {component}", along=along, limits=(0.0, None))

    return plot.panels([one(str(c)) for c in ds["component"].values])


def draw_noise(ds: xarray.Dataset) -> Figure:
    """The noise level in use along the pass."""
    lines = {str(e): ds["noise_level"].sel(element=e) for e in ds["element"].values}
    return plot.panels(
        [
            plot.panel(
                lines, quantity="noise (rms per sample)", along="position x", limits=(0.0, None)
            )
        ]
    )


def draw_times(ds: xarray.Dataset) -> Figure:
    """The share of chunks that took at most so long a sample."""
    times = ds["chunk_time_s"].sortby(ds["chunk_time_s"])
    n = times.sizes["chunk"]
    share = xarray.DataArray(
        (1.0 + xarray.DataArray(range(n), dims="chunk")).values / n,
        {"time": ("time", times.values, {"units": "s"})}, "time", attrs={"units": "1"},
    )  # fmt: skip
    return plot.panels(
        [plot.panel({"chunks": share}, quantity="share of the chunks", along="time per sample",
                    log="x", limits=(0.0, 1.0))]
    )  # fmt: skip


PLOTS = {
    "estimates": draw_estimates,
    "latency": draw_latency,
    "noise": draw_noise,
    "times": draw_times,
}
