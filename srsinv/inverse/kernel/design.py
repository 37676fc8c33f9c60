"""The signals that kernels make over a known input, on the cells of a line.

Element e passed in the directions s = +1 and -1 has the signals

    y_es(x) = g d/dx [K_ep * p + s mu K_eq * p](x) + noise,

linear in the kernels K_ep and K_eq. Nothing is divided by the input's spectrum, which has zeros.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float

from ...forward.film import Film
from ...forward.measured import MeasuredFilm
from ...forward.scan import ConstantSpeed
from ...forward.sensor import Sensor
from ...grid import Open, as_real
from ...numerics import fast_length
from ..line.gaps import Gaps
from ..line.problem import LineProblem
from ..line.transforms import from_spectrum, to_spectrum
from ..noise.nuisance import Nuisance
from ..noise.whitener import NoisePrecision
from .lags import Lags

Rows = Float[np.ndarray, "row n"]


@dataclass(frozen=True)
class KnownInput:
    """Signals of a sensor on the cells of a line over a pressure `p` (n,) [Pa] with the shear
    mu p. `stated`: how many of each element's effects are those of the sensor as stated, and so in
    its kernel; those after them are of the recording, as are the filters."""

    problem: LineProblem
    sensor: Sensor
    scan: ConstantSpeed
    pressure_Pa: Float[np.ndarray, " n"]
    friction: float
    stated: Sequence[int]

    def rows_of(self, element: int) -> list[int]:
        """The rows of the signals of one element: one for each direction of motion."""
        films = self.sensor.elements
        onwards = sum(not film.is_backward for film in films)
        return [row for row in range(len(films)) if row % onwards == element]

    @cached_property
    def _recorded(self) -> tuple[Film, ...]:
        """The films as they are read at the scan's speed."""
        return self.sensor.output(self.scan).elements

    def recorded_alike(self, row: int) -> tuple:
        """What tells the signals of a kernel at this row from those at others."""
        return tuple(map(repr, self._recorded[row].effects[self.stated[row] :]))

    @property
    def effective_friction(self) -> float:
        """q over p of the passes onwards, or of all where they go one way."""
        return self.friction * float(self.scan.direction)

    def signals(
        self, lags: Lags, kernels: Float[np.ndarray, "b m"], row: int
    ) -> Float[np.ndarray, "b n"]:
        """The signals at one row of kernels, under the pressure."""
        line = self.problem.line
        is_open = isinstance(line, Open)
        length = fast_length(2 * line.n) if is_open else line.n
        cell = float(line.cell_m)
        k = 2 * np.pi * np.fft.rfftfreq(length, cell)
        amplifier = self.sensor.amplifier
        gain = float(amplifier.at_speed(self.scan.speed_m_per_s)) * (1j * k) ** amplifier.order
        average = np.sinc(k * cell / 2 / np.pi)
        factor = gain * self._later(row, k)
        factor = factor * (average if is_open else 1 / average)
        if not is_open and length % 2 == 0:
            factor[-1] = 0.0  # beyond every kernel
        load = np.fft.rfft(self.pressure_Pa, length)
        return np.fft.irfft(lags.spectrum(kernels, k) * factor * load, length)[:, : line.n]

    def _later(self, row: int, k: Float[np.ndarray, " k"]) -> Complex[np.ndarray, " k"]:
        """What recording makes of a kernel: the mean over a cell, and the filters' lag."""
        factor = np.ones(k.size, complex)
        for effect in self._recorded[row].effects[self.stated[row] :]:
            factor = factor * np.asarray(effect.transfer(as_real(k)))
        return factor

    def shear(self, row: int) -> float:
        """The factor on the kernel of q: mu, with the sign of the row's direction of motion."""
        is_backward = self.sensor.elements[row].is_backward
        return -self.effective_friction if is_backward else self.effective_friction


def stated_effects(films: Sequence[Film], stated: Sequence[Film]) -> list[int]:
    """How many of the effects of each film, there for each way, are those of the sensor as
    stated."""
    return [
        film.stated_effects
        if isinstance(film, MeasuredFilm)
        else len(stated[row % len(stated)].effects)
        for row, film in enumerate(films)
    ]


class Weights:
    """The noise's inverse covariance on the signals of a problem, nuisance included."""

    def __init__(self, problem: LineProblem):
        precision = NoisePrecision(problem, Gaps.of(problem.is_observed))
        has_columns = problem.nuisance is not None
        self.weigh = Nuisance(problem, precision).weigh if has_columns else precision
        is_whole = problem.noise_scale is None and problem.observed is None and not has_columns
        self.spectrum = np.asarray(problem.whitener, float) ** 2 if is_whole else None

    def __call__(self, signals: Float[np.ndarray, "b row n"]) -> Float[np.ndarray, "b row n"]:
        """R^-1 y of several signals at once."""
        if self.spectrum is None:
            return np.stack([self.weigh(each) for each in signals])
        return from_spectrum(to_spectrum(signals) * self.spectrum, signals.shape[-1])
