"""Noise of signals on cells from the signals alone: white, correlated along the scan, drifting.

A sliding finger's own noise and a model that is not quite right leave more at short waves than
white noise does, and a rule that takes all of it for signal amplifies it by e^(k z). Prior and
noise are estimated together (see whittle.py), and a part is taken up where the likelihood speaks
for it. The prior falls as a power of k and the skin's response as e^(-k z), so that a tail of 1/k^2
below it is no traction; and a rate signal falls as k towards long waves, where a walk grows.

The means, slopes and bends of all elements' signals have a covariance that is known then: a
constant or a trend far beyond it is no traction either. Of two elements the traction makes few
combinations, and a constant on both is told from it at a hundredth of the signal.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Complex, Float

from ... import false_alarm
from ...forward.noise import exponential_spectrum
from ...grid import Line, half_spectrum_weights
from ...modules import with_fields
from ..line.problem import LineProblem
from .causes import LikelyCause, causes_of_noise, in_words
from .facts import with_learned_facts
from .model import of_walk
from .trend import SMOOTH, STRAIGHT, trend_columns
from .whittle import (
    TAIL,
    WALK,
    CellSignals,
    Likelihood,
    NoiseParameters,
    SpectralBands,
    mean_square_scale,
)


class CellNoise(NamedTuple):
    """Noise of each element on cells, as standard deviations in the signal's unit.

    - `white` (e,), and `correlated` (e,) over `length_m` along the scan; `walk` (e,): a random
      walk's step from cell to cell; zero of parts that are not there.
    - `degree` of a polynomial on each signal that is to be estimated with the traction; -1 where
      there is none. `trend` (e,): the largest value of one that no traction makes, as a fraction of
      the largest sample; zero where there is none.
    - `clear_m`: the shortest and the longest wave at which the signal is above the noise.
    - `causes`: what may look like the correlated part, the likeliest first.
    """

    white: Float[np.ndarray, " e"]
    correlated: Float[np.ndarray, " e"]
    length_m: float
    walk: Float[np.ndarray, " e"]
    clear_m: tuple[float, float]
    trend: Float[np.ndarray, " e"] = np.zeros(1)
    degree: int = -1
    causes: tuple[LikelyCause, ...] = ()

    def power(self, line: Line) -> Float[np.ndarray, "e k"]:
        """Its power at the line's wavenumbers."""
        shape = np.asarray(exponential_spectrum(line.k, line.cell_m, self.length_m), float)
        walks = np.stack([of_walk(line.n, float(step)) for step in self.walk])
        return self.white[:, None] ** 2 + self.correlated[:, None] ** 2 * shape + walks

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was found, and what it means for the answer."""
        words = []
        if self.correlated.any():
            ratio = float(np.sqrt(np.mean(self.correlated**2) / np.mean(self.white**2)))
            shortest, longest = (1e3 * each for each in self.clear_m)
            words.append(
                f"The noise has a part that is correlated over {1e3 * self.length_m:.2g} mm, "
                f"{ratio:.2g} times the white noise of a cell. The bands include it. The signal "
                f"exceeds it at waves from {shortest:.2g} to {longest:.2g} mm. {self._cause}"
            )
        if self.walk.any():
            words.append(
                "A drift is estimated jointly with the traction, so long waves of the traction are "
                "uncertain. Scan back and forth to separate the two."
            )
        if self.trend.any():
            shape = "A constant or a slope" if self.degree <= STRAIGHT else "A smooth trend"
            words.append(
                f"{shape} of up to {float(self.trend.max()):.2g} of the largest sample is on the "
                "signal, and no traction explains it. It is estimated jointly with the traction, "
                "so long waves of the traction are uncertain. If it is a drift, give "
                "recording.drift=auto."
            )
        return tuple(words)

    @property
    def _cause(self) -> str:
        if self.causes:
            return f"An error of the model explains it as well: {in_words(self.causes)}."
        return (
            "It may be an error of the model, but no single gain, depth, angle, offset, low-pass "
            "or saturation explains it."
        )


def with_found_noise(
    problem: LineProblem, depth_m: float, is_drifting: bool = False
) -> LineProblem:
    """The problem with the noise that is found on its signals, a trend among its nuisance and
    warnings; itself where no more than white noise is found.

    - `depth_m` of the film. `is_drifting`: whether a drift is known to be there.
    """
    problem = with_learned_facts(problem, depth_m, is_drifting)
    found = cell_noise(problem, depth_m, is_drifting)
    if found is None:
        return problem
    power = found.power(problem.line) / mean_square_scale(problem)[:, None]  # which is on it
    power[:, 0] = np.where(problem.has_free_offset, np.inf, power[:, 0])
    changed = {"noise": jnp.asarray(power, problem.noise.dtype)}
    if found.degree >= 0:
        problem = with_trend(problem, found.degree)
    return with_fields(problem, **changed, warnings=(*problem.warnings, *found.warnings))


def with_trend(problem: LineProblem, degree: int = SMOOTH) -> LineProblem:
    """The problem with polynomials of so many degrees among the nuisance of each element."""
    cells = np.flatnonzero(problem.observed_cells)
    along = np.interp(np.arange(problem.line.n), cells[[0, -1]], [-1.0, 1.0])
    y = np.where(problem.is_observed, np.asarray(problem.data, float), np.nan)
    own = trend_columns(y, along, degree, problem.has_free_offset)
    others = [] if problem.nuisance is None else [np.asarray(problem.nuisance)]
    columns = np.concatenate([*others, own], axis=1)
    return with_fields(problem, nuisance=jnp.asarray(columns, problem.data.dtype))


def cell_noise(problem: LineProblem, depth_m: float, is_drifting: bool = False) -> CellNoise | None:
    """The noise of signals on cells, their white noise as a first guess; None where further parts
    may be chance, and where no stretch is long enough."""
    signals = CellSignals.of(problem, depth_m)
    if not signals.stretches:
        return None
    bands = SpectralBands.of(signals)
    likelihood, of, gained = _likeliest(bands, is_drifting)
    kz = signals.kz[1:]
    spectra = likelihood.signal(of, kz, np.moveaxis(signals.gain[..., 1:], -1, 0))
    noise = sum(likelihood.noise(of, kz), np.zeros(1))
    eye = np.eye(len(signals.white))
    degree, trend = _trend(signals, spectra + noise[..., None] * eye, problem.has_free_offset)
    degree = SMOOTH if is_drifting else degree
    if not (of.tail.size or degree >= 0):
        return None
    is_clear = np.any(np.einsum("kee->ke", spectra).real > noise, axis=1)
    found = _found(signals, of, depth_m, is_clear)._replace(degree=degree, trend=trend)
    if is_drifting or not of.tail.size:
        return found
    return found._replace(causes=causes_of_noise(problem, signals, bands, gained))


def _likeliest(
    bands: SpectralBands, is_drifting: bool
) -> tuple[Likelihood, NoiseParameters, float]:
    """The parts of the noise that the signals speak for, their parameters, and what a correlated
    part gains of the likelihood's logarithm.

    Of a correlated part, chance makes more than g in the likelihood's logarithm with a probability
    of about e^-g. A walk is there where a drift is known to be, and as large as it may be: what may
    be drift is not to be taken for traction. Else a long memory fits as well as a walk does.
    """
    likelihood = Likelihood(bands, False, is_drifting)
    cost, of = likelihood.greatest()
    correlated = Likelihood(bands, True, is_drifting)
    less, other = correlated.greatest(of)
    gained = cost - less
    if gained > -np.log(false_alarm.NOISE_PART):
        likelihood, cost, of = correlated, less, other
    of = likelihood.with_most_walk(of, cost) if is_drifting else of
    return likelihood, of, gained


def _found(
    signals: CellSignals,
    of: NoiseParameters,
    depth_m: float,
    is_clear: Bool[np.ndarray, " k"],
) -> CellNoise:
    """The noise of these parameters, without a trend; `is_clear`: whether the signal is above it at
    `kz[1:]`."""
    none, cell = np.zeros(len(signals.white)), signals.cell
    length = float(np.exp(of.memory[0])) if of.memory.size else 1.0
    # s^2 and d^2 from the powers of exponential_spectrum and of_walk, for waves of many cells.
    tail = np.exp(of.tail) * (1 / length**2 + TAIL**2) * cell * length / 2
    step = np.exp(of.walk) * WALK**2 * cell**2
    clear = np.flatnonzero(is_clear)
    ends = clear[[-1, 0]] if clear.size else np.array([0, 0])
    shortest, longest = (2 * np.pi * depth_m / signals.kz[1:][ends]).tolist()
    return CellNoise(
        np.sqrt(signals.white * np.exp(of.white)),
        np.sqrt(signals.white * tail) if of.tail.size else none,
        length * depth_m,
        np.sqrt(signals.white * step) if of.walk.size else none,
        (shortest, longest),
    )


def _trend(
    signals: CellSignals, spectra: Complex[np.ndarray, "k e e"], has_free_offset: bool
) -> tuple[int, Float[np.ndarray, " e"]]:
    """The degree of a polynomial that is on the signals, where traction and noise of these
    `spectra` at `kz[1:]` do not make their mean or slope, and its largest value on each as a
    fraction of the largest sample; -1 and zero where they may. What has a slope may bend."""
    rows = signals.filled(signals.longest)
    # Tapered, so that a feature at the ends of the scan, which is cut off there, is little in them.
    taper = np.hanning(rows.shape[1] + 2)[1:-1]
    along = np.linspace(-1, 1, taper.size)
    tested = {0: taper, STRAIGHT: taper * along}
    if has_free_offset:
        del tested[0]
    chance = false_alarm.NOISE_PART / len(tested)
    found = [
        degree
        for degree, shape in tested.items()
        if _is_beyond_chance(signals, rows, spectra, shape, chance)
    ]
    if not found:
        return -1, np.zeros(len(rows))
    degree = SMOOTH if STRAIGHT in found else STRAIGHT
    shapes = np.polynomial.legendre.legvander(along, degree).T[int(has_free_offset) :]
    fitted = rows @ np.linalg.pinv(shapes) @ shapes
    return degree, np.max(np.abs(fitted), axis=1) / np.max(np.abs(rows), axis=1)


def _is_beyond_chance(
    signals: CellSignals,
    rows: Float[np.ndarray, "e cell"],
    spectra: Complex[np.ndarray, "k e e"],
    shape: Float[np.ndarray, " cell"],
    chance: float,
) -> bool:
    """Whether the sizes of a shape in all signals are more than these `spectra` make of them but
    by so small a chance."""
    n = signals.data.shape[1]
    whole = np.zeros(n)
    whole[signals.longest] = shape
    power = half_spectrum_weights(n)[1:] * np.abs(np.fft.rfft(whole)[1:]) ** 2
    covariance, sizes = np.einsum("k,kef->ef", power, spectra).real, rows @ shape
    square = sizes @ np.linalg.pinv(covariance, hermitian=True) @ sizes
    return bool(square > scipy.special.chdtri(sizes.size, chance))
