"""Samples that arrive one after another, gathered on the cells of a scan.

As on a line of cells in batch (gridding/cells.py): a sample at x is v = a s + white noise, a the
amplifier's gain at its speed, and a cell's signal per unit gain is s = sum(a v) / sum(a^2) with the
noise's variance over sum(a^2). A sample counts in each cell by the fraction of its interval inside.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

TOGETHER = 256  # samples gathered at once: the time for one is least there
REACH = 2  # samples before and after one that its speed and its fourth difference need
# Fourth differences (1, -4, 6, -4, 1) of white noise of variance one have this variance, and are
# correlated with their neighbours: so many of them count as one, the sum of the squares of their
# correlations.
VARIANCE = 70.0
CORRELATED = 1 + 2 * (56**2 + 28**2 + 8**2 + 1) / VARIANCE**2
UNEVEN = 1.5  # times the shortest interval between neighbours: a longer one is a gap
BEHIND = 0.25  # of a cell: samples farther behind the foremost position do not count


class CellSums(NamedTuple):
    """Sums over the samples of one cell.

    - `number`: of the cell in the direction of motion; `time_s` [s]: of its last sample.
    - `information` (e,): of a^2; `projection` (e,): of a v; `place` (e,): of a^2 x;
      `samples` (e,): their number.
    - `nuisance` (e, k): of a and each nuisance signal.
    - `squares`, `freedom` (e,): of fourth differences, in the variance of one sample, and their
      degrees of freedom.
    """

    number: int
    time_s: float
    information: Float[np.ndarray, " e"]
    projection: Float[np.ndarray, " e"]
    place: Float[np.ndarray, " e"]
    samples: Float[np.ndarray, " e"]
    nuisance: Float[np.ndarray, "e k"]
    squares: Float[np.ndarray, " e"]
    freedom: Float[np.ndarray, " e"]


@dataclasses.dataclass
class CellStream:
    """Gathers samples of one pass on cells; arrays and numbers alone, so that it can be stored.

    Samples come as rows (row, sample) in the order of time: time [s], position [m], speed [m/s] or
    NaN where it is to be found from the positions, each element's signal, NaN where it is missing,
    and the nuisance signals.

    - `cell_m` [m]: the cells' width. Cell i reaches from i to i + 1 widths in the coordinate
      `direction` x, which grows with the motion.
    - `gain` (2,): of the amplifier, g_0 + g_1 u at the speed u.
    - `shows_noise_m` [m]: samples that are farther apart show no waves of noise alone.
    - `tail`: the last samples, which wait for their neighbours.
    - `foremost` [m]: the farthest place so far in that coordinate, NaN before the first sample.
    - `number`: of the cell in progress; `sums` (sum, cell): the sums of this cell, and of those
      after it that the last sample reaches into; a row for each number of `CellSums`.
    - `time_s` [s]: of the last sample that was added, NaN before the first.
    """

    cell_m: float
    direction: float
    gain: Float[np.ndarray, "2"]
    elements: int
    shows_noise_m: float
    tail: Float[np.ndarray, "row sample"]
    foremost: float
    number: int
    sums: Float[np.ndarray, "sum cell"]
    time_s: float

    @classmethod
    def starting(
        cls,
        cell_m: float,
        is_onwards: bool,
        gain: Float[np.ndarray, "2"],
        elements: int,
        nuisances: int,
        shows_noise_m: float,
    ) -> "CellStream":
        """Before the first sample of a pass."""
        tail = np.zeros((3 + elements + nuisances, 0))
        sums = np.zeros((elements * (6 + nuisances), 0))
        direction = 1.0 if is_onwards else -1.0
        return cls(
            cell_m, direction, gain, elements, shows_noise_m, tail, np.nan, 0, sums, np.nan
        )  # fmt: skip

    def push(self, rows: Float[np.ndarray, "row sample"]) -> list[CellSums]:
        """The cells that these samples finish, in the order of the motion.

        Samples wait until a cell ends, as nothing is finished before."""
        finished = []
        for start in range(0, rows.shape[1], TOGETHER):
            self.tail = np.concatenate([self.tail, rows[:, start : start + TOGETHER]], axis=1)
            waiting = self.tail.shape[1] - 2 * REACH
            if waiting > 0 and (waiting >= TOGETHER or self._ends_a_cell()):
                finished += self._gather(self.tail)
                self.tail = self.tail[:, -2 * REACH :]
        return finished

    def _ends_a_cell(self) -> bool:
        """Whether the newest sample that has its neighbours is beyond the cell in progress."""
        if np.isnan(self.time_s):
            return True
        foremost = (self.direction * self.tail[1, :-REACH]).max()
        return bool(foremost >= (self.number + 1) * self.cell_m)

    def close(self) -> list[CellSums]:
        """The cells that the pass has not finished, those with a signal: it has ended."""
        finished = self._gather(self.tail) if self.tail.shape[1] > 2 * REACH else []
        self.tail = self.tail[:, :0]
        for ahead, sums in enumerate(self.sums.T):
            if sums[: self.elements].any():
                finished.append(self._cell(self.number + ahead, self.time_s, sums))
        return finished

    def _gather(self, rows: np.ndarray) -> list[CellSums]:
        """Add the samples that have neighbours on both sides to their cells."""
        e, own = self.elements, slice(REACH, rows.shape[1] - REACH)
        time_s, signal = rows[0], rows[3 : 3 + e, own]
        steps = time_s[1:] - time_s[:-1]
        x = self.direction * rows[1, : 1 - REACH]
        foremost = np.maximum.accumulate(np.fmax(x, self.foremost))
        at = foremost[own]
        middles = (foremost[REACH - 1 : -1] + foremost[REACH:]) / 2
        low, high = middles[:-1], middles[1:]
        # Samples that are farther apart than cells, and those beside a gap, each count in one.
        is_wide = high - low > self.cell_m
        low, high = np.where(is_wide, at, low), np.where(is_wide, at, high)
        speed = rows[2, own]
        if np.isnan(speed).any():
            speed = np.where(np.isnan(speed), slopes(time_s, rows[1]), speed)
        a = self.gain[0] + self.gain[1] * speed
        weight, projection = np.broadcast_to(a * a, signal.shape), a * signal
        missing = np.isnan(signal) | (at - x[own] > BEHIND * self.cell_m)
        nuisance = [np.broadcast_to(a * each[own], signal.shape) for each in rows[3 + e :]]
        if missing.any():
            weight, projection, *nuisance = (
                np.where(missing, 0.0, each) for each in (weight, projection, *nuisance)
            )
        differences = fourth_differences(rows[3 : 3 + e])
        shows = np.abs(speed) * steps[REACH - 1 : -REACH] <= self.shows_noise_m
        if steps.max() > UNEVEN * steps.min():
            shows &= _longest(steps) <= -UNEVEN * _longest(-steps)
        is_known = shows & ~np.isnan(differences)
        freedom = is_known / CORRELATED
        squares = np.where(is_known, differences**2, 0.0) / (VARIANCE * CORRELATED)
        quantities = (weight, projection, weight * at, ~missing, *nuisance, squares, freedom)
        self.foremost = float(at[-1])
        return self._added(np.concatenate(quantities), low, high, time_s[own])

    def _added(
        self, quantities: np.ndarray, low: np.ndarray, high: np.ndarray, time_s: np.ndarray
    ) -> list[CellSums]:
        """Add quantities (row, sample) over their samples' intervals, and take out the cells that
        these have left behind."""
        first = np.floor(low / self.cell_m).astype(int)
        last = np.maximum(np.ceil(high / self.cell_m).astype(int) - 1, first)
        if np.isnan(self.time_s):
            self.number = int(first[0])
        count = max(int(last.max()) - self.number + 1, self.sums.shape[1])
        cells = self.number + np.arange(count)
        edges = self.cell_m * np.append(cells, cells[-1] + 1)
        length = high - low
        inside = np.diff(np.clip(edges[:, None], low, high), axis=0)
        # A sample without an interval, as at a standstill, is in one cell.
        inside = np.where(length > 0, inside / np.where(length > 0, length, 1.0),
                          first == cells[:, None])  # fmt: skip
        sums = quantities @ inside.T
        sums[:, : self.sums.shape[1]] += self.sums
        done = int(first[-1]) - self.number
        # The time of the last sample up to each cell's end.
        times = np.append(self.time_s, time_s)[np.searchsorted(first, cells[:done], side="right")]
        self.sums, self.number, self.time_s = sums[:, done:].copy(), int(first[-1]), time_s[-1]
        each = zip(cells[:done].tolist(), times.tolist(), sums.T[:done], strict=True)
        return [self._cell(*one) for one in each]

    def _cell(self, number: int, time_s: float, sums: np.ndarray) -> CellSums:
        parts = sums.reshape(-1, self.elements)
        information, projection, place, samples, *nuisance, squares, freedom = parts
        of_each = np.array(nuisance).reshape(-1, self.elements).T
        return CellSums(
            number, time_s, information, projection, place, samples, of_each, squares, freedom
        )


def slopes(
    time_s: Float[np.ndarray, " sample"], x: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, " window"]:
    """The slope [m/s] of a line through each sample and its neighbours, of all samples that have
    `REACH` on both sides. Five points halve the noise of positions that are rounded."""
    n, middle = time_s.size - 2 * REACH, slice(REACH, time_s.size - REACH)
    time = np.stack([time_s[i : i + n] for i in range(2 * REACH + 1)]) - time_s[middle]
    place = np.stack([x[i : i + n] for i in range(2 * REACH + 1)]) - x[middle]
    time = time - time.mean(axis=0)
    return (time * place).sum(axis=0) / (time * time).sum(axis=0)


def fourth_differences(
    rows: Float[np.ndarray, "row sample"],
) -> Float[np.ndarray, "row window"]:
    """The fourth difference about each sample that has two neighbours on both sides."""
    n = rows.shape[1] - 2 * REACH
    ends, beside = rows[:, :n] + rows[:, 4:], rows[:, 1 : n + 1] + rows[:, 3 : n + 3]
    return ends - 4 * beside + 6 * rows[:, 2 : n + 2]


def _longest(steps: np.ndarray) -> np.ndarray:
    """The longest of the four steps about each sample."""
    windows = np.lib.stride_tricks.sliding_window_view(steps, 2 * REACH)
    return np.max(windows, axis=-1)
