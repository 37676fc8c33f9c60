"""Sensor, motion and white noise of a recording at even times."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config import reader
from ..errors import number, refuse
from ..forward.describe import elements
from ..forward.noise import Noise
from ..forward.scan import ConstantSpeed
from ..forward.scenario import Scenario
from ..forward.sensor import Sensor
from ..inverse.problem import Problem
from ..inverse.recorded import SKIN, check_elements, noise_of, problem_of, skin_facts
from ..inverse.sample_noise import SampleNoise
from ..recording import Recording, merge
from ..recording.even import load_even
from . import build


def elements_named(cfg: build.Config) -> dict[str, Any]:
    """The film elements that the configuration names, as a fact beside the sidecar's."""
    return {"sensor": {"elements": build.part(cfg, "sensor").get("elements")}}


def sensor_of(cfg: build.Config, recording: Recording) -> Sensor:
    """The sensor that the sidecar and the configuration describe; the configuration overrides.

    Raises `BadInput` for missing facts, and where the
    numbers of elements and signal columns differ.
    """
    facts = recording.sidecar
    description = merge(facts.get("sensor") or {}, build.part(cfg, "sensor"))
    films = elements(description)
    check_elements(recording, tuple(films))
    speed = ConstantSpeed(float(np.mean(recording.speed_m_per_s)))
    node = build.skin_node(build.part(cfg, "skin"), SKIN | skin_facts(recording))
    skin = build.make(node, "skin", "skin").sliding_at(speed.speed_m_per_s)
    ideal = Sensor(films, skin, build.amplifier(amplifier_node(cfg, description)))
    return build.with_effects(cfg, Scenario(None, ideal, speed)).sensor


def amplifier_node(cfg: build.Config, description: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration's `amplifier`, its resistor from the sensor's description where null."""
    resistance = description.get("feedback_resistance_ohm")
    node = dict(build.part(cfg, "amplifier"))
    if node.get("feedback_resistance_ohm", 0) is None:
        node["feedback_resistance_ohm"] = resistance
    return {"amplifier": node}


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


def coloured_noises(cfg: build.Config) -> dict[str, Noise]:
    """The named causes of noise but the white one, which is estimated from the recording."""
    others = {name: node for name, node in build.part(cfg, "noise").items() if name != "white"}
    noises = dict(zip(others, build.noises({"noise": others}), strict=True))
    for noise in noises.values():
        refuse(
            noise.needs_noise_free_signal,
            "noise=snr has no meaning for a recording: use noise=white (noise.white.rms, or null "
            "to take it from the recording).",
        )
    return noises


def sample_noise(cfg: build.Config, recording: Recording, depth_m: float) -> SampleNoise:
    """The noise per sample: its white level as given, or that at wavenumbers that the skin does not
    transmit, and the coloured causes."""
    causes = coloured_noises(cfg)
    given = build.part(build.part(cfg, "noise"), "white").get("rms")
    if given is not None:
        wanted = "a positive number in the signal's unit, or null to take it from the recording"
        return SampleNoise(number("noise.white.rms", given, wanted, above=0), causes)
    return noise_of(recording, depth_m, causes)


@dataclass(frozen=True)
class RecordedProblem:
    """A recording, and the problem of finding what made it."""

    recording: Recording
    problem: Problem

    @property
    def noise_rms(self) -> float:
        """The white noise per sample."""
        return float(self.problem.noise.rms)


def recorded_problem(cfg: build.Config, check: Callable[[Recording], None]) -> RecordedProblem:
    """The problem that the configuration poses of its recording, which `check` may refuse.

    Raises `BadInput` for a recording without what an inversion needs.
    """
    friction = build.friction(cfg) if "friction" in cfg else None
    settings = build.part(cfg, "recording")
    recording = load_even(settings, elements_named(cfg), reader(cfg))
    check(recording)
    sensor = sensor_of(cfg, recording)
    cell_m = settings.get("cell_m")
    if cell_m is not None:
        number("recording.cell_m", cell_m, "a positive width in metres", above=0)
    noise = sample_noise(cfg, recording, float(sensor.depth_m))
    problem = problem_of(recording, sensor, noise=noise, friction=friction, cell_m=cell_m)
    return RecordedProblem(recording, problem)
