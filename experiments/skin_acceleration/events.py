"""Events that a finger detects, by matched filters of its films and of its accelerometer.

A first contact is a rise of the pressure on the whole contact, a slip onset a fall of its shear, a
burst a jump of the shear on one patch while the finger slides over a texture. The signal of each is
known but for its size and sign; the noise is the sensors' own, and the texture's, which both have
in common.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Complex, Float

from srsinv.forward.filter import filtered
from srsinv.forward.skin_accelerometer import AXES, envelope_integral
from srsinv.forward.vibration import gain_at_rest
from srsinv.grid import Line, as_real, half_spectrum_weights

from .scans import Finger

DETECTORS: Mapping[str, tuple[str, ...]] = {  # and the sensors of each
    "film": ("film",),
    "normal accelerometer": ("normal",),
    "tangential accelerometer": ("tangential",),
    "film and normal": ("film", "normal"),
    "film and tangential": ("film", "tangential"),
}
EVENTS = {"first contact": 0, "slip onset": 1, "burst": 1}  # and the component that changes
FINE = 16  # points of an event's course in time in each sampling interval
PLACES = 40  # of contacts and of patches; even, as in the middle a film has no signal of shear
SIZES_PA = np.geomspace(1.0, 1e5, 121)


class Detectors(NamedTuple):
    """Matched filters, the contact, and the durations of the events.

    - `false_alarms_per_s`: of each filter, one test for each sample; `detection`: the probability
      at the least size.
    - `off_centre_m`: the middle of the contact is up to so far from the film, either way.
    - `contact_s`, `slip_s`: in which the pressure of a first contact rises, and the shear of a slip
      onset falls.
    """

    false_alarms_per_s: float
    detection: float
    off_centre_m: float
    contact_s: float
    slip_s: float

    def probability(
        self, finger: Finger, texture_power: Float[np.ndarray, " k"], friction: float
    ) -> Float[np.ndarray, "event detector size"]:
        """Probability that an event of each of `SIZES_PA` is detected, the mean over its places.

        `texture_power`: per sample [Pa^2], of the pressure that a burst has to be told from.
        """
        false_alarm = self.false_alarms_per_s / finger.rate_hz
        rows = np.array(["film"] * len(finger.sensor.elements) + list(AXES))
        transfer = finger.transfers(friction)
        common = texture_power[:, None, None] * transfer[:, :, None] * transfer[:, None].conj()
        rms = np.sqrt(half_spectrum_weights(finger.lines[0].n) @ np.real(common[:, 0, 0]))
        film, mass = finger.noise_powers(float(rms))
        own = np.stack([film if row == "film" else mass for row in rows], axis=-1)
        noise = own[:, :, None] * np.eye(rows.size)
        every = []
        for name, signals in _events(finger, self).items():
            covariance = noise + common if name == "burst" else noise + 0j
            for chosen in DETECTORS.values():
                strength = _strength(signals, covariance, np.isin(rows, chosen))
                every.append(_detected(strength, false_alarm))
        return np.reshape(every, (len(EVENTS), len(DETECTORS), SIZES_PA.size))


def least_sizes(
    probability: Float[np.ndarray, "*rows size"], wanted: float
) -> Float[np.ndarray, "*rows"]:
    """The least size [Pa] that is detected with this probability, NaN where none is."""
    flat = probability.reshape(-1, SIZES_PA.size)
    least = [
        np.exp(np.interp(wanted, row, np.log(SIZES_PA))) if row[-1] > wanted else np.nan
        for row in flat
    ]
    return np.reshape(least, probability.shape[:-1])


def _detected(strength: Float[np.ndarray, " place"], false_alarm: float) -> np.ndarray:
    """Probability of an estimate beyond the threshold of either sign, for unit strengths."""
    threshold = scipy.special.ndtri(1 - false_alarm / 2)
    at = SIZES_PA[:, None] * strength
    normal = scipy.special.ndtr
    return np.mean(normal(at - threshold) + normal(-at - threshold), axis=-1)


def _strength(
    signals: Float[np.ndarray, "place row sample"],
    covariance: Complex[np.ndarray, "k row row"],
    chosen: Bool[np.ndarray, " row"],
) -> Float[np.ndarray, " place"]:
    """d' of events of 1 Pa by some of the rows."""
    spectrum = np.moveaxis(np.fft.rfft(signals[:, chosen]), -1, 0)  # k, place, row
    # Scaled: volts and m/s^2 are far from each other.
    inside = covariance[:, chosen][:, :, chosen]
    size = np.sqrt(np.mean(np.real(inside.diagonal(axis1=1, axis2=2)), axis=0))
    inside, spectrum = inside / size / size[:, None], spectrum / size
    solved = np.linalg.solve(inside, np.swapaxes(spectrum, 1, 2))  # k, row, place
    power = np.sum(spectrum.conj() * np.swapaxes(solved, 1, 2), axis=-1).real
    return np.sqrt(half_spectrum_weights(signals.shape[-1]) @ power)


