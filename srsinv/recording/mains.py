"""Mains in a signal: its lines, found and measured, and the waves that they may be made of.

A line is a wave of unknown phase whose amplitude varies slowly: its spectrum lies within `half_Hz`
of its frequency, by Thomson (1982) the sums of the discrete prolate spheroidal sequences of that
band, times the wave.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from srsinv.errors import refuse
from srsinv.numerics import blackman_harris

from .. import false_alarm
from .noise import filled

FUNDAMENTALS_HZ = (50.0, 60.0)
WANDER_HZ = 1.0  # from where a line should be to what it is, where the signal hides it
REACH_HZ = 2.5  # from where a line should be to its strongest wave
BESIDE_HZ = 24.0  # up to there lies the spectrum around a line: of the median the line is no part
ABOVE = 3.0  # times the power around it: there a line ends
STANDS_OUT = 3.0  # times the greatest power beside it, both over its trend
TREND = 2  # degree of the logarithm of the power around a line
LOBE = 4.0  # bins on either side that the taper spreads a wave over
CAUGHT = 1e-3  # of the noise: what is weaker is left to it
NEGLIGIBLE_POWER = 1e-14  # of a line's power: a part that needs no wave
HIGHEST = 0.98  # of half the sampling rate
GRID = 4096  # samples of a sequence; between them it is interpolated
MOST_WAVES = 2000  # of each element


class MainsLine(NamedTuple):
    """A line at `frequency_Hz`, its power within `half_Hz` of it, of `rms` (e,) in each signal."""

    frequency_Hz: float
    half_Hz: float
    rms: Float[np.ndarray, " e"]


class _Spectrum:
    """Power of each element per bin of its tapered signal, trend out, so that a wave of rms a has
    the sum a^2."""

    def __init__(self, signal: Float[np.ndarray, "e sample"], rate_hz: float):
        n = signal.shape[-1]
        # Its side lobes are at -92 dB: hum may be a thousand times the noise.
        taper, slope = blackman_harris(n), np.linspace(-1, 1, n)
        rows = np.stack([filled(row) if np.isfinite(row).sum() > 3 else 0.0 * taper
                         for row in signal])  # fmt: skip
        rows = rows - rows.mean(axis=-1, keepdims=True)
        rows = rows - (rows @ slope / (slope @ slope))[:, None] * slope
        self.power = 2 * np.abs(np.fft.rfft(rows * taper)) ** 2 / (n * np.sum(taper**2))
        self.bin_Hz = rate_hz / n
        self.frequency_Hz = np.fft.rfftfreq(n, 1 / rate_hz)

    def hidden_line(self, expected_Hz: float) -> MainsLine:
        """The line there as strong as all that is within `WANDER_HZ`: it may be as much, and no
        more."""
        half = max(WANDER_HZ, self.bin_Hz / 2)
        inside = np.abs(self.frequency_Hz - expected_Hz) <= half + LOBE * self.bin_Hz
        return MainsLine(expected_Hz, half, np.sqrt(np.sum(self.power[:, inside], axis=-1)))

    def line(self, expected_Hz: float, chance: float) -> MainsLine | None:
        """The line there, None where noise alone makes as much with this probability."""
        reach, first = BESIDE_HZ / self.bin_Hz + LOBE, expected_Hz / self.bin_Hz
        own = slice(max(0, int(first - reach)), int(np.ceil(first + reach)) + 1)
        frequency_Hz, power = self.frequency_Hz[own], self.power[:, own]
        off = np.abs(frequency_Hz - expected_Hz)
        near, around = off <= REACH_HZ, (off <= BESIDE_HZ) & (frequency_Hz > 0)
        if not near.any() or around.sum() < 8:
            return None
        floor = np.median(power[:, around], axis=-1, keepdims=True) / np.log(2)
        is_noisy = floor[:, 0] > 0
        if not is_noisy.any():
            return None
        # Of noise, each is exponential: their sum over elements is a gamma variate.
        relative = np.sum(power[is_noisy] / floor[is_noisy], axis=0)
        top = int(np.argmax(np.where(near, relative, -1.0)))
        if not relative[top] > scipy.special.gammainccinv(is_noisy.sum(), chance / near.sum()):
            return None
        first, last = _around(around & (relative > ABOVE * is_noisy.sum()), top)
        weights, frequencies = relative[first : last + 1], frequency_Hz[first : last + 1]
        centre = float(weights @ frequencies / weights.sum())
        spread = float(np.max(np.abs(frequencies - centre)))
        half = spread + self.bin_Hz / 2
        inside = np.abs(frequency_Hz - centre) <= spread + LOBE * self.bin_Hz
        excess_power = np.sum(power[:, inside] - floor, axis=-1)
        return MainsLine(centre, half, np.sqrt(np.maximum(excess_power, 0.0)))

    def harmonics(self) -> tuple[MainsLine, ...]:
        """Those of 50 or of 60 Hz, whichever have more power, that noise does not make."""
        best: list[MainsLine] = []
        highest = HIGHEST * self.frequency_Hz[-1]
        for fundamental in FUNDAMENTALS_HZ:
            each = fundamental * np.arange(1, int(highest / fundamental) + 1)
            lines = [self.line(float(hz), false_alarm.MAINS_LINE) for hz in each]
            best = max(best, [line for line in lines if line is not None], key=_power)
        return tuple(best)

    def stands_out(self, line: MainsLine) -> bool:
        """Whether a line is above all that is beside it, as no lobe of a smooth spectrum is. Of the
        power its trend is taken out: the skin's response falls by orders of magnitude there."""
        away = self.frequency_Hz - line.frequency_Hz
        inside = np.abs(away) <= line.half_Hz + LOBE * self.bin_Hz
        beside = (np.abs(away) <= BESIDE_HZ) & ~inside & (self.frequency_Hz > 0)
        if np.count_nonzero(beside) <= TREND:
            return True
        logs = np.log(np.maximum(self.power, np.finfo(float).tiny))
        shapes = (away / BESIDE_HZ)[:, None] ** np.arange(TREND + 1)
        trends, *_ = np.linalg.lstsq(shapes[beside], logs[:, beside].T)
        left = logs - (shapes @ trends).T
        most, others = (np.max(left[:, at], axis=-1, initial=-np.inf) for at in (inside, beside))
        return bool(np.any(most > np.log(STANDS_OUT) + others))


