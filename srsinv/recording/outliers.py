"""Single samples and bursts that stand out of the noise (without jax).

The skin transmits nothing above k z = 12, so that a signal's waves above that cut-off are noise. An
impulse of ten times the noise is hidden under the signal and plain there.

The signal is high-passed by a symbol H that rises smoothly from the cut-off. Missing samples take
the values that leave the least x^T H x, found by conjugate gradients, so that a gap makes no kink;
beyond both ends the signal goes on with such values. What was found is missing in the next round.
"""

import numpy as np
import scipy
from jaxtyping import Bool, Float

from .. import false_alarm, numerics
from .noise import ABOVE_CUTOFF

LEAST_ABOVE = 0.5  # of the band, above the cut-off: of less, an impulse is spread over neighbours
RISES = 1.5  # times the cut-off, where the high-pass has risen to one, so that it rings little
FEWEST = 64  # samples: of fewer, the scale of the noise is too uncertain
MOST = 0.2  # of a channel's samples: more are no outliers, but noise of another kind
SHORTEST_AROUND = 61  # samples of which a local scale is the median, six times a burst of ten
DEPTHS_AROUND = 2.0  # the same in depths: noise that goes with the signal changes more slowly
# Of the largest value: below, what the skin transmits of a sharp edge above the cut-off is no
# noise, nor are positions and speeds exact enough.
FAINT = 1e-3
ROUNDING = 1e-12  # of the largest value: of a constant signal
MOST_ROUNDS = 20
MOST_STEPS = 60  # of conjugate gradients; ten are usual
CLOSE = 0.02  # of the rms above the cut-off, which the fill may be off
IN_BURST = 4  # outliers among NEAR samples before and as many behind, that are a burst
NEAR = 5
BESIDE = 2  # samples before and behind a burst, that are lost with it
MAD = 0.6745  # median of |x| for a normal x of standard deviation one
MAD_FREEDOM = 0.37  # degrees of freedom of a scale from the median of |x|, for each sample


def outliers(
    signal: Float[np.ndarray, "element sample"],
    speed_m_per_s: Float[np.ndarray, " sample"],
    depth_m: float,
    rate_hz: float,
    is_spared: Bool[np.ndarray, " sample"],
) -> tuple[Bool[np.ndarray, "element sample"], Float[np.ndarray, " element"]]:
    """Which samples stand out of the noise, and how many times it the largest of each element is.

    NaN marks a missing sample; `depth_m` is that of the film nearest to the skin. None is found
    where `is_spared`, where less than half of the band lies above the cut-off at the greatest speed
    (coarse sampling), in a channel of less than 64 samples, and where more than a fifth of a
    channel would be one. Chance makes one in `false_alarm.OUTLIER` of recordings. Noise that
    changes from place to place is judged by its scale there, and where the speed jumps the signal
    may jump with it.
    """
    found, times = np.zeros(signal.shape, bool), np.zeros(len(signal))
    fastest = float(np.max(np.abs(speed_m_per_s)))
    cutoff = 2 * ABOVE_CUTOFF * fastest / (2 * np.pi * depth_m * rate_hz)  # of half the rate
    if cutoff > 1 - LEAST_ABOVE or signal.shape[1] < FEWEST:
        return found, times
    high_pass = _HighPass(signal.shape[1], cutoff)
    around = max(SHORTEST_AROUND, int(DEPTHS_AROUND * depth_m / fastest * rate_hz))
    jumps = np.zeros(speed_m_per_s.shape)
    if np.ptp(speed_m_per_s):
        jumps = np.abs(high_pass(speed_m_per_s, np.ones(jumps.shape, bool))[0]) / fastest
    alarm = false_alarm.OUTLIER / signal.size
    for row, values in enumerate(signal):
        size = np.nanmax(np.abs(values), initial=0.0)
        if np.isfinite(values).sum() >= FEWEST and size > 0:
            channel = _Channel(high_pass, values / size, jumps, is_spared, around, alarm)
            found[row], times[row] = channel.outliers()
    return found, times


