"""Samples along a motion put on the cells of a line, with all that is on them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float

from ...errors import BadInput, refuse
from ...forward.film import SampleAverage
from ...forward.scan import ConstantSpeed, Motion
from ...forward.sensor import Sensor
from ...grid import Open, as_real
from ...recording.passes import Pass, go_both_ways, passes_of
from ..noise.model import SampleNoise
from .cells import LEAST_SAMPLES, Cells, block_of, cell_signals, line_over, sample_spacing_m
from .passes import AveragedPasses, Averaging


class SampledSignals(NamedTuple):
    """Signals (e, sample) along a motion, NaN where one is missing, and columns (e, m, sample) of
    what else may be on them; refusals call them `name`."""

    name: str
    sensor: Sensor
    motion: Motion
    signal: Float[np.ndarray, "e sample"]
    columns: Float[np.ndarray, "e m sample"]
    noise: SampleNoise

    @property
    def rows(self) -> Float[np.ndarray, "e row sample"]:
        """The signals and their columns, missing where the signals are."""
        rows = np.concatenate([self.signal[:, None], self.columns], axis=1)
        return np.where(np.isfinite(self.signal)[:, None], rows, np.nan)

    def cut(self, one: Pass) -> "SampledSignals":
        """One pass of them."""
        own = self.motion.of_samples(one.samples)
        signal, beside = self.signal[:, one.samples], self.columns[..., one.samples]
        return self._replace(motion=own, signal=signal, columns=beside)


class OnCells(NamedTuple):
    """Signals on the cells of an open line, as a [`LineProblem`][] takes them, of the elements of
    `sensor`, of which each stands for one direction of motion; `passes` where it turns."""

    line: Open
    sensor: Sensor
    scan: ConstantSpeed
    data: Float[np.ndarray, "e n"]
    power: Float[Array, "#e k"]
    observed: Bool[np.ndarray, "e n"]
    nuisance: Float[np.ndarray, "e m n"] | None
    noise_scale: Float[np.ndarray, "e n"] | None
    passes: AveragedPasses | None


def on_cells(
    given: SampledSignals,
    window_m: tuple[float, float] | None,
    cell_m: float | None,
    direction: bool | None = None,
) -> OnCells:
    """Signals along a motion on cells of about `cell_m`, or as wide as the depth asks for.

    Passes of a motion that turns are averaged, each direction of motion by itself; `direction`
    takes those towards +x (True) or -x (False) alone. Raises `BadInput` for scans shorter than
    three cells.
    """
    every = passes_of(np.asarray(given.motion.position_m))
    if not every:
        raise BadInput(
            f"{given.name}: the sensor does not move, so there is no rate signal: give a "
            "recording that slides."
        )
    turns = go_both_ways(every)
    passes = tuple(each for each in every if direction is None or each.is_onwards == direction)
    if not passes:
        towards = "+x" if direction else "-x"
        raise BadInput(f"{given.name}: no pass goes towards {towards}: give recording.ways=both.")
    _check_samples(given, passes)
    first, *others = passes
    if turns and others:
        return _averaged(given, passes, window_m, cell_m)
    given = given.cut(first) if turns else given
    depth = float(given.sensor.depth_m)
    block = block_of(given.name, given.motion, depth, cell_m)
    rows = given.rows
    cells = cell_signals(
        given.name, given.motion, rows.reshape(-1, rows.shape[-1]), given.sensor.amplifier, block
    )
    start_m = float(cells.x_m[0])
    line, cells = line_over(cells, window_m, depth)
    cells, columns = cells.parted(len(rows))
    scan = ConstantSpeed(float(np.mean(np.asarray(given.motion.speed_m_per_s))))
    trend = np.ones((len(rows), line.n)), start_m
    sensor = _averaging_samples(given.sensor, block, sample_spacing_m(given.motion))
    return _placed(given.noise, line, sensor, scan, cells, columns, trend, None)


def _averaged(
    given: SampledSignals,
    passes: tuple[Pass, ...],
    window_m: tuple[float, float] | None,
    cell_m: float | None,
) -> OnCells:
    """The means of several passes."""
    noise, depth = given.noise, float(given.sensor.depth_m)
    averaging, block, mean = _averaging(given, passes, cell_m)
    cells, beside, found = averaging()
    start_m, directions = float(cells.x_m[0]), averaging.directions
    # Columns are rows of their own beside the signals, so that the line's ends are theirs too.
    stacked = np.concatenate([cells.signal[:, None], beside], axis=1)
    each = stacked.shape[1]
    scales = (np.repeat(part, each, axis=0) for part in (cells.white_scale, cells.slow_scale))
    wide = Cells(cells.x_m, stacked.reshape(-1, stacked.shape[-1]), cells.samples, *scales)
    line, wide = line_over(wide, window_m, depth)
    cells, columns = wide.parted(len(stacked))
    spacing = mean / given.motion.sample_rate_hz
    sensor = _averaging_samples(given.sensor, block, spacing)
    if len(directions) > 1:
        sensor = sensor.in_both_directions()
    noise = noise.of_directions(len(directions))
    trend = cells.slow_scale, start_m
    return _placed(noise, line, sensor, ConstantSpeed(mean), cells, columns, trend, found)


def aligned(
    given: SampledSignals, passes: Sequence[Pass], cell_m: float | None, rounded_m: float
) -> tuple[Motion, Float[np.ndarray, "e way sample"], Float[np.ndarray, "e sample"]]:
    """The motion with each of its passes where the signals of its way have their mean place, and
    what it may be off: see [`Averaging`][]. Raises `BadInput` for passes shorter than three
    cells."""
    _check_samples(given, passes)
    return _averaging(given, passes, cell_m)[0].aligned(rounded_m)


def _check_samples(given: SampledSignals, passes: Sequence[Pass]) -> None:
    """Refuse passes of so few samples that they are no passes."""
    time_s = np.asarray(given.motion.time_s)
    for each in passes:
        own = each.samples
        count, at_s = own.stop - own.start, float(time_s[own.start])
        refuse(
            count < LEAST_SAMPLES,
            f"{given.name}: the position turns back after {count} of its samples, at "
            f"{at_s:.6g} s: correct its spike or its counter's wrap there.",
        )


def _averaging(
    given: SampledSignals, passes: Sequence[Pass], cell_m: float | None
) -> tuple[Averaging, int, float]:
    """The averaging of passes, the samples in a cell, and the mean speed."""
    motion, noise = given.motion, given.noise
    depth, rate = float(given.sensor.depth_m), motion.sample_rate_hz
    longest = max(passes, key=lambda each: each.samples.stop - each.samples.start)
    block = max(block_of(given.name, given.cut(longest).motion, depth, cell_m), 2)
    speed = np.abs(np.asarray(motion.speed_m_per_s))
    mean = float(np.mean(np.concatenate([speed[each.samples] for each in passes])))
    averaging = Averaging(
        given.name, motion, passes, given.rows, given.sensor.amplifier, mean,
        block * mean / rate, np.asarray(noise.white, float), depth, np.asarray(noise.drift),
        noise.level(motion),
    )  # fmt: skip
    return averaging, block, mean


def _placed(
    noise: SampleNoise,
    line: Open,
    sensor: Sensor,
    scan: ConstantSpeed,
    cells: Cells,
    columns: Float[np.ndarray, "e m n"],
    trend: tuple[Float[np.ndarray, "e n"], float],
    passes: AveragedPasses | None,
) -> OnCells:
    """The signals with their noise; `trend` has the size of a walk's in each cell, and where it
    starts."""
    observed = np.isfinite(cells.signal)
    data = np.where(observed, cells.signal, 0.0)
    signal_rms = np.sqrt(np.sum(data**2) / np.sum(observed))
    power = noise.power(line, scan, signal_rms, cells.samples)
    if noise.has_drift:
        size, start_m = trend
        own = (size * noise.trend(line, scan, start_m))[:, None]
        columns = np.concatenate([columns, own], axis=1)
    if sensor.amplifier.offset is None:
        power = np.array(power)
        power[:, 0] = np.inf
        power = as_real(power)
    return OnCells(
        line, sensor, scan, data, power, observed,
        np.where(observed[:, None], columns, 0.0) if columns.shape[1] else None,
        noise.scale(power, cells.samples, cells.white_scale, cells.slow_scale), passes,
    )  # fmt: skip


def _averaging_samples(sensor: Sensor, block: int, spacing_m: float) -> Sensor:
    """The sensor whose signals are means over so many samples."""
    if block == 1:
        return sensor
    return sensor.with_films(lambda film: film.with_effect(SampleAverage(block, spacing_m)))
