"""A scene felt by a sensor, on a grid: its signal, and the problem of inverting it."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..effects import ScreeningResult, screen
from ..errors import number, refuse
from ..forward.amplifier import ChargeReadout
from ..forward.contact import refuse_both_ways
from ..forward.drift import SinusoidalLoad
from ..forward.film import StripAverage
from ..forward.filter import even_interval, filtered
from ..forward.noise import Noise, with_noise
from ..forward.scan import ConstantSpeed, Motion
from ..forward.scenario import Scenario
from ..forward.scene import Scene, deviation
from ..forward.sensor import Sensor
from ..forward.skin import STRESSES
from ..forward.speed_profile import denser
from ..grid import Line, Periodic, Stage, as_real
from ..inverse.cells import fitted_on
from ..inverse.line_problem import LineProblem
from . import build

SAME_RATE = 1e-6  # by which rates differ that only rounding tells apart
LEAST_SAMPLES = 0.99  # a cell: with fewer, the cells would have to be guessed


class Simulation(eqx.Module):
    """A scene felt by a sensor, on a line and on one that is `refinement` times finer.

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
        """What is felt."""
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
        if self.sensor.filters and (times := self._denser(motion)) > 1:
            speed, profiles = float(self.scan.speed_m_per_s), self.scenario.recorder.speed_profiles
            return self.signal_along(denser(motion, times, speed, profiles))[:, ::times]
        own = float(self.scan.direction)
        traction, ways = self.traction(self.fine), motion.ways
        if len(ways) > 1:
            refuse_both_ways(self.sensor.skin)
            back = deviation(self.scene, self.fine, -self.scan.direction, self._periodic)
            # The scan's own direction is that of a motion towards +x, or towards -x.
            traction = jnp.stack([traction, back] if own > 0 else [back, traction])
        recorder = self.scenario.recorder
        return _signal_along(
            self.sensor, recorder.drift, self.scan, self.fine, motion, traction, self.background
        )

    def _denser(self, motion: Motion) -> int:
        """How many times as many samples the finer line's cells ask for."""
        rate = (motion.time_s.size - 1) / float(motion.time_s[-1] - motion.time_s[0])
        return int(np.ceil(float(self.scan.sample_rate_hz(self.fine)) / rate * (1 - SAME_RATE)))


@eqx.filter_jit
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
        readout = ChargeReadout(sensor.amplifier.gain(as_real(1.0)))
        of_charge = dataclasses.replace(ideal, amplifier=readout)
        uniform = of_charge.output(scan).transfer(jnp.zeros(1))[..., 0].real
        charge = of_charge.operator_along(line, motion)(traction) + uniform @ background
    signal = drift(motion.time_s, signal, charge)
    interval = even_interval(motion.time_s) if sensor.filters else None
    return filtered(sensor.filters, signal, interval)


@eqx.filter_jit
def response(stage: Stage, line: Line, traction, refinement: int):
    """The stage's signals (e, n) under `traction` on `line`, at every so many positions."""
    return line.operator(stage)(traction)[:, ::refinement]


def simulation(cfg: build.Config) -> Simulation:
    """The simulation that a configuration describes, with the effects that are named or called
    for."""
    return _as_named(screen_effects(cfg)[0])


def screen_effects(cfg: build.Config) -> tuple[build.Config, ScreeningResult | None]:
    """The configuration with those effects alone that its scene calls for, and what was found of
    each. Without `effects=auto` all that are named are called for, and there is nothing to find.

    Raises `BadInput` for a tolerance that is not positive.
    """
    if "tolerance" not in cfg:
        return cfg, None
    wanted = "a positive number, as a part of the signal's rms"
    tolerance = number("tolerance", cfg["tolerance"], wanted, above=0)
    ideal = build.ideal(cfg)
    _refuse_static(cfg, ideal)
    addable = {n: e for n, e in build.effects(cfg).items() if not e.is_defined_in(ideal)}
    named = {n: node for n, node in build.part(cfg, "effects").items() if n in addable}
    rest = {key: value for key, value in cfg.items() if key != "tolerance"}

    def only(names) -> dict[str, Any]:
        return {**rest, "effects": {n: node for n, node in named.items() if n in names}}

    def simulated(names) -> tuple[np.ndarray, np.ndarray]:
        sim = _as_named(only(names))
        signal = np.asarray(sim.signal())
        stress = np.asarray(sim.response(sim.sensor.stress()))
        return signal, stress.reshape(signal.shape[0], len(STRESSES), -1)

    fine = build.line(cfg, build.part(cfg, "grid").get("refinement"))
    screening = screen(ideal, fine, addable, tolerance, simulated)
    return only(screening.on), screening


def _as_named(cfg: build.Config) -> Simulation:
    refinement: Any = build.part(cfg, "grid").get("refinement")
    scenario = build.scenario(cfg)
    _refuse_static(cfg, scenario)
    return Simulation(scenario, build.line(cfg), build.line(cfg, refinement), int(refinement))


def _refuse_static(cfg: build.Config, scenario: Scenario) -> None:
    refuse(
        float(scenario.sensor.amplifier.gain(scenario.scan.speed_m_per_s)) == 0.0,
        f"scan.speed_m_per_s is {cfg['scan']['speed_m_per_s']}, and the sensor does not move "
        "across what it feels: a static touch gives no rate signal, give a speed, or a gain.",
    )


