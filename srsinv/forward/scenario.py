"""Scenario: scene, sensor and recorder, the whole of a simulation but its grid."""

import dataclasses
from typing import Any

import equinox as eqx

from ..errors import all_of_kind, of_kind
from .noise import Noise
from .recorder import Recorder
from .scan import ConstantSpeed
from .scene import Scene
from .sensor import Sensor
from .skin import Skin


def _noises(given: Any) -> tuple[Noise, ...]:
    return all_of_kind("noises", given, Noise, "noises, as [SignalToNoise(40)]")


class Scenario(eqx.Module):
    """A scenario: a scene, the sensor that slides over it, its motion, noise and recorder.

    - `scene`: a `TractionScene` or a `SurfaceScene`; None where only the sensor is needed.
    - `sensor`: a `Sensor`. `scan`: a `ConstantSpeed`.
    - `noises`: a list of noises, as `[SignalToNoise(40)]`; none by default.
    - `recorder`: sampling and its limits; by default one exact sample for each cell.

    Effects are added one by one: `effect.apply(scenario)` gives the edited scenario. An effect that
    is not added costs nothing. Raises `BadInput` for a part of another kind.
    """

    scene: Scene | None
    sensor: Sensor
    scan: ConstantSpeed
    noises: tuple[Noise, ...] = eqx.field(default=(), converter=_noises)
    recorder: Recorder = Recorder()

    def __check_init__(self):
        if self.scene is not None:
            of_kind("scene", self.scene, Scene, "a TractionScene or a SurfaceScene")
        of_kind("sensor", self.sensor, Sensor, "a Sensor")
        of_kind("scan", self.scan, ConstantSpeed, "a ConstantSpeed")
        of_kind("recorder", self.recorder, Recorder, "a Recorder")

    def replace(self, **changed) -> "Scenario":
        """The same scenario with other parts."""
        return dataclasses.replace(self, **changed)

    def with_skin(self, skin: Skin) -> "Scenario":
        """The scenario with another skin, around the film and in contact with the surface."""
        scene = None if self.scene is None else self.scene.with_skin(skin)
        return self.replace(scene=scene, sensor=eqx.tree_at(lambda s: s.skin, self.sensor, skin))

    def sliding(self) -> "Scenario":
        """The scenario with its skin as it responds at the speed of the scan."""
        return self.with_skin(self.sensor.skin.sliding_at(self.scan.speed_m_per_s))

    def with_films(self, change) -> "Scenario":
        """The scenario with `change` applied to every film element."""
        return self.replace(sensor=self.sensor.with_films(change))

    def with_recorder(self, **changed) -> "Scenario":
        """The scenario with other parts of the recorder."""
        return self.replace(recorder=dataclasses.replace(self.recorder, **changed))
