"""White noise of a signal, from wavenumbers that the skin does not transmit (without jax).

The median of the periodogram over the upper wavenumbers, which a few lines do not move. Where
samples are missing, short gaps are filled by a cubic spline, so that the signal has no jumps; long
ones part the signal into stretches, each with its trend out and its own taper. The bias depends on
the pattern of missing samples (a spline follows noise and has less of it), and is found from white
noise of level one on the same pattern.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import scipy
from jaxtyping import Bool, Float

from .. import false_alarm

ABOVE_CUTOFF = 12.0  # k z beyond which e^(-k z) < 1e-5: noise only
LONG_GAP = 8  # samples: shorter gaps are filled, so that single ones do not split the signal
SHORT_STRETCH = 32  # samples: of a shorter one hardly a wavenumber is above the signal's
CUBIC = 3
DRAWN = 2**20  # samples of white noise drawn in all, so that its own scatter is below 1 %
MOST_DRAWS = 24
ALIKE = 0.1  # relative differences of levels, which no inversion shows
# Variance of the logarithm of a level from the median of m bins, times m (simulated): that of
# independent bins is 1 / (2 ln 2)^2, and a Hann taper joins neighbours.
MEDIAN_VARIANCE = 0.9


def white_levels(
    signal: Float[np.ndarray, "element sample"], depth_m: float, spacing_m: float
) -> Float[np.ndarray, "#element"]:
    """Standard deviation of the white noise per sample, one for all elements, or one for each where
    they differ by more than chance makes; NaN is missing.

    `depth_m` of the film nearest to the skin, `spacing_m` from sample to sample, of at least 3. 0
    where the signal is constant or rounded, and where hardly any sample is valid: of one element it
    is taken as that of all.
    """
    levels = _WhiteLevels(signal, depth_m, spacing_m)
    every = range(len(signal))
    common = levels.of(every)
    if len(signal) < 2:
        return np.array([common])
    own = np.array([levels.of([row]) for row in every])
    is_there = own > 0
    if is_there.sum() < 2:
        return np.array([common])
    bins = _upper(np.zeros((1, signal.shape[-1])), depth_m, spacing_m).size
    bins = bins * np.isfinite(signal[is_there]).mean(axis=1)
    logs = np.log(own[is_there])
    off = logs - np.average(logs, weights=bins)
    chance = scipy.special.chdtrc(is_there.sum() - 1, np.sum(off**2 * bins) / MEDIAN_VARIANCE)
    if chance > false_alarm.NOISE_LEVELS or np.ptp(logs) < ALIKE:
        return np.array([common])
    return np.where(is_there, own, common or np.min(own[is_there]))


def level_stderr(
    signal: Float[np.ndarray, "element sample"], depth_m: float, spacing_m: float
) -> float:
    """The largest relative standard error of the [`white_levels`][] of a signal."""
    bins = _upper(np.zeros((1, signal.shape[-1])), depth_m, spacing_m).size
    counts = bins * np.isfinite(signal).mean(axis=1)
    return float(np.sqrt(MEDIAN_VARIANCE / max(float(counts.min(initial=np.inf)), 1.0)))


class _WhiteLevels:
    """Levels of the white noise of a signal's elements."""

    def __init__(self, signal: Float[np.ndarray, "e sample"], depth_m: float, spacing_m: float):
        self._signal, self._at = signal, (depth_m, spacing_m)
        self._observed = np.isfinite(signal)
        self._parts = [list(_stretches(row)) for row in self._observed]
        self._powers = [self._power(row, values) for row, values in enumerate(signal)]

    def of(self, rows: Sequence[int]) -> float:
        """The level of these elements together."""
        median = _median([self._powers[row] for row in rows])
        if self._observed[rows].all():
            return float(np.sqrt(median / np.log(2)))
        if not median > 0:
            return 0.0
        rng, n = np.random.default_rng(0), self._signal.shape[-1]
        draws = int(np.clip(DRAWN // n, 1, MOST_DRAWS))
        of_white = [
            _median([
                self._power(row, np.where(self._observed[row], values, np.nan))
                for row, values in zip(rows, rng.normal(size=(len(rows), n)), strict=True)
            ])
            for _ in range(draws)
        ]  # fmt: skip
        return float(np.sqrt(median / np.mean(of_white)))

    def _power(self, row: int, values: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " k"]:
        """The periodograms of an element's stretches, of these values, together."""
        if self._observed[row].all():
            return _upper(values[None], *self._at)[0]
        powers = [
            _upper(filled(values[part])[None], *self._at)[0]
            for part in self._parts[row]
            if np.isfinite(values[part]).sum() > CUBIC
        ]
        return np.concatenate([np.zeros(0), *powers])


def _median(powers: Sequence[np.ndarray]) -> float:
    together = np.concatenate(powers)
    return float(np.median(together)) if together.size else 0.0


def _stretches(observed: np.ndarray) -> Iterator[slice]:
    """Stretches of one element's samples between long gaps, short ones left out; where none is
    left, from its first valid sample to the last."""
    at = np.flatnonzero(observed)
    if at.size:
        yield from stretches_of(observed, SHORT_STRETCH) or [slice(int(at[0]), int(at[-1]) + 1)]


def stretches_of(observed: Bool[np.ndarray, " sample"], shortest: int) -> list[slice]:
    """Stretches of samples between long gaps, those of fewer than `shortest` samples left out."""
    at = np.flatnonzero(observed)
    if not at.size:
        return []
    cuts = np.flatnonzero(np.diff(at) > LONG_GAP + 1)
    ends = zip(at[np.append(0, cuts + 1)], at[np.append(cuts, -1)] + 1, strict=True)
    return [slice(int(a), int(b)) for a, b in ends if b - a >= shortest]


def filled(values: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " sample"]:
    """The values with missing ones interpolated: by a cubic spline, or linearly where any gap is
    long, as a spline would overshoot."""
    observed = np.isfinite(values)
    if observed.all():
        return values
    at, missing = np.flatnonzero(observed), np.flatnonzero(~observed)
    result, known = values.copy(), values[at]
    if int(np.max(np.diff(at))) > LONG_GAP + 1:
        result[missing] = scipy.interpolate.make_interp_spline(at, known, 1)(missing)
    else:
        result[missing] = scipy.interpolate.CubicSpline(at, known)(missing)
    return result


def _upper(
    signal: Float[np.ndarray, "element sample"], depth_m: float, spacing_m: float
) -> Float[np.ndarray, "element k"]:
    """The periodogram at wavenumbers of noise only, of mean 1 for white noise of level one: trend
    out, Hann taper."""
    n = signal.shape[-1]
    taper = np.hanning(n)
    slope = np.linspace(-1, 1, n)
    left = signal - signal.mean(axis=-1, keepdims=True)
    left = left - (left @ slope / (slope @ slope))[:, None] * slope
    power = np.abs(np.fft.rfft(left * taper)) ** 2 / np.sum(taper**2)
    k = 2 * np.pi * np.fft.rfftfreq(n, spacing_m)
    return power[:, k > min(ABOVE_CUTOFF / depth_m, 0.75 * k[-1])]