class _HighPass:
    """The high-pass on rows of n samples; `cutoff` in units of half the rate."""

    def __init__(self, n: int, cutoff: float):
        self.n = n
        self.period = int(np.ceil(2 / max(cutoff, 2 / n)))  # samples, of a wave at the cut-off
        self.whole = numerics.fast_length(n + max(4 * self.period, 32))
        share = np.linspace(0, 1, self.whole // 2 + 1) / cutoff
        rising = np.clip((share - 1) / (RISES - 1), 0, 1)
        self.symbol = np.sin(np.pi / 2 * rising) ** 2
        impulse = np.fft.irfft(self.symbol, self.whole)
        self.own = float(impulse[0])  # what is left of an impulse in its own sample
        # And in another one at most, over that.
        self.leak = float(np.max(np.abs(impulse[1:]))) / self.own

    def _through(self, values: np.ndarray) -> np.ndarray:
        return np.fft.irfft(self.symbol * np.fft.rfft(values), self.whole)

    def __call__(
        self, values: Float[np.ndarray, " sample"], observed: Bool[np.ndarray, " sample"]
    ) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, " sample"]]:
        """What is above the cut-off, 0 where nothing is observed, and the values, filled there."""
        at = np.flatnonzero(observed)
        missing = np.ones(self.whole, bool)
        missing[at] = False
        x = np.interp(np.arange(self.whole), at, values[at], period=self.whole)
        residual = -self._through(x) * missing
        step, power = residual, residual @ residual
        enough = (CLOSE * np.std(self._through(x)[at])) ** 2
        for _ in range(MOST_STEPS):
            if np.max(residual**2) <= enough:
                break
            towards = self._through(step)
            length = power / (step @ towards)
            x, residual = x + length * step, residual - length * towards * missing
            before, power = power, residual @ residual
            step = residual + power / before * step
        return self._through(x)[: self.n] * observed, x[: self.n]


class _Channel:
    """One channel's values, of size one, and how an outlier is known there."""

    def __init__(
        self,
        high_pass: _HighPass,
        values: np.ndarray,
        jumps: np.ndarray,
        is_spared: np.ndarray,
        around: int,
        alarm: float,
    ):
        self.high_pass, self.values, self.around = high_pass, values, around
        self.is_spared = is_spared
        self.reach = 2 * high_pass.period + 1
        self.jumps = scipy.ndimage.maximum_filter1d(jumps, self.reach)
        freedom = MAD_FREEDOM * float(np.isfinite(values).sum())
        self.most = float(-scipy.special.stdtrit(freedom, alarm / 2))

    def outliers(self) -> tuple[Bool[np.ndarray, " sample"], float]:
        """Which samples stand out, and how many times the noise the largest of them is."""
        present = np.isfinite(self.values)
        observed = present.copy()
        above, filled = self.high_pass(self.values, observed)
        bound = self._bound(above, filled, observed)
        for _ in range(MOST_ROUNDS):
            near = scipy.ndimage.maximum_filter1d(np.abs(above), self.reach)
            # What a larger one beside it may have left there waits until that one is missing.
            is_own = np.abs(above) >= min(2 * self.high_pass.leak, 1) * near
            new = (np.abs(above) > bound) & is_own
            if not new.any():
                break
            observed &= ~new
            if observed.sum() < (1 - MOST) * present.sum():
                return np.zeros(present.shape, bool), 0.0
            above, filled = self.high_pass(self.values, observed)
            bound = self._bound(above, filled, observed)
        # One that is as what is filled there was made by a larger one, which was not missing yet.
        found = present & ~observed & (self._off(filled) > bound)
        if not found.any():
            return found, 0.0
        found = present & _whole_bursts(found)
        filled = self.high_pass(self.values, present & ~found)[1]
        times = self.most * self._off(filled) / bound
        return found, float(np.max(times[found]))

    def _off(self, filled: np.ndarray) -> Float[np.ndarray, " sample"]:
        """What an impulse leaves above the cut-off in its own sample, by the samples around it."""
        return np.abs(self.values - filled) * self.high_pass.own

    def _bound(
        self, above: np.ndarray, filled: np.ndarray, observed: np.ndarray
    ) -> Float[np.ndarray, " sample"]:
        """The largest value above the cut-off that is noise or the signal's."""
        at = np.flatnonzero(observed)
        noise = np.abs(above[at])
        around = scipy.ndimage.median_filter(noise, min(self.around, noise.size), mode="reflect")
        local = np.interp(np.arange(observed.size), at, around)
        scale = np.maximum(np.median(noise), local) / MAD
        smooth = np.abs(filled - above - np.median(filled))
        jumping = scipy.ndimage.maximum_filter1d(smooth, self.reach) * self.jumps
        faint = max(FAINT * float(np.max(smooth)), ROUNDING)
        bound = np.maximum(self.most * scale + 2 * jumping, faint)
        return np.where(self.is_spared, np.inf, bound)


def _whole_bursts(found: Bool[np.ndarray, " sample"]) -> Bool[np.ndarray, " sample"]:
    """With the samples between those of a burst, and at its ends: what is interpolated between
    neighbours that are all missing follows a loud sample, which then does not stand out."""
    within = np.ones(2 * NEAR + 1)
    is_dense = found & (scipy.ndimage.convolve1d(found.astype(float), within) >= IN_BURST)
    bursts = scipy.ndimage.binary_closing(np.pad(is_dense, NEAR), within)[NEAR:-NEAR]
    return found | scipy.ndimage.binary_dilation(bursts, np.ones(2 * BESIDE + 1))
