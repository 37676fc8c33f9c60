"""The likelihood of signals on cells under a prior of the traction and noise of several parts.

The signals of all elements have at the wavenumber k the covariance

    C(k) = G(k) S(k) G(k)^H + diag(w_e + s_e / (1/l^2 + k^2) + d_e / k^2),

S = R (1 + (k a)^2)^-b the spectra of p and q with their cross spectrum, w_e of white noise, s_e of
noise that is correlated as exp(-|x|/l), and d_e of a random walk. Their tapered spectra P(k) have
Whittle's likelihood, -sum_k (log det C + tr C^-1 P) (Whittle 1953, Biometrika 40, 337), which a
constant and a trend taken out make a restricted one.
"""

import itertools
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Complex, Float, Int

from ...recording.noise import ABOVE_CUTOFF, filled, stretches_of
from ..line.problem import LineProblem
from .nuisance import scored
from .quiet import AS_PROBABLE

BAND = 0.08  # of k z: over it the skin's response changes by a sixth
WIDE = 0.1  # of k: a band's width where noise is all there is
SHORTEST = 64  # cells: a shorter stretch has hardly a wave between its length and the depth
FIRST = 1.5  # waves of a stretch's length: longer ones go with its trend
HANN = 1.5  # wavenumbers of a stretch that a Hann taper makes one of
# Of a wave's power, what a Hann taper leaves at its wavenumber and at those beside it. Over these
# the elements' responses differ, so that tapered signals are less coherent.
LOBE = np.array([1.0, 4.0, 1.0]) / 6
TAIL, WALK = 6.0, 1.0  # k z at which the powers of these parts are parameters
STEPS, LONGEST_STEP = 100, 4.0
# Slope by the logarithm of a level at which a search ends; a wavenumber alone makes about one. It
# does not end where values hardly change: there rounding, and so the processor, would decide.
FLAT = 1e-2


class CellSignals(NamedTuple):
    """Signals on cells in units of their white noise, NaN where they are missing.

    - `data` (e, n); `gain` (e, c, k): the model's at `kz` (k,), the wavenumbers in units of the
      inverse depth. `white` (e,): the white noise's power in a cell; `cell`: its width in depths.
    - `stretches`: where all elements are there, short gaps aside.
    """

    data: Float[np.ndarray, "e n"]
    gain: Complex[np.ndarray, "e c k"]
    kz: Float[np.ndarray, " k"]
    white: Float[np.ndarray, " e"]
    cell: float
    stretches: list[slice]

    @classmethod
    def of(cls, problem: LineProblem, depth_m: float) -> "CellSignals":
        """Those of a problem, its nuisance taken out."""
        problem = scored(problem)
        white = np.asarray(problem.noise, float)[:, -1]
        white = white * mean_square_scale(problem)
        level = np.sqrt(white)[:, None]
        data = np.where(problem.is_observed, np.asarray(problem.data, float) / level, np.nan)
        gain = np.asarray(problem.forward.circulant().transfer, complex) / level[:, None]
        kz = np.asarray(problem.line.k, float) * depth_m
        cell = float(problem.line.cell_m) / depth_m
        there = np.isfinite(data).all(axis=0)
        return cls(data, gain, kz, white, cell, stretches_of(np.asarray(there), SHORTEST))

    @property
    def longest(self) -> slice:
        """The longest stretch."""
        return max(self.stretches, key=lambda each: each.stop - each.start)

    def filled(self, stretch: slice) -> Float[np.ndarray, "e cell"]:
        """A stretch, its short gaps filled."""
        return np.stack([filled(row[stretch]) for row in self.data])

    def spectra(self) -> Complex[np.ndarray, "e e k"]:
        """The power of all stretches, tapered, a constant and a trend taken out of each, at the
        wavenumbers of the whole line; of white noise of one it is one."""
        total, squares = 0.0, 0.0
        for stretch in self.stretches:
            size = stretch.stop - stretch.start
            taper, slope = np.hanning(size + 2)[1:-1], np.linspace(-1, 1, size)
            shapes = np.stack([taper, taper * slope])
            rows = self.filled(stretch) * taper
            rows = rows - rows @ np.linalg.pinv(shapes) @ shapes
            whole = np.zeros(self.data.shape)
            whole[:, stretch] = rows
            spectrum = np.fft.rfft(whole)
            total = total + spectrum[:, None] * spectrum[None].conj()
            squares += float(taper @ taper)
        return np.asarray(total / squares)


