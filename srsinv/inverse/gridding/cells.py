"""Signals along a motion put on the cells of a line.

At constant speed a cell has the mean of a block of samples; else its signal at the mean speed is
fitted to the samples that lie in it.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ... import resolution
from ...errors import refuse
from ...forward.amplifier import Amplifier
from ...forward.scan import Motion
from ...grid import Open
from ...known import in_numpy
from ...numerics import SAME_COUNT, whole_steps
from ..noise.model import is_steady

LEAST_CELLS = 3  # as a line needs
LEAST_SAMPLES = 3
MOST_UNSCANNED = 100  # cells for each that was scanned: the least scan has 85 within its margins
FEW_CELLS = 1024  # beyond, a line is lengthened to what Fourier transforms are quick for,
MOST_LONGER = 256  # by so many cells at most: equations for missing samples treat a run densely
QUICK_PRIME = 11  # transforms have code of their own for factors up to it
FEW = 0.25  # of the median information: a cell with less has twice the noise of the others


class Window(NamedTuple):
    """The stretch of surface that is pressed on."""

    start_m: float
    end_m: float

    @property
    def length_m(self) -> float:
        """Its length."""
        return self.end_m - self.start_m


class Cells(NamedTuple):
    """Signals on successive cells: their centres `x_m` [m], the signal NaN where it is missing, and
    the number of `samples` at the mean speed that a cell is typically equivalent to.

    Factors on the noise's standard deviation, (e, cell): `white_scale` on that of as many samples,
    `slow_scale` on that of noise that is correlated along the motion, whatever the speed.
    """

    x_m: Float[np.ndarray, " cell"]
    signal: Float[np.ndarray, "e cell"]
    samples: float
    white_scale: Float[np.ndarray, "e cell"]
    slow_scale: Float[np.ndarray, "e cell"]

    def parted(self, elements: int) -> tuple["Cells", Float[np.ndarray, "e column cell"]]:
        """The cells of the first of each element's rows, and the others' signals."""
        first, *_ = rows = self.signal.reshape(elements, -1, self.signal.shape[-1]).swapaxes(0, 1)
        count = len(rows)
        scales = self.white_scale[::count], self.slow_scale[::count]
        return Cells(self.x_m, first, self.samples, *scales), rows[1:].swapaxes(0, 1)


def window_around(
    given: tuple[float, float] | None, x_m: Float[np.ndarray, " x"], depth_m: float
) -> Window:
    """The window that was given, else the scan and a margin beyond its ends."""
    if given:
        return Window(float(given[0]), float(given[1]))
    margin = resolution.margin_m("traction", depth_m)
    return Window(float(np.min(x_m)) - margin, float(np.max(x_m)) + margin)


def check_cells(name: str, length_m: float, cell_m: float) -> None:
    """Refuse a line that exceeds the memory of any machine: a unit is probably wrong."""
    cells, most = length_m / cell_m, resolution.MOST_CELLS
    refuse(
        not cells <= most,
        f"{name}: {length_m:.4g} m in cells of {cell_m:.4g} m make {cells:.4g} cells, "
        f"more than {most}: check the units of recording.speed_m_per_s, "
        "recording.sample_rate_hz, sensor.depth_m and recording.contact_window_m.",
    )


def sample_spacing_m(motion: Motion) -> float:
    """The mean distance between samples."""
    return float(np.mean(np.abs(np.asarray(motion.speed_m_per_s)))) / motion.sample_rate_hz


def block_of(name: str, motion: Motion, depth_m: float, cell_m: float | None) -> int:
    """Number of samples in one cell: about `cell_m` wide, else no wider than the depth asks for.

    At a varying speed samples are shared between cells, and with one in each their noise would be.
    Raises `BadInput` for a scan shorter than three cells.
    """
    spacing, count = sample_spacing_m(motion), motion.time_s.size
    wide = resolution.cell_m("inversion", depth_m) if cell_m is None else cell_m
    length = count * spacing
    refuse(
        not length * (1 + SAME_COUNT) >= LEAST_CELLS * wide,
        f"{name}: the scan is {length:.4g} m long, less than {LEAST_CELLS} cells of {wide:.4g} m: "
        "record a longer one, check the positions' unit, or give a smaller recording.cell_m.",
    )
    if cell_m is None:
        block = whole_steps(wide, spacing)
        block = max(block, 1 if is_steady(motion) else 2)
    else:
        block = round(wide / spacing * (1 + SAME_COUNT))
    return int(np.clip(block, 1, count // LEAST_SAMPLES))


def cell_signals(
    name: str,
    motion: Motion,
    signal: Float[np.ndarray, "e sample"],
    amplifier: Amplifier,
    block: int,
) -> Cells:
    """Cells of `block` samples at the mean speed, in the order of time.

    At constant speed a cell is a block of samples and has their mean, where none is missing.
    """
    if is_steady(motion) and np.isfinite(signal).all():
        used = motion.time_s.size // block * block

        def means(values: np.ndarray) -> np.ndarray:
            return values[..., :used].reshape(*values.shape[:-1], -1, block).mean(axis=-1)

        of_cells, alike = means(signal), np.ones((len(signal), used // block))
        return Cells(means(np.asarray(motion.position_m)), of_cells, float(block), alike, alike)
    return _fitted_cells(name, motion, signal, amplifier, block * sample_spacing_m(motion))


def _fitted_cells(
    name: str, motion: Motion, signal: np.ndarray, amplifier: Amplifier, cell: float
) -> Cells:
    """Cells at a varying speed, along the motion's direction."""
    speed = np.asarray(motion.speed_m_per_s)
    mean = speed.mean()
    gain: Any = in_numpy(amplifier).at_speed
    a = np.asarray(gain(speed)) / np.asarray(gain(np.asarray(mean)))
    x = np.maximum.accumulate(np.sign(mean) * np.asarray(motion.position_m))
    middles = sample_middles(x)
    length = float(middles[-1] - middles[0])
    refuse(
        whole_steps(length, cell) < LEAST_CELLS,
        f"{name}: the scan is {length:.4g} m long, less than {LEAST_CELLS} cells of "
        f"{cell:.4g} m: check the positions' unit, or give a smaller recording.cell_m.",
    )
    edges = middles[0] + cell * np.arange(whole_steps(length, cell) + 1)
    return Cells(np.sign(mean) * (edges[:-1] + cell / 2), *fitted_on(edges, x, a, signal))


