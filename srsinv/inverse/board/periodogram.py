"""Periodograms of signals along x: their level between lines, and what noise alone reaches."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

OVERSAMPLING = 4  # of the periodogram
LOBE = 2.0  # half-width of the Hann taper's main lobe, in 1/length
FLOOR = 16  # width of the running median, in 1/length: a line's lobe takes a quarter of it
FLOOR_BINS = FLOOR / 1.5 * 2 / np.pi  # bins of a mean as precise: Hann's 1.5, a median's 2/pi
TINY = np.finfo(float).tiny


class Periodogram(NamedTuple):
    """A periodogram summed over channels, at `per_m` (k,) [cycles/m], and its distribution under
    noise.

    - `power` (k,), in the square of the channels' unit; `floor` (k,): its level between lines;
    - `shift`, `step`, `dof`: power / floor is like shift + step chi-square(dof), matched in three
      cumulants to the sum over channels that are not independent (Buckley and Eagleson 1988);
    - `trials`: independent wavenumbers.
    """

    per_m: Float[np.ndarray, " k"]
    power: Float[np.ndarray, " k"]
    floor: Float[np.ndarray, " k"]
    shift: float
    step: float
    dof: float
    trials: float

    def false_alarm(self, power: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Probability that noise alone reaches `power` (k,) at any wavenumber."""
        excess = (power / self.floor - self.shift) / (self.step * self.dof)
        chance = scipy.special.fdtrc(self.dof, self.dof * FLOOR_BINS, excess)
        return np.minimum(1.0, self.trials * chance)

    def level(self, false_alarm: float) -> Float[np.ndarray, " k"]:
        """The power (k,) that noise alone reaches anywhere with this probability."""
        excess = scipy.special.fdtri(self.dof, self.dof * FLOOR_BINS, 1 - false_alarm / self.trials)
        return self.floor * (self.shift + self.step * self.dof * excess)


def spectrum(
    x_m: Float[np.ndarray, " n"], y: Float[np.ndarray, "c n"], longest_m: float
) -> Periodogram:
    """The Hann-tapered periodogram of y (channels of like noise), from `longest_m` down to two
    samples, and its own scale.

    Floor and scatter come from medians and capped sums, which a few lines hardly move.
    """
    step = x_m[1] - x_m[0]
    bins = OVERSAMPLING * x_m.size
    per_m = np.fft.rfftfreq(bins, step)
    in_band = (per_m >= 1 / longest_m) & (per_m < 0.5 / step)
    amplitude = np.fft.rfft(y * np.hanning(x_m.size), bins)[:, in_band]
    power = np.maximum(np.sum(np.abs(amplitude) ** 2, axis=0), TINY)
    floor = _floor(per_m[in_band], power)
    trials = length(x_m) * (0.5 / step - 1 / longest_m)
    return Periodogram(per_m[in_band], power, floor, *_scatter(amplitude, power, floor), trials)


def _floor(per_m, power) -> Float[np.ndarray, " k"]:
    """The running median, taken about a parabola in the logarithms: unbiased at the ends of a red
    spectrum too."""
    at = np.log(per_m)
    trend = np.exp(np.polyval(np.polyfit(at, np.log(power), 2), at))
    width = min(FLOOR * OVERSAMPLING, power.size) // 2 * 2 + 1
    return trend * scipy.ndimage.median_filter(power / trend, width, mode="reflect")


def _scatter(amplitude, power, floor) -> tuple[float, float, float]:
    """Shift, step and degrees of freedom of power / floor, whose median is 1.

    From the eigenvalues of the channels' covariance: the sum over channels is one of as many
    exponential variables. Bins are capped at their 90 % quantile, so that lines hardly count.
    """
    ratio = power / floor
    weight = np.minimum(1.0, np.quantile(ratio, 0.9) / ratio) / floor
    eigenvalues = np.linalg.eigvalsh((amplitude * weight) @ amplitude.conj().T)
    one, two, three = (np.sum(eigenvalues**order) for order in (1, 2, 3))
    dof = 2 * two**3 / three**2
    step = np.sqrt(two / (2 * dof))
    shift = one - step * dof
    median = shift + step * 2 * scipy.special.gammaincinv(dof / 2, 0.5)
    return float(shift / median), float(step / median), float(dof)


def length(x_m: Float[np.ndarray, " n"]) -> float:
    """From the first sample to the last."""
    return float(x_m[-1] - x_m[0])


def strongest_line_m(x: np.ndarray, values: np.ndarray) -> float | None:
    """Wavelength [m] of the strongest line of evenly spaced values, drift taken out.

    By the windowed, finely sampled periodogram of the residual of a straight line, over wavelengths
    from two cells to two fifths of the stretch (a Hann window blurs longer ones into the drift).
    """
    if len(x) < 16:
        return None
    left = values - np.polynomial.Polynomial.fit(x, values, 1)(x)
    n = 32 * len(x)
    power = np.abs(np.fft.rfft(left * np.hanning(len(x)), n)) ** 2
    frequency = np.fft.rfftfreq(n, (x[-1] - x[0]) / (len(x) - 1))
    band = frequency >= 2.5 / (x[-1] - x[0])
    top = int(np.argmax(np.where(band, power, -1.0)))
    return float(1 / frequency[top])
