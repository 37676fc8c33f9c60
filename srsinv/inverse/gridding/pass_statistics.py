"""What passes of one way have in common, and what they differ by: shifts, gains, levels and
scatter."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ... import false_alarm
from ...numerics import BAND_90, ROUNDED, root_of

SMOOTH_DEPTHS = 1 / 6  # over which signals' slopes are smoothed: waves so short are noise or hum
SHIFT_DEPTHS = 0.25  # the standard deviation of shifts before they are known
NOT_KNOWN = (
    "The variation of the gain from pass to pass is not known, so the bands do not include it. It "
    "needs two passes of one direction over a clear signal."
)
FAINT_SIGNAL = 10.0  # standard errors of a gain: a weaker signal says nothing of how it varies


class PassOnCells(NamedTuple):
    """One pass on the common cells: signals (e, cell), their columns (e, m, cell) and their
    information (e, cell) in samples at the mean speed, zero where there is none; `slow` (e, cell)
    as in [`Cells`][]."""

    signal: Float[np.ndarray, "e cell"]
    columns: Float[np.ndarray, "e m cell"]
    information: Float[np.ndarray, "e cell"]
    slow: Float[np.ndarray, "e cell"]
    typical: float


class PassGains(NamedTuple):
    """How gains vary from pass to pass, as where the contact's pressure varies; all relative.

    - `off` (pass, e): each pass's gain less that of the mean over its direction of motion, and its
      `variance` (pass, e) by noise alone; zero and infinite where it is not known.
    - `covariance` (e, e): of the gains of one pass, the noise's part taken off; zeros where noise
      explains all of it. It has `freedom` degrees of freedom, the differences between passes.
    - `of_means` (direction, e, j): the error that is left in the mean over each direction of
      motion, one standard deviation each of independent contributions j. They are wider by
      Student's quantile of `freedom` over the normal one, so that 90 % bands hold.
    """

    off: Float[np.ndarray, "pass e"]
    variance: Float[np.ndarray, "pass e"]
    covariance: Float[np.ndarray, "e e"]
    freedom: int
    of_means: Float[np.ndarray, "direction e j"]

    @property
    def spread(self) -> Float[np.ndarray, " e"]:
        """Rms by which the gain of each element varies from pass to pass, relative; NaN where it is
        not known."""
        is_known = np.isfinite(self.variance).any(axis=0)
        return np.where(is_known, np.sqrt(np.diag(self.covariance)), np.nan)

    @property
    def note(self) -> str:
        """What is known of how gains vary, as a sentence for answers whose bands hold it."""
        spread = self.spread[np.isfinite(self.spread)]
        if not spread.size:
            return NOT_KNOWN
        if not self.is_found:
            return "The gain is the same in all passes, as far as the noise shows."
        percent = f"{100 * spread.max():.2g} %"
        return f"The gain varies by {percent} from pass to pass; the bands include this."

    @property
    def is_found(self) -> bool:
        """Whether gains differ by more than noise does."""
        seen = np.isfinite(self.variance)
        squares = np.sum(self.off[seen] ** 2 / self.variance[seen])
        count = self.freedom * int(np.sum(seen.any(axis=0)))
        return bool(squares > scipy.special.chdtri(max(count, 1), false_alarm.PASSES))


class PassesOnCells:
    """Passes on common cells of `cell_m`, the number of each one's direction, the white
    noise's variance (e, 1) per sample, and the rms (e, 1) of a walk from cell to cell."""

    def __init__(
        self,
        every: Sequence[PassOnCells],
        direction: Sequence[int],
        variance: Float[np.ndarray, "e 1"],
        step: Float[np.ndarray, "e 1"],
        cell_m: float,
    ):
        self.every, self.direction = list(every), list(direction)
        self.variance, self.step, self.cell_m = variance, step, cell_m

    @property
    def directions(self) -> int:
        """Number of directions of motion."""
        return max(self.direction) + 1

    @property
    def contrasts(self) -> int:
        """Differences between passes of a way."""
        return len(self.direction) - self.directions

    def of(self, direction: int) -> list[PassOnCells]:
        """The passes of a way."""
        return [
            each for each, own in zip(self.every, self.direction, strict=True) if own == direction
        ]

    @cached_property
    def signals(self) -> list[Float[np.ndarray, "e cell"]]:
        """The mean signals of each way."""
        return [_mean([p.signal for p in self.of(w)], self.of(w)) for w in range(self.directions)]

    @cached_property
    def columns(self) -> list[Float[np.ndarray, "e m cell"]]:
        """The means of each way's columns."""
        return [_mean([p.columns for p in self.of(w)], self.of(w)) for w in range(self.directions)]

    def level_of(self, direction: int) -> Float[np.ndarray, "e cell"]:
        """What a level of one, the same in all passes of a way, is in their mean signal."""
        return _mean([p.slow for p in self.of(direction)], self.of(direction))

    @cached_property
    def differences(self) -> list[Float[np.ndarray, "e cell"]]:
        """What the signals of each pass differ by from the mean of its way."""
        return [p.signal - self.signals[w] for p, w in zip(self.every, self.direction, strict=True)]

    def without_nuisance(self) -> "PassesOnCells":
        """The passes less the expected signal of the columns, of sizes by what passes differ by;
        the columns become those of what is left open of the sizes."""
        elements, size, _ = self.every[0].columns.shape
        if not size:
            return self
        precision = np.tile(np.eye(size), (elements, 1, 1))
        right = np.zeros((elements, size))
        for direction, each, difference in zip(
            self.direction, self.every, self.differences, strict=True
        ):
            off = each.columns - self.columns[direction]
            weighed = off * (each.information / self.variance)[:, None]
            precision += np.einsum("ein,ejn->eij", weighed, off)
            right += np.einsum("ein,en->ei", weighed, difference)
        covariance = np.linalg.inv(precision * (1 + ROUNDED * np.eye(size)))
        root = root_of((covariance + covariance.swapaxes(1, 2)) / 2)
        sizes = np.einsum("eij,ej->ei", covariance, right)
        cleaned = [
            each._replace(
                signal=each.signal - np.einsum("ei,ein->en", sizes, each.columns),
                columns=np.einsum("eij,ein->ejn", root, each.columns),
            )
            for each in self.every
        ]
        return self._with(cleaned)

    def levelled(self) -> "PassesOnCells":
        """The passes at the level of the mean of their way, over the cells that all of them have:
        of a walk each begins at a level of its own, and where fewer are averaged their mean would
        step. Like all that is slow, a level is in signals at the mean speed `slow` times."""
        levelled = []
        for direction, each, difference in zip(
            self.direction, self.every, self.differences, strict=True
        ):
            common = np.all([p.information > 0 for p in self.of(direction)], axis=0)
            weight = common * each.information * each.slow
            level = np.sum(weight * difference, axis=1, keepdims=True) / np.maximum(
                np.sum(weight * each.slow, axis=1, keepdims=True), np.finfo(float).tiny
            )
            moved = np.where(each.information > 0, each.signal - level * each.slow, 0.0)
            levelled.append(each._replace(signal=moved))
        return self._with(levelled)

    def _with(self, every: Sequence[PassOnCells]) -> "PassesOnCells":
        return PassesOnCells(every, self.direction, self.variance, self.step, self.cell_m)

    def slope(self, direction: int, depth_m: float) -> Float[np.ndarray, "e cell"]:
        """The derivative of a way's mean signal along x, without what a skin of such a depth does
        not transmit."""
        width = SMOOTH_DEPTHS * depth_m / self.cell_m
        smooth = scipy.ndimage.gaussian_filter1d(self.signals[direction], width, axis=1)
        return np.gradient(smooth, self.cell_m, axis=1)

    def shifts(self, depth_m: float) -> tuple[Float[np.ndarray, " pass"], float]:
        """By how much each pass is ahead of the mean of its way, and the standard error [m], which
        holds a walk too, though weights are those of white noise."""
        prior, slopes = (
            SHIFT_DEPTHS * depth_m,
            [self.slope(w, depth_m) for w in range(self.directions)],
        )
        shifts, variances = np.zeros(len(self.direction)), np.zeros(len(self.direction))
        for j, (direction, each) in enumerate(zip(self.direction, self.every, strict=True)):
            weight = slopes[direction] * each.information / self.variance
            # A level tells nothing of a shift; of a walk the sums from each cell on remain.
            of_level = each.information / np.sum(each.information, axis=1, keepdims=True)
            weight = weight - of_level * np.sum(weight, axis=1, keepdims=True)
            precision = prior**-2 + np.sum(weight * slopes[direction])
            of_walk = np.sum((self.step * np.cumsum(weight, axis=1)) ** 2)
            variances[j] = 1 / precision + of_walk / precision**2
            if self.direction.count(direction) > 1:
                shifts[j] = -np.sum(weight * self.differences[j]) / precision
        return shifts, float(np.mean(1 / variances) ** -0.5)

    def are_shifted(self, shifts: Float[np.ndarray, " pass"], stderr: float) -> bool:
        """Whether shifts are more than noise makes of none."""
        if not self.contrasts:
            return False
        most = scipy.special.chdtri(self.contrasts, false_alarm.PASSES)
        return bool(np.sum((shifts / stderr) ** 2) > most)

    def level_spread(self) -> Float[np.ndarray, " e"]:
        """Rms of the levels that passes of a way differ by, an offset that wanders; zero where
        noise makes as much."""
        elements = len(self.variance)
        squares, noise = np.zeros(elements), np.zeros(elements)
        for each, difference in zip(self.every, self.differences, strict=True):
            total = np.sum(each.information, axis=1)
            level = np.sum(each.information * difference, axis=1) / total
            noise = noise + self.variance[:, 0] / total / len(self.every)
            squares = squares + level**2
        freedom = max(self.contrasts, 1)
        is_found = squares / noise > scipy.special.chdtri(freedom, false_alarm.PASSES)
        spread = np.sqrt(np.maximum(squares / freedom - noise, 0.0))
        return np.where(is_found & (self.contrasts > 0), spread, 0.0)

    def _gain_templates(self, direction: int) -> list[Float[np.ndarray, "e cell"]]:
        """The mean signal of a way over each of its passes, less its level there."""
        templates = []
        for each in self.of(direction):
            total = np.maximum(np.sum(each.information, axis=1, keepdims=True), ROUNDED)
            level = (
                np.sum(each.information * self.signals[direction], axis=1, keepdims=True) / total
            )
            templates.append(np.where(each.information > 0, self.signals[direction] - level, 0.0))
        return templates

    @cached_property
    def gains(self) -> PassGains:
        """How gains vary from pass to pass: each pass's difference projected on the mean signal of
        its way, less the noise's part (the moments of a one-way analysis of variance; Searle,
        Casella and McCulloch 1992, section 3.6)."""
        shape = len(self.direction), len(self.variance)
        off, variance = np.zeros(shape), np.full(shape, np.inf)
        for direction in range(self.directions):
            numbers = [j for j, own in enumerate(self.direction) if own == direction]
            if len(numbers) < 2:
                continue
            total = np.sum([self.every[j].information for j in numbers], axis=0)
            for j, template in zip(numbers, self._gain_templates(direction), strict=True):
                own, difference = self.every[j].information, self.differences[j]
                share = own / np.where(total > 0, total, 1.0)
                weight = own * template / self.variance
                size = np.sum(weight * template, axis=1)
                walk = np.sum((self.step * np.cumsum(weight, axis=1)) ** 2, axis=1)
                noise = np.sum(weight * template * (1 - share), axis=1) + walk
                clear = size - np.sum(share, axis=1)  # the mean has noise, too
                seen = clear > FAINT_SIGNAL * np.sqrt(size + walk)
                size = np.where(seen, clear, 1.0)
                product = np.sum(weight * difference, axis=1)
                off[j] = np.where(seen, product / size, 0.0)
                variance[j] = np.where(seen, noise / size**2, np.inf)
        freedom = self.contrasts
        noise = np.sum(np.where(np.isfinite(variance), variance, 0.0), axis=0)
        covariance = (off.T @ off - np.diag(noise)) / max(freedom, 1)
        root = root_of(covariance)
        wide = scipy.special.stdtrit(max(freedom, 1), scipy.special.ndtr(BAND_90)) / BAND_90
        counts = np.array(
            [self._effective_count(direction) for direction in range(self.directions)]
        )
        of_means = wide * root / np.sqrt(counts)[:, None, None]
        return PassGains(off, variance, root @ root.T, freedom, of_means)

    def _effective_count(self, direction: int) -> float:
        """How many passes of the same weight would have the mean that those of a way have."""
        weights = np.array([np.sum(each.information) for each in self.of(direction)])
        return float(np.sum(weights) ** 2 / np.sum(weights**2))

    def less_gains(self) -> "PassesOnCells":
        """The passes less what their own gains add to the mean signal of their way."""
        templates = [iter(self._gain_templates(direction)) for direction in range(self.directions)]
        return self._with(
            [
                each._replace(signal=each.signal - off[:, None] * next(templates[direction]))
                for direction, each, off in zip(
                    self.direction, self.every, self.gains.off, strict=True
                )
            ]
        )

    def scatter(self) -> tuple[float, int]:
        """Rms of what passes differ by over that of the noise, and its degrees of freedom; NaN of
        none."""
        each = zip(self.every, self.differences, strict=True)
        squares = sum(float(np.sum(off**2 * p.information / self.variance)) for p, off in each)
        count = sum(int(np.sum(p.information > 0)) for p in self.every)
        averages = sum(
            int(np.sum(np.any([p.information > 0 for p in self.of(direction)], axis=0)))
            for direction in range(self.directions)
        )
        freedom = count - averages - self.contrasts
        return (float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")), freedom


def _mean(parts: Sequence[np.ndarray], passes: Sequence[PassOnCells]) -> np.ndarray:
    """The mean (e, ..., cell), weighted by the passes' information."""
    total, weight = 0.0, 0.0
    for own, each in zip(parts, passes, strict=True):
        information = each.information.reshape(len(own), *[1] * (own.ndim - 2), own.shape[-1])
        total, weight = total + information * own, weight + information
    return total / np.where(weight > 0, weight, 1.0)
