"""Signals of one burst.

A burst that begins at the time t at the place y on the finger is a jump of the shear on one patch,
which decays over tau. Its first sample m has what is left of it, a = s exp(-(m dt - t)/tau), s its
size. Samples are means over the interval dt, so that t within it cannot be known: the data
determine a and m. All elements record the burst, b = a R(y) h_tau(j - m): R(y) (e,) their
responses to a patch at y, h_tau the same decay through the amplifier and the filters.

Everything else is in everything.py.
"""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Complex, Float
from scipy.interpolate import CubicSpline

from ...compiled import compiled
from ...errors import refuse
from ...forward.film import Film, SampleAverage
from ...forward.sensor import Sensor
from ...forward.snap_back import SnapBackNoise, relaxing
from ...grid import as_real
from ..line.problem import LineProblem

SHORTEST = 0.1  # of the interval, below which all that is known of a decay is that it is short
UNUSUAL = 0.05  # a cell's noise differs so much where it lacks samples, or the speed varies
PLACES = 401  # of the contact, at which responses are computed: a spline is between them


class BurstModel:
    """What one burst gives, in the order of time.

    - `elements`: their number; `interval_s`: between samples; `n`: number of samples; `seconds`:
      that were recorded; `contact_m`: of places on the finger, about the sensor's origin;
      `decay_s`: shortest and longest decay.
    """

    def __init__(
        self, problem: LineProblem, patch_m: float, contact_m: float, decay_s: tuple[float, float]
    ):
        sensor, scan = problem.sensor, problem.scan
        assert sensor is not None
        assert scan is not None
        self.elements, self.n = len(sensor.elements), problem.line.n
        self.interval_s = 1 / float(scan.sample_rate_hz(problem.line))
        refuse(
            decay_s[1] < SHORTEST * self.interval_s,
            f"method.bursts.decay_s ends at {decay_s[1]:.3g} s, but samples are "
            f"{self.interval_s:.3g} s apart, so no size follows: give a longer decay.",
        )
        self.seconds = float(np.sum(problem.observed_cells)) * self.interval_s
        self.contact_m, self.decay_s = contact_m, decay_s
        typical = float(np.sqrt(decay_s[0] * decay_s[1]))
        # A mean of samples is one over time: the patch stays where it is on the finger.
        sensor = sensor.with_films(_without_average)
        self._unit = SnapBackNoise.recorded_by(sensor, 1.0, 1.0, patch_m, typical, contact_m)
        self._recorded = np.asarray(self._unit.recorded(problem.line, scan))
        self._angle = 2 * np.pi * np.arange(self.n // 2 + 1) / self.n
        places = np.linspace(-contact_m / 2, contact_m / 2, PLACES)
        self._at = CubicSpline(places, np.asarray(_responses(self._unit, as_real(places))), axis=-1)
        self._slope = self._at.derivative()

    def responses(self, place_m: np.ndarray) -> Float[np.ndarray, "e place"]:
        """R [C/Pa] at places on the finger."""
        return self._at(place_m)

    def slopes(self, place_m: np.ndarray) -> Float[np.ndarray, "e place"]:
        """dR/dy [C/Pa/m]."""
        return self._slope(place_m)

    def decaying(self, decay_s: np.ndarray) -> Complex[np.ndarray, "decay k"]:
        """The spectra of h for these decays, of a jump in the first sample."""
        ratio = self.interval_s / np.atleast_1d(decay_s)[:, None]
        return relaxing(self._angle, ratio, self._unit.is_rate) * self._recorded

    def sample(self, sample: int) -> Complex[np.ndarray, " k"]:
        """The factor on a spectrum of what begins in this sample in place of the first."""
        return np.exp(-1j * self._angle * sample)

    def decays(self, count: int) -> Float[np.ndarray, " decay"]:
        """So many decays of the range, the shortest and the longest among them."""
        return np.geomspace(self.decay_s[0], self.decay_s[1], count)

    def left(self, decay_s: Any) -> Any:
        """Root of the mean square of exp(-age/decay), over ages within an interval."""
        twice = 2 * self.interval_s / decay_s
        return np.sqrt(-np.expm1(-twice) / twice)

    def small_bursts(self) -> tuple[Float[np.ndarray, "e e"], Float[np.ndarray, " k"]]:
        """Of many small bursts, one a sample of unit size: the mean products of the elements'
        responses, and the power of decays within the range."""
        responses = self.responses(np.linspace(-0.5, 0.5, PLACES) * self.contact_m)
        decay_s = self.decays(8)
        power = np.abs(self.decaying(decay_s)) ** 2 * self.left(decay_s)[:, None] ** 2
        return responses @ responses.T / PLACES, np.mean(power, axis=0)


@compiled
def _responses(unit: SnapBackNoise, place_m: Float[Array, " place"]) -> Float[Array, "e place"]:
    return unit.response(place_m)


def samples_in_a_cell(sensor: Sensor) -> int:
    """The number of samples that a cell's signal is the mean of."""
    effects = sensor.elements[0].effects
    return max((each.count for each in effects if isinstance(each, SampleAverage)), default=1)


def are_usual(problem: LineProblem) -> Bool[np.ndarray, "e n"]:
    """The cells whose noise is that of the others, as they have as many samples."""
    scale = problem.noise_scale
    if scale is None:
        return np.ones(problem.data.shape, bool)
    return np.abs(np.asarray(scale, float) - 1) < UNUSUAL


def _without_average(film: Film) -> Film:
    """The film without means over samples."""
    effects = tuple(each for each in film.effects if not isinstance(each, SampleAverage))
    return film if len(effects) == len(film.effects) else dataclasses.replace(film, effects=effects)
