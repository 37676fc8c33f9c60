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

from ... import false_alarm
from ...errors import refuse
from ...forward.amplifier import Amplifier
from ...forward.scan import Motion
from ...grid import as_real
from ...numerics import whole_steps
from ...recording.passes import Pass
from .cells import LEAST_CELLS, Cells, fitted_on, sample_middles
from .pass_statistics import PassesOnCells, PassGains, PassOnCells

MUCH_SCATTER = 1.1  # times the noise: less may be what cells make of it
MOST_BEATS = 64  # waves of a shift that varies along a pass
NEGLIGIBLE_COLUMN = 1e-3  # of the white noise's variance: a column that changes nothing


class AveragedPasses(NamedTuple):
    """What averaging of passes found: how many there are of each way, `onwards` and `back`; their
    `shifts_m`, zero where noise explains all differences, with their standard error; and the
    `scatter` between passes of a way, rms over that of the noise (NaN where it is not known), of so
    many degrees of `freedom`; their `gains`, and the scatter that is left beside these."""

    onwards: int
    back: int
    shifts_m: Float[np.ndarray, " pass"]
    shift_stderr_m: float
    scatter: float
    freedom: int
    gains: PassGains
    scatter_beside_gains: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """That passes differ by more than noise does."""
        return self._of_scatter(self.scatter)

    @property
    def warnings_beside_gains(self) -> tuple[str, ...]:
        """That passes differ by more than noise and gains of their own do, of an answer whose bands
        hold the gains."""
        return self._of_scatter(self.scatter_beside_gains)

    def _of_scatter(self, scatter: float) -> tuple[str, ...]:
        freedom = max(self.freedom, 1)
        chance = scipy.special.chdtri(freedom, false_alarm.PASSES) / freedom
        if not scatter > max(np.sqrt(chance), MUCH_SCATTER):
            return ()
        return (
            f"Passes of one direction differ by {scatter:.3g} times the noise. The bands do not "
            "include this scatter. Check whether the stage, the load and the surface repeat, and "
            "whether there is hum or drift (recording.mains_Hz, recording.drift).",
        )


