"""Signal health: clipping, quantisation and noise."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from ..numerics import runs

FLAT = 3  # equal samples in a row at a signal's extreme that count as one flat stretch
_ROUNDING = 1e-3  # of a step: how far from whole steps rounded values may lie
_MOST_STEPS = 2**24  # a range of more steps is that of printed digits, not of a converter
SHORTEST = 16  # samples: below, a spectrum is not estimated
_SEGMENTS = 8
_LEAST_SEGMENT = 256
_AROUND = 31  # frequencies whose median is a line's surroundings
_STANDS_OUT = 10.0  # times the surrounding power
_LINES = 5
_HANN_BINS = 1.5  # equivalent noise bandwidth of the window


@dataclass(frozen=True)
class ClippedSamples:
    """Samples at a signal's extremes.

    - `fraction`: of all samples at the least or the greatest value.
    - `stretches`: [start, stop) of at least `FLAT` equal samples in a row there.
    """

    fraction: float
    stretches: tuple[tuple[int, int], ...]

    @property
    def longest(self) -> int:
        """Samples in the longest flat stretch."""
        return max((stop - start for start, stop in self.stretches), default=0)

    @property
    def verdict(self) -> str:
        """Whether the signal is clipped, in words: a slow signal in coarse steps can rest at its
        peak once."""
        if not self.stretches:
            return "no"
        return "likely" if len(self.stretches) > 1 else "perhaps (one flat extreme)"


def clipping(values: Float[np.ndarray, " sample"]) -> ClippedSamples:
    """Samples of a signal (NaN: missing) at its least and greatest value; none for a constant
    one."""
    present = values[np.isfinite(values)]
    if not present.size or np.ptp(present) == 0:
        return ClippedSamples(0.0, ())
    stretches = []
    for extreme in (present.min(), present.max()):
        at = runs(values == extreme)
        stretches += [(start, stop) for start, stop in at if stop - start >= FLAT]
    at_extreme = (present == present.min()) | (present == present.max())
    return ClippedSamples(float(np.mean(at_extreme)), tuple(sorted(stretches)))


def quantisation_step(values: Float[np.ndarray, " sample"]) -> float | None:
    """The step that all differences between values are whole multiples of, where there is one."""
    levels = np.unique(values[np.isfinite(values)])
    if levels.size < 2:
        return None
    steps = np.diff(levels)
    if np.all(levels == np.round(levels)) and np.max(np.abs(levels)) < 2**53:
        return float(np.gcd.reduce(steps.astype(np.int64)))
    least = float(steps.min())
    if np.ptp(levels) > _MOST_STEPS * least:
        return None
    off = np.abs(steps / least - np.round(steps / least))
    return least if np.all(off < _ROUNDING * np.maximum(1, steps / least)) else None


@dataclass(frozen=True)
class SpectralLine:
    """A line: its frequency, the amplitude of the sine that makes it, and its power over the
    surrounding one."""

    frequency_hz: float
    amplitude: float
    over_surroundings: float


@dataclass(frozen=True, eq=False)
class SignalSpectrum:
    """Amplitude density (frequency,) [unit/sqrt(Hz)] and its spectral lines.

    `floor` is the level of the upper half of the band, as white noise would have it.
    """

    frequency_hz: Float[np.ndarray, " frequency"]
    density: Float[np.ndarray, " frequency"]
    floor: float
    lines: tuple[SpectralLine, ...]


def segment_length(samples: int) -> int:
    """Samples in one of the stretches whose spectra are averaged."""
    return min(samples, max(_LEAST_SEGMENT, 2 ** int(np.log2(max(samples / _SEGMENTS, 1)))))


def spectrum(
    values: Float[np.ndarray, " sample"], rate_hz: float, segment: int
) -> SignalSpectrum | None:
    """Welch's averaged spectrum at even times, missing samples interpolated from their neighbours.

    None for a signal that is too short or constant.
    """
    present = np.isfinite(values)
    if present.sum() < SHORTEST or np.ptp(values[present]) == 0:
        return None
    filled = values
    if not present.all():
        row = np.arange(values.size)
        filled = np.interp(row, row[present], values[present])
    # Scaled to one: squares of a signal in femtovolts would leave float64's range.
    size = float(np.max(np.abs(filled)))
    segment = min(segment, filled.size)
    frequency, power = _welch(filled / size, rate_hz, segment)
    averaged = (filled.size - segment) // max(segment // 2, 1) + 1
    upper = power[frequency > frequency[-1] / 2]
    floor = np.sqrt(np.median(upper) / _median_of_mean(averaged))
    return SignalSpectrum(
        frequency_hz=frequency[1:],
        density=size * np.sqrt(power[1:]),
        floor=float(size * floor),
        lines=_lines(frequency[1:], power[1:], size),
    )


def _median_of_mean(averaged: int) -> float:
    """Median of the mean of `averaged` squared amplitudes of white noise of mean 1 (Wilson and
    Hilferty's approximation of chi squared)."""
    return (1 - 1 / (9 * averaged)) ** 3


def _welch(
    values: Float[np.ndarray, " sample"], rate_hz: float, segment: int
) -> tuple[Float[np.ndarray, " frequency"], Float[np.ndarray, " frequency"]]:
    """Frequencies and the power density of segments that overlap by half, each less its straight
    line and tapered by Hann's window (Welch 1967)."""
    step = segment - segment // 2
    rows = np.lib.stride_tricks.sliding_window_view(values, segment)[::step]
    line = np.stack([np.ones(segment), np.linspace(-1, 1, segment)])
    rows = rows - (rows @ np.linalg.pinv(line)) @ line
    taper = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(segment) / segment)
    power = np.mean(np.abs(np.fft.rfft(rows * taper)) ** 2, axis=0) / (rate_hz * np.sum(taper**2))
    last = -1 if segment % 2 == 0 else None  # the highest frequency has no negative one
    power[1:last] *= 2
    return np.fft.rfftfreq(segment, 1 / rate_hz), power


def _lines(
    frequency: Float[np.ndarray, " frequency"], power: Float[np.ndarray, " frequency"], size: float
) -> tuple[SpectralLine, ...]:
    surroundings = scipy.ndimage.median_filter(power, _AROUND, mode="nearest")
    over = power / np.where(surroundings > 0, surroundings, np.inf)
    is_peak = (power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])
    peaks = [p for p in 1 + np.flatnonzero(is_peak) if over[p] > _STANDS_OUT]
    strongest = sorted(peaks, key=lambda p: power[p], reverse=True)[:_LINES]
    spacing = frequency[0]
    return tuple(
        SpectralLine(
            float(frequency[p]),
            float(size * np.sqrt(2 * power[p] * _HANN_BINS * spacing)),
            float(over[p]),
        )
        for p in strongest
    )
