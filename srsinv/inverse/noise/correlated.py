"""Noise on cells, a white part and one that is correlated along the scan, from the signals alone.

A sliding finger's own noise, mains and a model that is not quite right leave more at short waves
than white noise does. A rule that takes all of it for signal amplifies it by e^(k z). Under a
Gaussian prior of the traction the signals of all elements have at the wavenumber k the covariance

    C(k) = G(k) S(k) G(k)^H + diag(w_e + s_e f(k; l)),

S = R (1 + (k a)^2)^-b the spectra of p and q with their cross spectrum, w_e of white noise and
f = 1 / (1/l^2 + k^2) of noise that is correlated as exp(-|x|/l). The signals' tapered spectra P(k)
have Whittle's likelihood, -sum_k (log det C + tr C^-1 P) (Whittle 1953, Biometrika 40, 337), which
a constant and a trend taken out make a restricted one. Prior and noise are estimated together; the
correlated part is taken up where the likelihood speaks for it. The prior falls as a power of k and
the skin's response as e^(-k z), so that a tail of 1/k^2 below it is no traction.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Complex, Float

from ... import false_alarm
from ...forward.noise import exponential_spectrum
from ...grid import Line
from ...modules import with_fields
from ...recording.noise import ABOVE_CUTOFF, LONG_GAP, filled
from ..line.problem import LineProblem
from .nuisance import scored

BAND = 0.08  # of k z: over it the skin's response changes by a sixth
WIDE = 0.1  # of k: a band's width where noise is all there is
SHORTEST = 64  # cells: a shorter stretch has hardly a wave between its length and the depth
FIRST = 1.5  # waves of a stretch's length: longer ones go with its trend
HANN = 1.5  # wavenumbers of a stretch that a Hann taper makes one of
TAIL = 6.0  # k z at which the correlated part's power is a parameter: the signal is weak there
# Priors of the parameters, of standard deviations in their logarithms, so wide that they decide
# only where the data do not: R, a, b, w and l, and the friction between p and q.
WIDTHS = {"level": 6.0, "length": 2.0, "slope": 0.5, "white": 0.5, "memory": 1.5, "coupling": 2.0}
STEPS = 200


class CorrelatedNoise(NamedTuple):
    """Noise of each element on cells: `white` (e,) and `correlated` (e,), standard deviations in a
    cell, the latter's `length_m` of correlation; `log_odds` of the likelihood with it to that
    without; `strongest_m` (shortest, longest): the waves at which the signal is above it."""

    white: Float[np.ndarray, " e"]
    correlated: Float[np.ndarray, " e"]
    length_m: float
    log_odds: float
    clear_m: tuple[float, float]

    def power(self, line: Line) -> Float[np.ndarray, "e k"]:
        """Its power at the line's wavenumbers."""
        shape = np.asarray(exponential_spectrum(line.k, line.cell_m, self.length_m))
        return self.white[:, None] ** 2 + self.correlated[:, None] ** 2 * shape

    @property
    def warning(self) -> str:
        """What was found, and what it means for the answer."""
        ratio = float(np.sqrt(np.mean(self.correlated**2) / np.mean(self.white**2)))
        shortest, longest = (1e3 * each for each in self.clear_m)
        return (
            f"Noise that is correlated over {1e3 * self.length_m:.2g} mm was found, {ratio:.2g} "
            "times the white noise of a cell, and is in the bands. The signal is above it at waves "
            f"from {shortest:.2g} to {longest:.2g} mm. It may be a misfit of the model: check hum, "
            "clipping, depth and speed."
        )


def with_correlated_noise(problem: LineProblem, depth_m: float) -> LineProblem:
    """The problem with the noise that is found on its signals in place of white noise, and a
    warning; itself where no more than white noise is found. `depth_m` of the film."""
    found = correlated_noise(problem, depth_m)
    if found is None:
        return problem
    power = found.power(problem.line)
    power[:, 0] = np.where(problem.has_free_offset, np.inf, power[:, 0])
    warnings = (*problem.warnings, found.warning)
    return with_fields(problem, noise=jnp.asarray(power, problem.noise.dtype), warnings=warnings)


