"""Passes of the true sensor over a known input, both ways, and their means."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from srsinv.forward.noise import with_noise
from srsinv.forward.sensor import Sensor
from srsinv.forward.simulation import Simulation
from srsinv.inverse.line.problem import LineProblem


@dataclass(frozen=True)
class KnownPasses:
    """Simulations of the two ways over one known input, without noise."""

    onwards: Simulation
    back: Simulation

    @property
    def pressure_Pa(self) -> Float[np.ndarray, " n"]:
        """The known pressure."""
        return np.asarray(self.onwards.traction(self.onwards.line)[0])

    def means(self, passes: int, key: Array) -> "MeanPasses":
        """Means over so many passes each way, with noise and bursts of their own."""
        rows, power, scatter = [], [], []
        for direction, sim in enumerate((self.onwards, self.back)):
            clean, sign = sim.signal(), 1 - 2 * direction
            keys = jax.random.split(jax.random.fold_in(key, direction), passes)
            each = [with_noise(sim.scenario.noises, sim.line, sim.scan, clean, one) for one in keys]
            signals, spectrum = np.stack([np.asarray(one[0]) for one in each]), each[0][1]
            rows.append(sign * signals.mean(axis=0))
            power.append(np.tile(np.asarray(spectrum), (len(clean), 1)))
            scatter.append(signals - signals.mean(axis=0))
        return MeanPasses(
            np.concatenate(rows), np.concatenate(power), np.concatenate(scatter, axis=1)
        )


@dataclass(frozen=True)
class MeanPasses:
    """Means (row, n) over passes, elements onwards and then back, as if all slid onwards; the
    noise's `power` (row, k) of one pass, and what each pass differs from the mean by (pass, row,
    n)."""

    signal: Float[np.ndarray, "row n"]
    power: Float[np.ndarray, "row k"]
    difference: Float[np.ndarray, "pass row n"]

    @property
    def noise(self) -> Float[np.ndarray, "row k"]:
        """The power of the means' noise; an offset is not known."""
        noise = self.power / len(self.difference)
        noise[:, 0] = np.inf
        return noise

    def problem(self, sim: Simulation, sensor: Sensor) -> LineProblem:
        """The means as signals of a sensor that passes both ways."""
        both = sensor.in_both_directions()
        mean = jnp.mean(sim.traction(sim.line)[0])
        return LineProblem.of_sensor(
            sim.line, both, sim.scan, self.signal, self.noise, known_mean_Pa=(mean, None)
        )

    def repeating_share(self, left: Float[np.ndarray, "row n"]) -> float:
        """How much of what a model leaves of the means repeats from pass to pass: its power less
        that of what passes differ by, of single passes of the noise as stated."""
        passes = len(self.difference)
        noise = 1.0 if passes == 1 else self._over_noise(self.difference) * passes / (passes - 1)
        return max(1 - noise / (passes * self._over_noise(left)), 0.0)

    def _over_noise(self, signal: Float[np.ndarray, "*pass row n"]) -> float:
        n = signal.shape[-1]
        power = np.abs(np.fft.rfft(signal)[..., 1:]) ** 2 / n
        return float(np.mean(power / self.power[:, 1:]))
