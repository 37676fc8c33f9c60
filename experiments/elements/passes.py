"""Passes of elements along the travel over a scene, with bursts whose truth is known.

Bursts are summed one by one in time, at places and times that are on no grid, from each film's own
response to the patch. The inversion has them by spectra and by a table over the contact.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from srsinv.forward.film import Film
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Line, as_real

LASTING = 30.0  # decays, after which a burst is forgotten


class BurstStatistics(NamedTuple):
    """Statistics of bursts: rate [1/s], rms size [Pa], length of the patch and of the contact [m],
    and decay [s]."""

    rate_hz: float
    shear_Pa: float
    patch_m: float
    contact_m: float
    decay_s: float


class TrueBursts(NamedTuple):
    """Bursts of a pass: beginning [s] from the first sample, place on the finger [m] and size
    [Pa], each (burst,)."""

    time_s: np.ndarray
    place_m: np.ndarray
    size_Pa: np.ndarray


def in_a_row(film: Film, count: int, spacing_m: float) -> tuple[Film, ...]:
    """So many films like this one along the travel, about the sensor's origin."""
    offsets = spacing_m * (np.arange(count) - (count - 1) / 2)
    return tuple(dataclasses.replace(film, offset_m=as_real(offset)) for offset in offsets)


def drawn_bursts(
    rng: np.random.Generator, statistics: BurstStatistics, seconds: float
) -> TrueBursts:
    """Bursts of a pass that takes so long, in the order of time."""
    count = rng.poisson(statistics.rate_hz * seconds)
    half = statistics.contact_m / 2
    return TrueBursts(
        np.sort(rng.uniform(0, seconds, count)),
        rng.uniform(-half, half, count),
        rng.normal(0, statistics.shear_Pa, count),
    )


def burst_signals(
    bursts: TrueBursts, statistics: BurstStatistics, sensor: Sensor, line: Line, scan: ConstantSpeed
) -> Float[np.ndarray, "e n"]:
    """Signals of a current amplifier, samples in the order of x: means over the interval before
    each of them. What lasts beyond the last sample goes on at the first."""
    interval = float(line.cell_m) / abs(float(scan.speed_m_per_s))
    seconds, places = line.n * interval, as_real(bursts.place_m)
    if not len(bursts.place_m):
        return np.zeros((len(sensor.elements), line.n))
    response = np.asarray(sensor.charge().cell_response(-places, as_real(statistics.patch_m))[:, 1])
    age = np.arange(line.n)[:, None] * interval - bursts.time_s
    charge = np.zeros((len(sensor.elements), line.n))
    for _ in range(1 + int(LASTING * statistics.decay_s / seconds)):
        left = np.where(age >= 0, np.exp(-np.maximum(age, 0) / statistics.decay_s), 0.0)
        charge = charge + (response * bursts.size_Pa) @ left.T
        age = age + seconds
    left = np.where(age >= 0, np.exp(-np.maximum(age, 0) / statistics.decay_s), 0.0)
    charge = charge + (response * bursts.size_Pa) @ left.T
    gain = float(sensor.amplifier.at_speed(jnp.abs(scan.speed_m_per_s))) / float(line.cell_m)
    signal = gain * (charge - np.roll(charge, 1, axis=-1))
    return signal if float(scan.speed_m_per_s) > 0 else signal[:, ::-1]
