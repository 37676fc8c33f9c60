"""What effects change of a scene's signal: the same instants with them and without."""

import dataclasses
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..compiled import compiled
from ..grid import Line, Periodic
from .noise import NonGaussianNoise, split_gaussian
from .scan import ConstantSpeed, Motion
from .simulation import Simulation


class Trace(NamedTuple):
    """A signal (e, sample) without noise but that of bursts, at `time_s` (sample,)."""

    time_s: Float[np.ndarray, " sample"]
    signal: Float[np.ndarray, "e sample"]


def pair(full: Simulation, less: Simulation, key: jax.Array) -> tuple[Trace, Trace]:
    """The signals of two simulations that differ by effects, at the same instants: those at which
    `full` is sampled."""
    if not full.scenario.recorder.samples_in_time:
        instants = np.asarray(full.scan.time_s(full.line))

        def one(sim: Simulation) -> Trace:
            return Trace(instants, _converted_with_bursts(sim, sim.line, sim.signal(), key))

        return one(full), one(less)
    rate = full.scenario.recorder.rate_hz(full.fine, full.scan)
    motions = _motion(full, rate), _motion(less, rate)
    common = min(motion.time_s.size for motion in motions)
    samples = Periodic(common, abs(float(full.scan.speed_m_per_s)) / rate)

    def along(sim: Simulation, motion: Motion) -> Trace:
        signal = _converted_with_bursts(sim, samples, sim.signal_along(motion)[:, :common], key)
        return Trace(np.asarray(motions[0].time_s[:common]), signal)

    return along(full, motions[0]), along(less, motions[1])


def difference(one: Trace, other: Trace) -> float:
    """Rms of the difference over the rms of the `other`; 0 where both are rounded to nothing."""
    change = np.linalg.norm(one.signal - other.signal)
    return float(change / np.linalg.norm(other.signal)) if change else 0.0


def _motion(sim: Simulation, rate_hz: float) -> Motion:
    recorder = dataclasses.replace(sim.scenario.recorder, sample_rate_hz=rate_hz)
    return recorder.motion(sim.line, sim.fine, sim.scan)


def _converted_with_bursts(
    sim: Simulation, line: Line, signal, key
) -> Float[np.ndarray, "e sample"]:
    """With bursts, converted."""
    for noise in split_gaussian(sim.scenario.noises)[1]:
        signal = _with_bursts(noise, signal, line, sim.scan, key)
    return np.asarray(sim.scenario.recorder.convert(signal))


@compiled
def _with_bursts(noise: NonGaussianNoise, signal, line: Line, scan: ConstantSpeed, key):
    return signal + noise.draw(key, line, scan, jnp.sqrt(jnp.mean(signal**2)))


class Cost(NamedTuple):
    """Seconds: of the first call with all that is compiled for it, and steady."""

    first_s: float
    steady_s: float


def cost(
    simulated: Callable[[], Simulation], key: jax.Array, repeats: int = 3
) -> tuple[Simulation, Cost]:
    """What `simulated` gives, and what it takes from there to the signal: nothing that was compiled
    before is used."""

    def once():
        start = time.perf_counter()
        sim = simulated()
        trace(sim, key)
        return sim, time.perf_counter() - start

    jax.clear_caches()
    sim, first = once()
    return sim, Cost(first, min(once()[1] for _ in range(repeats)))


def trace(sim: Simulation, key: jax.Array) -> Trace:
    """The signal of a simulation at its own samples."""
    recorder = sim.scenario.recorder
    if not recorder.samples_in_time:
        return Trace(
            np.asarray(sim.scan.time_s(sim.line)),
            _converted_with_bursts(sim, sim.line, sim.signal(), key),
        )
    motion = recorder.motion(sim.line, sim.fine, sim.scan)
    spacing = abs(float(sim.scan.speed_m_per_s)) / recorder.rate_hz(sim.fine, sim.scan)
    samples = Periodic(motion.time_s.size, spacing)
    return Trace(
        np.asarray(motion.time_s),
        _converted_with_bursts(sim, samples, sim.signal_along(motion), key),
    )
