"""The signal of a scene, simulated on a line of cells and on a finer one."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..compiled import compiled
from ..grid import Line, Periodic, Stage, as_real
from .amplifier import ChargeReadout
from .contact import refuse_both_ways
from .drift import SinusoidalLoad
from .filter import even_interval, filtered
from .noise import Noise
from .scan import ConstantSpeed, Motion
from .scenario import Scenario
from .scene import Scene, deviation
from .sensor import Sensor
from .speed_profile import denser
from .varying_friction import refuse_uneven

SAME_RATE = 1e-6  # by which rates differ that only rounding tells apart


class Simulation(eqx.Module):
    """A scene and a sensor, on a line and on one that is `refinement` times finer.

    The signal comes from the finer line, so that what inverts it is not what made it. On the open
    line the traction is the deviation from the background, which has no end to feel.
    """

    scenario: Scenario
    line: Line
    fine: Line
    refinement: int = eqx.field(static=True)

    def with_noises(self, noises: tuple[Noise, ...]) -> "Simulation":
        """The same simulation with other noise."""
        return dataclasses.replace(self, scenario=self.scenario.replace(noises=noises))

    @property
    def scene(self) -> Scene:
        """The scene that the sensor slides over."""
        assert self.scenario.scene is not None
        return self.scenario.scene

    @property
    def sensor(self) -> Sensor:
        """What feels it."""
        return self.scenario.sensor

    @property
    def scan(self) -> ConstantSpeed:
        """How the sensor slides."""
        return self.scenario.scan

    @property
    def background(self):
        """What is taken out of the traction (2, 1) [Pa]: nothing on the periodic line."""
        taken_out = self.scene.background(self.scan.direction)[:, None]
        return 0.0 * taken_out if self._periodic else taken_out

    @property
    def _periodic(self) -> bool:
        return isinstance(self.line, Periodic)

    def traction(self, line: Line):
        """Cell averages of p and q (2, n) on `line`, less the background."""
        return deviation(self.scene, line, self.scan.direction, self._periodic)

    def response(self, stage: Stage):
        """A stage's signals (e, n) at the coarse line's positions, computed on the fine one."""
        return response(stage, self.fine, self.traction(self.fine), self.refinement)

    def signal(self):
        """The noise-free signal (element, n) at the coarse line's positions."""
        return self.response(self.sensor.output(self.scan))

    def signal_along(self, motion: Motion):
        """The noise-free signal (element, sample) at the samples of the recorder's motion.

        Filters come before the sampling: they act on samples as dense as the finer line's cells.
        """
        if self.sensor.filters:
            ratio = float(self.scan.sample_rate_hz(self.fine)) / motion.sample_rate_hz
            times = int(np.ceil(ratio * (1 - SAME_RATE)))
            if times > 1:
                speed = float(self.scan.speed_m_per_s)
                profiles = self.scenario.recorder.speed_profiles
                return self.signal_along(denser(motion, times, speed, profiles))[:, ::times]
        refuse_uneven(self.scene, bool(self.scenario.recorder.speed_profiles))
        own = float(self.scan.direction)
        traction, directions = self.traction(self.fine), motion.directions
        if len(directions) > 1:
            refuse_both_ways(self.sensor.skin)
            back = deviation(self.scene, self.fine, -self.scan.direction, self._periodic)
            # The scan's own direction is that of a motion towards +x, or towards -x.
            traction = jnp.stack([traction, back] if own > 0 else [back, traction])
        recorder = self.scenario.recorder
        return _signal_along(
            self.sensor, recorder.drift, self.scan, self.fine, motion, traction, self.background
        )


@compiled
def _signal_along(
    sensor: Sensor,
    drift: SinusoidalLoad | None,
    scan: ConstantSpeed,
    line: Line,
    motion: Motion,
    traction,
    background,
):
    """The signal (element, sample) of the traction on `line`, one or one for each way."""
    if drift is None:
        return sensor.operator_along(line, motion)(traction)
    # The load scales the charge ahead of the filters, that of the uniform load with the rest.
    ideal = dataclasses.replace(sensor, filters=())
    signal, charge = ideal.operator_along(line, motion)(traction), None
    if sensor.amplifier.order:
        readout = ChargeReadout(sensor.amplifier.at_speed(as_real(1.0)))
        of_charge = dataclasses.replace(ideal, amplifier=readout)
        uniform = of_charge.output(scan).transfer(jnp.zeros(1))[..., 0].real
        charge = of_charge.operator_along(line, motion)(traction) + uniform @ background
    signal = drift(motion.time_s, signal, charge)
    interval = even_interval(motion.time_s) if sensor.filters else None
    return filtered(sensor.filters, signal, interval)


@compiled
def response(stage: Stage, line: Line, traction, refinement: int):
    """The stage's signals (e, n) under `traction` on `line`, at every so many positions."""
    return line.operator(stage)(traction)[:, ::refinement]
