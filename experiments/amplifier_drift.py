"""Warming, a drifting load and bias on a current amplifier and on charge amplifiers, beside the
signal of ridges.

All of them are one circuit, a resistance R_f and a capacitance C_f side by side in the feedback,

    C_f dv/dt + v/R_f = dQ/dt.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
import xarray
from jaxtyping import Float
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import mapping, number, refuse
from srsinv.report.data import dataset
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity, significant, spoken

NAME = "amplifier_drift"
FIRST_S = 1e-2  # the first time that is drawn, far before the warmth reaches the film
TIMES = 3000
CAUSES = "warming", "load", "bias"
WANTED = {  # of the settings, all of them positive
    "pyroelectric_C_per_m2_K": "a positive coefficient in C/(m^2 K)",
    "surface_step_K": "a positive difference in kelvin",
    "diffusivity_m2_per_s": "a positive diffusivity in m^2/s",
    "load_change_Pa": "a positive pressure in Pa",
    "load_time_s": "a positive time in seconds",
    "contact_m": "a positive length in metres",
    "bias_current_A": "a positive current in A",
    "full_scale_V": "a positive voltage in V",
    "duration_s": "a positive time in seconds",
}


class FeedbackCircuit(NamedTuple):
    """Feedback of an amplifier: `resistance_ohm`, infinite where there is none, across
    `capacitance_F`."""

    resistance_ohm: float
    capacitance_F: float

    def periodic(
        self, charge_C: Float[np.ndarray, " n"], period_s: float
    ) -> Float[np.ndarray, " n"]:
        """Output [V] in the steady state for even samples of a charge over one period, without its
        mean."""
        turn = 2j * np.pi * np.fft.rfftfreq(charge_C.size, period_s / charge_C.size)[1:]
        wave = np.fft.rfft(charge_C)
        wave[1:] *= turn / (1 / self.resistance_ohm + turn * self.capacitance_F)
        wave[0] = 0
        return np.fft.irfft(wave, charge_C.size)

    def over_time(
        self, charge_C: Float[np.ndarray, " n"], time_s: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Output [V] from rest at the first time, exact for a charge that is straight between the
        times."""
        current, step = np.diff(charge_C) / np.diff(time_s), np.diff(time_s)
        stays = np.exp(-step / (self.resistance_ohm * self.capacitance_F))
        if np.isinf(self.resistance_ohm):
            gained = current * step / self.capacitance_F
        else:
            gained = current * self.resistance_ohm * (1 - stays)
        output = np.zeros_like(charge_C)
        for n, (each, more) in enumerate(zip(stays, gained, strict=True)):
            output[n + 1] = each * output[n] + more
        return output


