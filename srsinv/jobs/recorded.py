"""A recording as the jobs want it: even samples, its sensor, its motion and its white noise."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import choice, mapping, number, refuse, shown
from ..forward.describe import elements
from ..forward.film import LineEffect
from ..forward.noise import Noise, SignalToNoise
from ..forward.scan import ConstantSpeed, Motion
from ..forward.sensor import Sensor
from ..forward.setup import Setup
from ..inverse.surface_model import Window
from ..recording import Recording, load, merge
from . import build

STEADY = 1e-3  # how far a speed may stray from its mean and still be taken as constant
JITTER = 0.2  # of the sampling interval: beyond it there is a gap
ROUNDED = 0.25  # of an interval: time stamps nearer to even ones than this are only rounded
ABOVE_CUTOFF = 12.0  # k z beyond which e^(-k z) < 1e-5: noise only
OF_A_JOB = ("cell_m",)  # keys of `recording` that say nothing about the file
MARGIN_DEPTHS = 8  # how far beyond the scan's ends the traction can still be felt
SKIN = {"poisson_ratio": 0.5, "youngs_modulus_Pa": 7e5}  # where neither sidecar nor command says
MOTION = {
    "sample_rate_hz": "a positive number in Hz",
    "speed_m_per_s": "a speed in m/s",
    "scan_start_m": "a position in metres",
}


def load_steady(settings: Any, known: Mapping[str, Any]) -> Recording:
    """[`load_even`][] for what takes the speed as constant: raises `BadInput` where it varies."""
    recording = load_even(settings, known)
    refuse(
        not recording.is_constant_speed(STEADY),
        f"{recording.name}: the speed varies by more than {STEADY:.1%} of its mean, and this job "
        "takes it as constant: give recording.speed_m_per_s=... to do so all the same.",
    )
    return recording


def load_even(settings: Any, known: Mapping[str, Any]) -> Recording:
    """The recording that `settings`, the configuration's `recording`, names, at even times.

    `known` are further facts of the command line, beside the sidecar's. Raises `BadInput` for a
    file that cannot be read, a speed that is 0 throughout, and uneven times.
    """
    named = mapping("recording", settings)
    facts = {key: value for key, value in named.items() if key not in OF_A_JOB}
    path, missing = facts.pop("path", None), facts.pop("missing", "refuse")
    refuse(path is None, "No recording is named: give recording.path=FILE.")
    for key, file in (("path", path), ("sidecar", facts.get("sidecar"))):
        refuse(
            file is not None and not isinstance(file, str | os.PathLike),
            f"recording.{key} is {shown(file)}: give the name of a file.",
        )
    for key, wanted in MOTION.items():
        if (given := facts.get(key)) is not None:
            number(f"recording.{key}", given, wanted)
    choice("recording.missing", missing, ("refuse", "allow"))
    recording = load(path, missing=missing, **_given(facts | dict(known)))
    refuse(
        not np.any(recording.speed_m_per_s),
        f"{recording.name}: the speed is 0, so no surface passes the sensor: give "
        "recording.speed_m_per_s=... in m/s.",
    )
    jitter = recording.sampling_jitter
    refuse(
        jitter > JITTER,
        f"{recording.name}: the sampling interval varies by {jitter:.0%}, more than {JITTER:.0%}: "
        "give recording.sample_rate_hz=... or cut the recording at the gap.",
    )
    return _uniform(recording)


def _uniform(recording: Recording) -> Recording:
    """The recording at even times.

    Stamps that are off by less than a quarter of an interval are only rounded, and are replaced:
    interpolating would colour the noise, which the rules take as white. Else the signal is
    interpolated.
    """
    time_s = recording.time_s
    even = np.linspace(time_s[0], time_s[-1], time_s.size)
    if np.max(np.abs(time_s - even)) < ROUNDED / recording.sample_rate_hz:
        return replace(recording, time_s=even)
    return recording.resample_uniform()


def _given(known: dict[str, Any]) -> dict[str, Any]:
    """What the command line gives, in depth: null means not given."""
    trimmed = {k: _given(v) if isinstance(v, dict) else v for k, v in known.items()}
    return {k: v for k, v in trimmed.items() if v is not None and v != {}}


def elements_named(cfg: build.Config) -> dict[str, Any]:
    """The film elements that the configuration names, as a fact beside the sidecar's."""
    return {"sensor": {"elements": build.part(cfg, "sensor").get("elements")}}