def noisy_problem(sim: Simulation, key, friction=None) -> LineProblem:
    """The simulated signal with noise, its traction's mean pressure known as the load."""
    mean_p_Pa = jnp.mean(sim.traction(sim.line)[0])
    if sim.scenario.recorder.samples_in_time:
        return timed_problem(sim, mean_p_Pa, key, friction)
    return problem_of(sim, sim.signal(), mean_p_Pa, key, friction)


def problem_of(sim: Simulation, signal, mean_p_Pa, key, friction=None) -> LineProblem:
    """The signal without noise, (e, n) at the line's positions, with noise and what inverts it."""
    data, spectrum, rms = with_noise(sim.scenario.noises, sim.line, sim.scan, signal, key)
    _refuse_nothing(sim.scenario.noises, spectrum, rms)
    recorder, observed = sim.scenario.recorder, None
    if recorder.conversions:
        valid = np.asarray(recorder.valid(data))
        observed = None if valid.all() else valid
        data, spectrum = recorder.convert(data), spectrum + recorder.variance
    return _problem(sim, sim.sensor, data, spectrum, observed, mean_p_Pa, friction)


def timed_problem(sim: Simulation, mean_p_Pa, key, friction=None) -> LineProblem:
    """The recorded samples with noise, put on the line's cells, and what inverts them.

    What is sampled while sliding back, and at a standstill, is left out: friction is turned there.
    """
    record = recorded(sim, key)
    direction = float(sim.scan.direction)
    x = direction * np.asarray(record.motion.position_m)
    gain = sim.sensor.amplifier.gain
    a = np.asarray(gain(record.motion.speed_m_per_s) / gain(sim.scan.speed_m_per_s))
    onwards = np.maximum.accumulate(x)
    valid = record.valid & (onwards <= x)[None] & (np.asarray(record.motion.direction) == direction)
    samples = np.where(valid, record.signal, np.nan)
    cell = float(sim.line.cell_m)
    edges = np.sort(
        direction * (float(sim.line.start_m) + cell * (np.arange(sim.line.n + 1) - 0.5))
    )
    signal, typical = fitted_on(edges, onwards, a, samples)
    refuse(
        typical < LEAST_SAMPLES,
        f"There are {typical:.2g} samples for each of the {sim.line.n} cells, fewer than "
        f"{LEAST_SAMPLES:g}: raise effects.sampling.rate_hz, or take fewer grid.cells.",
    )
    signal = signal if direction > 0 else signal[:, ::-1]
    power = np.interp(sim.line.k, record.k, record.spectrum) / typical
    # A cell has the mean of what is sampled on its way.
    mean = [StripAverage.at_depth(cell, float(film.depth_m)) for film in sim.sensor.elements]
    films = [film.with_effect(m) for film, m in zip(sim.sensor.elements, mean, strict=True)]
    sensor = dataclasses.replace(sim.sensor, elements=films)
    data, observed = jnp.nan_to_num(signal), np.isfinite(signal)
    return _problem(sim, sensor, data, jnp.asarray(power), observed, mean_p_Pa, friction)


class TimedSamples(NamedTuple):
    """What is recorded in time: `signal` (e, sample), which of it is `valid`, along `motion`.

    `spectrum` (k,): the noise's power per sample at `k` of the mean speed.
    """

    motion: Motion
    signal: np.ndarray
    valid: np.ndarray
    k: np.ndarray
    spectrum: np.ndarray


def recorded(sim: Simulation, key) -> TimedSamples:
    """The samples along the real motion with noise, converted as the recorder does."""
    recorder = sim.scenario.recorder
    motion = recorder.motion(sim.line, sim.fine, sim.scan)
    ideal = sim.signal_along(motion)
    spacing = abs(float(sim.scan.speed_m_per_s)) / recorder.rate_hz(sim.fine, sim.scan)
    samples = Periodic(ideal.shape[1], spacing)
    noisy, spectrum, rms = with_noise(sim.scenario.noises, samples, sim.scan, ideal, key)
    _refuse_nothing(sim.scenario.noises, spectrum, rms)
    signal, valid = recorder.convert(noisy), recorder.valid(noisy)
    spectrum = spectrum + recorder.variance
    return TimedSamples(
        motion, *(np.asarray(each) for each in (signal, valid, samples.k, spectrum))
    )


def _problem(
    sim: Simulation, sensor: Sensor, data, spectrum, observed, mean_p_Pa, friction
) -> LineProblem:
    free_offset = sensor.amplifier.offset is None
    return LineProblem.of_sensor(
        sim.line,
        sensor,
        sim.scan,
        data if observed is None else jnp.where(observed, data, 0.0),
        spectrum.at[0].set(jnp.inf) if free_offset else spectrum,
        observed=observed,
        known_mean_Pa=(mean_p_Pa, None),
        friction=friction,
    )


def _refuse_nothing(noises, spectrum, rms) -> None:
    refuse(
        bool(noises) and not bool(jnp.any(spectrum > 0)) and not bool(rms > 0),
        "The scene gives no signal at all, nor noise that is set by its ratio to the signal: put "
        "something uneven within the window, or name noise of its own, noise=[white] or [johnson].",
    )
