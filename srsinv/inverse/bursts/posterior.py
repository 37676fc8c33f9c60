"""The posterior of one burst: its first sample, its place, its decay and its size.

Of signals d, a burst of first amplitude a, sample m, place y and decay tau has the likelihood ratio
exp(a A - a^2 Q/2) over none, with A = <b, C^-1 d> and Q = <b, C^-1 b> for a = 1; d' = |A|/sqrt(Q)
is the signal-to-noise ratio that was measured. a is integrated in closed form under a Gaussian
prior, or a mixture of some. What is left has three dimensions, and a grid over them has every mode
of it: with one or two elements places are often ambiguous, and decays shorter than a sample look
alike. The grid is refined where the posterior is.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from ...grid import half_spectrum_weights
from .everything import Everything
from .model import BurstModel

BESIDE = 3  # samples on each side of the likeliest, which the first sample may be
DECAYS, PLACES = 16, 64  # of the grid
ZOOMS = ((0.1, 14.0), (0.02, 14.0), (0.0, 12.0), (0.0, 12.0))
DRAWS, AGES = 2000, 16
BEYOND = 4.0  # in log decay, how far out of the range a likelier one is looked for
MOST_GROWTH = 300.0  # decays in an interval: of more, a burst's size is not known at all
LEAST_LEFT = 1e-9  # of Q, beside other bursts and missing samples


class SizePrior(NamedTuple):
    """Sizes are Gaussian of mean 0 and an rms that is one of `rms_Pa` (s,), with these odds."""

    rms_Pa: Float[np.ndarray, " s"]
    odds: Float[np.ndarray, " s"]

    def log_ratio(self, along: np.ndarray, square: np.ndarray, left: np.ndarray) -> np.ndarray:
        """Log of the likelihood ratio of a burst over none, its size integrated out; `left`: of a
        size in its first sample."""
        total = np.full(np.broadcast_shapes(along.shape, square.shape), -np.inf)
        for rms, odds in zip(self.rms_Pa, self.odds, strict=True):
            variance = (rms * left) ** 2
            explained = 0.5 * along**2 / (square + 1 / variance)
            log = np.log(odds) + explained - 0.5 * np.log1p(variance * square)
            total = np.logaddexp(total, log)
        return total


class Draws(NamedTuple):
    """Draws of the posterior of a burst, each (draw,)."""

    time_s: np.ndarray
    place_m: np.ndarray
    size_Pa: np.ndarray
    decay_s: np.ndarray


class Burst(NamedTuple):
    """The likeliest burst: the first `sample` with a part of it, `amplitude_Pa` there, the place
    and the decay."""

    sample: int
    place_m: float
    decay_s: float
    amplitude_Pa: float
    d_prime: float

    def spectrum(self, model: BurstModel) -> Complex[np.ndarray, "e k"]:
        """Its signals, in the order of time."""
        wave = model.decaying(np.array([self.decay_s]))[0] * model.sample(self.sample)
        return self.amplitude_Pa * model.responses(np.array([self.place_m])) * wave

    def tangents(self, model: BurstModel) -> Complex[np.ndarray, "3 e k"]:
        """Derivatives of its signals by the amplitude, the place and the log decay."""
        step = 1e-3
        place, decays = np.array([self.place_m]), self.decay_s * np.exp([-step, 0.0, step])
        before, wave, after = model.decaying(decays) * model.sample(self.sample)
        own, slope = model.responses(place), self.amplitude_Pa * model.slopes(place)
        of_decay = self.amplitude_Pa * own * (after - before) / (2 * step)
        return np.stack([own * wave, slope * wave, of_decay])


def signals_of(model: BurstModel, bursts: Sequence[Burst]) -> Complex[np.ndarray, "e k"]:
    """The spectra of what all these bursts add to the signals, in the order of time."""
    silent = np.zeros((model.elements, model.n // 2 + 1), complex)
    return sum((each.spectrum(model) for each in bursts), silent)


class Others(NamedTuple):
    """Bursts beside the one in question, free to move about their likeliest values: C^-1 times
    their tangents (c, e, k), and a root of the inverse of their precision (c, c)."""

    weighed: Complex[np.ndarray, "c e k"]
    root: Float[np.ndarray, "c c"]

    @classmethod
    def of(
        cls, model: BurstModel, rest: Everything, prior: SizePrior, bursts: list[Burst]
    ) -> "Others | None":
        """None without any. Sizes are free within the widest of the prior's."""
        if not bursts:
            return None
        columns = np.concatenate([each.tangents(model) for each in bursts])
        weighed = rest.weigh(columns)
        decades = np.log(model.decay_s[1] / model.decay_s[0])
        free = [prior.rms_Pa.max() ** -2, 12 / model.contact_m**2, 12 / max(decades, 1e-3) ** 2]
        precision = rest.dot(columns, weighed) + np.diag(np.tile(free, len(bursts)))
        # In units of their own, as shears, lengths and logarithms are of different sizes.
        unit = 1 / np.sqrt(np.diag(precision))
        values, vectors = np.linalg.eigh(unit[:, None] * precision * unit)
        values = np.maximum(values, np.finfo(float).eps * values.max())
        return cls(weighed, unit[:, None] * vectors / np.sqrt(values))

    @property
    def covariance(self) -> Float[np.ndarray, "c c"]:
        """The inverse of their precision."""
        return self.root @ self.root.T


