"""One pass of the sensor, from its first sample to a turn or a stop."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .cells import CellStream, CellSums
from .noise_level import NoiseLevel
from .settings import LiveSettings
from .smoother import FixedLagSmoother, Measurement
from .state_space import StateSpace

CENTRED = 1e-3  # of a cell: samples whose mean place is no farther off are at its centre
NOISE_DEPTHS = 0.1  # of a depth: samples farther apart show no waves of noise alone
HUM_GROWTH_PER_S = 0.1  # of a signal's variance, by which that of mains' waves grows in a second
HUM_SIZE = 3.0  # standard deviation of mains before anything is known, in the signal's

FinishedCell = list[float]  # position, p, q, their standard errors, pass, settling, noise


class LiveModel(NamedTuple):
    """All that is known before the first sample, for one direction of motion."""

    settings: LiveSettings
    space: StateSpace


@dataclasses.dataclass
class PassRecord:
    """What a pass keeps beside its filter.

    - `cells` (cell, 2 + e): of each cell in the smoother its number, whether the noise level was
      settling, and the noise that was assumed.
    - `typical` (e,): the rms of each element's signal under the prior, at the speed of the first
      cell; NaN before it. Nuisance parameters have their sizes by it.
    - `time_s` [s]: of the last cell's end; `number`: of the pass, from 0.
    """

    cells: Float[np.ndarray, "cell fact"]
    typical: Float[np.ndarray, " e"]
    time_s: float
    number: int


@dataclasses.dataclass
class OnePass:
    """One pass: its cells in progress, those that wait for a noise level, and the filter."""

    stream: CellStream
    queue: list[CellSums]
    smoother: FixedLagSmoother
    record: PassRecord

    @classmethod
    def starting(cls, model: LiveModel, is_onwards: bool) -> "OnePass":
        """Before the first sample of all."""
        settings, lag = model.settings, int(model.settings.lag)
        elements, nuisances = settings.elements, settings.nuisances
        stream = CellStream.starting(
            float(settings.cell_m),
            is_onwards,
            settings.gain,
            elements,
            nuisances,
            NOISE_DEPTHS * float(settings.depth_m),
        )
        smoother = FixedLagSmoother.starting(model.space, lag, elements * nuisances)
        unknown = np.full(elements, np.nan)
        record = PassRecord(np.zeros((lag + 1, 2 + elements)), unknown, np.nan, 0)
        return cls(stream, [], smoother, record)

    def following(self, model: LiveModel, is_onwards: bool) -> "OnePass":
        """The next pass, before its first sample: it begins with what this one knows of the
        nuisance parameters."""
        own, last, k = OnePass.starting(model, is_onwards), self.record, model.settings.parameters
        own.record.typical, own.record.time_s = last.typical, last.time_s
        own.record.number = last.number + (self.smoother.count > 0)
        own.smoother.mean[:k] = self.smoother.mean[:k]
        own.smoother.covariance[:k, :k] = self.smoother.covariance[:k, :k]
        return own

    def push(
        self, model: LiveModel, level: NoiseLevel, rows: Float[np.ndarray, "row sample"]
    ) -> list[FinishedCell]:
        """The cells that further samples finish; `rows` as [`CellStream`][] takes them."""
        return self._gathered(model, level, self.stream.push(rows))

    def close(self, model: LiveModel, level: NoiseLevel) -> list[FinishedCell]:
        """What the end of the pass finishes: all cells that are left."""
        finished = self._gathered(model, level, self.stream.close())
        if self.queue and not level.is_known:
            level.begin_with_power(self.queue)
        for waiting in self.queue:
            finished += self._passed(model, level, waiting)
        cells = len(self.record.cells)
        left = min(self.smoother.count, cells - 1)
        return finished + [self._finished(model, row) for row in range(cells - left, cells)]

    def _gathered(
        self, model: LiveModel, level: NoiseLevel, cells: list[CellSums]
    ) -> list[FinishedCell]:
        """What these cells finish. The first ones wait until a noise level is known, a depth of
        them at most."""
        finished = []
        for cell in cells:
            level.pass_cell(cell.squares, cell.freedom)
            self.queue.append(cell)
            if not level.is_known:
                if len(self.queue) <= model.settings.depth_cells:
                    continue
                level.begin_with_power(self.queue)
            for waiting in self.queue:
                finished += self._passed(model, level, waiting)
            self.queue = []
        return finished

    def _passed(self, model: LiveModel, level: NoiseLevel, cell: CellSums) -> list[FinishedCell]:
        """Pass one cell; the cell that this finishes."""
        space, is_there = model.space, cell.information > 0
        information = np.where(is_there, cell.information, 1.0)
        signal = np.where(is_there, cell.projection, np.nan) / (information * space.signal)
        place = cell.place / information / model.settings.cell_m - (cell.number + 0.5)
        off_centre = np.where(is_there & (np.abs(place) > CENTRED), place, 0.0)
        floor = space.floor[space.components :][: signal.size]
        noise = np.maximum(level.variance / (information * space.signal**2) - floor, 0.0)
        nuisance = self._nuisance_of(model, cell, information)
        measured = Measurement(signal, noise, off_centre, *nuisance)
        innovation = self.smoother.step(space, measured)
        is_settling = float(level.is_settling)
        own = [float(cell.number), is_settling, *np.sqrt(level.variance).tolist()]
        level.pass_innovation(innovation, noise)
        self.record.cells = np.concatenate([self.record.cells[1:], [own]])
        return [self._finished(model, 0)] if self.smoother.is_full else []

    def _nuisance_of(
        self, model: LiveModel, cell: CellSums, information: Float[np.ndarray, " e"]
    ) -> tuple[Float[np.ndarray, "e k"], Float[np.ndarray, " k"]]:
        """The signals of the nuisance parameters, and the variance that each gains up to here."""
        settings, record = model.settings, self.record
        e, k = settings.elements, settings.nuisances
        if not k:
            return np.zeros((e, 0)), np.zeros(0)
        if np.isnan(record.typical).any() and cell.information.any():
            self._size_nuisance(model, cell)
        signals = np.zeros((e, e, k))
        each = cell.nuisance / (information * model.space.signal)[:, None]
        signals[np.arange(e), np.arange(e)] = each
        passed_s = cell.time_s - record.time_s
        passed_s = 0.0 if np.isnan(passed_s) else max(passed_s, 0.0)
        record.time_s = cell.time_s
        power = np.nan_to_num(record.typical) ** 2
        growth = np.repeat(HUM_GROWTH_PER_S * passed_s * power[:, None], k, axis=1)
        if settings.has_level:
            growth[:, 0] = settings.drift**2 * passed_s
        return signals.reshape(e, -1), growth.ravel()

    def _size_nuisance(self, model: LiveModel, cell: CellSums) -> None:
        """Give the nuisance parameters their variances before anything is known: those of signals
        that are larger than the traction's at the speed of this cell."""
        settings = model.settings
        gain = np.sqrt(np.sum(cell.information) / np.sum(cell.samples))
        self.record.typical = gain * model.space.signal
        size = np.repeat((HUM_SIZE * self.record.typical[:, None]) ** 2, settings.nuisances, axis=1)
        if settings.has_level and not settings.has_offset:
            size[:, 0] = 0.0  # a drift begins at zero
        own = np.arange(size.size)
        self.smoother.covariance[own, own] = size.ravel()

    def _finished(self, model: LiveModel, row: int) -> FinishedCell:
        """One cell of the smoother as it is returned."""
        settings, direction = model.settings, self.stream.direction
        size = model.space.traction_Pa
        value = (self.smoother.traction[row] * size).tolist()
        stderr = (np.sqrt(np.maximum(self.smoother.variance[row], 0.0)) * size).tolist()
        value[0] += float(settings.nominal_pressure_Pa)
        if len(value) == 1:
            mu = float(settings.friction) * direction
            value.append(mu * value[0])
            stderr.append(abs(mu) * stderr[0])
        number, *others = self.record.cells[row].tolist()
        x = direction * float(settings.cell_m) * (number + 0.5)
        return [x, *value, *stderr, float(self.record.number), *others]