def correlated_noise(problem: LineProblem, depth_m: float) -> CorrelatedNoise | None:
    """The noise of signals on cells, their white noise as a first guess; None where its correlated
    part may be chance, and where no stretch is long enough."""
    bands = Bands.of(problem, depth_m)
    if bands is None:
        return None
    alone, both = (_Likelihood(bands, has_tail) for has_tail in (False, True))
    least, most = alone.greatest(), both.greatest()
    log_odds = float(least.fun - most.fun)
    if not log_odds > -np.log(false_alarm.CORRELATED_NOISE):
        return None
    return both.noise(most.x, log_odds)


class Bands(NamedTuple):
    """Spectra of the signals in bands of wavenumbers, in units of the white noise.

    - `kz` (b,): the bands' wavenumbers, in units of the inverse depth; `count` (b,): how many
      independent ones are in each.
    - `power` (b, e, e): the signals' spectra; `gain` (b, e, c): the model's.
    - `white` (e,): the white noise's power in a cell; `cell`: a cell's width in depths.
    """

    kz: Float[np.ndarray, " b"]
    count: Float[np.ndarray, " b"]
    power: Complex[np.ndarray, "b e e"]
    gain: Complex[np.ndarray, "b e c"]
    white: Float[np.ndarray, " e"]
    cell: float
    depth_m: float

    @classmethod
    def of(cls, problem: LineProblem, depth_m: float) -> "Bands | None":
        """Those of a problem; None where no stretch of it is long enough."""
        problem = scored(problem)
        line, elements = problem.line, len(problem.data)
        white = np.broadcast_to(np.asarray(problem.noise, float)[:, -1], elements)
        level = np.sqrt(white)[:, None]
        data = np.where(problem.is_observed, np.asarray(problem.data, float) / level, np.nan)
        if problem.noise_scale is not None:
            typical = np.asarray(problem.noise_scale, float) ** 2
            scale = np.sqrt(np.nanmean(np.where(np.isnan(data), np.nan, typical), axis=1))
            data = data / scale[:, None]
        stretches = list(_stretches(data))
        cells = sum(stop - start for start, stop in stretches)
        if not cells:
            return None
        longest = max(stop - start for start, stop in stretches)
        spectra, kz = _spectra(data, stretches), np.asarray(line.k, float) * depth_m
        gain = np.asarray(problem.forward.circulant().transfer, complex) / level[:, None]
        first = 2 * np.pi * FIRST * depth_m / (longest * float(line.cell_m))
        edges = _edges(kz, first)
        each = [slice(start, stop) for start, stop in zip(edges[:-1], edges[1:], strict=True)]
        middle = [(own.start + own.stop - 1) // 2 for own in each]
        independent = cells / line.n / HANN
        return cls(
            kz[middle],
            np.array([own.stop - own.start for own in each]) * independent,
            np.stack([spectra[..., own].mean(axis=-1) for own in each]),
            np.moveaxis(gain[..., middle], -1, 0),
            white,
            float(line.cell_m) / depth_m,
            depth_m,
        )


def _stretches(data: Float[np.ndarray, "e n"]):
    """Where all elements are there, short gaps aside."""
    at = np.flatnonzero(np.isfinite(data).all(axis=0))
    if not at.size:
        return
    cuts = np.flatnonzero(np.diff(at) > LONG_GAP + 1)
    for start, stop in zip(at[np.append(0, cuts + 1)], at[np.append(cuts, -1)] + 1, strict=True):
        if stop - start >= SHORTEST:
            yield int(start), int(stop)


def _spectra(
    data: Float[np.ndarray, "e n"], stretches: list[tuple[int, int]]
) -> Complex[np.ndarray, "e e k"]:
    """The power of tapered stretches, a constant and a trend taken out of each, at the wavenumbers
    of the whole line; of white noise of one it is one."""
    total, squares = 0.0, 0.0
    for start, stop in stretches:
        taper, slope = np.hanning(stop - start + 2)[1:-1], np.linspace(-1, 1, stop - start)
        shapes = np.stack([taper, taper * slope])
        rows = np.stack([filled(row[start:stop]) for row in data]) * taper
        rows = rows - rows @ np.linalg.pinv(shapes) @ shapes
        whole = np.zeros(data.shape)
        whole[:, start:stop] = rows
        spectrum = np.fft.rfft(whole)
        total = total + spectrum[:, None] * spectrum[None].conj()
        squares += float(taper @ taper)
    return total / squares


def _edges(kz: Float[np.ndarray, " k"], first: float) -> list[int]:
    """Where bands begin, and the last one ends."""
    at = int(np.searchsorted(kz, first))
    edges = [at]
    while at < kz.size:
        width = BAND if kz[at] < ABOVE_CUTOFF else WIDE * kz[at]
        at = max(int(np.searchsorted(kz, kz[at] + width)), at + 1)
        edges.append(at)
    return edges


class _Parameters(NamedTuple):
    """The model's parameters: logarithms of the prior's levels (c,), length and slope, of the white
    noise (e,), and of the tail (e,) and its memory; `coupling`, the area tangent of p's and q's
    coherence. Powers are in units of a first guess."""

    level: Float[np.ndarray, " c"]
    coupling: Float[np.ndarray, " pair"]
    length: float
    slope: float
    white: Float[np.ndarray, " e"]
    tail: Float[np.ndarray, " tail"]
    memory: float


class _Likelihood:
    """Minus the logarithm of the likelihood of bands, and its slopes, with a correlated part or
    without one."""

    def __init__(self, bands: Bands, has_tail: bool):
        self._bands, self._has_tail = bands, has_tail
        self._elements, self._unknowns = bands.gain.shape[1:]
        self._own = np.arange(self._elements)
        own = np.einsum("bee->b", bands.power).real - self._elements
        signal = max(float(bands.count @ np.maximum(own, 0.0)), 1e-3)
        gains = np.sum(np.abs(bands.gain) ** 2, axis=1) / (1 + bands.kz[:, None] ** 2)
        self._unit = signal / np.maximum(bands.count @ gains, np.finfo(float).tiny)
        self._wave = 4 / bands.cell**2 * np.sin(np.minimum(bands.kz * bands.cell, np.pi) / 2) ** 2

    def greatest(self):
        """The search from a few starts, of the tail's level and memory."""
        starts = [(-3.0, -1.0), (1.0, -1.0), (1.0, 1.0)] if self._has_tail else [(0.0, 0.0)]
        e, c, tail = self._elements, self._unknowns, self._elements * self._has_tail
        bounds = [
            *[(-20.0, 20.0)] * c, *[(-4.0, 4.0)] * (c == 2), (-2.5, 3.0), (-1.0, 1.2),
            *[(-3.0, 2.0)] * e, *[(-9.0, 18.0)] * tail, *[(-3.0, 5.0)] * self._has_tail,
        ]  # fmt: skip
        ends = [
            scipy.optimize.minimize(
                self, np.concatenate([np.zeros(c + (c == 2) + 2 + e), np.full(tail, level),
                                      np.full(int(self._has_tail), memory)]),
                jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS},
            )
            for level, memory in starts
        ]  # fmt: skip
        return min(ends, key=lambda end: end.fun)

    def noise(self, x: Float[np.ndarray, " parameter"], log_odds: float) -> CorrelatedNoise:
        """The noise of these parameters."""
        of, bands = self._parted(x), self._bands
        length = float(np.exp(of.memory))
        tail, signal = self._tail(of), np.einsum("bee->be", self._signal(of)[0]).real
        # Over cells: s^2 times the spectrum is the tail where the correlation is short of them.
        at_tail = np.exp(of.tail) * (1 / length**2 + TAIL**2) * bands.cell * length / 2
        clear = np.flatnonzero(np.any(signal > tail, axis=1))
        ends = clear[[-1, 0]] if clear.size else np.array([0, 0])
        shortest, longest = 2 * np.pi * bands.depth_m / bands.kz[ends]
        return CorrelatedNoise(
            np.sqrt(bands.white * np.exp(of.white)),
            np.sqrt(bands.white * at_tail),
            length * bands.depth_m,
            log_odds,
            (float(shortest), float(longest)),
        )

    def __call__(self, x: Float[np.ndarray, " parameter"]) -> tuple[float, np.ndarray]:
        bands, of = self._bands, self._parted(x)
        covariance, root, shape, slopes = self._signal(of)
        white, tail = np.exp(of.white), self._tail(of)
        covariance[:, self._own, self._own] += white + tail
        inverse = np.linalg.inv(covariance)
        _, logs = np.linalg.slogdet(covariance)
        fitted = inverse @ bands.power
        value = float(bands.count @ (logs + np.einsum("bee->b", fitted).real))
        weight = bands.count[:, None, None] * (inverse - fitted @ inverse)
        of_noise = np.einsum("bee->be", weight).real
        among = np.einsum("bec,bef,bfd->bcd", bands.gain.conj(), weight, bands.gain).real
        levels = np.einsum("bcd,b->cd", among, shape) * root
        by_shape = np.einsum("bcd,cd->b", among, root) * shape
        coupling = []
        if self._unknowns == 2:
            turn = 1 - np.tanh(of.coupling[0]) ** 2
            size = np.sqrt(root[0, 0] * root[1, 1])
            coupling = [2 * turn * size * float(among[:, 0, 1] @ shape)]
        gradient = np.concatenate([
            levels.sum(axis=1), coupling, by_shape @ np.stack(slopes, axis=1),
            of_noise.sum(axis=0) * white,
            np.einsum("be,be->e", of_noise, tail)[: len(of.tail)],
            self._by_memory(of, of_noise * tail),
        ])  # fmt: skip
        prior, prior_slope = self._prior(of)
        return value + prior, gradient + prior_slope

    def _parted(self, x: np.ndarray) -> _Parameters:
        e, c = self._elements, self._unknowns
        sizes = [c, int(c == 2), 1, 1, e, e * self._has_tail, int(self._has_tail)]
        level, coupling, length, slope, white, tail, memory = np.split(x, np.cumsum(sizes)[:-1])
        return _Parameters(
            level, coupling, float(length[0]), float(slope[0]), white, tail,
            float(memory[0]) if self._has_tail else 0.0,
        )  # fmt: skip

    def _signal(self, of: _Parameters):
        """The signals' covariance (b, e, e), the prior's R (c, c), its shape (b,), and the slopes
        of the shape's logarithm by a's and b's (b,) each."""
        scale, gain = np.sqrt(self._unit * np.exp(of.level)), self._bands.gain
        root = np.outer(scale, scale)
        if self._unknowns == 2:
            coherence = np.tanh(of.coupling[0])
            root = root * np.array([[1.0, coherence], [coherence, 1.0]])
        square, slope = np.exp(2 * of.length), np.exp(of.slope)
        waves = square * self._bands.kz**2
        log_shape = -slope * (np.log1p(waves) - np.log1p(square))
        by_length = -2 * slope * (waves / (1 + waves) - square / (1 + square))
        shape = np.exp(log_shape)
        covariance = np.einsum("bec,cd,bfd,b->bef", gain, root, gain.conj(), shape)
        return covariance, root, shape, (by_length, log_shape)

    def _tail(self, of: _Parameters) -> Float[np.ndarray, "b #e"]:
        """The power of the correlated part."""
        if not self._has_tail:
            return np.zeros((len(self._wave), 1))
        rate = np.exp(-2 * of.memory)
        return (rate + TAIL**2) / (rate + self._wave)[:, None] * np.exp(of.tail)

    def _by_memory(self, of: _Parameters, weighed: Float[np.ndarray, "b e"]) -> list[float]:
        if not self._has_tail:
            return []
        rate = np.exp(-2 * of.memory)
        slope = 2 * rate * (1 / (rate + self._wave) - 1 / (rate + TAIL**2))
        return [float(weighed.sum(axis=1) @ slope)]

    def _prior(self, of: _Parameters) -> tuple[float, np.ndarray]:
        widths = [np.full(np.size(each), WIDTHS.get(name, np.inf))
                  for name, each in zip(of._fields, of, strict=True)]  # fmt: skip
        kept = slice(None) if self._has_tail else slice(-1)
        width = np.concatenate(widths)[kept]
        x = np.concatenate([np.ravel(each) for each in of])[kept]
        return float(np.sum((x / width) ** 2) / 2), x / width**2