def sensor_of(cfg: build.Config, recording: Recording, also: Sequence[LineEffect] = ()) -> Sensor:
    """The sensor that the sidecar and the configuration describe; what is configured wins.

    `also`: effects that every element gets. Raises `BadInput` for what is missing, and where there
    are not as many elements as signal columns.
    """
    facts = recording.sidecar
    description = merge(facts.get("sensor") or {}, build.part(cfg, "sensor"))
    films = elements(description)
    refuse(
        len(films) != len(recording.channels),
        f"{recording.name}: {len(recording.channels)} signal columns but {len(films)} film "
        "elements: name as many in recording.channels as the sensor has elements.",
    )
    skin = build.make(merge(SKIN | _skin(facts), build.part(cfg, "skin")), "skin", "skin")
    bare = Sensor(films, skin, build.amplifier(amplifier_node(cfg, description)))
    speed = ConstantSpeed(float(np.mean(recording.speed_m_per_s)))
    felt = build.with_effects(cfg, Setup(None, bare, speed))
    for effect in also:
        felt = felt.with_films(lambda film, effect=effect: film.with_effect(effect))
    return felt.sensor


def _skin(facts: dict[str, Any]) -> dict[str, Any]:
    skin = facts.get("skin") or {}
    model = skin.get("model", "half_space")
    refuse(
        model != "half_space",
        f"The sidecar's skin.model is {model!r}: only half_space is known here.",
    )
    return {key: skin[key] for key in SKIN.keys() & skin.keys()}


def amplifier_node(cfg: build.Config, description: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration's `amplifier`, its resistor from the sensor's description where null."""
    resistance = description.get("feedback_resistance_ohm")
    node = dict(build.part(cfg, "amplifier"))
    if node.get("feedback_resistance_ohm", 0) is None:
        node["feedback_resistance_ohm"] = resistance
    return {"amplifier": node}


def check_cells(name: str, length_m: float, cell_m: float) -> None:
    """Refuse a line that no machine holds: something is in another unit than it is taken to be."""
    cells = length_m / cell_m
    refuse(
        not cells <= build.MOST_CELLS,
        f"{name}: the {length_m:.4g} m in cells of {cell_m:.4g} m are {cells:.4g} cells, more than "
        f"{build.MOST_CELLS}: check recording.speed_m_per_s, recording.sample_rate_hz, "
        "sensor.depth_m and recording.contact_window_m, and their units.",
    )


def motion_of(recording: Recording) -> Motion:
    """How the sensor moved: along the measured positions, else by the integral of the speed."""
    time_s, speed = recording.time_s, recording.speed_m_per_s
    if recording.measured_position_m is not None:
        return Motion(time_s, recording.measured_position_m, speed)
    return Motion.from_speed(time_s, speed, float(recording.position_m[0]))


def nominal_pressure(recording: Recording) -> float | None:
    """The mean pressure over the contact window [Pa], where it is known."""
    given = recording.sidecar.get("nominal_pressure_Pa")
    wanted = "a pressure in Pa that is at least 0, or null where it is not known"
    key = f"{recording.name}: nominal_pressure_Pa"
    return None if given is None else float(number(key, given, wanted, least=0))


def contact_window(facts: Mapping[str, Any], position_m, depth_m: float) -> Window:
    """What the surface repeats with: as known, else the scan and a margin beyond its ends."""
    given = facts.get("contact_window_m")
    if given:
        return Window(float(given[0]), float(given[1]))
    margin = MARGIN_DEPTHS * depth_m
    return Window(float(np.min(position_m)) - margin, float(np.max(position_m)) + margin)


def coloured_noises(cfg: build.Config) -> tuple[Noise, ...]:
    """The named causes of noise but the white one, which the recording itself shows."""
    others = {name: node for name, node in build.part(cfg, "noise").items() if name != "white"}
    noises = build.noises({"noise": others})
    for noise in noises:
        refuse(
            isinstance(noise, SignalToNoise),
            "noise=snr has no meaning for a recording: use noise=white (noise.white.rms, or null "
            "to take it from the recording).",
        )
    return noises


def white_rms(cfg: build.Config, recording: Recording, depth: float, spacing: float) -> float:
    """The white noise per sample: given, or the level where the skin lets nothing through.

    The median of the periodogram over the upper wavenumbers, which a few lines do not move.
    """
    white = build.part(build.part(cfg, "noise"), "white")
    if (given := white.get("rms")) is not None:
        wanted = "a positive number in the signal's unit, or null to take it from the recording"
        return float(number("noise.white.rms", given, wanted, above=0))
    signal = np.nan_to_num(recording.signal)
    n = signal.shape[-1]
    taper = np.hanning(n)
    slope = np.linspace(-1, 1, n)
    left = signal - signal.mean(axis=-1, keepdims=True)
    left = left - (left @ slope / (slope @ slope))[:, None] * slope
    power = np.abs(np.fft.rfft(left * taper)) ** 2 / np.sum(taper**2)
    k = 2 * np.pi * np.fft.rfftfreq(n, spacing)
    noise_only = k > min(ABOVE_CUTOFF / depth, 0.75 * k[-1])
    level = np.median(power[:, noise_only]) / np.log(2)
    refuse(
        not level > 0,
        f"{recording.name}: no noise can be told from the signal (it is constant, or rounded): "
        "give noise.white.rms=... in the signal's unit.",
    )
    return float(np.sqrt(level))
