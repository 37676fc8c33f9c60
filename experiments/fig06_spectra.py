"""The paper's Fig. 6: one element's transfer, the noise, and the Wiener filter."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import number, refuse
from srsinv.grid import Stage
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.method import Method
from srsinv.inverse.simulated import noisy_problem
from srsinv.report.data import dataset
from srsinv.report.plot.spectra import (
    gain_limits,
    over_wavenumber,
    power,
    wavelength_mm,
    wavenumbers,
)
from srsinv.report.plot.style import names_of
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed

LONG_WAVES_KZ = 1e-3
INVERSE = "inverse 1/|G|"


def run(cfg: config.Config) -> Result:
    """|G|, the powers of signal and noise, and each Wiener filter with its cut-off.

    Raises `BadInput` for refusals of the configuration's parts.
    """
    with config.precision(cfg):
        sim, methods = config.simulation(cfg), config.methods(cfg)
        sim.sensor.require_elements(1)
        friction = number("friction", config.friction(cfg), "mu of q = mu p, such as 0.4")
        problem = noisy_problem(sim, config.random_key(cfg), friction)
        k, noise = np.asarray(sim.line.k), np.asarray(problem.noise)[0]
        gain = np.abs(np.asarray(problem.forward.circulant().transfer[0, 0]))
        prior = _assumed_power(methods, problem)
        stages = {"charge": sim.sensor.charge(), "rate": sim.sensor.current(sim.scan)}
        slopes = [_octave_dB(each, sim.sensor.depth_m, friction) for each in stages.values()]

    total = gain**2 * prior + noise
    resolution = gain**2 * prior / total
    cutoff = np.array([_last_half(k, each) for each in resolution])
    unit, along = sim.sensor.amplifier.unit, ("estimator", "wavenumber")
    inverse = np.divide(1.0, gain, out=np.full_like(gain, np.nan), where=gain > 0)
    data = dataset(
        {
            "sensor_gain": ("wavenumber", gain, f"{unit}/Pa"),
            "inverse_gain": ("wavenumber", inverse, f"Pa/{unit}"),
            "signal_power": ("wavenumber", gain**2 * prior[0], f"({unit})^2"),
            "noise_power": ("wavenumber", noise, f"({unit})^2"),
            "filter": (along, gain * prior / total, f"Pa/{unit}"),
            "resolution": (along, resolution, "1"),
            "cutoff": ("estimator", cutoff, "rad/m", "cutoff_{estimator}_rad_per_m"),
            "wavelength": ("estimator", 2 * np.pi / cutoff, "m", "cutoff_wavelength_{estimator}_m"),
            "slope": ("stage", slopes, "dB", "slope_{stage}_dB_per_octave"),
        },
        {"wavenumber": (k, "rad/m"), "estimator": (list(methods), "1"),
         "stage": (list(stages), "1")},
        friction=friction, noise=" and ".join(cfg["noise"]), effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    shortest = 1e3 * float(data["wavelength"].min())
    title = f"The Wiener filter resolves waves down to {shortest:.2g} mm"
    return Result(title, data, sections(__file__, filters=filters))


def _assumed_power(methods: Mapping[str, Method], problem: LineProblem) -> np.ndarray:
    """The power of p that each filter assumes (method, k) [Pa^2]."""
    spectra = {name: method.spectra(problem) for name, method in methods.items()}
    others = [name for name, powers in spectra.items() if powers is None]
    refuse(
        bool(others),
        f"method names {others}, but only Wiener filters have a spectrum to draw: "
        "give method=[wiener].",
    )
    return np.stack([np.asarray(each)[0] for each in spectra.values() if each is not None])


def _octave_dB(stage: Stage, depth_m: Any, friction: float) -> float:
    """Rise of |G_p + mu G_q| over an octave of long waves, where depth and strip width do not yet
    matter."""
    p, q = np.asarray(stage.transfer(jnp.asarray([1.0, 2.0]) * LONG_WAVES_KZ / depth_m)[0])
    low, high = np.abs(p + friction * q)
    return float(20 * np.log10(high / low))


def _last_half(k: np.ndarray, resolution: np.ndarray) -> float:
    """The last wavenumber [rad/m] with a resolution of at least one half, NaN if none."""
    resolved = np.flatnonzero(resolution >= 0.5)
    return float(k[resolved[-1]]) if resolved.size else float("nan")


def filters(ds: xarray.Dataset) -> Figure:
    """The sensor's transfer, the power of signal and noise, and the inverse filters."""
    k, gain, cutoff = (ds[name].values for name in ("wavenumber", "sensor_gain", "cutoff"))
    across, at = wavenumbers(k, gain, cutoff), float(cutoff[0])
    marks = [plot.Mark(at, f"cut-off, {wavelength_mm(at):.3g} mm")] if np.isfinite(at) else []
    waves = ds.isel(wavenumber=slice(1, None))
    lines = {name: waves["filter"].sel({"estimator": name}) for name in names_of(ds["estimator"])}
    # An unregularised inverse grows without bound: the lowest filter sets the limits.
    lowest = min(float(line.max()) for line in lines.values())
    panel = partial(plot.panel, along=across.quantity, within=across.limits, log="xy", marks=marks)
    signal, noise = ds["signal_power"], ds["noise_power"].values
    return over_wavenumber([
        panel({f"p with q = {ds.attrs['friction']:g} p": waves["sensor_gain"]}, quantity="|G|",
              limits=gain_limits(gain), title="Sensor transfer"),
        power({"signal": signal.values}, noise, signal.attrs["units"], across, k, marks),
        panel({**lines, INVERSE: waves["inverse_gain"]}, looks={INVERSE: {"linestyle": "--"}},
              quantity="|H|", limits=(lowest * 1e-5, lowest * 1e3), title="Inverse filter"),
    ])  # fmt: skip