def line_over(
    cells: Cells, window_m: tuple[float, float] | None, depth_m: float
) -> tuple[Open, Cells]:
    """The open line over the window, and what is on all of its cells: the signal is NaN where there
    is none."""
    x, rows = cells.x_m, (cells.signal, cells.white_scale, cells.slow_scale)
    if x[-1] < x[0]:
        x, rows = x[::-1], tuple(each[:, ::-1] for each in rows)
    cell = float((x[-1] - x[0]) / (x.size - 1))
    window = window_around(window_m, x, depth_m)
    check_cells(f"The contact window, [{window.start_m}, {window.end_m}] m", window.length_m, cell)
    before = max(0, whole_steps(float(x[0]) - cell / 2 - window.start_m, cell))
    after = max(0, whole_steps(window.end_m - float(x[-1]) - cell / 2, cell))
    n = before + x.size + after
    refuse(
        n > MOST_UNSCANNED * x.size,
        f"The scan is {x[-1] - x[0] + cell:.4g} m long, but the contact needs a line "
        f"of {n * cell:.4g} m, more than {MOST_UNSCANNED} times that: record a longer "
        "scan, or give a narrower recording.contact_window_m.",
    )
    if window_m is None and n > FEW_CELLS:
        n = _quick_length(n)
        after = n - before - x.size
    line = Open(n, cell, x[0] - before * cell)
    around = (0, 0), (before, after)
    signal = np.pad(rows[0], around, constant_values=np.nan)
    scales = (np.pad(each, around, constant_values=1.0) for each in rows[1:])
    return line, Cells(np.asarray(line.x), signal, cells.samples, *scales)


def _quick_length(n: int) -> int:
    """The length from n on that Fourier transforms are quick for."""
    return min(range(n, n + MOST_LONGER), key=lambda each: max(_largest_prime(each), QUICK_PRIME))