class Grid(NamedTuple):
    """The posterior on a grid: log ratios (m, decay, place) and what they are made of."""

    samples: np.ndarray
    log_decay: np.ndarray
    place_m: np.ndarray
    along: Float[np.ndarray, "m decay place"]
    square: Float[np.ndarray, "m decay place"]
    log_ratio: Float[np.ndarray, "m decay place"]
    step: tuple[float, float]

    @property
    def d_prime(self) -> float:
        """The greatest signal-to-noise ratio that was measured."""
        return float(np.sqrt(np.max(self.along**2 / self.square)))

    @property
    def likeliest_decay_s(self) -> float:
        """The decay of the highest ratio."""
        _, at, _ = np.unravel_index(int(np.argmax(self.log_ratio)), self.log_ratio.shape)
        return float(np.exp(self.log_decay[at]))

    @property
    def log_evidence(self) -> float:
        """Log of the sum of the ratios times the volume of a cell."""
        top = self.log_ratio.max()
        return float(top + np.log(np.sum(np.exp(self.log_ratio - top)) * np.prod(self.step)))


class OneBurst:
    """The posterior of one more burst in signals of this spectrum, which have been weighed by C^-1.

    - `data` (e, k): the signals less the bursts beside it; `others`: which they are.
    """

    def __init__(
        self,
        model: BurstModel,
        rest: Everything,
        prior: SizePrior,
        data: Complex[np.ndarray, "e k"],
        others: Others | None = None,
    ):
        self.model, self.rest, self.prior, self.others = model, rest, prior, others
        self.weighed = rest.weigh(data)
        if others is not None:
            moved = others.covariance @ rest.dot(others.weighed, data[None])[:, 0]
            self.weighed = self.weighed - np.einsum("cek,c->ek", others.weighed, moved)

    def around(self, sample: int) -> Grid:
        """The posterior of bursts that begin about this sample, refined where it is."""
        contact, decays = self.model.contact_m, np.log(self.model.decay_s)
        samples = sample + np.arange(-BESIDE, BESIDE + 1)
        box = np.array([decays, [-contact / 2, contact / 2]])
        grid = self._on(samples, box)
        for share, least in ZOOMS:
            floor = grid.log_ratio.max() - max(share * grid.log_ratio.max(), least)
            inside = grid.log_ratio >= floor
            keep = [np.flatnonzero(inside.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
            samples = grid.samples[keep[0][0] : keep[0][-1] + 1]
            smaller = box.copy()
            for row, (at, count) in enumerate(zip(keep[1:], (DECAYS, PLACES), strict=True)):
                step = (box[row, 1] - box[row, 0]) / count
                smaller[row] = box[row, 0] + step * np.array([at[0] - 1, at[-1] + 2])
                smaller[row] = np.clip(smaller[row], *box[row])
            box = smaller
            grid = self._on(samples, box)
        return grid

    def gain_out_of_range(self, burst: Burst) -> float:
        """By how much the log likelihood is higher at decays next to the range than within it."""
        decays, place = np.log(self.model.decay_s), burst.place_m
        near = self.model.contact_m / PLACES
        samples = burst.sample + np.arange(-1, 2)

        def highest(low: float, high: float) -> float:
            box = np.array([[low, high], [place - near, place + near]])
            box[1] = np.clip(box[1], -self.model.contact_m / 2, self.model.contact_m / 2)
            grid = self._on(samples, box)
            return float(np.max(grid.along**2 / grid.square) / 2)

        inside = highest(*decays)
        outside = (decays[0] - BEYOND, decays[0]), (decays[1], decays[1] + BEYOND)
        return max(highest(*ends) for ends in outside) - inside

    def _on(self, samples: np.ndarray, box: Float[np.ndarray, "2 2"]) -> Grid:
        """The posterior on the cells of a box of log decays and places."""
        model, decays = self.model, np.log(self.model.decay_s)
        log_decay, place = _middles(box[0], DECAYS), _middles(box[1], PLACES)
        waves, responses = model.decaying(np.exp(log_decay)), model.responses(place)
        along = self._along(waves, samples, self.weighed[None])[0] @ responses
        square = whole = self.rest.squares(waves, responses)[None]
        if self.rest.taken is not None:
            square = whole - self.rest.taken.squares(waves, samples, responses)
        if self.others is not None:
            each = self._along(waves, samples, self.others.weighed)
            each = np.einsum("cmte,ey->cmty", each, responses, optimize=True)
            taken = np.einsum("cmty,cd->dmty", each, self.others.covariance, optimize=True)
            square = square - np.sum(taken * each, axis=0)
        # What is left of it is a difference, which rounding must not make nothing.
        square = np.maximum(square, LEAST_LEFT * whole + np.finfo(float).tiny)
        left = model.left(np.exp(log_decay))[None, :, None]
        ratio = self.prior.log_ratio(along, square, left)
        square = np.broadcast_to(square, along.shape)
        step = (
            (box[0, 1] - box[0, 0]) / DECAYS / max(decays[1] - decays[0], 1e-12),
            (box[1, 1] - box[1, 0]) / PLACES / model.contact_m,
        )
        return Grid(samples, log_decay, place, along, square, ratio, step)

    def _along(
        self, waves: np.ndarray, samples: np.ndarray, weighed: Complex[np.ndarray, "c e k"]
    ) -> Float[np.ndarray, "c m decay e"]:
        """Inner products of the decays that begin in these samples with weighed signals."""
        k = np.arange(self.model.n // 2 + 1)
        turned = np.exp(2j * np.pi * samples[:, None] * k / self.model.n)
        waves = waves.conj() * half_spectrum_weights(self.model.n)
        each = weighed[:, None] * turned[None, :, None]
        return np.einsum("tk,cmek->cmte", waves, each, optimize=True).real

    def likeliest(self, grid: Grid) -> Burst:
        """The burst of the highest ratio on a grid."""
        m, t, y = np.unravel_index(int(np.argmax(grid.log_ratio)), grid.log_ratio.shape)
        along, square = float(grid.along[m, t, y]), float(grid.square[m, t, y])
        decay = float(np.exp(grid.log_decay[t]))
        odds, precision = self._odds(grid, np.array([m]), np.array([t]), np.array([y]))
        mean = float(np.sum(odds[0] * along / precision[0]))
        sample = int(grid.samples[m]) % self.model.n
        return Burst(sample, float(grid.place_m[y]), decay, mean, abs(along) / np.sqrt(square))

    def _odds(
        self, grid: Grid, m: np.ndarray, t: np.ndarray, y: np.ndarray
    ) -> tuple[Float[np.ndarray, "draw s"], Float[np.ndarray, "draw s"]]:
        """In cells of the grid, the odds of each rms of sizes, and the amplitude's precision."""
        along, square = grid.along[m, t, y][:, None], grid.square[m, t, y][:, None]
        left = self.model.left(np.exp(grid.log_decay[t]))[:, None]
        variance = (self.prior.rms_Pa * left) ** 2
        log = np.log(self.prior.odds) + 0.5 * along**2 / (square + 1 / variance)
        log = log - 0.5 * np.log1p(variance * square)
        odds = np.exp(log - log.max(axis=1, keepdims=True))
        return odds / odds.sum(axis=1, keepdims=True), square + 1 / variance

    def draws(self, grid: Grid, seed: int = 0) -> Draws:
        """Draws from the posterior on a grid, even within its cells."""
        rng, model = np.random.default_rng(seed), self.model
        odds = np.exp(grid.log_ratio - grid.log_ratio.max()).ravel()
        cell = rng.choice(odds.size, DRAWS, p=odds / odds.sum())
        m, t, y = np.unravel_index(cell, grid.log_ratio.shape)
        of_rms, precision = self._odds(grid, m, t, y)
        rms = np.sum(np.cumsum(of_rms, axis=1) < rng.random(DRAWS)[:, None], axis=1)
        rms = np.minimum(rms, self.prior.rms_Pa.size - 1)
        precision = precision[np.arange(DRAWS), rms]
        amplitude = grid.along[m, t, y] / precision + rng.normal(size=DRAWS) / np.sqrt(precision)
        along_t, along_y = rng.random((2, DRAWS)) - 0.5
        width = np.diff(np.log(model.decay_s))[0]
        decay = np.exp(grid.log_decay[t] + along_t * grid.step[0] * width)
        place = grid.place_m[y] + along_y * grid.step[1] * model.contact_m
        # The age in the first sample, by how likely the size is that it would have.
        age = _middles((0.0, 1.0), AGES)
        growth = np.minimum(model.interval_s / decay, MOST_GROWTH)
        grown = np.exp(growth[:, None] * age)
        scaled = (amplitude / self.prior.rms_Pa[rms])[:, None] * grown
        log = np.log(grown) - 0.5 * scaled**2
        weights = np.exp(log - log.max(axis=1, keepdims=True))
        total = np.cumsum(weights, axis=1)
        at = np.sum(total < (rng.random(DRAWS) * total[:, -1])[:, None], axis=1)
        aged = age[at] + (rng.random(DRAWS) - 0.5) / AGES
        time = (grid.samples[m] - aged) * model.interval_s
        size = amplitude * np.exp(growth * aged)
        return Draws(time, place, size, decay)


def _middles(ends: Any, count: int) -> np.ndarray:
    """The middles of so many equal cells of a range."""
    low, high = ends
    return low + (high - low) * (np.arange(count) + 0.5) / count