def mean_square_scale(problem: LineProblem) -> Float[np.ndarray, " e"]:
    """The mean over the samples of each element of the square of the factors on the noise: of a
    mean over K passes 1 / K."""
    if problem.noise_scale is None:
        return np.ones(len(problem.data))
    squares = np.where(problem.is_observed, np.asarray(problem.noise_scale) ** 2, 0.0)
    return squares.sum(axis=1) / np.maximum(problem.is_observed.sum(axis=1), 1)


class SpectralBands(NamedTuple):
    """Spectra in bands of wavenumbers, in units of the white noise: of the signals (b, e, e), and
    of the model (b, 3, e, c) at `around` (b, 3), the wavenumbers of a taper's lobe about `kz` (b,)
    and their `places` (b, 3) on the line's; each band of `weight` (b,) independent wavenumbers."""

    kz: Float[np.ndarray, " b"]
    around: Float[np.ndarray, "b 3"]
    weight: Float[np.ndarray, " b"]
    power: Complex[np.ndarray, "b e e"]
    gain: Complex[np.ndarray, "b 3 e c"]
    cell: float
    places: Int[np.ndarray, "b 3"]

    @classmethod
    def of(cls, signals: CellSignals) -> "SpectralBands":
        """Those of signals that have a stretch."""
        lengths = [stretch.stop - stretch.start for stretch in signals.stretches]
        edges = _edges(signals.kz, 2 * np.pi * FIRST / (max(lengths) * signals.cell))
        each = [slice(start, stop) for start, stop in itertools.pairwise(edges)]
        middle = np.array([(own.start + own.stop - 1) // 2 for own in each])
        n = signals.data.shape[1]
        beside = round(n / max(lengths)) * np.array([-1, 0, 1])
        around = np.clip(middle[:, None] + beside, 0, signals.kz.size - 1)
        independent = sum(lengths) / n / HANN
        spectra = signals.spectra()
        return cls(
            signals.kz[middle],
            signals.kz[around],
            np.array([own.stop - own.start for own in each]) * independent,
            np.stack([spectra[..., own].mean(axis=-1) for own in each]),
            at_bands(signals.gain, around),
            signals.cell,
            around,
        )

    def with_gain(self, signals: CellSignals) -> "SpectralBands":
        """The same spectra under the model of other signals."""
        return self._replace(gain=at_bands(signals.gain, self.places))


def at_bands(
    gain: Complex[np.ndarray, "e c k"], places: Int[np.ndarray, "b 3"]
) -> Complex[np.ndarray, "b 3 e c"]:
    return np.moveaxis(gain[..., places], (-2, -1), (0, 1))


def _edges(kz: Float[np.ndarray, " k"], first: float) -> list[int]:
    """Where bands begin, and the last one ends."""
    at = int(np.searchsorted(kz, first))
    edges = [at]
    while at < kz.size:
        width = BAND if kz[at] < ABOVE_CUTOFF else WIDE * kz[at]
        at = max(int(np.searchsorted(kz, kz[at] + width)), at + 1)
        edges.append(at)
    return edges


class NoiseParameters(NamedTuple):
    """The model's parameters: logarithms of the prior's levels (c,), its length and slope (1,), of
    the white noise (e,), of the correlated part (e,) at `TAIL` and its memory (1,), and of the walk
    (e,) at `WALK`; `coupling` (1,), the area tangent of p's and q's coherence; `facts` (j,), how
    far those of the rig are off, of variance one. Those of parts that are not in the model are
    empty. Powers are in units of a first guess."""

    level: Any
    coupling: Any
    length: Any
    slope: Any
    facts: Any
    white: Any
    tail: Any
    memory: Any
    walk: Any


# Standard deviations of Gaussian priors about zero, so wide that they decide only where the data do
# not.
WIDTHS = NoiseParameters(6.0, 2.0, 2.0, 0.5, 1.0, 0.5, 10.0, 1.5, 10.0)
FACTS = NoiseParameters._fields.index("facts")
START = {"tail": 1.0, "memory": -1.0, "walk": 4.0}
RAISED, MOST_RAISED = 1.0, 30  # logarithm of a walk's power, by steps


class Likelihood:
    """Minus the logarithm of the likelihood of bands and of its priors, with its slopes; of noise
    with a correlated part (`has_tail`) and with a walk (`has_walk`), or without.

    - `unit` (c,): of the prior's levels; None: that of these bands.
    - `facts`: what one standard deviation of each fact of the rig changes of the bands' gain.
    """

    def __init__(
        self,
        bands: SpectralBands,
        has_tail: bool,
        has_walk: bool,
        unit: Float[np.ndarray, " c"] | None = None,
        facts: Complex[np.ndarray, "b 3 j e c"] | None = None,
    ):
        self._facts = np.zeros((*bands.gain.shape[:2], 0, 1, 1)) if facts is None else facts
        self._bands = bands
        self._elements, self._unknowns = e, c = bands.gain.shape[2:]
        self._sizes = NoiseParameters(
            c, int(c == 2), 1, 1, self._facts.shape[2], e, e * has_tail, int(has_tail), e * has_walk
        )  # fmt: skip
        own = np.einsum("bee->b", bands.power).real - e
        signal = max(float(bands.weight @ np.maximum(own, 0.0)), 1e-3)
        gains = np.sum(np.abs(bands.gain[:, 1]) ** 2, axis=1) / (1 + bands.kz[:, None] ** 2)
        largest = np.maximum(bands.weight @ gains, np.finfo(float).tiny)
        self.unit = signal / largest if unit is None else unit
        self._width = self._row(WIDTHS)

    def greatest(self, alone: NoiseParameters | None = None) -> tuple[float, NoiseParameters]:
        """Minus the logarithm of the greatest likelihood, and its parameters; `alone`: those of
        fewer parts, to start from."""
        first = NoiseParameters(*np.zeros(len(WIDTHS))) if alone is None else alone
        return self._search(self._row(first._replace(**START)))

    def posterior(self, of: NoiseParameters) -> Float[np.ndarray, "j j"]:
        """The covariance of the facts of the rig about the greatest likelihood's parameters, by
        Fisher's information."""
        covariance = np.linalg.inv(self(np.concatenate(of))[2])
        first = sum(self._sizes[:FACTS])
        own = slice(first, first + self._sizes.facts)
        return covariance[own, own]

    def with_most_walk(self, of: NoiseParameters, cost: float) -> NoiseParameters:
        """The parameters with as large a walk as the signals do not speak against, from those of
        the greatest likelihood and minus its logarithm."""
        for _ in range(MOST_RAISED):
            raised = of._replace(walk=of.walk + RAISED)
            more, found = self._search(np.concatenate(raised), holds_walk=True)
            if more - cost > AS_PROBABLE:
                break
            of = found
        return of

    def _search(
        self, start: Float[np.ndarray, " m"], holds_walk: bool = False
    ) -> tuple[float, NoiseParameters]:
        """Minus the logarithm of the greatest likelihood, and its parameters, from a start on; the
        walk, which comes last, is as it starts where it is held."""
        free = start.size - self._sizes.walk * holds_walk

        @lru_cache(maxsize=2)
        def at(x: tuple[float, ...]) -> tuple[float, np.ndarray, np.ndarray]:
            value, slope, curvature = self(np.append(x, start[free:]))
            return value, slope[:free], curvature[:free, :free]

        end = scipy.optimize.minimize(
            lambda x: at(tuple(x))[0],
            start[:free],
            jac=lambda x: at(tuple(x))[1],
            hess=lambda x: at(tuple(x))[2],
            method="trust-exact",
            options={"gtol": FLAT, "maxiter": STEPS, "max_trust_radius": LONGEST_STEP},
        )
        return float(end.fun), self._parted(np.append(end.x, start[free:]))

    def __call__(
        self, x: Float[np.ndarray, " m"]
    ) -> tuple[float, Float[np.ndarray, " m"], Float[np.ndarray, "m m"]]:
        """The value, its slope, and its curvature as expected (Fisher's information)."""
        weight, of = self._bands.weight, self._parted(x)
        covariance, changes = self._covariance(of)
        inverse = np.linalg.inv(covariance)
        fitted = inverse @ self._bands.power
        logs = np.linalg.slogdet(covariance)[1] + np.einsum("bee->b", fitted).real
        moved = inverse @ changes
        rows = moved.reshape(x.size, -1)
        columns = (weight[:, None, None] * moved).swapaxes(-1, -2).reshape(x.size, -1)
        left = weight[:, None, None] * (np.eye(self._elements) - fitted.swapaxes(-1, -2))
        slope = np.einsum("mbef,bef->m", moved, left).real
        value = float(weight @ logs + np.sum((x / self._width) ** 2) / 2)
        curvature = (rows @ columns.T).real + np.diag(1 / self._width**2)
        return value, slope + x / self._width**2, curvature

    def _covariance(
        self, of: NoiseParameters
    ) -> tuple[Complex[np.ndarray, "b e e"], Complex[np.ndarray, "m b e e"]]:
        """The signals' covariance, and its derivatives by the parameters."""
        kz, e, c = self._bands.kz, self._elements, self._unknowns
        gain = self._bands.gain + np.einsum("bljec,j->blec", self._facts, of.facts)
        root, (shape, by_shape) = self._root(of), prior_shape(of, self._bands.around)
        lobes, scales = LOBE * shape, np.sqrt(np.diag(root))
        # Half of the signal of each component with all others, and the friction between two.
        parts = [root * (one[:, None] + one) / 2 for one in np.eye(c)]
        if c == 2:
            cross = scales[0] * scales[1] * (1 - np.tanh(of.coupling[0]) ** 2)
            parts.append(cross * (1 - np.eye(2)))
        each = np.einsum("bjec,mcd,bjfd->mjbef", gain, np.stack(parts), gain.conj())
        by_root = np.einsum("mjbef,bj->mbef", each, lobes)
        whole = each[:c].sum(axis=0)
        signal = by_root[:c].sum(axis=0)
        of_shape = np.einsum("jbef,bj,bjm->mbef", whole, lobes, by_shape)
        moved = np.einsum("bljec,cd,blfd,bl->jbef", self._facts, root, gain.conj(), lobes)
        by_facts = moved + moved.swapaxes(-1, -2).conj()
        rate = np.exp(-2 * np.sum(of.memory))
        by_memory = 2 * rate * (1 / (rate + self._waves(kz)) - 1 / (rate + TAIL**2))
        own = np.eye(e)[:, None, :, None] * np.eye(e)
        white, tail, walk = (
            own * np.broadcast_to(part, (kz.size, e))[..., None] for part in self.noise(of, kz)
        )
        changes = np.concatenate([
            by_root, of_shape, by_facts, white,
            tail[: of.tail.size],
            *[[tail.sum(axis=0) * by_memory[:, None, None]]] * of.memory.size,
            walk[: of.walk.size],
        ])  # fmt: skip
        return signal + (white + tail + walk).sum(axis=0), changes

    def signal(
        self, of: NoiseParameters, kz: Float[np.ndarray, " k"], gain: Complex[np.ndarray, "k e c"]
    ) -> Complex[np.ndarray, "k e e"]:
        """The spectra of the traction's signals under the prior, of pairs of elements."""
        root, (shape, _) = self._root(of), prior_shape(of, kz)
        return np.einsum("kec,cd,kfd,k->kef", gain, root, gain.conj(), shape)

    def noise(self, of: NoiseParameters, kz: Float[np.ndarray, " k"]) -> list[np.ndarray]:
        """The power (#k, #e) of each part of the noise."""
        waves, rate = self._waves(kz)[:, None], np.exp(-2 * np.sum(of.memory))
        none = np.zeros((1, 1))
        tail = np.exp(of.tail) * (rate + TAIL**2) / (rate + waves) if of.tail.size else none
        walk = np.exp(of.walk) * WALK**2 / waves if of.walk.size else none
        return [np.exp(of.white)[None], tail, walk]

    def _waves(self, kz: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """k^2 of differences between cells."""
        cell = self._bands.cell
        return (2 / cell * np.sin(np.clip(kz * cell, 1e-9, np.pi) / 2)) ** 2

    def _root(self, of: NoiseParameters) -> Float[np.ndarray, "c c"]:
        scale = np.sqrt(self.unit * np.exp(of.level))
        coherence = np.eye(self._unknowns)
        if of.coupling.size:
            coherence = coherence + np.tanh(of.coupling) * (1 - coherence)
        return np.outer(scale, scale) * coherence

    def _parted(self, x: Float[np.ndarray, " m"]) -> NoiseParameters:
        return NoiseParameters(*np.split(x, np.cumsum(self._sizes)[:-1]))

    def _row(self, values: NoiseParameters) -> Float[np.ndarray, " m"]:
        """One number for all parameters of each kind, or one for each."""
        return np.concatenate(
            [np.broadcast_to(v, n) for n, v in zip(self._sizes, values, strict=True)]
        )


def prior_shape(
    of: NoiseParameters, kz: Float[np.ndarray, "*k"]
) -> tuple[Float[np.ndarray, "*k"], Float[np.ndarray, "*k 2"]]:
    """The prior's shape, one at k z = 1, and the slopes of its logarithm by the logarithms of a and
    b."""
    square, slope = np.exp(2 * of.length), np.exp(of.slope)
    waves = square * kz**2
    logs = -slope * (np.log1p(waves) - np.log1p(square))
    by_length = -2 * slope * (waves / (1 + waves) - square / (1 + square))
    return np.exp(logs), np.stack([by_length, logs], axis=-1)
