"""Simulate a scene, invert its signal by every method named, and compare with the truth."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..errors import refuse
from ..forward.noise import Noise, with_noise
from ..forward.scan import ConstantSpeed
from ..forward.scene import Scene
from ..forward.sensor import Sensor
from ..grid import Line
from ..inverse.problem import Problem
from ..report.outcome import Outcome
from . import build
from .analysis import Case
from .analysis import run as analyse


class Simulation(eqx.Module):
    """A scene felt by a sensor, on a line and on one that is `refinement` times finer.

    The signal comes from the finer line, so that what inverts it is not what made it. On the open
    line the traction is the deviation from the background, which has no end to feel.
    """

    scene: Scene
    sensor: Sensor
    scan: ConstantSpeed
    line: Line
    fine: Line
    refinement: int = eqx.field(static=True)

    @property
    def background(self):
        """What is taken out of the traction (2, 1) [Pa]: nothing on the periodic line."""
        open_line = not isinstance(self.line, build.Periodic)
        return open_line * self.scene.background(self.scan.direction)[:, None]

    @eqx.filter_jit
    def traction(self, line: Line):
        """Cell averages of p and q (2, n) on `line`, less the background."""
        return self.scene.traction(line, self.scan.direction) - self.background

    @eqx.filter_jit
    def sampled(self, stage):
        """A stage's signals (e, n) at the coarse line's positions, computed on the fine one."""
        signal = self.fine.operator(stage)(self.traction(self.fine))
        return signal[:, :: self.refinement]


def simulation(cfg: build.Config) -> Simulation:
    """The simulation that a configuration describes."""
    refinement: Any = build.part(cfg, "grid").get("refinement")
    sensor, scan = build.sensor(cfg), build.scan(cfg)
    refuse(
        float(sensor.amplifier.gain(scan.speed_m_per_s)) == 0.0,
        f"scan.speed_m_per_s is {float(scan.speed_m_per_s)}: a static touch gives no rate signal, "
        "give a speed, or a gain.",
    )
    return Simulation(
        build.scene(cfg),
        sensor,
        scan,
        build.line(cfg),
        build.line(cfg, refinement),
        int(refinement),
    )


def noisy_problem(sim: Simulation, noises: tuple[Noise, ...], key, friction=None) -> Problem:
    """The simulated signal with noise, its traction's mean pressure known as the load."""
    signal = sim.sampled(sim.sensor.signal(sim.scan))
    return problem_of(sim, signal, jnp.mean(sim.traction(sim.line)[0]), noises, key, friction)


def problem_of(
    sim: Simulation, signal, mean_p_Pa, noises: tuple[Noise, ...], key, friction=None
) -> Problem:
    """The signal without noise, (e, n) at the line's positions, with noise and what inverts it."""
    data, spectrum, rms = with_noise(noises, sim.line, sim.scan, signal, key)
    refuse(
        bool(noises) and not bool(jnp.any(spectrum > 0)) and not bool(rms > 0),
        "The scene gives no signal at all, nor noise that is set by its ratio to the signal: put "
        "something uneven within the window, or name noise of its own, noise=[white] or [johnson].",
    )
    free_offset = sim.sensor.amplifier.offset is None
    return Problem(
        sim.line,
        sim.line.operator(sim.sensor.signal(sim.scan)),
        data,
        spectrum.at[0].set(jnp.inf) if free_offset else spectrum,
        known_mean_Pa=(mean_p_Pa, None),
        friction=friction,
    )


def run(cfg: build.Config) -> Outcome:
    """The job: simulate, invert, compare."""
    with build.precision(cfg):
        sim, methods, noises = simulation(cfg), build.methods(cfg), build.noises(cfg)
        problem = noisy_problem(sim, noises, build.random_key(cfg), build.friction(cfg))
        names = ", ".join(cfg["method"])
        case = Case(
            title=f"Simulated scene, {len(sim.sensor.elements)} film elements: {names}",
            problem=problem,
            sensor=sim.sensor,
            speed_m_per_s=float(sim.scan.speed_m_per_s),
            methods=methods,
            signal_unit=sim.sensor.amplifier.unit,
            stages=stages(sim),
            assumed=assumed(cfg, sim),
        )
        return analyse(case)


def stages(sim: Simulation) -> dict[str, tuple[tuple[str, ...], Any, str]]:
    """Every stage of the simulation at the line's positions: (dims, values, units) by name."""
    elements = len(sim.sensor.elements)
    stress = sim.sampled(sim.sensor.stress()).reshape(elements, 4, -1)
    along = ("element", "x")
    return {
        "traction": (("component", "x"), np.asarray(sim.traction(sim.line)), "Pa"),
        "friction": (("x",), np.asarray(sim.scene.friction(sim.line)), "1"),
        "stress": (("element", "stress_name", "x"), np.asarray(stress), "Pa"),
        "charge": (along, np.asarray(sim.sampled(sim.sensor.charge())), "C"),
        "current": (along, np.asarray(sim.sampled(sim.sensor.current(sim.scan))), "A"),
        "signal_noise_free": (
            along,
            np.asarray(sim.sampled(sim.sensor.signal(sim.scan))),
            sim.sensor.amplifier.unit,
        ),
    }


def assumed(cfg: build.Config, sim: Simulation) -> tuple[tuple[str, str], ...]:
    """Rows of the page's last section."""
    line = sim.line
    effects = cfg["effects"]
    off = [name for name in build.EFFECTS if name not in effects]
    cell_um = 1e6 * float(line.cell_m)
    kinds = {
        "periodic": "everything repeats with the window",
        "open": "nothing beyond the window; p and q are deviations from the background",
    }
    return (
        ("line", f"{cfg['grid']['line']}: {kinds[cfg['grid']['line']]}"),
        ("cells", f"{line.n} of {cell_um:.4g} um; simulated on cells {sim.refinement} times finer"),
        ("skin", sim.sensor.skin.words),
        ("speed", f"{float(sim.scan.speed_m_per_s):.4g} m/s, constant"),
        ("amplifier", type(sim.sensor.amplifier).__name__),
        ("noise", ", ".join(cfg["noise"]) or "none"),
        ("effects on", ", ".join(effects) or "none"),
        ("effects off", ", ".join(off) or "none"),
        ("p and q", "apart" if cfg["friction"] is None else f"q = {cfg['friction']} p"),
        ("precision, seed", f"{cfg['precision']}, {cfg['seed']}"),
    )
