"""Section IV-A of the paper: the signal of a vibrating edge at one place over its frequency."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray
from jaxtyping import Array
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.effects import Order
from srsinv.errors import choice, number, number_range, refuse, shown, whole
from srsinv.forward.indentation import Indentation, has_indentation, relative_modulus
from srsinv.forward.knife_edge import KnifeEdge, VibratingEdge, contact_modulus_Pa
from srsinv.forward.scenario import Scenario
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import PERIOD_SAMPLES, apparent_frequency_hz, measured, readout
from srsinv.report.plot.style import GREY, TRUTH
from srsinv.report.result import Result, dataset, scalars
from srsinv.report.section import sections
from srsinv.report.text import listed

NAME = "frequency_response"
IDEAL, AVERAGED, ALL = "nothing named", "averaging", "all named"
AVERAGING = (AVERAGED, ALL)
OF_TIME = (Order.ELECTRONICS, Order.RECORD)
LOAD = "load"
PALE = "#b9c1c8"
STEEPEST_DB = -30.0  # that the figure of slopes goes down to
POWERS = {"displacement": 0, "velocity": 1, "acceleration": 2}  # of w, over the displacement's
NEEDED = {
    "one derivative": "nothing: the model",
    "displacement": "an edge that follows the shaker, on this skin",
    "AC coupling": "a high-pass behind the amplifier, its corner above the band",
    "growing load": "a load that grows with the frequency by itself",
    "power": "20 log10 of a power, which doubles the decibels",
}


def run(cfg: config.Config) -> Result:
    """Amplitude, slope and phase of the signal over frequency, for each effect in time and all.

    Raises `BadInput` for a sensor that has not one element, a displacement on a skin where none is
    defined, and refusals of the configuration's parts.
    """
    given = _checked(cfg[NAME])
    frequency = given["frequency_hz"]
    with config.precision(cfg):
        cases = _cases({n: e.order for n, e in config.effects(cfg).items()}, given["averaged_s"])
        scenarios = {
            case: config.at_rest(config.select_effects(cfg, names)) for case, names in cases.items()
        }
        sensor, rate = scenarios[IDEAL].sensor, scenarios[ALL].recorder.sample_rate_hz
        sensor.require_elements(1)
        loads = given["preload_N_per_m"], given["amplitude_N_per_m"]
        charge = VibratingEdge(given["edge"], *loads).small_charge(sensor, given["place_m"]).item()
        key = config.random_key(cfg)
        signal = {
            case: _swept(each, charge, given, key, given["averaged_s"] * (case in AVERAGING))
            for case, each in scenarios.items()
        }
        drives, extra = _drives(sensor, charge, given), _numbers(sensor, given)

    apparent = apparent_frequency_hz(frequency, rate) if rate else frequency
    data = dataset(
        {
            **_curves("case", signal, frequency, sensor.amplifier.unit),
            **_curves("drive", drives, frequency, sensor.amplifier.unit, "drive_"),
            "apparent_frequency": ("frequency", apparent, "Hz"),
            **_explanations(drives, given),
            **scalars(extra),
        },
        {"frequency": (frequency, "Hz"), "case": (list(signal), "1"), "drive": (list(drives), "1"),
         "explanation": (list(NEEDED), "1")},
        effects_on=listed(cfg["effects"]), noise=listed(config.part(cfg, "noise")),
        skin=sensor.skin.sliding_at(0.0).words, sampling_hz=rate or 0.0,
        **{key: value for key, value in given.items() if np.isscalar(value)},
    )  # fmt: skip
    return Result(_title(data), data, sections(__file__, cases=draw_cases, drives=draw_drives))


def _cases(orders: Mapping[str, Order], averaged_s: float) -> dict[str, set[str]]:
    """The effects of each case: of film and skin, with none, each and all of those in time."""
    of_time = [name for name, order in orders.items() if order in OF_TIME]
    always = set(orders) - set(of_time)
    alone = {name: always | {name} for name in of_time}
    averaged = {AVERAGED: always} if averaged_s else {}
    return {IDEAL: always, **alone, **averaged, ALL: set(orders)}


def _checked(settings: Any) -> dict[str, Any]:
    """The settings within their bounds, the frequencies and the edge."""
    given = dict(settings)
    wanted = "two positive frequencies in Hz"
    ends = number_range(f"{NAME}.frequency_range_hz", given["frequency_range_hz"], wanted, above=0)
    wanted = "a whole number from 3 to 2000"
    count = whole(f"{NAME}.frequencies", given["frequencies"], wanted, least=3, most=2000)
    given["frequency_hz"] = np.geomspace(*ends, count)
    number(f"{NAME}.place_m", given["place_m"], "a position in metres")
    whole(
        f"{NAME}.periods", given["periods"], "a whole number from 1 to 10000", least=1, most=10000
    )
    given["averaged_s"] = given["averaged_s"] or 0.0
    number(f"{NAME}.averaged_s", given["averaged_s"], "a time in seconds, or null", least=0)
    for key in ("coupling_hz", "density_kg_per_m3"):
        number(f"{NAME}.{key}", given[key], "a positive number, in SI units", above=0)
    drives = given["drives"]
    refuse(
        not (drives is None or isinstance(drives, list)),
        f"{NAME}.drives is {shown(drives)}: give a list of {', '.join((LOAD, *POWERS))}, or null.",
    )
    for each in drives or ():
        choice(f"{NAME}.drives", each, (LOAD, *POWERS))
    wanted, direction = "an angle from -90 to 90 degrees", given["direction_deg"]
    number(f"{NAME}.direction_deg", direction, wanted, least=-90, most=90)
    given["edge"] = KnifeEdge(given["radius_m"], np.deg2rad(direction))
    return given


def _swept(
    scenario: Scenario, charge: float, given: Mapping[str, Any], key: Array, averaged_s: float
) -> np.ndarray:
    """Complex amplitude of the recorded signal (frequency,)."""
    wave = charge * np.sin(2 * np.pi * np.arange(PERIOD_SAMPLES) / PERIOD_SAMPLES)[None]
    return np.array([
        measured(scenario, wave, float(each), given["periods"], key, averaged_s)[0]
        for each in given["frequency_hz"]
    ])  # fmt: skip


def _drives(sensor: Sensor, charge: float, given: Mapping[str, Any]) -> dict[str, np.ndarray]:
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


def _numbers(sensor: Sensor, given: Mapping[str, Any]) -> dict[str, float | None]:
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


def _curves(
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


def _explanations(drives: dict[str, np.ndarray], given: Mapping[str, Any]) -> dict[str, Any]:
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


def _title(data: xarray.Dataset) -> str:
    mean, phase = (data[name].sel(case=IDEAL).item() for name in ("mean_slope", "first_phase"))
    ahead = f"{round(phase) + 0:g}° ahead of the load"
    title = f"The signal rises by {round(mean, 2) + 0.0:.2f} dB per octave, {ahead}"
    named, last = (data[name].sel(case=ALL).item() for name in ("mean_slope", "last_phase"))
    if data.sizes["case"] == 2 or not np.isfinite(named):  # nothing is named, or nothing is left
        return title
    return f"{title}; with the electronics named by {named:.2f}, at {last:.0f}° in the end"


def draw_cases(ds: xarray.Dataset) -> Figure:
    """Amplitude, slope and phase over frequency of every case, and where samples show the wave."""

    def one(name: str, quantity: str, **settings: Any) -> plot.Panel:
        lines = {str(case).replace("_", " "): ds[name].sel(case=case) for case in ds["case"].values}
        looks = {IDEAL: {"color": PALE, "linewidth": 4}, ALL: {"color": TRUTH, "linestyle": "--"}}
        return plot.panel(lines, looks=looks, quantity=quantity, along="frequency", **settings)

    apparent = plot.panel(
        {"": ds["apparent_frequency"]}, looks={"": {"color": GREY}}, log="xy",
        quantity="frequency in samples", along="frequency",
    )  # fmt: skip
    is_folded = bool(np.any(ds["apparent_frequency"].values != ds["frequency"].values))
    return plot.panels([
        one("amplitude", "amplitude", log="xy"),
        one("slope", "slope per octave", log="x", limits=(STEEPEST_DB, -STEEPEST_DB / 2)),
        one("phase", "phase from the load", log="x"),
        *([apparent] if is_folded else []),
    ])  # fmt: skip


def draw_drives(ds: xarray.Dataset) -> Figure:
    """Amplitude and slope of the ideal signal, by what the shaker holds constant."""

    def one(name: str, quantity: str, log: str) -> plot.Panel:
        lines = {f"constant {each}": ds[name].sel(drive=each) for each in ds["drive"].values}
        return plot.panel(lines, quantity=quantity, along="frequency", log=log)

    return plot.panels([
        one("drive_amplitude", "amplitude", "xy"), one("drive_slope", "slope per octave", "x")
    ])  # fmt: skip
