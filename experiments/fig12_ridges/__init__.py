"""The paper's Fig. 12: ridges 6.5 um high, their signal and noise, and detection by averaging."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.effects import add_effects
from srsinv.errors import number, number_range, refuse, whole
from srsinv.inverse.detection import needed_wave
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity, quantity_with_error

from . import waves
from .figures import PAPER_M, draw_signal, draw_size
from .pitched import PitchedScan, PitchRecord, PitchSweep

STATED = ("ridges", "blind_strip_width_m", "false_alarm", "detection", "peak_over_noise",
          "sample_rate_hz")  # settings that the page names  # fmt: skip
Settings = Mapping[str, Any]


def run(cfg: config.Config) -> Result:
    """The pitch from a noisy signal, and the signal's amplitude against the paper's statements.

    Raises `BadInput` for another surface than ridges, a window that does not hold whole pitches,
    more than one film element, too few ridges or heights, and what is not positive.
    """
    given = cfg["fig12_ridges"]
    ridges, heights, pressures = _ranges(given)
    needed = needed_wave(given["false_alarm"], given["detection"])
    with config.precision(cfg):
        parts = config.line(cfg), config.scene(cfg), config.sensor(cfg), config.scan(cfg)
        scan = PitchedScan.checked(*parts)
        wanted = "a number in Hz that makes at least four samples for each ridge"
        rate = number("fig12_ridges.sample_rate_hz", given["sample_rate_hz"], wanted,
                      least=4 * scan.frequency_hz)  # fmt: skip
        blind = partial(dataclasses.replace, width_m=given["blind_strip_width_m"])
        wide = add_effects(config.ideal(cfg).with_films(blind), config.sensor_effects(cfg))
        solved = scan.sweep(heights, pressures, wide.sensor.elements[0])
        noise = config.noises(cfg), config.random_key(cfg)
        record = scan.record(solved.pressure, ridges, rate, *noise)

    data = dataset(
        {
            "height": ("x", np.asarray(scan.scene.surface.height(scan.line)), "m"),
            "gap": ("x", solved.gap, "m"),
            "pressure": ("x", solved.pressure, "Pa"),
            "amplitude_by_height": ("ridge_height", solved.by_height, "V"),
            "amplitude_by_pressure": ("nominal_pressure", solved.by_pressure, "V"),
        },
        {"x": (np.asarray(scan.line.x), "m"), "ridge_height": (heights, "m"),
         "nominal_pressure": (pressures, "Pa")},
        noise=", ".join(cfg["noise"]), effects_on=listed(cfg["effects"]), seed=str(cfg["seed"]),
        **scan.facts, **{name: given[name] for name in STATED},
    )  # fmt: skip
    data = data.merge(_signal(given, scan, solved, record))
    data = data.merge(_averaged(given, needed, data, record.per_pitch))
    shown = sections(__file__, signal=draw_signal, size=draw_size)
    return Result(_title(data), data, shown)


def _title(data: xarray.Dataset) -> str:
    read = quantity_with_error(float(data["pitch_m"]), float(data["pitch_m_stderr"]), "m")
    ridges = f"{data.attrs['ridges']} ridges {quantity(data.attrs['height_m'], 'm', digits=2)} high"
    snr = f"{float(data['snr_per_sample']):.2g}"
    return f"The pitch of {ridges} is {read}, at a signal of {snr} times the noise per sample"


def _ranges(given: Settings) -> tuple[int, np.ndarray, np.ndarray]:
    """The number of ridges, and the heights and nominal pressures tried."""
    wanted = "a whole number from {}".format
    ridges = whole("fig12_ridges.ridges", given["ridges"], wanted(5), least=5)
    name, in_order = "fig12_ridges.height_range_m", "[least, greatest], positive and increasing"
    low, high = number_range(name, given["height_range_m"], in_order, above=0)
    wanted_range = "positive lengths in metres"
    number_range("fig12_ridges.pitch_range_m", given["pitch_range_m"], wanted_range, above=0)
    whole("fig12_ridges.most_ridges", given["most_ridges"], wanted(1), least=1)
    count = whole("fig12_ridges.heights", given["heights"], wanted(3), least=3)
    name, positive = "fig12_ridges.pressures_Pa", "a list of positive pressures in Pa"
    refuse(not given["pressures_Pa"], f"{name} is empty: give {positive}.")
    pressures = [number(name, each, positive, above=0) for each in given["pressures_Pa"]]
    return ridges, np.geomspace(low, high, count), np.array(pressures, float)


def _signal(
    given: Settings, scan: PitchedScan, solved: PitchSweep, record: PitchRecord
) -> xarray.Dataset:
    """The signal in its noise, over x and over the frequency, the pitch read from it, and numbers
    of it and of the contact."""
    x, noisy = record.x, record.data
    per_m, amplitude, chance = waves.wave_spectrum(
        x, noisy, record.power, scan.pitch_m, given["false_alarm"]
    )
    return dataset(
        {
            "signal": ("position", record.signal, "V"),
            "data": ("position", noisy, "V"),
            "data_in_band": ("position", waves.low_passed(noisy, 2 / record.per_pitch), "V"),
            "data_amplitude": ("frequency", amplitude, "V"),
            "amplitude_by_chance": ("frequency", chance, "V"),
            **scalars(_numbers(given, scan, solved, record)),
        },
        {"position": (x, "m"), "frequency": (scan.frequency_hz * scan.pitch_m * per_m, "Hz")},
    )


def _numbers(
    given: Settings, scan: PitchedScan, solved: PitchSweep, record: PitchRecord
) -> dict[str, Any]:
    """Of the pitch read, of the signal over the noise, and of the contact."""
    (low, high), size = given["pitch_range_m"], solved.amplitude
    fitted = waves.averaged_pitch(record.x, record.data, record.per_pitch, (low, high))
    wave = waves.noise_beside(record.x, record.power, scan.pitch_m, size)
    best = solved.by_pressure.argmax()
    return wave | {
        "pitch_m": float(fitted.pitch_m),
        "pitch_m_stderr": float(fitted.stderr_m),
        "pitch_error": float(fitted.pitch_m / scan.pitch_m - 1),
        "band_hz": 2 * scan.frequency_hz,
        "amplitude_V": size,
        "amplitude_blind_strip_V": solved.amplitude_other,
        "amplitude_most_V": float(solved.by_pressure[best]),
        "amplitude_most_at_Pa": float(given["pressures_Pa"][best]),
        "snr_shortfall": given["peak_over_noise"] * wave["noise_rms_V"] / size,
        "snr_shortfall_in_band": given["peak_over_noise"] * wave["noise_rms_in_band_V"] / size,
        "load_to_touch_between_N_per_m": solved.touch_load,
        "load_to_touch_between_closed_form_N_per_m": scan.touch_load_closed_form,
        "load_per_ridge_N_per_m": float(scan.scene.nominal_pressure_Pa) * scan.pitch_m,
        "contact_converged": solved.converged,
    }


def _averaged(
    given: Settings, needed: float, ds: xarray.Dataset, per_pitch: float
) -> xarray.Dataset:
    """The least height detected over the length averaged over, and what the paper's heights
    need."""
    heights, sizes = ds["ridge_height"].values, ds["amplitude_by_height"].values
    noise, pitch = float(ds["noise_at_pitch_V"]), ds.attrs["pitch_m"]
    counts = np.geomspace(1, given["most_ridges"], 121)
    least = waves.inverse_of_rising(
        waves.detectable_amplitude(needed, noise, counts * per_pitch), sizes, heights
    )
    numbers = {"strength_needed": needed}
    numbers["least_height_over_scan_m"] = float(np.interp(given["ridges"], counts, least))
    for name, height in PAPER_M.items():
        samples = waves.samples_to_detect(needed, noise, np.interp(height, heights, sizes))
        numbers[f"averaging_length_{name}_m"] = float(pitch / per_pitch * samples)
    return dataset(
        {"least_height": ("averaging_length", least, "m"), **scalars(numbers)},
        {"averaging_length": (counts * pitch, "m")},
    )
