"""One pass of the sensor, from its first sample to a turn or a stop."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .cells import CellStream, CellSums
from .covariance import JointCovariance
from .noise_level import NoiseLevel
from .settings import LiveSettings
from .smoother import FixedLagSmoother, Measurement
from .state_space import StateSpace

CENTRED = 1e-3  # of a cell: samples whose mean place is no farther off are at its centre
NOISE_DEPTHS = 0.1  # of a depth: samples farther apart show no waves of noise alone
HUM_GROWTH_PER_S = 0.1  # of its variance, by which the waves of mains change in a second
HUM_SIZE = 3.0  # standard deviation of mains before anything is known, in the signal's

FinishedCell = list[float]  # position, p, q, their standard errors, pass, settling, noise


class LiveModel(NamedTuple):
    """All that is known before the first sample, for one direction of motion."""

    settings: LiveSettings
    covariance: JointCovariance
    space: StateSpace

    @property
    def nuisance_variance(self) -> Float[np.ndarray, "e k"]:
        """The variance of each nuisance parameter before anything is known: that of signals which
        are larger than the traction's."""
        settings = self.settings
        typical = HUM_SIZE * self.covariance.signal * np.abs(settings.gain).max()
        size = np.repeat(typical[:, None] ** 2, settings.nuisances, axis=1)
        if settings.has_level and not settings.has_offset:
            size[:, 0] = 0.0  # a drift begins at zero
        return size


@dataclasses.dataclass
class PassRecord:
    """What a pass keeps beside its filter.

    - `tags` (cell, 2 + e): of each cell in the smoother its number, whether the noise level was
      settling, and the noise that was assumed.
    - `time_s` [s]: of the last cell's end; `number`: of the pass, from 0.
    """

    tags: Float[np.ndarray, "cell tag"]
    time_s: float
    number: int


@dataclasses.dataclass
class OnePass:
    """One pass: its cells in progress, those that wait for a noise level,
    and the filter."""

    stream: CellStream
    queue: list[CellSums]
    smoother: FixedLagSmoother
    record: PassRecord

    @classmethod
    def starting(
        cls, model: LiveModel, is_onwards: bool, number: int, nuisance: Float[np.ndarray, "2 k"]
    ) -> "OnePass":
        """Before the first sample; `nuisance`: mean and variance of the nuisance parameters."""
        settings, lag = model.settings, int(model.settings.lag)
        stream = CellStream.starting(
            float(settings.cell_m),
            is_onwards,
            settings.gain,
            settings.elements,
            settings.nuisances,
            NOISE_DEPTHS * float(settings.depth_m),
        )
        mean, variance = nuisance
        smoother = FixedLagSmoother.starting(
            model.space, model.covariance.components, lag, variance
        )
        smoother.mean[: mean.size] = mean
        record = PassRecord(
            np.zeros((lag + 1, 2 + settings.elements)),
            np.nan,
            number,
        )
        return cls(stream, [], smoother, record)

    def push(
        self, model: LiveModel, level: NoiseLevel, rows: Float[np.ndarray, "row sample"]
    ) -> list[FinishedCell]:
        """The cells that further samples finish; `rows` as [`CellStream`][] takes them."""
        return self._gathered(model, level, self.stream.push(rows))

    def close(self, model: LiveModel, level: NoiseLevel) -> list[FinishedCell]:
        """What the end of the pass finishes: all cells that are left."""
        finished = self._gathered(model, level, self.stream.close())
        if self.queue and not level.is_known:
            level.bound(self.queue)
        for waiting in self.queue:
            finished += self._passed(model, level, waiting)
        cells = len(self.record.tags)
        left = min(self.smoother.count, cells - 1)
        return finished + [self._finished(model, row) for row in range(cells - left, cells)]

    def nuisance(self, parameters: int) -> Float[np.ndarray, "2 k"]:
        """Mean and variance of so many nuisance parameters."""
        variance = np.diagonal(self.smoother.covariance)[:parameters]
        return np.stack([self.smoother.mean[:parameters], variance])

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
                level.bound(self.queue)
            for waiting in self.queue:
                finished += self._passed(model, level, waiting)
            self.queue = []
        return finished

    def _passed(self, model: LiveModel, level: NoiseLevel, cell: CellSums) -> list[FinishedCell]:
        """Pass one cell; the cell that this finishes."""
        covariance, space = model.covariance, model.space
        is_there = cell.information > 0
        information = np.where(is_there, cell.information, 1.0)
        signal = np.where(is_there, cell.projection, np.nan) / (information * covariance.signal)
        place = cell.place / information / model.settings.cell_m - (cell.number + 0.5)
        place = np.where(is_there & (np.abs(place) > CENTRED), place, 0.0)
        floor = space.floor[covariance.components :][: signal.size]
        noise = np.maximum(level.variance / (information * covariance.signal**2) - floor, 0.0)
        nuisance = self._nuisance_of(model, cell, information)
        innovation = self.smoother.step(space, Measurement(signal, noise, place, *nuisance))
        is_settling = float(level.is_settling)
        tag = [float(cell.number), is_settling, *np.sqrt(level.variance).tolist()]
        level.pass_innovation(innovation, noise)
        self.record.tags = np.concatenate([self.record.tags[1:], [tag]])
        return [self._finished(model, 0)] if self.smoother.is_full else []

    def _nuisance_of(
        self, model: LiveModel, cell: CellSums, information: Float[np.ndarray, " e"]
    ) -> tuple[Float[np.ndarray, "e k"], Float[np.ndarray, " k"]]:
        """The signals of the nuisance parameters, and the variance that each gains up to here."""
        settings = model.settings
        e, k = settings.elements, settings.nuisances
        if not k:
            return np.zeros((e, 0)), np.zeros(0)
        signals = np.zeros((e, e, k))
        each = cell.nuisance / (information * model.covariance.signal)[:, None]
        signals[np.arange(e), np.arange(e)] = each
        passed_s = max(cell.time_s - self.record.time_s, 0.0)
        passed_s = 0.0 if np.isnan(passed_s) else passed_s
        self.record.time_s = cell.time_s
        growth = HUM_GROWTH_PER_S / HUM_SIZE**2 * passed_s * model.nuisance_variance
        if settings.has_level:
            growth[:, 0] = settings.drift**2 * passed_s
        return signals.reshape(e, -1), growth.ravel()

    def _finished(self, model: LiveModel, row: int) -> FinishedCell:
        """One cell of the smoother as it is returned."""
        settings, direction = model.settings, self.stream.direction
        size = model.covariance.traction_Pa
        value = (self.smoother.traction[row] * size).tolist()
        stderr = (np.sqrt(np.maximum(self.smoother.variance[row], 0.0)) * size).tolist()
        value[0] += float(settings.nominal_pressure_Pa)
        if len(value) == 1:
            mu = float(settings.friction) * direction
            value.append(mu * value[0])
            stderr.append(abs(mu) * stderr[0])
        number, *others = self.record.tags[row].tolist()
        x = direction * float(settings.cell_m) * (number + 0.5)
        return [x, *value, *stderr, float(self.record.number), *others]
