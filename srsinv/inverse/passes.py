"""Passes of a motion that turns: parted by direction, aligned, and averaged on common cells.

A pass j over the same traction shows

    v_j(x) = s(x - d_j) + C_j a + noise,

s the same in all passes of one way, d_j a shift of the stage's position and C_j a signals of no
interest (the waves of mains), whose sizes a the passes have in common. The weighted mean over the
passes is all that they say of s. What they differ by says what the sizes and the shifts are; what
it leaves open of both stays with the mean as columns of unknown size.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..errors import refuse
from ..forward.amplifier import Amplifier
from ..forward.scan import Motion
from ..grid import as_real
from ..recording.passes import Pass
from ..recording.passes import passes_of as positions_passes
from .cells import LEAST_CELLS, Cells, fitted_on, sample_middles

FALSE_ALARM = 1e-3  # of shifts, and of a scatter beyond the noise, where there is none
MUCH_SCATTER = 1.1  # times the noise: less may be what cells make of it
SMOOTH_DEPTHS = 1 / 6  # over which signals' slopes are smoothed: waves so short are noise or hum
SHIFT_DEPTHS = 0.25  # the standard deviation of shifts before they are known
FAINT = 1e-3  # of the white noise's variance: a column that changes nothing


class AveragedPasses(NamedTuple):
    """What averaging of passes found: how many there are of each way, `onwards` and `back`; their
    `shifts_m`, zero where noise explains all differences, with their standard error; and the
    `scatter` between passes of a way, rms over that of the noise (NaN where it is not known), of so
    many degrees of `freedom`."""

    onwards: int
    back: int
    shifts_m: Float[np.ndarray, " pass"]
    shift_stderr_m: float
    scatter: float
    freedom: int

    @property
    def warnings(self) -> tuple[str, ...]:
        """That passes differ by more than noise does."""
        chance = scipy.stats.chi2.isf(FALSE_ALARM, max(self.freedom, 1)) / max(self.freedom, 1)
        if not self.scatter > max(np.sqrt(chance), MUCH_SCATTER):
            return ()
        return (
            f"Passes of one way differ by {self.scatter:.3g} times the noise: what differs is in "
            "no band. The stage, the load or the surface does not repeat, or hum or drift is on "
            "the signals (recording.mains_Hz, recording.drift).",
        )


def passes_of(motion: Motion) -> tuple[Pass, ...]:
    """The passes of a motion: see [`recording.passes`][]."""
    return positions_passes(np.asarray(motion.position_m))


class PassOnCells(NamedTuple):
    """One pass on the common cells: signals (e, cell), their columns (e, m, cell) and their
    information (e, cell) in samples at the mean speed, zero where there is none; `slow` (e, cell)
    as in [`Cells`][]."""

    signal: Float[np.ndarray, "e cell"]
    columns: Float[np.ndarray, "e m cell"]
    information: Float[np.ndarray, "e cell"]
    slow: Float[np.ndarray, "e cell"]
    typical: float


class Averaging:
    """Averages of the passes of each way.

    - `rows` (e, 1 + m, sample): the signals, and columns beside them, NaN where one is missing.
    - `speed_m_per_s`: the speed that signals are given at; `cell_m`: the width of the cells.
    - `white_rms` (#e,) per sample. `is_walk`: whether a drift, which does not repeat, is on them.
    """

    def __init__(
        self,
        name: str,
        motion: Motion,
        passes: Sequence[Pass],
        rows: Float[np.ndarray, "e row sample"],
        amplifier: Amplifier,
        speed_m_per_s: float,
        cell_m: float,
        white_rms: Float[np.ndarray, "#e"],
        depth_m: float,
        is_walk: bool,
    ):
        speed = as_real(np.asarray(motion.speed_m_per_s))
        gain = np.asarray(amplifier.at_speed(speed) / amplifier.at_speed(as_real(speed_m_per_s)))
        self._given = [self._rising(each, motion, gain, rows) for each in passes]
        self.ways = tuple(way for way in (True, False) if any(p.is_onwards == way for p in passes))
        self._way = np.array([self.ways.index(each.is_onwards) for each in passes])
        middles = [sample_middles(x) for x, _, _ in self._given]
        first, last = min(m[0] for m in middles), max(m[-1] for m in middles)
        refuse(
            not all(m[-1] - m[0] > (LEAST_CELLS + 1) * cell_m for m in middles),
            f"{name}: a pass is shorter than {LEAST_CELLS} cells of {cell_m:.4g} m: check the "
            "positions' unit, or give a smaller recording.cell_m.",
        )
        self._edges = first + cell_m * np.arange(int((last - first) / cell_m) + 1)
        self._variance = np.broadcast_to(white_rms**2, len(rows))[:, None]
        self._depth, self._is_walk = depth_m, is_walk

    @staticmethod
    def _rising(one: Pass, motion: Motion, gain, rows):
        """A pass's positions, rising, with its gains and its rows."""
        order = slice(None) if one.is_onwards else slice(None, None, -1)
        x = np.asarray(motion.position_m)[one.samples][order]
        return (
            np.maximum.accumulate(x),
            gain[one.samples][order],
            rows[..., one.samples][..., order],
        )

    def __call__(self) -> tuple[Cells, Float[np.ndarray, "row m cell"], AveragedPasses]:
        """Cells with a row for each way and element, way by way, the columns of each row, and what
        was found."""
        shifts = np.zeros(len(self._given))
        passes = self._passes(shifts)
        cleaned = self._clean(passes)
        fitted, stderr = self._shifts(cleaned)
        if np.sum((fitted / stderr) ** 2) > self._most_squares:
            shifts = fitted
            for _ in range(2):
                passes = self._passes(shifts)
                cleaned = self._clean(passes)
                further, stderr = self._shifts(cleaned)
                shifts = shifts + further
        spread = float(np.sqrt(np.sum(shifts**2) / max(self._contrasts, 1)))
        cells, columns = self._average(cleaned, np.hypot(spread, stderr))
        found = AveragedPasses(
            int(np.sum([self.ways[i] for i in self._way])),
            int(np.sum([not self.ways[i] for i in self._way])),
            shifts, stderr, *self._scatter(cleaned),
        )  # fmt: skip
        return cells, columns, found

    @property
    def _contrasts(self) -> int:
        """Differences between passes of a way."""
        return len(self._way) - len(self.ways)

    @property
    def _most_squares(self) -> float:
        return (
            float(scipy.stats.chi2.isf(FALSE_ALARM, self._contrasts)) if self._contrasts else np.inf
        )

    def _passes(self, shifts_m: Float[np.ndarray, " pass"]) -> list[PassOnCells]:
        """Every pass on the common cells, moved back by its shift."""
        n, every = self._edges.size - 1, []
        cell = self._edges[1] - self._edges[0]
        for (x, gain, rows), shift in zip(self._given, shifts_m, strict=True):
            middles = sample_middles(x - shift)
            start = max(int(np.ceil((middles[0] - self._edges[0]) / cell - 1e-9)), 0)
            stop = min(int(np.floor((middles[-1] - self._edges[0]) / cell + 1e-9)), n)
            elements, each, _ = rows.shape
            flat = rows.reshape(elements * each, -1)
            values, typical, white, slow = fitted_on(
                self._edges[start : stop + 1], x - shift, gain, flat
            )
            around = (0, 0), (start, n - stop)
            known = np.isfinite(values)
            information = np.where(known, typical / white**2, 0.0)
            values, information, slow = (
                np.pad(part, around).reshape(elements, each, n)
                for part in (np.where(known, values, 0.0), information, slow)
            )
            every.append(
                PassOnCells(values[:, 0], values[:, 1:], information[:, 0], slow[:, 0], typical)
            )
        return every

    def _means(
        self, parts: Sequence[np.ndarray], passes: Sequence[PassOnCells]
    ) -> list[np.ndarray]:
        """The weighted mean over the passes of each way, (e, ..., cell)."""
        means = []
        for way in range(len(self.ways)):
            total, weight = 0.0, 0.0
            for own, each, of in zip(parts, passes, self._way, strict=True):
                if of == way:
                    shape = (len(own), *[1] * (own.ndim - 2), own.shape[-1])
                    total = total + each.information.reshape(shape) * own
                    weight = weight + each.information.reshape(shape)
            means.append(total / np.where(weight > 0, weight, 1.0))
        return means

    def _clean(self, passes: Sequence[PassOnCells]) -> list[PassOnCells]:
        """The passes less the expected signal of the columns, of sizes by what passes differ by;
        the columns become those of what is left open of the sizes."""
        if not passes[0].columns.shape[1]:
            return list(passes)
        signals, columns = [each.signal for each in passes], [each.columns for each in passes]
        mean, mean_columns = self._means(signals, passes), self._means(columns, passes)
        size = columns[0].shape[1]
        precision = np.tile(np.eye(size), (len(signals[0]), 1, 1))
        right = np.zeros(precision.shape[:2])
        for way, each in zip(self._way, passes, strict=True):
            off = each.columns - mean_columns[way]
            weighed = off * (each.information / self._variance)[:, None]
            precision += np.einsum("ein,ejn->eij", weighed, off)
            right += np.einsum("ein,en->ei", weighed, each.signal - mean[way])
        covariance = np.linalg.inv(precision)
        root = np.linalg.cholesky((covariance + covariance.swapaxes(1, 2)) / 2)
        sizes = np.einsum("eij,ej->ei", covariance, right)
        return [
            each._replace(
                signal=each.signal - np.einsum("ei,ein->en", sizes, each.columns),
                columns=np.einsum("eij,ein->ejn", root, each.columns),
            )
            for each in passes
        ]

    def _shifts(self, passes: Sequence[PassOnCells]) -> tuple[Float[np.ndarray, " pass"], float]:
        """By how much each pass is ahead of the mean of its way, and the standard error [m]."""
        prior = SHIFT_DEPTHS * self._depth
        signals = [each.signal for each in passes]
        means = self._means(signals, passes)
        shifts, precisions = np.zeros(len(passes)), np.full(len(passes), prior**-2)
        for j, (way, each) in enumerate(zip(self._way, passes, strict=True)):
            slope = self._slope(means[way])
            weight = slope * each.information / self._variance
            precisions[j] += np.sum(weight * slope)
            if np.sum(self._way == way) > 1:
                shifts[j] = -np.sum(weight * (each.signal - means[way])) / precisions[j]
        return shifts, float(np.mean(precisions) ** -0.5)

    def _slope(self, mean: Float[np.ndarray, "e cell"]) -> Float[np.ndarray, "e cell"]:
        """The derivative of a mean signal along x, without what the skin does not transmit."""
        cell = self._edges[1] - self._edges[0]
        smooth = scipy.ndimage.gaussian_filter1d(mean, SMOOTH_DEPTHS * self._depth / cell, axis=1)
        return np.gradient(smooth, cell, axis=1)

    def _level_spread(self, passes: Sequence[PassOnCells]) -> Float[np.ndarray, " e"]:
        """Rms of the levels that passes of a way differ by, an offset that wanders; zero where
        noise makes as much, or a walk is known."""
        means = self._means([each.signal for each in passes], passes)
        squares, noise = np.zeros(len(passes[0].signal)), np.zeros(len(passes[0].signal))
        for way, each in zip(self._way, passes, strict=True):
            total = np.sum(each.information, axis=1)
            level = np.sum(each.information * (each.signal - means[way]), axis=1) / total
            noise = noise + self._variance[:, 0] / total / len(passes)
            squares = squares + level**2
        freedom = max(self._contrasts, 1)
        is_more = squares / noise > scipy.stats.chi2.isf(FALSE_ALARM, freedom)
        is_found = is_more & (not self._is_walk) & (self._contrasts > 0)
        return np.sqrt(np.where(is_found, np.maximum(squares / freedom - noise, 0.0), 0.0))

    def _scatter(self, passes: Sequence[PassOnCells]) -> tuple[float, int]:
        """Rms of what passes differ by over that of the noise, and its degrees of freedom."""
        means = self._means([each.signal for each in passes], passes)
        squares, count = 0.0, 0
        for way, each in zip(self._way, passes, strict=True):
            off = each.signal - means[way]
            squares += float(np.sum(off**2 * each.information) / self._variance)
            count += int(np.sum(each.information > 0))
        averages = sum(
            int(np.sum(np.any([e.information > 0 for e, w in zip(passes, self._way, strict=True)
                               if w == way], axis=0)))
            for way in range(len(self.ways))
        )  # fmt: skip
        freedom = count - averages - self._contrasts
        if self._is_walk or freedom < 1:
            return float("nan"), freedom
        return float(np.sqrt(squares / freedom)), freedom

    def _average(
        self, passes: Sequence[PassOnCells], shift_stderr_m: float
    ) -> tuple[Cells, Float[np.ndarray, "row m cell"]]:
        samples = float(np.median([p.typical for p in passes]))
        means = self._means([each.signal for each in passes], passes)
        columns = self._means([each.columns for each in passes], passes)
        spread = self._level_spread(passes)[:, None, None]
        signal, white, slow, beside = [], [], [], []
        for way, (mean, own) in enumerate(zip(means, columns, strict=True)):
            each = [p for p, of in zip(passes, self._way, strict=True) if of == way]
            total = np.sum([p.information for p in each], axis=0)
            known = total > 0
            total = np.where(known, total, 1.0)
            squares = np.sum([(p.information * p.slow) ** 2 for p in each], axis=0)
            signal.append(np.where(known, mean, np.nan))
            white.append(np.where(known, np.sqrt(samples / total), 1.0))
            slow.append(np.where(known, np.sqrt(squares) / total, 1.0))
            # Of one pass alone the position is what the recording says.
            moved = self._slope(mean) * shift_stderr_m / np.sqrt(len(each))
            moved = moved[:, None] * (len(each) > 1)
            level = np.broadcast_to(spread / np.sqrt(len(each)), moved.shape)
            beside.append(np.concatenate([own, moved, level], axis=1))
        x = (self._edges[1:] + self._edges[:-1]) / 2
        rows = (np.concatenate(part) for part in (signal, white, slow, beside))
        signal, white, slow, beside = rows
        least = FAINT * np.min(self._variance) * np.min(white**2) / samples
        return Cells(x, signal, samples, white, slow), _compressed(beside, least)


def _compressed(columns: Float[np.ndarray, "row m n"], least: float) -> np.ndarray:
    """As few columns of the same sum of squares, but for a variance of `least` each."""
    parts = [np.linalg.svd(own, full_matrices=False)[1:] for own in columns]
    count = max((int(np.sum(strength**2 > least)) for strength, _ in parts), default=0)
    return np.stack([strength[:count, None] * axes[:count] for strength, axes in parts])
