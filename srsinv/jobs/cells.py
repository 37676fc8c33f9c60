"""Recordings on a line of cells: the problem that an inversion solves."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..config import reader
from ..errors import choice, number, refuse
from ..forward.amplifier import Amplifier
from ..forward.film import SampleAverage
from ..forward.noise import total_spectrum
from ..forward.scan import ConstantSpeed
from ..forward.sensor import Sensor
from ..grid import Open, as_real
from ..inverse.problem import Problem
from ..inverse.quadratic import DIRECT_LIMIT
from ..recording import Recording
from ..recording.even import STEADY, check_volts, load_even
from . import build
from .recorded import (
    MARGIN_DEPTHS,
    check_cells,
    coloured_noises,
    contact_window,
    elements_named,
    nominal_pressure,
    sensor_of,
    times_rows,
    white_rms,
)

CELLS_PER_DEPTH = 8  # beyond, e^(-k z) is negligible: at the cells' last wavenumber it is e^(-25)
TURNED = 0.01  # of the greatest speed: a way back slower than this is the noise of a standstill
LEAST_CELLS = 3  # as a line needs
FEW = 0.25  # of the median information: a cell with less has twice the noise of the others


@dataclass(frozen=True)
class RecordingProblem:
    """A recording and the problem of inverting it, p and q in `traction_unit`; `assumed`: its
    assumptions in words."""

    recording: Recording
    sensor: Sensor
    speed_m_per_s: float
    problem: Problem
    traction_unit: str
    assumed: tuple[tuple[str, str], ...]


def recording_problem(cfg: build.Config, cells_per_depth: int | None = None) -> RecordingProblem:
    """The recording that the configuration names, on an open line over its contact window.

    Cells are `recording.cell_m` wide; where that is null `cells_per_depth` are in a depth, or, by
    default, 8 and as many fewer as a direct solution can hold. Raises `BadInput` for a recording
    that cannot be inverted.
    """
    friction = build.friction(cfg)
    recording = _load(cfg)
    unit = _traction_unit(cfg, recording)
    nominal = nominal_pressure(recording)
    ideal = sensor_of(cfg, recording)
    depth = float(ideal.depth_m)
    speed = float(np.mean(recording.speed_m_per_s))
    spacing = abs(speed) / recording.sample_rate_hz
    cell = _cell_m(cfg)
    if cell is None and cells_per_depth is not None:
        cell = depth / cells_per_depth
    block = _block(cell, recording, depth, spacing, 1 if friction is not None else 2)
    noise_rms = white_rms(cfg, recording, depth, _widest_spacing(recording, spacing))
    position, signal, samples = cell_signals(recording, ideal.amplifier, block, spacing)
    line, data, observed = _on_line(position, signal, recording.sidecar, depth)
    average = (SampleAverage(block, spacing),) if block > 1 else ()
    sensor = sensor_of(cfg, recording, average)
    scan = ConstantSpeed(speed)
    noise = _spectrum(cfg, line, scan, data, observed, noise_rms / np.sqrt(samples))
    offset = sensor.amplifier.offset
    if offset is None:
        noise = noise.at[0].set(jnp.inf)
    else:
        data = np.where(observed, data - np.asarray(offset), 0.0)
    problem = Problem(
        line,
        sensor.operator(line, scan),
        data,
        noise,
        observed=observed,
        known_mean_Pa=(0.0, None),
        background_Pa=(nominal, None),
        friction=friction,
    )
    assumed = _assumed(cfg, recording, sensor, line, block, spacing, noise_rms, nominal, unit)
    return RecordingProblem(recording, sensor, speed, problem, unit, assumed)


def _traction_unit(cfg: build.Config, recording: Recording) -> str:
    """The unit of p and q: Pa, or "1" where the sensor's or the amplifier's gain is not known and
    they are relative."""
    wanted = choice("traction_unit", cfg.get("traction_unit", "Pa"), ("Pa", "relative"))
    if wanted == "Pa":
        check_volts(recording)
        return "Pa"
    refuse(
        recording.sidecar.get("nominal_pressure_Pa") is not None,
        f"{recording.name}: nominal_pressure_Pa is given, and traction_unit=relative makes p a "
        "number without a unit: leave one of them out.",
    )
    return "1"


def _load(cfg: build.Config) -> Recording:
    recording = load_even(cfg["recording"], elements_named(cfg), reader(cfg))
    least, greatest = recording.speed_m_per_s.min(), recording.speed_m_per_s.max()
    refuse(
        min(greatest, -least) > TURNED * max(greatest, -least),
        f"{recording.name}: the motion reverses (its speed goes from {least:.4g} to "
        f"{greatest:.4g} m/s), and friction with it, so that no one traction explains all of it: "
        "cut the recording where it turns.",
    )
    return recording


def _cell_m(cfg: build.Config) -> float | None:
    wanted = cfg["recording"].get("cell_m")
    if wanted is None:
        return None
    return float(number("recording.cell_m", wanted, "a positive width in metres", above=0))


def _block(
    wanted: float | None, recording: Recording, depth: float, spacing: float, unknowns: int
) -> int:
    """Number of samples averaged into one cell, `wanted` metres wide where that is given."""
    length = spacing * recording.time_s.size + 2 * MARGIN_DEPTHS * depth
    cell = max(depth / CELLS_PER_DEPTH, length * unknowns / DIRECT_LIMIT)
    return int(np.clip(round((wanted or cell) / spacing), 1, recording.time_s.size // 3))


def cell_signals(
    recording: Recording, amplifier: Amplifier, block: int, spacing: float
) -> tuple[Float[np.ndarray, " cell"], Float[np.ndarray, "e cell"], float]:
    """Position [m] and signal of cells of block * spacing, the signal NaN where it is missing, and
    the number of samples at the mean speed that a cell is equivalent to.

    At constant speed a cell is a block of samples and has their mean, where none is missing.
    """
    if recording.is_constant_speed(STEADY) and np.isfinite(recording.signal).all():
        blocks = recording.block_average(block)
        return blocks.position_m, blocks.signal, float(block)
    return _fitted_cells(recording, amplifier, block * spacing)


def _fitted_cells(
    recording: Recording, amplifier: Amplifier, cell: float
) -> tuple[Float[np.ndarray, " cell"], Float[np.ndarray, "e cell"], float]:
    """Cells at a varying speed, along the recording's direction."""
    speed, mean = recording.speed_m_per_s, recording.speed_m_per_s.mean()
    a = np.asarray(amplifier.gain(as_real(speed)) / amplifier.gain(as_real(mean)))
    x = np.maximum.accumulate(np.sign(mean) * recording.position_m)
    middles = _middles(x)
    edges = _cell_edges(recording, middles, cell)
    signal, typical = fitted_on(edges, x, a, recording.signal)
    return np.sign(mean) * (edges[:-1] + cell / 2), signal, typical


