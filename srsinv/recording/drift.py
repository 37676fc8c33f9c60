"""Drift of a signal: the level of a random walk, found beside white noise and the signal itself.

The signal is averaged with a smooth taper (Blackman and Harris', whose side lobes of -92 dB leave
nothing of mains), and second differences of neighbouring averages are taken on a ladder of scales,
a wavelet variance (Percival, Biometrika 82, 1995). Of weights a that sum to zero, white noise of
variance s^2 per sample makes the variance s^2 sum_j a_j^2, and a walk of d^2 per second, at f
samples a second, d^2 / f sum_j (sum_{i<=j} a_i)^2. Both are known at every scale.

The traction adds to that, in places (an edge, a ridge) or at short scales (a texture): stretches
far above the rest are left out, and only scales that agree with the lowest of all are used. A
feature's integral is bounded, so that its rate fades towards long scales, where a walk grows.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from srsinv.numerics import blackman_harris, runs

from .. import false_alarm
from ._recording import Recording
from .noise import LONG_GAP, filled
from .passes import pass_differences, passes_of

# Where a drift is known to be there a missed one costs more than a small one that is not.
SHORTEST_S = 0.1  # of a taper: its main lobe ends at 40 Hz, below mains
FEWEST_SAMPLES = 16  # of a taper, where the rate is low
BEYOND = 10.0  # over the shortest taper: frequencies above are of white noise
PER_TAPER = 4  # overlapping differences: closer ones add 1 %
GROSS = 5.0  # standard deviations, which chance reaches once in a million
CLIPPED = 3.0  # standard deviations, beyond which a difference is left out of the variance
EFFICIENCY = 0.87  # of a variance so clipped (simulated): its degrees of freedom over all
QUIET = 0.3  # of all differences: so many at least are taken to be free of the signal
LEAST = 0.25  # of a scale's differences: where fewer are left, the signal is everywhere
FEWEST = 3.0  # degrees of freedom of a scale
FEWEST_IN_ALL = 8.0  # of the scales that agree: fewer are as well a touch that lasts throughout
AGREEMENT = 0.05  # of scales that show the same walk, on either side
APART = 3.0  # times: levels of eight degrees of freedom differ less by chance, but once in 500
LEAST_SPREAD = 0.0366  # d^2 T: a walk's variance about its mean is below once in twenty


class _Scale(NamedTuple):
    """A robust variance of differences, its degrees of freedom, and the variances that white noise
    of one per sample and a walk of one per second have."""

    variance: float
    freedom: float
    of_white: float
    of_walk: float


def shared_levels(levels: Float[np.ndarray, " e"]) -> Float[np.ndarray, "#e"]:
    """One level for all elements, or one for each where those that are found differ `APART` times;
    where none is found that of all is taken."""
    common, is_found = common_level(levels), levels > 0
    if not is_found.any() or levels.max() < APART * levels[is_found].min():
        return np.array([common])
    return np.where(is_found, levels, common)


def common_level(levels: Float[np.ndarray, " e"]) -> float:
    """One level for all elements: the root mean square of theirs."""
    return float(np.sqrt(np.mean(levels**2)))


def drift_of(recording: Recording, chance: float = false_alarm.DRIFT) -> Float[np.ndarray, " e"]:
    """The drift of each element of a recording at even times: where it passes one way more than
    once, from what passes differ by, which no touch is in. `chance` as in
    [`drift_levels`][]."""
    position, rate = recording.position_m, recording.sample_rate_hz
    found = passes_of(position)
    differences = pass_differences(recording.signal, position, found)
    is_repeated = differences.shape[1] > FEWEST_SAMPLES
    return drift_levels(differences if is_repeated else recording.signal, rate, chance)


def drift_levels(
    signal: Float[np.ndarray, "e sample"], rate_hz: float, chance: float = false_alarm.DRIFT
) -> Float[np.ndarray, " e"]:
    """Rms of each element's random walk after a second, in the signal's unit; NaN is missing.

    0 where white noise alone makes as much with the probability `chance`, where the scales
    that are free of the signal do not agree, and where there are too few samples to tell.
    """
    return np.array([_level(row, rate_hz, chance) for row in np.asarray(signal, float)])


def _level(row: Float[np.ndarray, " sample"], rate_hz: float, chance: float) -> float:
    is_lost = ~np.isfinite(row)
    if (~is_lost).sum() <= FEWEST_SAMPLES or np.ptp(row[~is_lost]) == 0:
        return 0.0
    size = float(np.max(np.abs(row[~is_lost])))
    values = filled(row / size)
    # Interpolated noise is missing from the spectrum, but for a spline's, which fills short gaps.
    is_long_gap = np.zeros_like(is_lost)
    for start, stop in runs(is_lost):
        is_long_gap[start:stop] = stop - start > LONG_GAP
    white = _white_power(values - values.mean(), rate_hz) / max(1 - is_long_gap.mean(), 0.01)
    scales = list(_scales(values - values.mean(), is_long_gap, rate_hz))
    if not scales or not white > 0:
        return 0.0
    d2, odds = _walk(scales, white)
    is_found = odds > scipy.special.ndtri(chance) ** 2
    duration_s = row.size / rate_hz
    has_moved = LEAST_SPREAD * d2 * duration_s < np.var(values)
    return size * float(np.sqrt(d2)) if is_found and has_moved else 0.0


def _white_power(values: Float[np.ndarray, " sample"], rate_hz: float) -> float:
    """Variance of the white noise per sample: the median of the periodogram in the octave that has
    most, as a low-pass takes the highest ones."""
    taper = blackman_harris(values.size)
    power = np.abs(np.fft.rfft(values * taper)) ** 2 / np.sum(taper**2)
    frequency, half = np.fft.rfftfreq(values.size, 1 / rate_hz), rate_hz / 2
    lowest = min(BEYOND / SHORTEST_S, half / 2)
    octaves = max(int(np.log2(half / lowest) + 1e-9), 1)
    edges = [*(lowest * 2.0 ** np.arange(octaves)), np.inf]
    parts = [power[(frequency >= a) & (frequency < b)] for a, b in itertools.pairwise(edges)]
    return max(float(np.median(part)) if part.size else 0.0 for part in parts) / np.log(2)


def _scales(
    values: Float[np.ndarray, " sample"], is_lost: Bool[np.ndarray, " sample"], rate_hz: float
) -> Iterator[_Scale]:
    """The scales that the recording holds, the shortest first. What is left out at one is left out
    at all longer ones."""
    is_busy, taper = is_lost, max(round(SHORTEST_S * rate_hz), FEWEST_SAMPLES)
    while values.size >= 2.5 * taper:
        weights = _second_difference(taper)
        hop = taper // PER_TAPER
        white, white_correlation = _power_and_correlation(weights, hop)
        walk, walk_correlation = _power_and_correlation(np.cumsum(weights), hop)
        starts, differences = _differences(values, weights, hop)
        variance, is_used, is_busy = _robust(starts, differences, weights.size, is_busy)
        if is_used.sum() > 1:
            freedom = EFFICIENCY * min(
                _freedom(is_used, correlation)
                for correlation in (white_correlation, walk_correlation)
            )
            if freedom >= FEWEST and variance > 0:
                yield _Scale(variance, freedom, white, walk / rate_hz)
        taper *= 2


def _second_difference(taper: int) -> Float[np.ndarray, " weight"]:
    """Weights of a second difference of tapered averages that overlap by half."""
    average = blackman_harris(taper)
    average, half = average / average.sum(), taper // 2
    weights = np.zeros(taper + 2 * half)
    for place, factor in enumerate((1.0, -2.0, 1.0)):
        weights[place * half : place * half + taper] += factor * average
    return weights


def _power_and_correlation(
    weights: Float[np.ndarray, " weight"], hop: int
) -> tuple[float, Float[np.ndarray, " lag"]]:
    """The sum of squares, and the correlation of white noise so weighted at every `hop` samples."""
    spectrum = np.fft.rfft(weights, 2 * weights.size)
    lags = np.fft.irfft(np.abs(spectrum) ** 2)[: weights.size]
    return float(lags[0]), lags[::hop] / lags[0]


def _differences(
    values: Float[np.ndarray, " sample"], weights: Float[np.ndarray, " weight"], hop: int
) -> tuple[np.ndarray, Float[np.ndarray, " window"]]:
    """First samples of the windows, every `hop` samples, and the weighted sums over them."""
    first = -(weights.size - 1) % hop  # so that windows end at multiples of the hop
    if values.size < first + weights.size:
        return np.zeros(0, int), np.zeros(0)
    windows = np.lib.stride_tricks.sliding_window_view(values, weights.size)[first::hop]
    return first + hop * np.arange(len(windows)), windows @ weights[::-1]


def _robust(
    starts: np.ndarray,
    differences: Float[np.ndarray, " window"],
    length: int,
    is_busy: Bool[np.ndarray, " sample"],
) -> tuple[float, Bool[np.ndarray, " window"], Bool[np.ndarray, " sample"]]:
    """The variance of differences in quiet stretches, which windows it is taken from, and the busy
    samples: those of gross differences besides the ones given."""
    squares, marked = differences**2, is_busy
    while True:
        is_free = _is_free(starts, length, marked)
        if is_free.sum() < max(2, LEAST * is_free.size):
            break
        variance, is_within = _clipped_variance(squares, is_free)
        is_gross = is_free & (squares > GROSS**2 * variance)
        if not is_gross.any():
            return variance, is_within, marked
        marked = marked | _covered(starts[is_gross], length, is_busy.size)
    is_free = _is_free(starts, length, is_busy)
    return (float(squares[is_free].mean()) if is_free.any() else 0.0), is_free, is_busy


def _is_free(starts: np.ndarray, length: int, is_busy: Bool[np.ndarray, " sample"]) -> np.ndarray:
    """Whether windows hold no busy sample."""
    busy_before = np.concatenate([[0], np.cumsum(is_busy)])
    return busy_before[starts + length] == busy_before[starts]


def _covered(starts: np.ndarray, length: int, size: int) -> Bool[np.ndarray, " sample"]:
    edges = np.zeros(size + 1, int)
    np.add.at(edges, starts, 1)
    np.add.at(edges, starts + length, -1)
    return np.cumsum(edges[:-1]) > 0


def _clipped_variance(
    squares: Float[np.ndarray, " window"], is_free: Bool[np.ndarray, " window"]
) -> tuple[float, Bool[np.ndarray, " window"]]:
    """The normal variance of which the squares within `CLIPPED` standard deviations have the mean
    that they have, from a low quantile on."""
    density = np.exp(-(CLIPPED**2) / 2) / np.sqrt(2 * np.pi)
    lost = 2 * CLIPPED * density / (2 * scipy.special.ndtr(CLIPPED) - 1)
    quantile = scipy.special.ndtri((1 + QUIET) / 2) ** 2
    variance = float(np.quantile(squares[is_free], QUIET) / quantile)
    is_within = is_free
    for _ in range(50):
        is_within = is_free & (squares <= CLIPPED**2 * variance)
        last, variance = variance, float(squares[is_within].mean()) / (1 - lost)
        if abs(variance - last) <= 1e-6 * variance:
            break
    return variance, is_within


def _freedom(is_used: Bool[np.ndarray, " window"], correlation: Float[np.ndarray, " lag"]) -> float:
    """Degrees of freedom of the mean square of correlated normal numbers."""
    count, pairs = int(is_used.sum()), 0.0
    for lag in range(1, min(correlation.size, is_used.size)):
        pairs += 2 * np.sum(is_used[lag:] & is_used[:-lag]) * correlation[lag] ** 2
    return count**2 / (count + pairs)


def _walk(scales: list[_Scale], white: float) -> tuple[float, float]:
    """The most probable variance of a walk after a second, and twice the logarithm of its odds
    against none. No odds where only one of several scales is free of the signal, or too little."""
    variance, freedom, of_white, of_walk = np.array(scales).T
    # Of chi squared at either end.
    quantiles = (
        2 * scipy.special.gammaincinv(freedom / 2, level) for level in (AGREEMENT, 1 - AGREEMENT)
    )
    most, least = (
        np.maximum(variance * freedom / quantile - white * of_white, 0) / of_walk
        for quantile in quantiles
    )
    agrees = least <= most.min()
    if agrees.sum() < min(2, len(scales)) or freedom[agrees].sum() < FEWEST_IN_ALL:
        return 0.0, 0.0
    variance, freedom, of_white, of_walk = np.array(scales)[agrees].T

    def log_likelihood(d2: float) -> float:
        expected = white * of_white + d2 * of_walk
        return -0.5 * float(np.sum(freedom * (np.log(expected) + variance / expected)))

    least_d2 = 1e-6 * white * np.min(of_white / of_walk)
    most_d2 = max(10 * np.max(variance / of_walk), 2 * least_d2)
    best = scipy.optimize.minimize_scalar(
        lambda log_d2: -log_likelihood(np.exp(log_d2)),
        bounds=(np.log(least_d2), np.log(most_d2)),
        method="bounded",
    )
    d2 = float(np.exp(best.x))
    return d2, 2 * (log_likelihood(d2) - log_likelihood(0.0))