def run(cfg: config.Config) -> Result:
    """Outputs over time after the finger touches a warmer surface, and the time to saturation.

    Raises `BadInput` for a sensor that has not one element, circuits that are not named as a
    mapping, and what is not positive.
    """
    given = {
        name: number(f"{NAME}.{name}", cfg[NAME][name], wanted, above=0)
        for name, wanted in WANTED.items()
    }
    circuits = _circuits(cfg[NAME]["circuits"])
    with config.precision(cfg):
        line, scene = config.line(cfg), config.scene(cfg)
        sensor, scan = config.sensor(cfg), config.scan(cfg)
        sensor.require_elements(1)
        scan.require_onwards()
        ridges = np.asarray(line.operator(sensor.charge())(scene.traction(line)))[0]
        of_patch = sensor.charge().cell_response(jnp.zeros(1), jnp.asarray(given["contact_m"]))
        per_Pa, film = of_patch[0, 0].item(), sensor.elements[0]
        area = float(film.strips * film.width_m * film.length_m)
        period = line.n * float(line.cell_m) / float(scan.speed_m_per_s)
        depth = float(film.depth_m)

    time = np.concatenate([[0], np.geomspace(FIRST_S, given["duration_s"], TIMES)])
    warmth = given["surface_step_K"] * warming(time, depth, given["diffusivity_m2_per_s"])
    charge = np.stack([
        given["pyroelectric_C_per_m2_K"] * area * warmth,
        per_Pa * given["load_change_Pa"] * -np.expm1(-time / given["load_time_s"]),
        given["bias_current_A"] * time,
    ])  # fmt: skip
    output = np.array([[c.over_time(q, time) for q in charge] for c in circuits.values()])
    ridge = np.array([np.abs(c.periodic(ridges, period)).max() for c in circuits.values()])
    data = dataset(
        {
            "temperature": ("time", warmth, "K"),
            "charge": (("cause", "time"), charge, "C"),
            **_outputs(output, ridge, time, given),
            "resistance": ("circuit", [c.resistance_ohm for c in circuits.values()], "ohm"),
            "capacitance": ("circuit", [c.capacitance_F for c in circuits.values()], "F"),
        },
        {"circuit": (list(circuits), "1"), "cause": (list(CAUSES), "1"), "time": (time, "s")},
        depth_m=depth, area_m2=area, speed_m_per_s=float(scan.speed_m_per_s), **given,
        effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    return Result(_title(data), data, sections(__file__, outputs=draw_outputs))


def warming(
    time_s: Float[np.ndarray, " n"], depth_m: float, diffusivity_m2_per_s: float
) -> Float[np.ndarray, " n"]:
    """Temperature at a depth in a half space over that of its surface since time 0."""
    reach = 2 * np.sqrt(diffusivity_m2_per_s * np.maximum(time_s, np.finfo(float).tiny))
    return scipy.special.erfc(depth_m / reach)


def _circuits(settings: Any) -> dict[str, FeedbackCircuit]:
    key = f"{NAME}.circuits"
    named = mapping(key, settings)
    refuse(not named, f"{key} is empty: give a mapping of circuits by name.")
    return {name: _circuit(f"{key}.{name}", each) for name, each in named.items()}


def _circuit(key: str, settings: Any) -> FeedbackCircuit:
    node = mapping(key, settings, "a mapping of resistance_ohm and capacitance_F")
    resistance, wanted = node.get("resistance_ohm"), "a positive resistance in ohm, or null"
    if resistance is not None:
        resistance = number(f"{key}.resistance_ohm", resistance, wanted, above=0)
    wanted = "a positive capacitance in F"
    capacitance = number(f"{key}.capacitance_F", node.get("capacitance_F"), wanted, above=0)
    return FeedbackCircuit(np.inf if resistance is None else resistance, capacitance)


def _outputs(
    output: np.ndarray, ridge: np.ndarray, time: np.ndarray, given: Mapping[str, float]
) -> dict[str, tuple[Any, ...]]:
    """Outputs (circuit, cause, time) [V], their peaks, and when their sum exceeds the scale."""
    total, peak = output.sum(axis=1), np.abs(output).max(axis=-1)
    is_over = np.abs(total) >= given["full_scale_V"]
    first = np.where(is_over.any(axis=-1), time[is_over.argmax(axis=-1)], np.nan)
    warmest = given["full_scale_V"] / peak[:, 0] * given["surface_step_K"]
    return {
        "output": (("circuit", "cause", "time"), output, "V"),
        "total": (("circuit", "time"), total, "V"),
        "peak": (("circuit", "cause"), peak, "V", "peak_{cause}_{circuit}_V"),
        "ridge": ("circuit", ridge, "V", "peak_ridges_{circuit}_V"),
        "over_ridge": ("circuit", peak[:, 0] / ridge, "1", "warming_over_ridges_{circuit}"),
        "saturation": ("circuit", first, "s", "saturation_{circuit}_s"),
        "step_to_saturate": ("circuit", warmest, "K", "warming_to_saturate_{circuit}_K"),
    }


def _title(data: xarray.Dataset) -> str:
    ratios = data["over_ridge"].sortby(data["over_ridge"])
    names = [spoken(each) for each in ratios["circuit"].values]
    ends = [f"{significant(ratios.values[at], 2)} ({names[at]})" for at in (0, -1)]
    warm = quantity(data.attrs["surface_step_K"], "K", digits=2)
    return f"Warming by {warm} gives {ends[0]} to {ends[1]} times the signal of the ridges"


def draw_outputs(ds: xarray.Dataset) -> Figure:
    """Charge by cause, and the output of every circuit over time."""
    later = ds.isel(time=slice(1, None))
    size, total = abs(later["charge"]), abs(later["total"])
    charge = {str(c): size.sel(cause=c) for c in ds["cause"].values}
    output = {spoken(c): total.sel(circuit=c) for c in ds["circuit"].values}
    ratio = {spoken(c): total.sel(circuit=c) / ds["ridge"].sel(circuit=c)
             for c in ds["circuit"].values}  # fmt: skip
    for lines, units in ((charge, "C"), (output, "V"), (ratio, "1")):
        for line in lines.values():
            line.attrs["units"] = units
    full = plot.Mark(ds.attrs["full_scale_V"], "full scale", axis="y")
    panel = partial(plot.panel, along="time", log="xy")
    return plot.panels([
        panel(charge, quantity="charge", limits=(1e-15, None)),
        panel(output, quantity="output", limits=(1e-7, None), marks=[full]),
        panel(ratio, quantity="output over that of ridges", limits=(0.1, None),
              marks=[plot.Mark(1.0, "ridges", axis="y")]),
    ], legend="beside")  # fmt: skip