def _around(is_above: np.ndarray, top: int) -> tuple[int, int]:
    """The first and the last that are above, single others between them aside."""
    first = last = top
    for step in (-1, 1):
        at, below = top, 0
        while below < 3 and 0 <= at + step < is_above.size:
            at += step
            below = 0 if is_above[at] else below + 1
            if is_above[at]:
                first, last = min(first, at), max(last, at)
    return first, last


def mains_lines(
    signal: Float[np.ndarray, "e sample"], rate_hz: float, named: Sequence[float] | None = None
) -> tuple[MainsLine, ...]:
    """The lines of mains in a signal, NaN where it is missing: those near the `named` frequencies,
    as strong as they are, or may be where the signal itself hides them; or, where none are named,
    those of the harmonics of 50 or of 60 Hz that noise does not make."""
    spectrum = _Spectrum(signal, rate_hz)
    if named is None:
        return spectrum.harmonics()
    each = [hz for hz in named if hz < HIGHEST * rate_hz / 2]
    lines = (spectrum.line(hz, false_alarm.MAINS_LINE) or spectrum.hidden_line(hz) for hz in each)
    return tuple(line for line in lines if line.rms.any())


def standing_lines(signal: Float[np.ndarray, "e sample"], rate_hz: float) -> tuple[MainsLine, ...]:
    """Those of the harmonics of 50 or of 60 Hz that stand out of all that is beside them."""
    spectrum = _Spectrum(signal, rate_hz)
    return tuple(filter(spectrum.stands_out, spectrum.harmonics()))


def _power(lines: Sequence[MainsLine]) -> float:
    return float(sum(np.sum(line.rms**2) for line in lines))


def waves(
    time_s: Float[np.ndarray, " sample"], lines: Sequence[MainsLine], noise_rms: float
) -> Float[np.ndarray, "e wave sample"]:
    """The waves that lines are made of, for each element its own, scaled so that their sizes are
    independent and of variance one; what is far below white noise of `noise_rms` is left out.
    Raises `BadInput` for more than `MOST_WAVES`."""
    n, elements = time_s.size, len(lines[0].rms) if lines else 0
    length_s = float(time_s[-1] - time_s[0])
    rows = []
    for line in lines:
        product = max(line.half_Hz * length_s, 0.5)
        power, least = float(np.max(line.rms)) ** 2, CAUGHT * noise_rms**2
        most = power * n / (4 * product)
        if not most > least:
            continue  # an envelope of no more than the line's own band is too faint
        # As many sequences as twice the product have half of themselves in the band, or more
        # (Landau 1993): known before they are computed.
        certain = 2 * int(2 * product) if most / 2 > least else 0
        _check_count(len(rows) + certain, line, length_s)
        envelopes, variances = _envelopes(n, product)
        strong = power * variances / 2 > least
        phase = 2 * np.pi * line.frequency_Hz * (time_s - time_s[0])
        for envelope, part in zip(envelopes[strong], variances[strong], strict=True):
            for wave in (np.cos(phase), np.sin(phase)):
                rows.append(np.sqrt(part) * line.rms[:, None] * envelope * wave)
        _check_count(len(rows), line, length_s)
    return np.stack(rows, axis=1) if rows else np.zeros((elements, 0, n))


def _check_count(waves: int, line: MainsLine, length_s: float) -> None:
    refuse(
        waves > MOST_WAVES,
        f"The hum at {line.frequency_Hz:.4g} Hz is {2 * line.half_Hz:.3g} Hz wide "
        f"over {length_s:.4g} s, more than {MOST_WAVES} waves: leave it out of "
        "recording.mains_Hz, or cut the recording.",
    )


def _envelopes(n: int, product: float):
    """Envelopes (wave, n) of norm one within a band of so many wavenumbers on either side, and the
    variance of each (wave,) in a process of variance one over all n samples."""
    # Beyond twice the product the sequences' shares fall by orders of magnitude each.
    further = np.log(1 / NEGLIGIBLE_POWER) * np.log(8 * np.pi * product) / np.pi**2
    count = min(int(np.ceil(2 * product + further)), n)
    size = min(n, max(GRID, 16 * count))
    sequences, ratios = scipy.signal.windows.dpss(size, product, count, return_ratios=True)
    if size < n:
        grid, every = np.linspace(0, 1, size), np.linspace(0, 1, n)
        sequences = scipy.interpolate.make_interp_spline(grid, sequences, axis=1)(every)
    sequences = sequences / np.linalg.norm(sequences, axis=1, keepdims=True)
    return sequences, n * ratios / (2 * product)
