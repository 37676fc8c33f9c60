"""The paper's Fig. 12: ridges 6.5 um high, their signal and noise, and detection by averaging."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.effects import add_effects
from srsinv.errors import number, refuse, whole
from srsinv.forward.film import Film
from srsinv.forward.noise import Noise, with_noise
from srsinv.forward.pitched import PitchedScan, PitchWaves
from srsinv.grid import Periodic
from srsinv.inverse import detection
from srsinv.inverse import wave_detection as waves
from srsinv.report.plot.style import GREY, PALETTE, TRUTH
from srsinv.report.result import Result, dataset, scalars
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity, quantity_with_error

PAPER_M = {"6.5um": 6.5e-6, "0.65um": 0.65e-6}  # measured; and expected to be measurable
STATED = ("ridges", "blind_strip_width_m", "false_alarm", "detection", "peak_over_noise",
          "sample_rate_hz")  # settings that the page names  # fmt: skip
HERE = {"color": PALETTE[1], "linestyle": ":"}
SHOWN_RAW, SHOWN_SMOOTH = 5, 15  # ridges of the noisy trace, and of the smoothed one


Settings = Mapping[str, Any]


def _checked(given: Settings) -> Settings:
    """`fig12_ridges` of the configuration, with the heights tried. Raises `BadInput` for too few
    ridges or heights, and what is not positive; the rate is checked against the scan."""
    return {
        **given,
        "ridges": whole("fig12_ridges.ridges", given["ridges"], "a whole number from 5", least=5),
        "heights_m": _heights(given),
        "pressures_Pa": _pressures(given["pressures_Pa"]),
    }


def _heights(given: Mapping[str, Any]) -> np.ndarray:
    name, wanted = "fig12_ridges.height_range_m", "[least, greatest], positive and increasing"
    low, high = given["height_range_m"]
    low = number(name, low, wanted, above=0)
    number(name, high, wanted, above=low)
    wanted = "a whole number from 3"
    return np.geomspace(low, high, whole("fig12_ridges.heights", given["heights"], wanted, least=3))


def _pressures(given: list) -> np.ndarray:
    wanted = "a list of positive pressures in Pa"
    refuse(not given, f"fig12_ridges.pressures_Pa is empty: give {wanted}.")
    return np.array([number("fig12_ridges.pressures_Pa", p, wanted, above=0) for p in given], float)


class Simulated(NamedTuple):
    """The ridges' signal at the samples `x` (sample,), its `data` with noise [V], and the noise's
    `power`; the amplitude [V] of the wave at the pitch over the heights and pressures tried. The
    last of `solved` is the scene itself, the two before it give the load that closes the gap."""

    x: np.ndarray
    signal: np.ndarray
    power: np.ndarray
    data: np.ndarray
    by_height: np.ndarray
    by_pressure: np.ndarray
    solved: PitchWaves


def run(cfg: config.Config) -> Result:
    """The pitch from a noisy signal, and the signal's amplitude against the paper's statements.

    Raises `BadInput` for another surface than ridges, a window that does not hold whole pitches,
    and more than one film element.
    """
    settings = _checked(cfg["fig12_ridges"])
    needed = detection.needed_wave(settings["false_alarm"], settings["detection"])
    with config.precision(cfg):
        parts = config.line(cfg), config.scene(cfg), config.sensor(cfg), config.scan(cfg)
        scan = PitchedScan.checked(*parts)
        blind = partial(dataclasses.replace, width_m=settings["blind_strip_width_m"])
        without = config.ideal(cfg).with_films(blind)
        wide = add_effects(without, config.sensor_effects(cfg)).sensor.elements[0]
        given = _simulated(settings, scan, wide, config.noises(cfg), config.random_key(cfg))
    variables, numbers = _limits(settings, scan, given, needed)
    numbers |= _pitch(settings, scan, given, numbers)
    film, per_m = scan.sensor.elements[0], variables.pop("per_m")
    data = dataset(
        variables | scalars(numbers),
        {"x": (np.asarray(scan.line.x), "m"), "position": (given.x, "m"),
         "frequency": (float(scan.scan.speed_m_per_s) * per_m, "Hz"),
         "ridge_height": (settings["heights_m"], "m"),
         "nominal_pressure": (settings["pressures_Pa"], "Pa"),
         "averaging_length": (_counts(settings) * scan.pitch_m, "m")},
        height_m=float(scan.ridges.height_m), pitch_m=scan.pitch_m,
        nominal_Pa=float(scan.scene.nominal_pressure_Pa), skin=scan.scene.skin.words,
        friction=float(scan.scene.surface.base_friction), depth_m=float(film.depth_m),
        strips=int(film.strips), strip_width_m=float(film.width_m),
        speed_m_per_s=float(scan.scan.speed_m_per_s),
        noise=", ".join(cfg["noise"]), effects_on=listed(cfg["effects"]), seed=str(cfg["seed"]),
        **{name: settings[name] for name in STATED},
    )  # fmt: skip
    high = quantity(data.attrs["height_m"], "m", digits=2)
    read = quantity_with_error(numbers["pitch_m"], numbers["pitch_m_stderr"], "m")
    title = f"Pitch of {settings['ridges']} ridges {high} high: {read}, by a signal of "
    title += f"{numbers['snr_per_sample']:.2g} of the noise in a sample"
    return Result(title, data, sections(__file__, signal=draw_signal, size=draw_size))


def _simulated(
    settings: Settings, scan: PitchedScan, wide: Film, noises: tuple[Noise, ...], key
) -> Simulated:
    samples, load = _samples(settings, scan), float(scan.scene.nominal_pressure_Pa)
    height, heights = float(scan.ridges.height_m), settings["heights_m"]
    solved = scan.waves(wide, [
        *((each, load) for each in heights),
        *((height, each) for each in settings["pressures_Pa"]),
        *scan.touch_points,
        (height, load),
    ])  # fmt: skip
    signal = scan.signal(solved.pressure[-1], samples.x)
    data, power, _ = with_noise(noises, samples, scan.scan, signal, key)
    refuse(not bool(jnp.all(power > 0)), "There is no noise: give noise=[johnson].")
    tried = np.split(solved.amplitude[:-3, 0], [heights.size])
    arrays = (np.asarray(each) for each in (samples.x, signal[0], power, data[0], *tried))
    return Simulated(*arrays, solved=solved)


def _samples(settings: Settings, scan: PitchedScan) -> Periodic:
    """The samples' positions, over whole ridges."""
    speed = float(scan.scan.speed_m_per_s)
    wanted = "a number in Hz that makes at least four samples for each ridge"
    rate = number("fig12_ridges.sample_rate_hz", settings["sample_rate_hz"], wanted,
                  least=4 * speed / scan.pitch_m)  # fmt: skip
    return Periodic(round(settings["ridges"] * scan.pitch_m * rate / speed), speed / rate, 0.0)


