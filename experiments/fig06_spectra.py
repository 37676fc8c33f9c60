"""The paper's Fig. 6: one element's transfer, the noise, and the Wiener filter."""

import jax.numpy as jnp
import numpy as np
import xarray

from srsinv import config
from srsinv.errors import BadInput, refuse
from srsinv.jobs.simulation import noisy_problem
from srsinv.report import figures
from srsinv.report.outcome import Outcome, Section, Table
from srsinv.report.text import listed

LONG_WAVES_KZ = 1e-3


def run(cfg: config.Config) -> Outcome:
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
        prior = {name: np.asarray(s)[0] for name, s in spectra.items() if s is not None}
        # An octave apart at long waves, where depth and strip width do not yet matter.
        low = jnp.asarray([1.0, 2.0]) * LONG_WAVES_KZ / sim.sensor.depth_m
        slopes = {
            name: _octave_dB(stage.transfer(low)[0], friction)
            for name, stage in (("charge", sim.sensor.charge()),
                                ("rate", sim.sensor.current(sim.scan)))
        }  # fmt: skip

    resolution = {name: gain**2 * s / (gain**2 * s + noise) for name, s in prior.items()}
    filters = {name: gain * s / (gain**2 * s + noise) for name, s in prior.items()}
    cutoff = {name: _last_half(k, r) for name, r in resolution.items()}
    signal = gain**2 * next(iter(prior.values()))
    unit = sim.sensor.amplifier.unit
    metrics = {f"slope_{name}_dB_per_octave": slope for name, slope in slopes.items()}
    for name, at in cutoff.items():
        tag = name.lower().replace(" ", "_")
        metrics |= {f"cutoff_{tag}_rad_per_m": at, f"cutoff_wavelength_{tag}_m": 2 * np.pi / at}
    dataset = xarray.Dataset(
        {
            "sensor_gain": (("wavenumber",), gain, {"units": f"{unit}/Pa"}),
            "signal_power": (("wavenumber",), signal, {"units": f"({unit})^2"}),
            "noise_power": (("wavenumber",), noise, {"units": f"({unit})^2"}),
            "filter": (("method", "wavenumber"), [*filters.values()], {"units": f"Pa/{unit}"}),
            "resolution": (("method", "wavenumber"), [*resolution.values()], {"units": "1"}),
        },
        {
            "wavenumber": ("wavenumber", k, {"units": "rad/m"}),
            "method": ("method", list(filters), {"units": "1"}),
        },
    )

    def draw():
        inverse = np.divide(1.0, gain, out=np.full_like(gain, np.nan), where=gain > 0)
        drawn, first = filters | {"inverse 1/|G|": inverse}, next(iter(cutoff.values()))
        name = f"p with q = {friction:g} p"
        return figures.filter_spectra(
            k, {name: gain}, signal, noise, drawn, first, signal_unit=unit
        )

    rows = [(name, at, 2e3 * np.pi / at) for name, at in cutoff.items()]
    table = Table(("filter", "cut-off [rad/m]", "wavelength [mm]"), tuple(rows))
    return Outcome(
        "Sensor, noise and Wiener filter of one element",
        {key: float(value) for key, value in metrics.items()},
        dataset,
        (
            Section(
                "Spectra",
                (f"At long waves the rate signal rises by {slopes['rate']:.2f} dB per octave and "
                 f"the charge by {slopes['charge']:.2f}: one derivative is +6 dB, where the paper "
                 "says +12 dB per octave. It is stated here as the model gives it.",),
                {"filter_spectra": draw},
                {"filter_spectra": "The rate takes away long waves, the skin's depth short ones; "
                 "the strip's width puts zeros at its own wavelength and its fractions. The "
                 "filters follow the plain inverse where signal stands above noise, and let go "
                 "beyond the cut-off, where they keep half of the traction."},
                (table,),
            ),
            Section(
                "What was assumed",
                ("Traction: the first filter's spectrum is also the signal's here (correlated "
                 "exponentially in x); the paper's form takes a flat one in units in which the "
                 "largest gain is 1.",
                 f"Noise: {' and '.join(cfg['noise'])}, levels relative to the signal of the "
                 f"configured scene. Effects on: {listed(cfg['effects'])}."),
            ),
        ),
        table,
    )  # fmt: skip


def _octave_dB(transfer, friction: float) -> float:
    """Rise of |G_p + mu G_q| (component, 2) from its first to its second wavenumber."""
    low, high = np.abs(np.asarray(transfer[0] + friction * transfer[1]))
    return float(20 * np.log10(high / low))


def _last_half(k: np.ndarray, resolution: np.ndarray) -> float:
    """The last wavenumber [rad/m] with a resolution of at least one half, NaN if none."""
    resolved = np.flatnonzero(resolution >= 0.5)
    return float(k[resolved[-1]]) if resolved.size else float("nan")
