"""The simple threshold: an alarm where a sample is too large for noise, at a stated rate.

Of `e` elements, the whitened samples of one instant have the squared size s^2, chi-square of `e`
degrees of freedom in noise. An alarm is a sample above the threshold after one below: with the
probability a of a single exceedance, white noise alone gives a (1 - a) alarms for each sample.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import ArrayLike, Float

from ...errors import number
from .whitening import StreamWhitener, as_samples

MOST_ALARMS = 0.1  # for each sample: above, most of them would be of noise


class Alarm(NamedTuple):
    """A sample above the threshold: when [s], its size s in standard deviations of noise, and how
    many such or larger ones noise alone gives in a second."""

    time_s: float
    size: float
    false_alarms_per_s: float


def stated_rates(rate_hz: Any, false_alarms_per_s: Any) -> tuple[float, float]:
    """Samples and false alarms in a second. Raises `BadInput` for rates that are not positive, and
    more false alarms than one for ten samples."""
    rate = float(number("rate_hz", rate_hz, "a positive rate in Hz", above=0))
    most = MOST_ALARMS * rate
    wanted = f"a positive number, up to {most:g}"
    alarms = number("false_alarms_per_s", false_alarms_per_s, wanted, above=0, most=most)
    return rate, float(alarms)


class ThresholdDetector:
    """Alarms of a threshold on a stream of samples.

    - `whitener`: of the noise, a `StreamWhitener`; `rate_hz` [Hz]: samples a second.
    - `false_alarms_per_s` [1/s]: stated for noise alone, exact where it is white.

    `push` takes samples in blocks of any length. Raises `BadInput` for rates that are not positive,
    and more false alarms than one for ten samples.
    """

    def __init__(self, whitener: StreamWhitener, rate_hz: float, false_alarms_per_s: float):
        self.rate_hz, self.false_alarms_per_s = stated_rates(rate_hz, false_alarms_per_s)
        self.whitener = whitener
        self.limit = threshold(len(whitener.root), self.false_alarms_per_s / self.rate_hz)
        self._before, self._is_above, self._count = None, False, 0

    def push(self, signal: Float[ArrayLike, "e n"]) -> list[Alarm]:
        """The alarms of the next samples. Raises `BadInput` for another number of elements, and
        samples that are not finite."""
        signal = as_samples(signal, len(self.whitener.root))
        size = np.linalg.norm(self.whitener(signal, self._before), axis=0)
        is_above = size > self.limit
        starts = np.flatnonzero(is_above & ~np.append(self._is_above, is_above[:-1]))
        alarms = [self._alarm(int(at), float(size[at])) for at in starts]
        self._before = _last(self._before, signal, self.whitener.order)
        self._count += signal.shape[-1]
        self._is_above = bool(is_above[-1]) if is_above.size else self._is_above
        return alarms

    def _alarm(self, at: int, size: float) -> Alarm:
        chance = float(scipy.stats.chi2.sf(size**2, len(self.whitener.root)))
        return Alarm((self._count + at) / self.rate_hz, size, self.rate_hz * chance * (1 - chance))


def threshold(elements: int, alarms_per_sample: float) -> float:
    """The size s above which noise has so many alarms for each sample."""
    chance = (1 - np.sqrt(1 - 4 * alarms_per_sample)) / 2
    return float(np.sqrt(scipy.stats.chi2.isf(chance, elements)))


def detection_by_threshold(event: Float[np.ndarray, "e n"], limit: float) -> float:
    """The probability that a whitened event in noise has at least one sample above the limit."""
    squares = np.sum(np.asarray(event) ** 2, axis=0)
    missed = scipy.stats.ncx2.logcdf(limit**2, len(event), squares)
    return float(-np.expm1(np.sum(missed)))


def _last(
    before: Float[np.ndarray, "e m"] | None, signal: Float[np.ndarray, "e n"], count: int
) -> Float[np.ndarray, "e count"]:
    """The last `count` samples so far; zeros before the first of all."""
    start = np.zeros((signal.shape[0], count)) if before is None else before
    joined = np.concatenate([start, signal], axis=-1)
    return joined[:, joined.shape[-1] - count :]