def _largest_prime(n: int) -> int:
    """The largest prime factor."""
    prime = 2
    while prime * prime <= n:
        n, prime = (n // prime, prime) if n % prime == 0 else (n, prime + 1)
    return n


def fitted_on(
    edges: Float[np.ndarray, " edge"],
    x: Float[np.ndarray, " sample"],
    a: Float[np.ndarray, " sample"],
    signal: Float[np.ndarray, "e sample"],
) -> tuple[
    Float[np.ndarray, "e cell"], float, Float[np.ndarray, "e cell"], Float[np.ndarray, "e cell"]
]:
    """The least-squares signal of each cell at the mean speed, NaN with too little information, and
    what else [`Cells`][] has of them.

    A sample at x, which never falls, is v = a s + white noise, a = gain(u) / gain(mean u): u over
    its mean for a rate signal. Least squares give s = sum(a v) / sum(a^2) with the noise's variance
    over sum(a^2), and nothing is divided by a small u. A cell where sum(a^2) is far below the
    median is missing (a standstill, a gap); the median is taken for the others, less the fraction
    of their samples that is missing, and each cell's own information is in its factor. What is
    correlated along the motion is in s sum(a) / sum(a^2) times.

    The mean of whole samples is off the cell's centre by up to half a spacing, which on a clean
    recording matters more than the noise. So a sample is weighted in each cell by the fraction of
    its interval, from middle to middle between neighbours, inside; and s, which is at the samples'
    weighted mean position, is interpolated to the centres: the two differ beside a standstill.
    """
    middles = sample_middles(x)

    def totals(values: Float[np.ndarray, "row sample"]) -> Float[np.ndarray, "row cell"]:
        sums = np.pad(np.cumsum(values, axis=-1), ((0, 0), (1, 0)))
        return np.diff([np.interp(edges, middles, row) for row in sums])

    observed = np.isfinite(signal)
    weight = np.where(observed, a**2, 0.0)
    whole = totals(a[None] ** 2)
    typical = float(np.median(whole))
    information = totals(weight)
    information = np.where(information >= FEW * typical, information, np.nan)
    observed_fraction = (information / whole)[np.isfinite(information)]
    typical *= float(np.median(observed_fraction)) if observed_fraction.size else 1.0
    fitted = totals(np.where(observed, a * signal, 0.0)) / information
    white = np.sqrt(typical / information)
    slow = totals(np.where(observed, np.abs(a), 0.0)) / information
    centres = (edges[:-1] + edges[1:]) / 2
    rows = zip(totals(weight * x) / information, fitted, strict=True)
    signals = np.stack([_interpolated(centres, *row) for row in rows])
    white, slow = (np.where(np.isfinite(each), each, 1.0) for each in (white, slow))
    return signals, typical, white, slow


def sample_middles(x: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " middle"]:
    """Where the intervals of samples at rising x meet, and the ends of the first and the last."""
    return np.concatenate(
        [[1.5 * x[0] - x[1] / 2], (x[1:] + x[:-1]) / 2, [1.5 * x[-1] - x[-2] / 2]]
    )


def _interpolated(
    centres: Float[np.ndarray, " cell"],
    at: Float[np.ndarray, " cell"],
    values: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Values given at `at`, interpolated to the centres of the same cells; NaN stays.

    Beside a gap and at the ends by the slope on the other side: one across the gap is not that at
    its edge, and beyond the ends there is none. In the last cell before a turn the samples are
    slower the farther they are, so that their weighted mean is far off its centre.
    """
    moved, last = values.copy(), values.size - 1
    cells = np.flatnonzero(np.isfinite(values) & (centres != at))
    side = np.where(centres[cells] > at[cells], 1, -1)
    beside, other = (np.clip(each, 0, last) for each in (cells + side, cells - side))
    is_known = (beside != cells) & np.isfinite(values[beside])
    beside = np.where(is_known, beside, other)
    # Cells whose samples are all at one place have one value, and no slope.
    known = (at[beside] != at[cells]) & np.isfinite(values[beside])
    i, j = cells[known], beside[known]
    moved[i] += (values[j] - values[i]) * (centres[i] - at[i]) / (at[j] - at[i])
    return moved