def _events(
    finger: Finger, settings: Detectors
) -> dict[str, Float[np.ndarray, "place row sample"]]:
    """The signals of events of 1 Pa, at places even over where they may be."""
    bursts, contact = finger.bursts, float(finger.accelerometer.contact_m)
    off = np.linspace(-1, 1, PLACES)
    whole = _contact_charge(finger, off * settings.off_centre_m)
    patch = np.asarray(
        finger.sensor.charge().cell_response(as_real(-off * contact / 2), as_real(bursts.patch_m))
    )
    area = np.pi * contact / 4 * float(finger.accelerometer.length_m)
    small = bursts.patch_m * float(finger.accelerometer.length_m)

    def ramp(duration):
        return lambda time: np.clip(time / duration, 0, 1)

    def relaxing(time):
        return np.where(time > 0, np.exp(-np.maximum(time, 0) / bursts.decay_s), 0.0)

    return {
        name: _signals(finger, charge[:, component], force, component, course)
        for (name, component), (charge, force, course) in zip(
            EVENTS.items(),
            [(whole, area, ramp(settings.contact_s)), (whole, area, ramp(settings.slip_s)),
             (patch, small, relaxing)],
            strict=True,
        )
    }  # fmt: skip


def _contact_charge(
    finger: Finger, places_m: Float[np.ndarray, " place"]
) -> Float[np.ndarray, "e c place"]:
    """Every film's charge under Hertz's envelope of 1 Pa of p and of q, its middle at places."""
    line: Line = finger.lines[1]
    middle = line.n // 2
    edges = (jnp.arange(line.n + 1) - middle - 0.5) * line.cell_m
    integral = envelope_integral(edges, finger.accelerometer.contact_m)
    load = jnp.diff(integral) / line.cell_m
    operator, zero = line.operator(finger.sensor.charge()), jnp.zeros_like(load)
    each = [operator(jnp.stack(pair)) for pair in ((load, zero), (zero, load))]
    x = np.asarray((jnp.arange(line.n) - middle) * line.cell_m)
    return np.array(
        [
            [np.interp(-places_m, x, np.asarray(row)) for row in rows]
            for rows in zip(*each, strict=True)
        ]
    )


def _signals(
    finger: Finger,
    charge_C: Float[np.ndarray, "e place"],
    force_N: float,
    component: int,
    course: Callable[[np.ndarray], np.ndarray],
) -> Float[np.ndarray, "place row sample"]:
    """Samples of the films and of an accelerometer of either axis, after an amplifier at rest.

    `course`: the size of a load over the time [s] since the event. A sample of the acceleration is
    the mean over the interval before it, as one of a rate is.
    """
    n, interval = finger.lines[0].n, 1 / finger.rate_hz
    time = interval * (np.arange((n - 1) * FINE + 1) / FINE - n // 4 + 0.5)
    load = course(time)
    amplifier = finger.sensor.amplifier
    reading = np.append(0.0, load[::FINE])
    reading = np.diff(reading) / interval if amplifier.order else reading[1:]
    film = gain_at_rest(amplifier) * reading * charge_C.T[:, :, None]
    film = np.stack([
        np.asarray(filtered(finger.sensor.filters, jnp.asarray(each), as_real(interval)))
        for each in film
    ])  # fmt: skip
    fine = finger.accelerometer.in_time(jnp.asarray(load)[None], as_real(interval / FINE))[0]
    means = np.diff(np.append(0.0, np.cumsum(np.asarray(fine))[::FINE])) / FINE
    mass = np.stack([force_N * means * (component == axis) for axis in range(len(AXES))])
    return np.concatenate([film, np.broadcast_to(mass, (len(film), *mass.shape))], axis=1)
