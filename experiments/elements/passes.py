"""Passes of elements along the travel over a scene, with bursts whose truth is known.

Bursts are summed one by one in time, at places and times that are on no grid, from each film's own
response to the patch. The inversion has them by spectra and by a table over the contact.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from srsinv.compiled import compiled
from srsinv.forward.film import Film
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import FilmSignal, Sensor
from srsinv.grid import Line, as_real

TOGETHER = 32
LASTING = 30.0  # decays, after which a burst is forgotten


class BurstStatistics(NamedTuple):
    """Statistics of bursts: rate [1/s], rms size [Pa], length of the patch and of the contact [m],
    and shortest and longest decay [s], of equal odds over logarithms between them."""

    rate_hz: float
    shear_Pa: float
    patch_m: float
    contact_m: float
    decay_s: tuple[float, float]


class TrueBursts(NamedTuple):
    """Bursts of a pass: beginning [s] from the first sample, place on the finger [m], size
    [Pa] and decay [s], each (burst,)."""

    time_s: np.ndarray
    place_m: np.ndarray
    size_Pa: np.ndarray
    decay_s: np.ndarray


def in_a_row(film: Film, count: int, spacing_m: float) -> tuple[Film, ...]:
    """So many films like this one along the travel, about the sensor's origin."""
    offsets = spacing_m * (np.arange(count) - (count - 1) / 2)
    return tuple(dataclasses.replace(film, offset_m=as_real(offset)) for offset in offsets)


def drawn_bursts(
    rng: np.random.Generator, statistics: BurstStatistics, seconds: float
) -> TrueBursts:
    """Bursts of a pass that takes so long, in the order of time."""
    count = rng.poisson(statistics.rate_hz * seconds)
    half, (shortest, longest) = statistics.contact_m / 2, np.log(statistics.decay_s)
    return TrueBursts(
        np.sort(rng.uniform(0, seconds, count)),
        rng.uniform(-half, half, count),
        rng.normal(0, statistics.shear_Pa, count),
        np.exp(rng.uniform(shortest, longest, count)),
    )


def burst_signals(
    bursts: TrueBursts, patch_m: float, sensor: Sensor, line: Line, scan: ConstantSpeed
) -> Float[np.ndarray, "e n"]:
    """Signals of a current amplifier, samples in the order of x: means over the interval before
    each of them. What lasts beyond the last sample goes on at the first."""
    interval = float(line.cell_m) / abs(float(scan.speed_m_per_s))
    seconds = line.n * interval
    if not len(bursts.place_m):
        return np.zeros((len(sensor.elements), line.n))
    count = len(bursts.place_m)
    padded = np.zeros(TOGETHER * -(-count // TOGETHER))  # one program for many numbers of bursts
    padded[:count] = bursts.place_m
    response = np.asarray(_responses(sensor.charge(), as_real(padded), as_real(patch_m)))
    response = response[:, :count]
    age = np.arange(line.n)[:, None] * interval - bursts.time_s
    charge = np.zeros((len(sensor.elements), line.n))
    for _ in range(1 + int(LASTING * bursts.decay_s.max() / seconds)):
        left = np.where(age >= 0, np.exp(-np.maximum(age, 0) / bursts.decay_s), 0.0)
        charge = charge + (response * bursts.size_Pa) @ left.T
        age = age + seconds
    left = np.where(age >= 0, np.exp(-np.maximum(age, 0) / bursts.decay_s), 0.0)
    charge = charge + (response * bursts.size_Pa) @ left.T
    gain = float(sensor.amplifier.at_speed(jnp.abs(scan.speed_m_per_s))) / float(line.cell_m)
    signal = gain * (charge - np.roll(charge, 1, axis=-1))
    return signal if float(scan.speed_m_per_s) > 0 else signal[:, ::-1]


@compiled
def _responses(
    charge: FilmSignal, place_m: Float[Array, " burst"], patch_m: Float[Array, ""]
) -> Float[Array, "e burst"]:
    """Charge [C/Pa] per unit shear on patches at these places."""
    return charge.cell_response(-place_m, patch_m)[:, 1]
