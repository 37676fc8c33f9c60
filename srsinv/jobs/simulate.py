"""Simulate a scene, invert its signal by every method named, and compare with the truth."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from .. import config
from ..forward.simulation import Simulation
from ..report.outcome import Outcome
from ..report.text import listed
from .analysis import InversionCase
from .analysis import run as analyse
from .recorded import Rows, effects_rows
from .simulation import noisy_problem, recorded


def run(cfg: config.Config) -> Outcome:
    """The job: simulate, invert, compare."""
    with config.precision(cfg):
        methods = config.methods(cfg)
        sim, screening = config.screened(cfg)
        named = config.part(cfg, "effects")
        on = [name for name in named if screening is None or name in screening.on]
        problem = noisy_problem(sim, config.random_key(cfg), config.friction(cfg))
        names = ", ".join(cfg["method"])
        case = InversionCase(
            title=f"Simulated scene, {len(sim.sensor.elements)} film elements: {names}",
            problem=problem,
            sensor=sim.sensor,
            speed_m_per_s=float(sim.scan.speed_m_per_s),
            methods=methods,
            signal_unit=sim.sensor.amplifier.unit,
            stages=stages(sim) | as_recorded(sim, config.random_key(cfg)),
            assumed=assumed(
                sim,
                noises=cfg["noise"],
                effects=on,
                friction=cfg["friction"],
                numbers=f"{cfg['precision']}, {cfg['seed']}",
            ),
            screening=screening,
            warnings=sim.scene.warnings(sim.fine),
        )
        return analyse(case)


def stages(sim: Simulation) -> dict[str, tuple[tuple[str, ...], Any, str]]:
    """Every stage of the simulation at the line's positions: (dims, values, units) by name."""
    elements = len(sim.sensor.elements)
    stress = sim.response(sim.sensor.stress()).reshape(elements, 4, -1)
    along = ("element", "x")
    return {
        "traction": (("component", "x"), np.asarray(sim.traction(sim.line)), "Pa"),
        "friction": (("x",), np.asarray(sim.scene.friction(sim.line)), "1"),
        "stress": (("element", "stress_name", "x"), np.asarray(stress), "Pa"),
        "charge": (along, np.asarray(sim.response(sim.sensor.charge())), "C"),
        "current": (along, np.asarray(sim.response(sim.sensor.current(sim.scan))), "A"),
        "signal_noise_free": (
            along,
            np.asarray(sim.signal()),
            sim.sensor.amplifier.unit,
        ),
    }


def as_recorded(sim: Simulation, key) -> dict[str, tuple[tuple[str, ...], Any, str]]:
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


def assumed(
    sim: Simulation, *, noises: Iterable[str], effects: Iterable[str], friction: Any, numbers: str
) -> Rows:
    """Rows of the page's last section.

    `noises` and `effects` are the names of those that are on; `friction` is mu of q = mu p or
    None; `numbers` are the precision and the seed.
    """
    line = sim.line
    cell_um = 1e6 * float(line.cell_m)
    kinds = {
        "periodic": "everything repeats with the window",
        "open": "nothing beyond the window; p and q are deviations from the background",
    }
    return (
        ("line", f"{line.kind}: {kinds[line.kind]}"),
        ("cells", f"{line.n} of {cell_um:.4g} um; simulated on cells {sim.refinement} times finer"),
        ("skin", sim.sensor.skin.words),
        ("speed", f"{float(sim.scan.speed_m_per_s):.4g} m/s, {_how(sim)}"),
        ("amplifier", type(sim.sensor.amplifier).__name__),
        ("noise", listed(noises)),
        *effects_rows(effects),
        *_not_inverted(sim),
        ("p and q", "apart" if friction is None else f"q = {friction} p"),
        ("precision, seed", numbers),
    )


def _not_inverted(sim: Simulation) -> tuple[tuple[str, str], ...]:
    """Page rows of effects on the signal that the inversion's model leaves out, if any."""
    recorder, lags = sim.scenario.recorder, bool(sim.sensor.filters)
    left = [
        *(["the load's drift"] if recorder.drift else []),
        *(["the filters' lag as the speed varies (that at constant speed is)"]
          if recorder.speed_profiles and lags else []),
    ]  # fmt: skip
    return (("not in the inversion", ", ".join(left)),) if left else ()


def _how(sim: Simulation) -> str:
    profiles = sim.scenario.recorder.speed_profiles
    names = [type(profile).__name__.removesuffix("Profile").lower() for profile in profiles]
    return f"with {', '.join(names)}" if names else "constant"
