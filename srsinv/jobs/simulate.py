"""Simulate a scene, invert its signal by every method named, and compare with the truth."""

from typing import Any

import numpy as np

from .. import config
from ..compiled import compiled
from ..forward.scene import Scene
from ..forward.simulation import Simulation
from ..grid import Line
from ..inverse.simulated import noisy_problem, recorded
from ..report.result import Result
from . import _facts
from ._inversion import InversionCase
from ._inversion import run as invert

Stages = dict[str, tuple[tuple[str, ...], Any, str]]


def run(cfg: config.Config) -> Result:
    """The job: simulate, invert, compare."""
    with config.precision(cfg):
        methods = config.methods(cfg)
        sim, screening = config.screened(cfg)
        named = config.part(cfg, "effects")
        on = [name for name in named if screening is None or name in screening.on]
        key = config.random_key(cfg)
        facts = {
            **_facts.of_simulation(sim, config.part(cfg, "noise"), on),
            **_facts.of_friction(cfg["friction"]),
            "precision_and_seed": f"{cfg['precision']}, {cfg['seed']}",
        }
        return invert(
            InversionCase(
                problem=noisy_problem(sim, key, config.friction(cfg)),
                sensor=sim.sensor,
                methods=methods,
                facts=facts,
                signal_unit=sim.sensor.amplifier.unit,
                stages=stages(sim) | as_recorded(sim, key),
                screening=screening,
                warnings=sim.scene.warnings(sim.fine),
                repeats=3,
            )
        )


@compiled
def _friction(scene: Scene, line: Line):
    return scene.friction(line)


def stages(sim: Simulation) -> Stages:
    """Every stage of the simulation at the line's positions: (dims, values, units) by name."""
    elements = len(sim.sensor.elements)
    stress = sim.response(sim.sensor.stress()).reshape(elements, 4, -1)
    along = ("element", "x")
    return {
        "traction": (("component", "x"), np.asarray(sim.traction(sim.line)), "Pa"),
        "friction": (("x",), np.asarray(_friction(sim.scene, sim.line)), "1"),
        "stress": (("element", "stress_name", "x"), np.asarray(stress), "Pa"),
        "charge": (along, np.asarray(sim.response(sim.sensor.charge())), "C"),
        "current": (along, np.asarray(sim.response(sim.sensor.current(sim.scan))), "A"),
        "signal_noise_free": (along, np.asarray(sim.signal()), sim.sensor.amplifier.unit),
    }


def as_recorded(sim: Simulation, key) -> Stages:
    """The recorded signal and motion, where samples differ from those of the line at constant
    speed."""
    if not sim.scenario.recorder.samples_in_time:
        return {}
    record = recorded(sim, key)
    along, motion = ("sample",), record.motion
    return {
        "recorded_signal": (("element", *along), record.signal, sim.sensor.amplifier.unit),
        "sample_time": (along, np.asarray(motion.time_s), "s"),
        "sample_position": (along, np.asarray(motion.position_m), "m"),
        "sample_speed": (along, np.asarray(motion.speed_m_per_s), "m/s"),
    }
