"""Signals over frequency: as they are recorded, by what a shaker holds constant, and in numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Array

from srsinv.effects import Order
from srsinv.forward.indentation import Indentation, has_indentation, relative_modulus
from srsinv.forward.knife_edge import contact_modulus_Pa
from srsinv.forward.scenario import Scenario
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import PERIOD_SAMPLES, measured, readout

IDEAL, AVERAGED, ALL = "nothing named", "averaging", "all named"
AVERAGING = (AVERAGED, ALL)
OF_TIME = (Order.ELECTRONICS, Order.RECORD)
LOAD = "load"
POWERS = {"displacement": 0, "velocity": 1, "acceleration": 2}  # of w, over the displacement's
NEEDED = {
    "one derivative": "nothing: the model",
    "displacement": "an edge that follows the shaker, on this skin",
    "AC coupling": "a high-pass behind the amplifier, its corner above the band",
    "growing load": "a load that grows with the frequency by itself",
    "power": "20 log10 of a power, which doubles the decibels",
}


def cases(orders: Mapping[str, Order], averaged_s: float) -> dict[str, set[str]]:
    """The effects of each case: of film and skin, with none, each and all of those in time."""
    of_time = [name for name, order in orders.items() if order in OF_TIME]
    always = set(orders) - set(of_time)
    alone = {name: always | {name} for name in of_time}
    averaged = {AVERAGED: always} if averaged_s else {}
    return {IDEAL: always, **alone, **averaged, ALL: set(orders)}


def swept(
    scenario: Scenario, charge: float, given: Mapping[str, Any], key: Array, averaged_s: float
) -> np.ndarray:
    """Complex amplitude of the recorded signal (frequency,)."""
    wave = charge * np.sin(2 * np.pi * np.arange(PERIOD_SAMPLES) / PERIOD_SAMPLES)[None]
    return np.array([
        measured(scenario, wave, float(each), given["periods"], key, averaged_s)[0]
        for each in given["frequency_hz"]
    ])  # fmt: skip


def drives(sensor: Sensor, charge: float, given: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Complex amplitude of the ideal signal (frequency,) by what the shaker holds constant, all of
    the same size at the first frequency but for the skin's relaxation."""
    frequency, depth = given["frequency_hz"], float(sensor.depth_m)
    signal = {LOAD: charge * readout(sensor, frequency)}
    named = given["drives"]
    if named is None:
        named = POWERS if has_indentation(given["edge"], sensor.skin, depth) else ()
    moved = [name for name in dict.fromkeys(named) if name != LOAD]
    if moved:
        Indentation(given["edge"], sensor.skin, depth)  # refuses where none is defined
        stiffer = relative_modulus(sensor.skin, frequency, depth)
        for name in moved:
            turn = (frequency[0] / (1j * frequency)) ** POWERS[name]
            signal[name] = signal[LOAD] * stiffer * turn
    return signal


def numbers(sensor: Sensor, given: Mapping[str, Any]) -> dict[str, float | None]:
    """How far inertia would matter, and the indentation under the preload where there is one."""
    shear_Pa = contact_modulus_Pa(sensor.skin) / 4  # of an incompressible skin
    speed = np.sqrt(shear_Pa / given["density_kg_per_m3"])
    kz = 2 * np.pi * given["frequency_hz"][-1] * float(sensor.depth_m) / speed
    depth, edge = float(sensor.depth_m), given["edge"]
    is_defined = has_indentation(edge, sensor.skin, depth)
    relation = Indentation(edge, sensor.skin, depth) if is_defined else None
    load = np.array([given["preload_N_per_m"]])
    deep = None if relation is None else relation.indentation_m(load).item()
    return {"shear_wave_kz_at_last": float(kz), "preload_indentation_m": deep}


def curves(
    dim: str, signal: dict[str, np.ndarray], frequency: np.ndarray, unit: str, start: str = ""
) -> dict[str, tuple[Any, ...]]:
    """Amplitude, phase and local slope over frequency, and the mean slope over all of it."""
    values = np.stack(list(signal.values()))
    size = np.abs(values)  # 0 where all samples are of one level
    level, octave = 20 * np.log10(np.where(size > 0, size, np.nan)), np.log2(frequency)
    phase = np.rad2deg(np.unwrap(np.angle(values), axis=-1))
    label, along = f"{start}{{{dim}}}", (dim, "frequency")
    slope = np.gradient(level, octave, axis=-1)
    mean = (level[:, -1] - level[:, 0]) / (octave[-1] - octave[0])
    return {
        f"{start}amplitude": (along, size, unit),
        f"{start}phase": (along, phase, "deg"),
        f"{start}slope": (along, slope, "dB"),
        f"{start}mean_slope": (dim, mean, "dB", f"slope_{label}_dB_per_octave"),
        f"{start}greatest_slope": (
            dim,
            slope.max(-1),
            "dB",
            f"greatest_slope_{label}_dB_per_octave",
        ),
        f"{start}first_phase": (dim, phase[:, 0], "deg", f"phase_{label}_at_first_deg"),
        f"{start}last_phase": (dim, phase[:, -1], "deg", f"phase_{label}_at_last_deg"),
    }


def explanations(drives: dict[str, np.ndarray], given: Mapping[str, Any]) -> dict[str, Any]:
    """What would give which mean slope, computed where the model can."""
    frequency, octave = given["frequency_hz"], 20 * np.log10(2)
    coupled = 1j * frequency / given["coupling_hz"]
    one = _mean_slope(drives[LOAD], frequency)
    slopes = {
        "one derivative": one,
        "displacement": _mean_slope(drives.get("displacement", np.full(2, np.nan)), frequency),
        "AC coupling": _mean_slope(drives[LOAD] * coupled / (1 + coupled), frequency),
        "growing load": one + octave,
        "power": 2 * one,
    }
    values = np.array([slopes[each] for each in NEEDED])
    return {
        "explained_slope": ("explanation", values, "dB",
                            "slope_by_{explanation}_dB_per_octave"),
        "needed": ("explanation", list(NEEDED.values()), "1"),
    }  # fmt: skip


def _mean_slope(signal: np.ndarray, frequency: np.ndarray) -> float:
    level = 20 * np.log10(np.abs(signal[[0, -1]]))
    return float((level[1] - level[0]) / np.log2(frequency[-1] / frequency[0]))
