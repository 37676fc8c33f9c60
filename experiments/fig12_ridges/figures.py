"""Figures of fig12_ridges: the signal in its noise, and its size over height and load."""

import xarray
from matplotlib.figure import Figure

from srsinv import plot
from srsinv.report.plot.style import GREY, PALETTE, TRUTH
from srsinv.report.text import quantity

HERE = {"color": PALETTE[1], "linestyle": ":"}
PAPER_M = {"6.5um": 6.5e-6, "0.65um": 0.65e-6}  # measured; and expected to be measurable
LOOKS = {
    "with noise": {"color": GREY, "linewidth": 0.8}, "without noise": {"color": PALETTE[1]},
}  # fmt: skip


def draw_signal(ds: xarray.Dataset) -> Figure:
    """The signal in its noise, the same after a low-pass filter, and the amplitude of each wave."""
    band_hz, parts = float(ds["band_hz"]), []
    for name, ridges, title in (
        ("data", 5, "Whole band"), ("data_in_band", 15, f"Up to {band_hz:.3g} Hz"),
    ):  # fmt: skip
        end = ridges * ds.attrs["pitch_m"]
        near = ds.sel(position=slice(0, end))
        both = {"with noise": near[name], "without noise": near["signal"]}
        parts.append(plot.panel(both, looks=LOOKS, quantity="signal", within=(0, end), title=title))
    waves = {"with noise": ds["data_amplitude"], "reached by chance": ds["amplitude_by_chance"]}
    looks = {
        "with noise": {"color": GREY},
        "reached by chance": {"color": TRUTH, "linestyle": "--"},
    }
    marks = [plot.Mark(band_hz / 2, "pitch", look=HERE)]
    return plot.panels([*parts, plot.panel(
        waves, looks=looks, quantity="amplitude", limits=(0, None), title="Each wave", marks=marks
    )])  # fmt: skip


def draw_size(ds: xarray.Dataset) -> Figure:
    """The signal's amplitude at the pitch over the height and over the nominal pressure."""
    size, facts = ds["amplitude_by_height"], ds.attrs
    look = {"color": PALETTE[0]}
    by_height = plot.panel(
        {"by contact": size, "linear": size[0] / size["ridge_height"][0] * size["ridge_height"]},
        looks={"by contact": look, "linear": {"color": GREY, "linestyle": "--"}},
        quantity="amplitude", log="xy", title=f"At {quantity(facts['nominal_Pa'], 'Pa', digits=2)}",
        marks=[plot.Mark(each, look=HERE) for each in PAPER_M.values()],
    )  # fmt: skip
    by_pressure = plot.panel(
        {"by contact": ds["amplitude_by_pressure"]},
        looks={"by contact": {**look, "marker": "o", "markersize": 4}},
        quantity="amplitude at one height", log="x", limits=(0, None),
        title=f"At {quantity(facts['height_m'], 'm', digits=2)}",
        marks=[plot.Mark(facts["nominal_Pa"], look=HERE)],
    )  # fmt: skip
    return plot.panels([[by_height, by_pressure]], height_in=3.0)
