"""Sensor, motion and white noise of a recording at even times."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import number, refuse
from ..forward.describe import elements
from ..forward.film import LineEffect
from ..forward.noise import Noise, SignalToNoise
from ..forward.scan import ConstantSpeed, Motion
from ..forward.scenario import Scenario
from ..forward.sensor import Sensor
from ..inverse.surface_model import Window
from ..recording import Recording, merge
from ..recording.noise import white_level
from . import build

MARGIN_DEPTHS = 8  # distance beyond the scan's ends at which traction still gives a signal
SKIN = {"poisson_ratio": 0.5, "youngs_modulus_Pa": 7e5}  # if neither sidecar nor command gives them


def elements_named(cfg: build.Config) -> dict[str, Any]:
    """The film elements that the configuration names, as a fact beside the sidecar's."""
    return {"sensor": {"elements": build.part(cfg, "sensor").get("elements")}}


def sensor_of(cfg: build.Config, recording: Recording, also: Sequence[LineEffect] = ()) -> Sensor:
    """The sensor that the sidecar and the configuration describe; the configuration overrides.

    `also`: effects added to every element. Raises `BadInput` for missing facts, and where the
    numbers of elements and signal columns differ.
    """
    facts = recording.sidecar
    description = merge(facts.get("sensor") or {}, build.part(cfg, "sensor"))
    films = elements(description)
    refuse(
        len(films) != len(recording.channels),
        f"{recording.name}: {len(recording.channels)} signal columns but {len(films)} film "
        "elements: name as many in recording.channels as the sensor has elements.",
    )
    speed = ConstantSpeed(float(np.mean(recording.speed_m_per_s)))
    node = build.skin_node(build.part(cfg, "skin"), SKIN | _skin(facts))
    skin = build.make(node, "skin", "skin").sliding_at(speed.speed_m_per_s)
    ideal = Sensor(films, skin, build.amplifier(amplifier_node(cfg, description)))
    scenario = build.with_effects(cfg, Scenario(None, ideal, speed))
    for effect in also:
        scenario = scenario.with_films(lambda film, effect=effect: film.with_effect(effect))
    return scenario.sensor


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
    """Refuse a line that exceeds the memory of any machine: a unit is probably wrong."""
    cells = length_m / cell_m
    refuse(
        not cells <= build.MOST_CELLS,
        f"{name}: the {length_m:.4g} m in cells of {cell_m:.4g} m are {cells:.4g} cells, more than "
        f"{build.MOST_CELLS}: check recording.speed_m_per_s, recording.sample_rate_hz, "
        "sensor.depth_m and recording.contact_window_m, and their units.",
    )


def times_rows(cfg: build.Config, recording: Recording) -> tuple[tuple[str, str], ...]:
    """Rows of a page: samples that are missing, and times that were left out."""
    rows = []
    if recording.missing_rows:
        rows.append((
            "lost rows",
            f"{recording.missing_rows} at {recording.gaps} places, by the time stamps: missing "
            "samples, speed and measured position interpolated there",
        ))  # fmt: skip
    missing = np.isnan(recording.signal)
    empty = int(missing.sum()) - recording.missing_rows * len(recording.channels)
    if empty > 0:
        rows.append(("other missing samples", f"{empty} of {missing.size}"))
    if build.part(cfg, "recording").get("times") == "ignore":
        rate = f"{recording.sample_rate_hz:.6g} Hz"
        rows.append(("times", f"the file's left out: rows taken as even at {rate}, none lost"))
    return tuple(rows)


def motion_of(recording: Recording) -> Motion:
    """The sensor's motion: the measured positions, else the integral of the speed."""
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
    """The surface's period: as known, else the scan and a margin beyond its ends."""
    given = facts.get("contact_window_m")
    if given:
        return Window(float(given[0]), float(given[1]))
    margin = MARGIN_DEPTHS * depth_m
    return Window(float(np.min(position_m)) - margin, float(np.max(position_m)) + margin)


def coloured_noises(cfg: build.Config) -> tuple[Noise, ...]:
    """The named causes of noise but the white one, which is estimated from the recording."""
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
    """The white noise per sample: given, or the level at wavenumbers that the skin does not
    transmit."""
    white = build.part(build.part(cfg, "noise"), "white")
    if (given := white.get("rms")) is not None:
        wanted = "a positive number in the signal's unit, or null to take it from the recording"
        return float(number("noise.white.rms", given, wanted, above=0))
    level = white_level(recording.signal, depth, spacing)
    refuse(
        not level > 0,
        f"{recording.name}: no noise can be told from the signal (it is constant, or rounded): "
        "give noise.white.rms=... in the signal's unit.",
    )
    return level