def _counts(settings: Settings) -> np.ndarray:
    """Numbers of ridges averaged over."""
    return np.geomspace(1, settings["most_ridges"], 121)


def _limits(
    settings: Settings, scan: PitchedScan, given: Simulated, needed: float
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The contact, the signal in its noise and the least height detected, with numbers of them."""
    pitch, step = scan.pitch_m, given.x[1] - given.x[0]
    per_ridge = settings["sample_rate_hz"] * pitch / float(scan.scan.speed_m_per_s)
    at = np.fft.rfftfreq(given.x.size, step)
    noise = float(np.sqrt(np.interp(1 / pitch, at, given.power)))  # white, as strong as there
    counts = _counts(settings)
    least = waves.inverse_of_rising(
        waves.detectable_amplitude(needed, noise, counts * per_ridge),
        given.by_height, settings["heights_m"],
    )  # fmt: skip
    per_m, amplitude, chance = waves.wave_spectrum(
        given.x, given.data, given.power, pitch, settings["false_alarm"]
    )
    variables = {
        "per_m": per_m,
        "height": ("x", np.asarray(scan.scene.surface.height(scan.line)), "m"),
        "gap": ("x", given.solved.gap[-1], "m"),
        "pressure": ("x", given.solved.pressure[-1], "Pa"),
        "signal": ("position", given.signal, "V"),
        "data": ("position", given.data, "V"),
        "data_in_band": ("position", waves.low_passed(given.data, 2 / per_ridge), "V"),
        "data_amplitude": ("frequency", amplitude, "V"),
        "amplitude_by_chance": ("frequency", chance, "V"),
        "amplitude_by_height": ("ridge_height", given.by_height, "V"),
        "amplitude_by_pressure": ("nominal_pressure", given.by_pressure, "V"),
        "least_height": ("averaging_length", least, "m"),
    }
    numbers = {"noise_at_pitch_V": noise, "strength_needed": needed}
    numbers["least_height_over_scan_m"] = float(np.interp(settings["ridges"], counts, least))
    for name, height in PAPER_M.items():
        size = np.interp(height, settings["heights_m"], given.by_height)
        samples = waves.samples_to_detect(needed, noise, size)
        numbers[f"averaging_length_{name}_m"] = float(pitch / per_ridge * samples)
    return variables, numbers


def _pitch(
    settings: Settings, scan: PitchedScan, given: Simulated, known: Mapping[str, float]
) -> dict[str, Any]:
    """Numbers of the pitch, of the signal over the noise, and of the contact."""
    pitch, amplitude, level = (
        scan.pitch_m,
        float(given.solved.amplitude[-1, 0]),
        known["noise_at_pitch_V"],
    )
    tone_hz = float(scan.scan.speed_m_per_s) / pitch
    per_ridge, (low, high) = settings["sample_rate_hz"] / tone_hz, settings["pitch_range_m"]
    fitted = waves.averaged_pitch(given.x, given.data, per_ridge, (low, high))
    noise = float(np.sqrt(np.mean(given.power)))
    in_band = level * float(np.sqrt(4 * tone_hz / settings["sample_rate_hz"]))
    rms = amplitude / float(np.sqrt(2))
    return {
        "pitch_m": float(fitted.pitch_m),
        "pitch_m_stderr": float(fitted.stderr_m),
        "pitch_m_stderr_bound": waves.pitch_stderr_bound(given.x, pitch, amplitude, level),
        "pitch_error": float(fitted.pitch_m / pitch - 1),
        "amplitude_V": amplitude,
        "amplitude_blind_strip_V": float(given.solved.amplitude[-1, 1]),
        "amplitude_most_V": float(given.by_pressure.max()),
        "amplitude_most_at_Pa": float(settings["pressures_Pa"][given.by_pressure.argmax()]),
        "noise_rms_V": noise,
        "noise_rms_in_band_V": in_band,
        "band_hz": 2 * tone_hz,
        "snr_per_sample": rms / noise,
        "snr_in_band": rms / in_band,
        "strength_over_scan": rms / level * float(np.sqrt(given.x.size)),
        "snr_shortfall": settings["peak_over_noise"] * noise / amplitude,
        "snr_shortfall_in_band": settings["peak_over_noise"] * in_band / amplitude,
        "load_to_touch_between_N_per_m": scan.touch_load(given.solved.gap[-3:-1]),
        "load_to_touch_between_closed_form_N_per_m": scan.touch_load_closed_form,
        "load_per_ridge_N_per_m": float(scan.scene.nominal_pressure_Pa) * pitch,
        "contact_converged": given.solved.converged,
    }


def draw_signal(ds: xarray.Dataset) -> Figure:
    """The signal in its noise, the same after a low-pass filter, and the amplitude of each wave."""
    up, pitch = plot.PanelAxis("signal", "V"), ds.attrs["pitch_m"]
    band = f"{float(ds['band_hz']):.3g} Hz"
    parts = []
    for name, ridges, title in (
        ("data", SHOWN_RAW, "Whole band"),
        ("data_in_band", SHOWN_SMOOTH, f"Up to {band}"),
    ):
        near = ds.sel(position=slice(0, ridges * pitch))
        curves = [
            plot.Curve(near[name].values, "with noise", look={"color": GREY, "linewidth": 0.8}),
            plot.Curve(near["signal"].values, "without noise", look={"color": PALETTE[1]}),
        ]
        along = plot.PanelAxis("position", "m", limits=(0, ridges * pitch))
        parts.append(plot.Panel(curves, along, up, near["position"].values, title))
    of_waves = [
        plot.Curve(ds["data_amplitude"].values, "with noise", look={"color": GREY}),
        plot.Curve(ds["amplitude_by_chance"].values, "reached by chance",
                   look={"color": TRUTH, "linestyle": "--"}),
    ]  # fmt: skip
    marks = [plot.Mark(float(ds["band_hz"]) / 2, "pitch", look=HERE)]
    frequency, amplitude = (
        plot.PanelAxis("frequency", "Hz"),
        plot.PanelAxis("amplitude", "V", limits=(0, None)),
    )
    parts.append(
        plot.Panel(of_waves, frequency, amplitude, ds["frequency"].values, "Each wave", marks)
    )
    return plot.panels(parts)


def draw_size(ds: xarray.Dataset) -> Figure:
    """The signal's amplitude at the pitch over the height and over the nominal pressure."""
    height, size = ds["ridge_height"].values, ds["amplitude_by_height"].values
    up = plot.PanelAxis("amplitude", "V", is_log=True)
    by_height = [
        plot.Curve(size, "by contact", look={"color": PALETTE[0]}),
        plot.Curve(size[0] / height[0] * height, "linear", look={"color": GREY, "linestyle": "--"}),
    ]
    marks = [plot.Mark(each, look=HERE) for each in PAPER_M.values()]
    pressure = plot.PanelAxis("nominal pressure", "Pa", is_log=True)
    by_pressure = ds["amplitude_by_pressure"].values
    look = {"color": PALETTE[0], "marker": "o", "markersize": 4}
    return plot.panels([[
        plot.Panel(by_height, plot.PanelAxis("ridge height", "m", is_log=True), up, height,
                   f"At {quantity(ds.attrs['nominal_Pa'], 'Pa', digits=2)}", marks),
        plot.Panel([plot.Curve(by_pressure, "by contact", look=look)], pressure,
                   plot.PanelAxis("amplitude at one height", "V", limits=(0, None)),
                   ds["nominal_pressure"].values,
                   f"At {quantity(ds.attrs['height_m'], 'm', digits=2)}",
                   [plot.Mark(ds.attrs["nominal_Pa"], look=HERE)]),
    ]], height_in=3.0)  # fmt: skip