def fitted_on(
    edges: Float[np.ndarray, " edge"],
    x: Float[np.ndarray, " sample"],
    a: Float[np.ndarray, " sample"],
    signal: Float[np.ndarray, "e sample"],
) -> tuple[Float[np.ndarray, "e cell"], float]:
    """The least-squares signal of each cell at the mean speed, NaN with too little information, and
    the number of samples at that speed that a cell is equivalent to.

    A sample at x, which never falls, is v = a s + white noise, a = gain(u) / gain(mean u): u over
    its mean for a rate signal. Least squares give s = sum(a v) / sum(a^2) with the noise's variance
    over sum(a^2), and nothing is divided by a small u. A cell where sum(a^2) is far below the
    median is missing (a standstill, a gap); the median is taken for the others, less the fraction
    of their samples that is missing.

    The mean of whole samples is off the cell's centre by up to half a spacing, which on a clean
    recording matters more than the noise. So a sample is weighted in each cell by the fraction of
    its interval, from middle to middle between neighbours, inside; and s, which is at the samples'
    weighted mean position, is interpolated to the centres: the two differ beside a standstill.
    """
    middles = _middles(x)

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
    centres = (edges[:-1] + edges[1:]) / 2
    rows = zip(totals(weight * x) / information, fitted, strict=True)
    return np.stack([_interpolated(centres, *row) for row in rows]), typical


def _middles(x: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " middle"]:
    return np.concatenate(
        [[1.5 * x[0] - x[1] / 2], (x[1:] + x[:-1]) / 2, [1.5 * x[-1] - x[-2] / 2]]
    )


def _cell_edges(
    recording: Recording, middles: Float[np.ndarray, " middle"], cell: float
) -> Float[np.ndarray, " edge"]:
    length = middles[-1] - middles[0]
    refuse(
        length < LEAST_CELLS * cell,
        f"{recording.name}: the scan is {length:.4g} m long, less than {LEAST_CELLS} cells of "
        f"{cell:.4g} m: check the positions' unit, or give a smaller recording.cell_m.",
    )
    return middles[0] + cell * np.arange(int(length / cell) + 1)


