"""The noise level of each element while the finger slides.

Two things show it. Waves that are much shorter than the film is deep are noise alone, as the skin
does not transmit them: fourth differences of successive samples consist of such waves. And the
innovations of the filter have the variance that model and noise give them: noise that is not white,
and what the model misses, is in these alone.

Both are gathered over the last cells; a sudden change shortens the window to the cells since. The
level is that of short waves, or of innovations where these are significantly larger.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from .cells import CellSums
from .smoother import Innovation

WINDOW_DEPTHS = 8  # over which a level is averaged
SETTLED_DEPTHS = 4  # after which a level has settled
CHANGED = 4.5  # standard errors that a sudden change exceeds, and that innovations do that are
# taken in place of short waves
FEW = 8.0  # degrees of freedom, of less no level is known
MOST = 64.0  # degrees of freedom of one cell: a standstill is no more than that
MOST_STEP = 0.23  # 1 dB, by which a level without short waves follows from cell to cell
MOST_EXCESS = 8.0  # of a squared innovation over its variance: more is a misfit


@dataclasses.dataclass
class NoiseLevel:
    """The variance of each element's white noise per sample, in the signal's unit squared.

    - `sums` (cell, 4, e): of the window's cells, newest last: the squares of what short waves show
      and their degrees of freedom, and the same of innovations.
    - `given` (e,): levels that are known, NaN where they are to be found.
    - `window` (e,): the number of newest cells that are in use: all, or those since a sudden
      change.
    - `variance` (e,): the level in use. `depth_cells`: cells in a depth.
    """

    sums: Float[np.ndarray, "cell 4 e"]
    given: Float[np.ndarray, " e"]
    window: Int[np.ndarray, " e"]
    variance: Float[np.ndarray, " e"]
    depth_cells: int

    @classmethod
    def starting(cls, given: Float[np.ndarray, " e"], depth_cells: int) -> "NoiseLevel":
        """The levels that are `given`, NaN where they are to be found."""
        cells = WINDOW_DEPTHS * depth_cells
        sums, window = np.zeros((cells, 4, given.size)), np.zeros(given.size, int)
        return cls(sums, given, window, given.copy(), depth_cells)

    @property
    def is_known(self) -> bool:
        """Whether each element has a level."""
        return not np.isnan(self.variance).any()

    @property
    def is_settling(self) -> bool:
        """Whether a level that is to be found is one of less than `SETTLED_DEPTHS`."""
        return bool((np.isnan(self.given) & (self.window < self._settled)).any())

    @property
    def _settled(self) -> int:
        return SETTLED_DEPTHS * self.depth_cells

    @property
    def _has_waves(self) -> Bool[np.ndarray, " e"]:
        """Whether a level is given, or short waves show it."""
        return np.isfinite(self.given) | (self.sums[:, 1].sum(axis=0) >= FEW)

    def begin_with_power(self, cells: Sequence[CellSums]) -> None:
        """Take the power of these cells' signals as the level where none is known: the noise is
        less, and innovations will show it."""
        information = np.stack([cell.information for cell in cells])
        projection = np.stack([cell.projection for cell in cells])
        power = projection**2 / np.where(information > 0, information, 1.0)
        mean = power.sum(axis=0) / np.maximum((information > 0).sum(axis=0), 1)
        unknown = np.isnan(self.variance)
        self.variance[unknown] = np.maximum(mean, np.finfo(float).tiny)[unknown]

    def pass_cell(self, squares: np.ndarray, freedom: np.ndarray) -> None:
        """Take in what short waves show of a further cell."""
        most = np.minimum(1.0, MOST / np.maximum(freedom, MOST))
        self.sums[:-1] = self.sums[1:]
        self.sums[-1] = 0.0
        self.sums[-1, 0], self.sums[-1, 1] = squares * most, freedom * most
        cells = len(self.sums)
        self.window = np.minimum(self.window + 1, cells)
        # Row n - 1: the sums over the n newest cells.
        upto = np.cumsum(self.sums[::-1], axis=0)
        together = upto[:, :2] + upto[:, 2:]
        for e, window in enumerate(self.window.tolist()):
            for newest in (max(self.depth_cells // 4, 2), self.depth_cells):
                if _has_changed(together[:, :, e], newest, window):
                    window = newest
            self.window[e] = window
            if np.isnan(self.given[e]):
                self._update(e, *upto[window - 1, :, e].tolist())

    def pass_innovation(self, innovation: Innovation, noise: Float[np.ndarray, " e"]) -> None:
        """Take in the innovations of a cell; `noise`: the part of their variances that is the
        cell's noise of the level in use."""
        share, excess = noise / innovation.variance, innovation.value**2 / innovation.variance - 1
        is_known = share > 0  # NaN where a signal is missing
        share, excess = np.where(is_known, share, 0.0), np.where(is_known, excess, 0.0)
        self.sums[-1, 2] += self.variance * (share**2 + share * excess)
        self.sums[-1, 3] += share**2
        has_waves = self._has_waves
        if has_waves.all() or not is_known.any():
            return
        # Without short waves the level takes a step of the score's size (Gaussian likelihood).
        freedom = self.sums[:, 3].sum(axis=0)
        step = share * np.minimum(excess, MOST_EXCESS) / np.where(freedom > 0, freedom, 1.0)
        factor = np.exp(np.clip(step, -MOST_STEP, MOST_STEP))
        self.variance = np.where(has_waves, self.variance, self.variance * factor)

    def _update(
        self, e: int, of_waves: float, waves: float, of_innovations: float, innovations: float
    ) -> None:
        """The level from squares and degrees of freedom over the window."""
        if waves < FEW or of_waves <= 0:
            return
        variance, freedom = of_waves / waves, waves
        if innovations >= FEW:
            other = of_innovations / innovations
            if _off(other, innovations, variance, waves) > CHANGED:
                variance, freedom = other, innovations
        if self.window[e] < self._settled:  # bands hold while the level settles
            variance *= 1 + math.sqrt(2 / freedom)
        self.variance[e] = variance


def _off(variance: float, freedom: float, other: float, other_freedom: float) -> float:
    """By how many standard errors a variance differs from another; the cube root of their ratio is
    nearly normal (Wilson and Hilferty 1931)."""
    ratio = max(variance / other, 0.0) ** (1 / 3)
    return (ratio - 1) / math.sqrt(2 / 9 * (1 / freedom + 1 / other_freedom))


def _has_changed(upto: Float[np.ndarray, "cell 2"], newest: int, window: int) -> bool:
    """Whether the newest cells are louder, or quieter, than the others of the window by more than
    chance; squares and degrees of freedom are summed `upto` each cell."""
    if window < 2 * newest:
        return False
    (new, new_freedom), (every, freedom) = upto[newest - 1].tolist(), upto[window - 1].tolist()
    old, old_freedom = every - new, freedom - new_freedom
    if min(new_freedom, old_freedom) < FEW or old <= 0:
        return False
    off = _off(new / new_freedom, new_freedom, old / old_freedom, old_freedom)
    return abs(off) > CHANGED
