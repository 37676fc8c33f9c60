"""The stages of a scene along x, and of its recording: traction, stress, samples in time."""

from collections.abc import Iterable

import numpy as np
import xarray
from matplotlib.figure import Figure

from .panels import Curve, Panel, PanelAxis, panels
from .style import GREY, PALETTE, TRUTH, colours, names_of, units_of

X = PanelAxis("position x", "m")
TIME = PanelAxis("time", "s")
QUANTITIES = {"p": "pressure p", "q": "shear q"}
ACTIVE_FRACTION = 0.02  # of a signal's peak: below, the signal is not drawn


def traction(dataset: xarray.Dataset) -> Figure:
    """Draw the true p and q on the skin along x [Pa], and the friction where it is known.

    `dataset`: `traction` (component, x) and, where it is known, `friction` (x).
    """
    x, units = dataset["x"].values, units_of(dataset["traction"])
    signs = {"p": "Pressure, positive into the finger", "q": "Shear, positive along +x"}
    parts = [
        Panel([Curve(values, name)], X, PanelAxis(QUANTITIES[name], units), x, signs[name])
        for name, values in zip(
            names_of(dataset["component"]), dataset["traction"].values, strict=True
        )
    ]
    if "friction" in dataset:
        parts.append(
            Panel([Curve(dataset["friction"].values, "mu")], X, PanelAxis("mu"), x, "Friction")
        )
    return panels(parts, "Traction on the skin", legend="", height_in=1.8)


def stress(dataset: xarray.Dataset) -> Figure:
    """Draw the stress at the film along x [Pa], tension positive: one panel for each depth.

    `dataset`: `stress` (element, stress_name, x), `element_depth` [m].
    """
    depths, parts = dataset["element_depth"].values, []
    for depth in np.unique(depths):
        elements = np.flatnonzero(depths == depth)
        which = ", ".join(str(i) for i in elements)
        values = dataset["stress"].values[elements[0]]
        curves = [
            Curve(each, name)
            for name, each in zip(names_of(dataset["stress_name"]), values, strict=True)
        ]
        where = f"{1e3 * depth:.4g} mm deep (element{'s' * (len(elements) > 1)} {which})"
        parts.append(Panel(curves, X, PanelAxis("stress", "Pa"), dataset["x"].values, where))
    return panels(parts, "Stress at the film, tension positive")


def record(dataset: xarray.Dataset) -> Figure:
    """Draw the recorded samples of every element over time, and below them the speed of sliding.

    `dataset`: `recorded_signal` (element, sample), `sample_time` [s], `sample_speed` [m/s].
    """
    time_s, signals = dataset["sample_time"].values, dataset["recorded_signal"]
    lines = [
        Curve(values, name)
        for name, values in zip(names_of(dataset["element"]), signals.values, strict=True)
    ]
    speed = Curve(dataset["sample_speed"].values, "", look={"color": TRUTH})
    return panels(
        [
            Panel(lines, TIME, PanelAxis("signal", units_of(signals)), time_s, "As recorded"),
            Panel([speed], TIME, PanelAxis("speed", "m/s"), time_s, "Speed of sliding"),
        ]
    )


def with_and_without(dataset: xarray.Dataset, effect: str) -> Figure:
    """Draw the signal of each element with an effect and without, and their difference beside.

    - `effect`: its name, EFFECT below.
    - `dataset`: `signal_with_EFFECT`, `signal_without_EFFECT` (element, time_EFFECT) and the
      coordinate `time_EFFECT` [s], for an effect has sample times of its own.
    """
    time_s, unit = dataset[f"time_{effect}"].values, units_of(dataset[f"signal_with_{effect}"])
    changed, ideal = (dataset[f"signal_{name}_{effect}"].values for name in ("with", "without"))
    across = PanelAxis("time", "s", limits=_active_interval_s(time_s, changed, ideal))
    rows = []
    for e, name in enumerate(names_of(dataset["element"])):
        both = [
            Curve(ideal[e], "without", look={"color": GREY}),
            Curve(changed[e], "with", look={"color": PALETTE[1], "linestyle": "--"}),
        ]
        change = [Curve(changed[e] - ideal[e], "difference", look={"color": TRUTH})]
        rows.append(
            (
                Panel(both, across, PanelAxis("signal", unit), time_s, f"Element {name}"),
                Panel(
                    change,
                    across,
                    PanelAxis("change", unit),
                    time_s,
                    "With less without the effect",
                ),
            )
        )
    return panels(rows)


def _active_interval_s(time_s: np.ndarray, *signals: np.ndarray) -> tuple[float, float]:
    """Interval in which any signal (element, sample) is above `ACTIVE_FRACTION` of its peak, and a
    margin."""
    size = np.abs(np.concatenate(signals)).max(axis=0)
    active = time_s[size >= ACTIVE_FRACTION * size.max()]
    margin = 0.3 * (active[-1] - active[0]) + (time_s[-1] - time_s[0]) / 50
    return max(active[0] - margin, time_s[0]), min(active[-1] + margin, time_s[-1])


def method_looks(methods: list[str]) -> dict[str, dict[str, str]]:
    """Colour and line style of each method."""
    styles = ("-", "--", ":", "-.")
    palette = colours(methods)
    return {
        name: {"color": palette[name], "linestyle": styles[i % len(styles)]}
        for i, name in enumerate(palette)
    }


def method_curves(methods: list[str], rows: Iterable[np.ndarray]) -> list[Curve]:
    """A curve for each method, one of `rows` (n,), in its look."""
    looks = method_looks(methods).items()
    return [Curve(row, name, look=look) for (name, look), row in zip(looks, rows, strict=True)]
