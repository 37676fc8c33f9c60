"""The problem of inverting a simulation: its signal with noise, as it is recorded."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..compiled import compiled
from ..errors import refuse
from ..forward.film import CellAverage
from ..forward.noise import check_power, cross_spectrum, split_gaussian, with_noise
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from ..forward.simulation import Simulation
from ..grid import Periodic
from ..known import is_traced
from .gridding.cells import fitted_on
from .line.problem import LineProblem
from .line.shared import shared_noise

LEAST_SAMPLES = 0.99  # a cell: with fewer, the cells would have to be guessed


def noisy_problem(sim: Simulation, key, friction=None) -> LineProblem:
    """The simulated signal with noise, its traction's mean pressure known as the load."""
    mean_p_Pa = _mean_pressure(sim.traction(sim.line))
    if sim.scenario.recorder.samples_in_time:
        return timed_problem(sim, mean_p_Pa, key, friction)
    return problem_of(sim, sim.signal(), mean_p_Pa, key, friction)


@compiled
def _mean_pressure(traction: Float[Array, "c n"]) -> Float[Array, ""]:
    return jnp.mean(traction[0])


def problem_of(sim: Simulation, signal, mean_p_Pa, key, friction=None) -> LineProblem:
    """The signal without noise, (e, n) at the line's positions, with noise and what inverts it."""
    noises = sim.scenario.noises
    data, spectrum, rms = with_noise(noises, sim.line, sim.scan, signal, key)
    _check_noise(sim.sensor, noises, spectrum, rms)
    cross = _cross_spectrum(noises, sim.line, sim.scan, rms, len(data))
    recorder, observed = sim.scenario.recorder, None
    if recorder.conversions:
        valid = np.asarray(recorder.valid(data))
        observed = None if valid.all() else valid
        data, spectrum = recorder.convert(data), spectrum + recorder.variance
    return _problem(sim, sim.sensor, data, (spectrum, cross), observed, mean_p_Pa, friction)


def timed_problem(sim: Simulation, mean_p_Pa, key, friction=None) -> LineProblem:
    """The recorded samples with noise, put on the line's cells, and what inverts them.

    What is sampled while sliding back, and at a standstill, is left out: friction is turned there.
    """
    record = recorded(sim, key)
    direction = float(sim.scan.direction)
    x = direction * np.asarray(record.motion.position_m)
    gain = sim.sensor.amplifier.at_speed
    a = np.asarray(gain(record.motion.speed_m_per_s) / gain(sim.scan.speed_m_per_s))
    onwards = np.maximum.accumulate(x)
    valid = record.valid & (onwards <= x)[None] & (np.asarray(record.motion.direction) == direction)
    samples = np.where(valid, record.signal, np.nan)
    cell = float(sim.line.cell_m)
    edges = np.sort(
        direction * (float(sim.line.start_m) + cell * (np.arange(sim.line.n + 1) - 0.5))
    )
    signal, typical, *_ = fitted_on(edges, onwards, a, samples)
    refuse(
        typical < LEAST_SAMPLES,
        f"There are {typical:.2g} samples for each of the {sim.line.n} cells, fewer "
        f"than {LEAST_SAMPLES:g}: raise effects.sampling.rate_hz, or lower grid.cells.",
    )
    signal = signal if direction > 0 else signal[:, ::-1]

    def on_cells(power: np.ndarray) -> np.ndarray:
        return np.interp(sim.line.k, record.k, power) / typical

    cross = record.cross
    if cross is not None:
        cross = jnp.asarray(np.apply_along_axis(on_cells, -1, cross))
    power = jnp.asarray(on_cells(record.spectrum)), cross
    # A cell has the mean of what is sampled on its way.
    sensor = sim.sensor.with_films(
        lambda film: film.with_effect(CellAverage.at_depth(cell, film.depth_m))
    )
    data, observed = jnp.nan_to_num(signal), np.isfinite(signal)
    return _problem(sim, sensor, data, power, observed, mean_p_Pa, friction)


class TimedSamples(NamedTuple):
    """What is recorded in time: `signal` (e, sample), which of it is `valid`, along `motion`.

    `spectrum` (k,): the noise's power per sample at `k` of the mean speed, the mean over elements;
    `cross` (e, e, k): the cross-spectral matrix of the part that elements share, if any.
    """

    motion: Motion
    signal: np.ndarray
    valid: np.ndarray
    k: np.ndarray
    spectrum: np.ndarray
    cross: np.ndarray | None


def recorded(sim: Simulation, key) -> TimedSamples:
    """The samples along the real motion with noise, converted as the recorder does."""
    recorder = sim.scenario.recorder
    motion = recorder.motion(sim.line, sim.fine, sim.scan)
    ideal = sim.signal_along(motion)
    spacing = abs(float(sim.scan.speed_m_per_s)) / recorder.rate_hz(sim.fine, sim.scan)
    samples = Periodic(ideal.shape[1], spacing)
    noisy, spectrum, rms = with_noise(sim.scenario.noises, samples, sim.scan, ideal, key)
    _check_noise(sim.sensor, sim.scenario.noises, spectrum, rms)
    signal, valid = recorder.convert(noisy), recorder.valid(noisy)
    spectrum = spectrum + recorder.variance
    cross = _cross_spectrum(sim.scenario.noises, samples, sim.scan, rms, len(signal))
    kept = None if cross is None else np.asarray(cross)
    signal, valid, k, power = map(np.asarray, (signal, valid, samples.k, spectrum))
    return TimedSamples(motion, signal, valid, k, power, kept)


def _cross_spectrum(noises, line, scan, rms, elements: int) -> Float[Array, "e e k"] | None:
    """The cross-spectral matrix of the noise that elements share; None where there is none."""
    others = split_gaussian(noises)[1]
    return cross_spectrum(others, line, scan, rms, elements) if others else None


def _problem(
    sim: Simulation, sensor: Sensor, data, power, observed, mean_p_Pa, friction
) -> LineProblem:
    """The problem, its noise's `power` the mean spectrum and the cross-spectral matrix, if any."""
    (spectrum, cross), shared, warnings = power, None, ()
    if cross is not None:
        of_elements = jnp.einsum("eek->ek", cross)
        own = jnp.maximum(spectrum - jnp.mean(of_elements, axis=0), 0.0)
        shared, warnings = shared_noise(cross, own)
        spectrum = own[None] + of_elements if len(cross) > 1 else spectrum
    free_offset = sensor.amplifier.offset is None
    return LineProblem.of_sensor(
        sim.line,
        sensor,
        sim.scan,
        data if observed is None else jnp.where(observed, data, 0.0),
        spectrum.at[..., 0].set(jnp.inf) if free_offset else spectrum,
        shared_noise=shared,
        warnings=warnings,
        observed=observed,
        known_mean_Pa=(mean_p_Pa, None),
        friction=friction,
    )


def _check_noise(sensor: Sensor, noises, spectrum, rms) -> None:
    if is_traced(spectrum, rms):
        return
    parts = (sensor.skin, *sensor.elements, sensor.amplifier, *sensor.filters)
    refuse(
        not np.isfinite(float(rms)),
        f"The signal's rms is {float(rms)}: one of "
        f"{', '.join(type(p).__name__ for p in parts)} or the scene gives values that "
        "are not finite; correct it.",
    )
    check_power(noises, spectrum)
    refuse(
        bool(noises) and not np.any(np.asarray(spectrum) > 0) and not bool(rms > 0),
        "The scene gives no signal, so a signal-to-noise ratio has no meaning: put a "
        "feature within the window, or give noise=[white] or noise=[johnson].",
    )
