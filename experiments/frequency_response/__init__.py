"""Section IV-A of the paper: the signal of a vibrating edge at one place over its frequency."""

from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.errors import choice, echo, number, number_range, refuse, whole
from srsinv.forward.knife_edge import KnifeEdge, VibratingEdge
from srsinv.forward.vibration import apparent_frequency_hz
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed

from . import sweeps
from .figures import draw_cases, draw_drives
from .sweeps import ALL, AVERAGING, IDEAL, LOAD, NEEDED, POWERS

NAME = "frequency_response"


def run(cfg: config.Config) -> Result:
    """Amplitude, slope and phase of the signal over frequency, for each effect in time and all.

    Raises `BadInput` for a sensor that has not one element, a displacement on a skin where none is
    defined, and refusals of the configuration's parts.
    """
    given = _checked(cfg[NAME])
    frequency = given["frequency_hz"]
    with config.precision(cfg):
        cases = sweeps.cases(
            {n: e.order for n, e in config.effects(cfg).items()}, given["averaged_s"]
        )
        scenarios = {
            case: config.at_rest(config.select_effects(cfg, names)) for case, names in cases.items()
        }
        sensor, rate = scenarios[IDEAL].sensor, scenarios[ALL].recorder.sample_rate_hz
        sensor.require_elements(1)
        loads = given["preload_N_per_m"], given["amplitude_N_per_m"]
        charge = VibratingEdge(given["edge"], *loads).small_charge(sensor, given["place_m"]).item()
        key = config.random_key(cfg)
        signal = {
            case: sweeps.swept(each, charge, given, key, given["averaged_s"] * (case in AVERAGING))
            for case, each in scenarios.items()
        }
        drives, extra = sweeps.drives(sensor, charge, given), sweeps.numbers(sensor, given)

    apparent = apparent_frequency_hz(frequency, rate) if rate else frequency
    data = dataset(
        {
            **sweeps.curves("case", signal, frequency, sensor.amplifier.unit),
            **sweeps.curves("drive", drives, frequency, sensor.amplifier.unit, "drive_"),
            "apparent_frequency": ("frequency", apparent, "Hz"),
            **sweeps.explanations(drives, given),
            **scalars(extra),
        },
        {"frequency": (frequency, "Hz"), "case": (list(signal), "1"), "drive": (list(drives), "1"),
         "explanation": (list(NEEDED), "1")},
        effects_on=listed(cfg["effects"]), noise=listed(config.part(cfg, "noise")),
        skin=sensor.skin.sliding_at(0.0).words, sampling_hz=rate or 0.0,
        **{key: value for key, value in given.items() if np.isscalar(value)},
    )  # fmt: skip
    return Result(_title(data), data, sections(__file__, cases=draw_cases, drives=draw_drives))


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
        f"{NAME}.drives is {echo(drives)}: give a list of {', '.join((LOAD, *POWERS))}, or null.",
    )
    for each in drives or ():
        choice(f"{NAME}.drives", each, (LOAD, *POWERS))
    wanted, direction = "an angle from -90 to 90 degrees", given["direction_deg"]
    number(f"{NAME}.direction_deg", direction, wanted, least=-90, most=90)
    given["edge"] = KnifeEdge(given["radius_m"], np.deg2rad(direction))
    return given


def _title(data: xarray.Dataset) -> str:
    mean, phase = (data[name].sel(case=IDEAL).item() for name in ("mean_slope", "first_phase"))
    ahead = f"{round(phase) + 0:g}° ahead of the load"
    title = f"The signal rises by {round(mean, 2) + 0.0:.2f} dB per octave, {ahead}"
    named, last = (data[name].sel(case=ALL).item() for name in ("mean_slope", "last_phase"))
    if data.sizes["case"] == 2 or not np.isfinite(named):  # nothing is named, or nothing is left
        return title
    return f"{title}; with the electronics by {named:.2f} dB per octave, up to {last:.0f}°"
