"""The paper's Fig. 6: one element's transfer, the noise, and the Wiener filter."""

import jax.numpy as jnp
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import BadInput, refuse
from srsinv.inverse.simulated import noisy_problem
from srsinv.report.plot.spectra import (
    gain_limits,
    over_wavenumber,
    power,
    wavelength_mm,
    wavenumbers,
)
from srsinv.report.result import Result, dataset
from srsinv.report.section import sections

LONG_WAVES_KZ = 1e-3


def run(cfg: config.Config) -> Result:
    """|G|, the powers of signal and noise, and each Wiener filter with its cut-off.

    Raises `BadInput` for refusals of the configuration's parts.
    """
    with config.precision(cfg):
        sim, methods = config.simulation(cfg), config.methods(cfg)
        elements = len(sim.sensor.elements)
        refuse(elements != 1, f"sensor has {elements} elements: give 1, use sensor=one_element.")
        friction = config.friction(cfg)
        if friction is None:
            raise BadInput("friction is null: give mu of q = mu p, such as 0.4.")
        problem = noisy_problem(sim, config.random_key(cfg), friction)
        k, noise = np.asarray(sim.line.k), np.asarray(problem.noise)
        gain = np.abs(np.asarray(problem.forward.circulant().transfer[0, 0]))
        spectra = {name: method.spectra(problem) for name, method in methods.items()}
        others = [name for name, powers in spectra.items() if powers is None]
        refuse(bool(others), f"method names {others}: only Wiener filters have a spectrum to draw.")
        prior = np.stack([np.asarray(each)[0] for each in spectra.values() if each is not None])
        # An octave apart at long waves, where depth and strip width do not yet matter.
        low = jnp.asarray([1.0, 2.0]) * LONG_WAVES_KZ / sim.sensor.depth_m
        stages = {"charge": sim.sensor.charge(), "rate": sim.sensor.current(sim.scan)}
        slopes = [_octave_dB(stage.transfer(low)[0], friction) for stage in stages.values()]

    resolution = gain**2 * prior / (gain**2 * prior + noise)
    cutoff = np.array([_last_half(k, each) for each in resolution])
    unit, along = sim.sensor.amplifier.unit, ("method", "wavenumber")
    inverse = np.divide(1.0, gain, out=np.full_like(gain, np.nan), where=gain > 0)
    data = dataset(
        {
            "sensor_gain": ("wavenumber", gain, f"{unit}/Pa"),
            "inverse_gain": ("wavenumber", inverse, f"Pa/{unit}"),
            "signal_power": ("wavenumber", gain**2 * prior[0], f"({unit})^2"),
            "noise_power": ("wavenumber", noise, f"({unit})^2"),
            "filter": (along, gain * prior / (gain**2 * prior + noise), f"Pa/{unit}"),
            "resolution": (along, resolution, "1"),
            "cutoff": ("method", cutoff, "rad/m", "cutoff_{method}_rad_per_m"),
            "wavelength": ("method", 2 * np.pi / cutoff, "m", "cutoff_wavelength_{method}_m"),
            "slope": ("stage", slopes, "dB", "slope_{stage}_dB_per_octave"),
        },
        {"wavenumber": (k, "rad/m"), "method": (list(methods), "1"), "stage": (list(stages), "1")},
        friction=friction,
        noise=" and ".join(cfg["noise"]),
        effects_on=", ".join(cfg["effects"]) or "none",
    )
    shortest = 1e3 * float(data["wavelength"].min())
    title = f"The Wiener filter follows the inverse down to waves of {shortest:.2g} mm"
    return Result(title, data, sections(__file__, filters=filters))


def filters(ds: xarray.Dataset) -> Figure:
    """The sensor's transfer, the power of signal and noise, and the inverse filters."""
    k, gain, cutoff = (ds[name].values for name in ("wavenumber", "sensor_gain", "cutoff"))
    across, at = wavenumbers(k, gain, cutoff), float(cutoff[0])
    marks = [plot.Mark(at, f"cut-off, {wavelength_mm(at):.3g} mm")] if np.isfinite(at) else []
    lines = {
        str(name): row
        for name, row in zip(ds["method"].values, ds["filter"].values[:, 1:], strict=True)
    }
    # An unregularised inverse grows without bound: the lowest filter sets the limits.
    lowest = min(np.nanmax(row) for row in lines.values())
    gain_axis = plot.PanelAxis("|G|", ds["sensor_gain"].attrs["units"], True, gain_limits(gain))
    filter_axis = plot.PanelAxis(
        "|H|", ds["filter"].attrs["units"], True, (lowest * 1e-5, lowest * 1e3)
    )
    curves = [plot.Curve(row, name) for name, row in lines.items()]
    curves.append(
        plot.Curve(ds["inverse_gain"].values[1:], "inverse 1/|G|", look={"linestyle": "--"})
    )
    signal, noise = ds["signal_power"], ds["noise_power"].values
    transfer = [plot.Curve(gain[1:], f"p with q = {ds.attrs['friction']:g} p")]
    return over_wavenumber(
        [
            plot.Panel(transfer, across, gain_axis, k[1:], "Sensor transfer", marks),
            power({"signal": signal.values}, noise, signal.attrs["units"], across, k, marks),
            plot.Panel(curves, across, filter_axis, k[1:], "Inverse filter", marks),
        ]
    )


def _octave_dB(transfer, friction: float) -> float:
    """Rise of |G_p + mu G_q| (component, 2) from its first to its second wavenumber."""
    low, high = np.abs(np.asarray(transfer[0] + friction * transfer[1]))
    return float(20 * np.log10(high / low))


def _last_half(k: np.ndarray, resolution: np.ndarray) -> float:
    """The last wavenumber [rad/m] with a resolution of at least one half, NaN if none."""
    resolved = np.flatnonzero(resolution >= 0.5)
    return float(k[resolved[-1]]) if resolved.size else float("nan")
