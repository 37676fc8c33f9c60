"""Spectra of sensor gain, signal and noise, and resolution of the methods."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from .panels import Curve, Mark, Panel, PanelAxis, panels
from .stages import method_looks
from .style import (
    GREY,
    LINE_STYLES,
    MM_PER_M,
    PALETTE,
    TRUTH,
    colours,
    has_values,
    names_of,
    peak,
    short,
    styled,
    units_of,
)

_DEEPEST = 1e-8  # of the largest gain: below, no recording has a signal
_GAIN = "gain |G|"


def spectra(dataset: xarray.Dataset) -> Figure:
    """Draw spectra over the wavenumber: sensor gain, power of signal and noise, and resolution.

    `dataset`: `sensor_gain` (element, component, wavenumber), `signal_power`, `noise_power`,
    `resolution` and `cutoff` [rad/m] of each method. k = 0 is not on a logarithmic axis; the mean
    is described with the estimates.
    """
    k = dataset["wavenumber"].values
    signal = {
        f"signal, element {short(name)}": values
        for name, values in zip(
            names_of(dataset["element"]), dataset["signal_power"].values, strict=True
        )
    }
    cutoff = dataset["cutoff"].values
    across = wavenumbers(k, dataset["sensor_gain"].values, cutoff)
    units = units_of(dataset["signal_power"])
    return over_wavenumber(
        [
            _gain(dataset, across),
            power(signal, dataset["noise_power"].values, units, across, k),
            _resolution(dataset, across),
        ]
    )


@styled
def over_wavenumber(parts: Sequence[Panel]) -> Figure:
    """Panels over a wavenumber [rad/m], with the wavelength on top."""
    figure = panels(parts, height_in=2.4, legend="beside")
    top = figure.axes[0].secondary_xaxis("top", functions=(wavelength_mm, wavelength_mm))
    top.set_xlabel("wavelength 2π/k [mm]")
    top.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    top.xaxis.set_minor_locator(NullLocator())
    top.xaxis.set_major_formatter(FuncFormatter(lambda mm, _: f"{mm:g}"))
    return figure


def wavenumbers(k: np.ndarray, gain: np.ndarray, cutoff: np.ndarray) -> PanelAxis:
    """The axis of wavenumbers (k,) up to where the gain (..., k) has become negligible, but well
    past every cut-off."""
    limits = float(k[1]), _last_wavenumber(k, gain, cutoff)
    return PanelAxis("wavenumber k", "rad/m", True, limits)


def gain_limits(gain: np.ndarray) -> tuple[float | None, float | None]:
    """The range of a gain that a recording can show."""
    top = float(peak(gain))
    return (top * _DEEPEST, top * 5) if top > 0 else (None, None)


def _gain(dataset: xarray.Dataset, across: PanelAxis) -> Panel:
    gain, k = dataset["sensor_gain"], dataset["wavenumber"].values
    palette = colours(names_of(dataset["component"]))
    lines = [
        Curve(
            gain.values[e, c, 1:], f"{component}, element {short(element)}",
            look={"color": colour, "linestyle": LINE_STYLES[e % len(LINE_STYLES)]},
        )
        for e, element in enumerate(names_of(dataset["element"]))
        for c, (component, colour) in enumerate(palette.items())
        if has_values(gain.values[e, c])
    ]  # fmt: skip
    up = PanelAxis(_GAIN, units_of(gain), True, gain_limits(gain.values))
    return Panel(lines, across, up, k[1:], "Sensor gain")


def power(
    signal: Mapping[str, Any],
    noise: np.ndarray,
    units: str,
    across: PanelAxis,
    k: np.ndarray,
    marks: Sequence[Mark] = (),
) -> Panel:
    """The power (k,) of signals by label, and that of the noise, (k,) or (element, k) where it is
    not the same in all, down to below the noise."""
    noise = np.atleast_2d(noise)[:, 1:]
    shades = PALETTE[-2::-1]  # far from p and q
    lines = [
        Curve(values[1:], label, look={"color": shades[i % len(shades)], "linewidth": 1.0})
        for i, (label, values) in enumerate(signal.items())
    ]
    lines += [
        Curve(row, "" if i else "noise", look={"color": TRUTH, "linestyle": LINE_STYLES[i % 2]})
        for i, row in enumerate(noise)
    ]
    powers = np.concatenate([[values[1:] for values in signal.values()], noise])
    positive = powers[np.isfinite(powers) & (powers > 0)]
    limits: tuple[float | None, float | None] = (None, None)
    if positive.size:
        loud = noise[np.isfinite(noise) & (noise > 0)]
        floor = loud.min() * 1e-2 if loud.size else positive.max() * _DEEPEST**2
        limits = (float(floor), 5 * float(positive.max()))
    up = PanelAxis("power", units, bool(positive.size), limits)
    return Panel(lines, across, up, k[1:], "Power of signal and noise", marks)


def _resolution(dataset: xarray.Dataset, across: PanelAxis) -> Panel:
    k, cutoff = dataset["wavenumber"].values, dataset["cutoff"].values
    looks = method_looks(names_of(dataset["estimator"]))
    lines, marks = [], [Mark(0.5, axis="y", look={"color": GREY, "linewidth": 0.6})]
    for m, (method, look) in enumerate(looks.items()):
        for c, component in enumerate(names_of(dataset["component"])):
            own = {"color": look["color"], "linestyle": LINE_STYLES[c]}
            values, at = dataset["resolution"].values[m, c], float(cutoff[m, c])
            if not has_values(values):
                continue
            where = f"{wavelength_mm(at):.3g} mm" if np.isfinite(at) else "no cut-off"
            lines.append(Curve(values[1:], f"{component}, {method}: {where}", look=own))
            if np.isfinite(at):
                marks.append(Mark(at, look={**own, "linewidth": 0.8, "alpha": 0.7}))
    top = float(np.clip(1.05 * peak(dataset["resolution"].values), 1.05, 1.5))
    title = "Resolution: part of the truth in the estimate, and its cut-off"
    return Panel(
        lines, across, PanelAxis("resolution", "1", limits=(-0.03, top)), k[1:], title, marks
    )


def wavelength_mm(k: Any) -> Any:
    """The wavelength [mm] of a wavenumber [rad/m]."""
    with np.errstate(divide="ignore"):
        return 2 * np.pi / np.asarray(k, float) * MM_PER_M


def _last_wavenumber(k: np.ndarray, gain: np.ndarray, cutoff: np.ndarray) -> float:
    """The wavenumber where the gain has become negligible, but well past every cut-off."""
    gain = np.nan_to_num(gain)
    visible = k[(gain > gain.max() * _DEEPEST).any(axis=tuple(range(gain.ndim - 1)))]
    ends = [2 * visible.max() if visible.size else k[-1], *(3 * cutoff[np.isfinite(cutoff)])]
    octave = 2 * k[1]  # of three cells, k[1] is the last
    return float(np.clip(max(ends), octave, max(octave, k[-1])))