def _interpolated(
    centres: Float[np.ndarray, " cell"],
    at: Float[np.ndarray, " cell"],
    values: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Values given at `at`, interpolated to the centres of the same cells; NaN stays.

    Beside a gap by the slope on its other side: one across the gap is not that at its edge.
    """
    moved = values.copy()
    side = np.where(centres > at, 1, -1)
    for i in np.flatnonzero(np.isfinite(values) & (centres != at)):
        j = i + side[i]
        if not 0 <= j < values.size:  # at the scan's ends the value is taken as it is
            continue
        j = j if np.isfinite(values[j]) else max(i - side[i], 0)
        if j != i and j < values.size and np.isfinite(values[j]):
            moved[i] += (values[j] - values[i]) * (centres[i] - at[i]) / (at[j] - at[i])
    return moved


def _on_line(x, signal, facts: dict[str, Any], depth: float):
    """The open line over the contact window, the signal on its cells, and the mask of valid
    ones."""
    if x[-1] < x[0]:
        x, signal = x[::-1], signal[:, ::-1]
    cell = (x[-1] - x[0]) / (x.size - 1)
    window = contact_window(facts, x, depth)
    check_cells(f"The contact window, [{window.start_m}, {window.end_m}] m", window.length_m, cell)
    before = max(0, int(np.floor((x[0] - cell / 2 - window.start_m) / cell)))
    after = max(0, int(np.floor((window.end_m - x[-1] - cell / 2) / cell)))
    line = Open(before + x.size + after, cell, x[0] - before * cell)
    padded = np.pad(signal, ((0, 0), (before, after)), constant_values=np.nan)
    observed = np.isfinite(padded)
    return line, np.where(observed, padded, 0.0), observed


def _widest_spacing(recording: Recording, spacing: float) -> float:
    """Distance [m] between samples where the motion is fastest: a frequency above the cut-off there
    is above it everywhere."""
    if recording.is_constant_speed(STEADY):
        return spacing
    return float(np.max(np.abs(recording.speed_m_per_s))) / recording.sample_rate_hz


def _spectrum(cfg, line, scan, data, observed, white_rms: float):
    """Noise power per block; white noise as estimated from the recording, other causes as named."""
    noises = coloured_noises(cfg)
    signal_rms = np.sqrt(np.sum(data**2) / np.sum(observed))
    return total_spectrum(noises, line, scan, signal_rms) + white_rms**2


def _assumed(cfg, recording, sensor, line, block, spacing, noise_rms, nominal, traction_unit):
    unit = recording.signal_unit
    return (
        ("recording", f"{recording.name}, {recording.time_s.size} samples {1e6 * spacing:.4g} um "
         f"apart"),
        *times_rows(cfg, recording),
        ("cells", f"{line.n} of {1e6 * float(line.cell_m):.4g} um, "
         + _filled_with(recording, block)),
        ("line", "open: p and q are deviations from a uniform background, zero outside the window"),
        ("window", f"{1e3 * float(line.x[0]):.4g} to {1e3 * float(line.x[-1]):.4g} mm; beyond the "
         "scan's ends the traction is estimated from what can still be felt there"),
        ("nominal pressure", "not known" if nominal is None else f"{nominal:.4g} Pa"),
        ("skin", sensor.skin.words),
        ("amplifier", type(sensor.amplifier).__name__),
        ("noise", f"white, {noise_rms:.3g} {unit} per sample, "
         + ("given" if (cfg["noise"].get("white") or {}).get("rms") is not None
            else "from the highest wavenumbers of the recording")),
        *build.effects_rows(cfg),
        ("p and q", "apart" if cfg["friction"] is None else f"q = {cfg['friction']} p"),
        *((("unit of p and q", "relative: the signal's unit over the sensor's assumed gain, which "
            "nobody measured"),) if traction_unit == "1" else ()),
    )  # fmt: skip


def _filled_with(recording: Recording, block: int) -> str:
    """Computation of cells from samples, in words."""
    steady = recording.is_constant_speed(STEADY)
    if steady and not np.isfinite(recording.signal).all():
        return (
            f"each with the mean of those of {block} samples that are there; cells with less than "
            f"{FEW:.0%} of them are missing"
        )
    if steady:
        return f"each with the mean of {block} samples (as the model has it, too)"
    speed = recording.speed_m_per_s
    return (
        f"each with the signal at the mean speed of {speed.mean():.4g} m/s that explains its "
        f"samples best (the speed goes from {speed.min():.4g} to {speed.max():.4g} m/s); cells "
        "passed too fast or too slowly to tell are missing"
    )