class Averaging:
    """Averages of the passes of each way.

    - `rows` (e, 1 + m, sample): the signals, and columns beside them, NaN where one is missing.
    - `speed_m_per_s`: the speed that signals are given at; `cell_m`: the width of the cells.
    - `white_rms` (#e,) per sample. `drift` (#e,): of what drifts on them, after a second;
      `level` (#e,) the rms of its level.
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
        drift: Float[np.ndarray, "#e"],
        level: Float[np.ndarray, "#e"],
    ):
        speed = as_real(np.asarray(motion.speed_m_per_s))
        gain = np.asarray(amplifier.at_speed(speed) / amplifier.at_speed(as_real(speed_m_per_s)))
        self._name, self._motion, self._gain, self._every = name, motion, gain, passes
        self._given = [self._rising(each, motion, gain, rows) for each in passes]
        self.directions = tuple(
            direction
            for direction in (True, False)
            if any(p.is_onwards == direction for p in passes)
        )
        self._direction = [self.directions.index(each.is_onwards) for each in passes]
        middles = [sample_middles(x) for x, _, _ in self._given]
        first, last = min(m[0] for m in middles), max(m[-1] for m in middles)
        refuse(
            not all(whole_steps(m[-1] - m[0], cell_m) > LEAST_CELLS for m in middles),
            f"{name}: a pass is shorter than {LEAST_CELLS} cells of {cell_m:.4g} m: check the "
            "positions' unit, or give a smaller recording.cell_m.",
        )
        self._edges = first + cell_m * np.arange(whole_steps(last - first, cell_m) + 1)
        self._variance = np.broadcast_to(white_rms**2, len(rows))[:, None]
        step = drift * np.sqrt(cell_m / speed_m_per_s)
        self._step = np.broadcast_to(step, len(rows))[:, None]
        self._level = np.broadcast_to(level, len(rows))[:, None]
        self._depth, self._is_walk = depth_m, bool(drift.any())

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
        """Cells with a row for each direction and element, direction by direction, the columns of
        each row, and what was found."""
        passes, shifts, stderr = self._settled()
        cells, columns = self._average(passes, np.hypot(_spread(shifts, passes), stderr))
        # What drifts does not repeat either: passes then differ by more than the white noise.
        scatter, freedom = passes.scatter()
        beside, _ = passes.less_gains().scatter()
        if self._is_walk:
            scatter = beside = float("nan")
        found = AveragedPasses(
            int(np.sum([self.directions[i] for i in self._direction])),
            int(np.sum([not self.directions[i] for i in self._direction])),
            shifts, stderr, scatter, freedom, passes.gains, beside,
        )  # fmt: skip
        return cells, columns, found

    def aligned(
        self, rounded_m: float = 0.0
    ) -> tuple[Motion, Float[np.ndarray, "e way sample"], Float[np.ndarray, "e sample"]]:
        """The motion with each pass less its shift; for each way what it may still be off makes of
        the signals, as columns, none where noise explains all differences and nothing is rounded;
        and what positions that are rounded make of each sample, rms.

        `rounded_m`: rms rounding of the positions, of which the mean over a way may be as much.
        """
        are_many = len(self._every) > len(self.directions)
        shifts = np.zeros(len(self._every))
        passes, shifts, _ = self._settled() if are_many else (self._passes(shifts), shifts, 0.0)
        position = np.asarray(self._motion.position_m).copy()
        slopes = np.zeros((len(self._variance), len(self.directions), position.size))
        if not shifts.any() and not rounded_m:
            return self._motion, slopes[:, :0], slopes[:, 0]
        spread = _spread(shifts, passes) if are_many else 0.0
        centres = (self._edges[1:] + self._edges[:-1]) / 2
        of_direction = [
            passes.slope(direction, self._depth) for direction in range(len(self.directions))
        ]
        for each, direction, shift in zip(self._every, self._direction, shifts, strict=True):
            own = each.samples
            position[own] -= shift
            slopes[:, direction, own] = [
                self._gain[own] * np.interp(position[own], centres, row)
                for row in of_direction[direction]
            ]
        counts = np.array(
            [self._direction.count(direction) for direction in range(len(self.directions))]
        )
        columns = slopes * np.hypot(spread / np.sqrt(counts), rounded_m)[:, None]
        if rounded_m:
            columns = np.concatenate([columns, rounded_m * self._drifting(slopes, position)], 1)
        motion = Motion(self._motion.time_s, position, self._motion.speed_m_per_s)
        return motion, columns, rounded_m * np.abs(slopes.sum(axis=1))

    def _drifting(
        self, slopes: Float[np.ndarray, "e way sample"], position_m: Float[np.ndarray, " sample"]
    ) -> Float[np.ndarray, "e column sample"]:
        """What a shift of variance one that varies along x makes of the signals, over a depth and
        longer: where a sample is nearly a whole number of steps from the next one, rounding beats
        slowly with the sampling."""
        first, length = float(self._edges[0]), float(np.ptp(self._edges))
        count = min(max(int(np.ceil(length / self._depth)), 1), MOST_BEATS)
        along = np.pi * np.clip((position_m - first) / length, 0.0, 1.0)
        waves = np.sqrt(2 / count) * np.cos(np.arange(1, count + 1)[:, None] * along)
        elements, directions, n = slopes.shape
        return (slopes[:, :, None] * waves).reshape(elements, directions * count, n)

    def _settled(self) -> tuple[PassesOnCells, Float[np.ndarray, " pass"], float]:
        """The passes where their signals agree, by how much they are moved, and its standard error;
        not moved where noise explains all differences."""
        shifts = np.zeros(len(self._given))
        passes = self._passes(shifts)
        fitted, stderr = passes.shifts(self._depth)
        if passes.are_shifted(fitted, stderr):
            shifts = fitted
            for _ in range(2):
                passes = self._passes(shifts)
                further, stderr = passes.shifts(self._depth)
                shifts = shifts + further
        return passes, shifts, stderr

    def _passes(self, shifts_m: Float[np.ndarray, " pass"]) -> PassesOnCells:
        """Every pass on the common cells, moved back by its shift, less the columns' expected
        signal."""
        n, every = self._edges.size - 1, []
        cell = self._edges[1] - self._edges[0]
        for (x, gain, rows), shift in zip(self._given, shifts_m, strict=True):
            middles = sample_middles(x - shift)
            start = max(int(np.ceil((middles[0] - self._edges[0]) / cell - 1e-9)), 0)
            stop = min(int(np.floor((middles[-1] - self._edges[0]) / cell + 1e-9)), n)
            refuse(
                stop - start < LEAST_CELLS,
                f"{self._name}: a pass matches the others of its direction only when moved by "
                f"{shift:.4g} m, more than a stage is off: check whether the positions' "
                "counter wraps.",
            )
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
        passes = PassesOnCells(
            every, self._direction, self._variance, self._step, cell
        ).without_nuisance()
        return passes.levelled() if self._is_walk else passes

    def _average(
        self, passes: PassesOnCells, shift_stderr_m: float
    ) -> tuple[Cells, Float[np.ndarray, "row m cell"]]:
        samples = float(np.median([p.typical for p in passes.every]))
        spread = np.zeros(len(self._variance)) if self._is_walk else passes.level_spread()
        signal, white, slow, beside = [], [], [], []
        for direction, (mean, own) in enumerate(zip(passes.signals, passes.columns, strict=True)):
            each = passes.of(direction)
            total = np.sum([p.information for p in each], axis=0)
            known = total > 0
            total = np.where(known, total, 1.0)
            squares = np.sum([(p.information * p.slow) ** 2 for p in each], axis=0)
            signal.append(np.where(known, mean, np.nan))
            white.append(np.where(known, np.sqrt(samples / total), 1.0))
            slow.append(np.where(known, np.sqrt(squares) / total, 1.0))
            # Of one pass alone the position is what the recording says.
            moved = passes.slope(direction, self._depth) * shift_stderr_m / np.sqrt(len(each))
            moved = moved[:, None] * (len(each) > 1)
            level = np.broadcast_to(spread[:, None, None] / np.sqrt(len(each)), moved.shape)
            walk = (self._level * passes.level_of(direction))[:, None]
            beside.append(np.concatenate([own, moved, level, walk], axis=1))
        x = (self._edges[1:] + self._edges[:-1]) / 2
        signal, white, slow, beside = map(np.concatenate, (signal, white, slow, beside))
        least = NEGLIGIBLE_COLUMN * np.min(self._variance) * np.min(white**2) / samples
        return Cells(x, signal, samples, white, slow), _compressed(beside, least)


def _spread(shifts_m: Float[np.ndarray, " pass"], passes: PassesOnCells) -> float:
    """By how much a pass is typically off."""
    return float(np.sqrt(np.sum(shifts_m**2) / max(passes.contrasts, 1)))


def _compressed(columns: Float[np.ndarray, "row m n"], least: float) -> np.ndarray:
    """As few columns of the same sum of squares, but for a variance of `least` each."""
    parts = [np.linalg.svd(own, full_matrices=False)[1:] for own in columns]
    count = max((int(np.sum(strength**2 > least)) for strength, _ in parts), default=0)
    return np.stack([strength[:count, None] * axes[:count] for strength, axes in parts])
