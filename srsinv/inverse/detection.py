"""Detection: the signal strength that a matched filter needs against noise, and limits by it.

A signal's strength is d' = sqrt(signal^T N^-1 signal), its size over that of the noise along it; in
white noise sqrt(sum of squares)/rms.
"""

from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from ..errors import number

STRONGEST = 100.0  # d'; a stronger one is never missed


def needed_known(false_alarm: float, detection: float) -> float:
    """The d' that a matched filter needs, for a signal known but for its presence.

    Noise alone passes the threshold with probability `false_alarm`, the signal with `detection`.
    """
    _check(false_alarm, detection)
    return float(scipy.special.ndtri(detection) - scipy.special.ndtri(false_alarm))


def needed_wave(false_alarm: float, detection: float) -> float:
    """The d' that a sine wave of known pitch and unknown phase needs: its cosine and sine parts
    are estimated, and their squares are chi-square of two degrees of freedom."""
    _check(false_alarm, detection)
    threshold = scipy.special.chdtri(2, false_alarm)
    noncentral = scipy.stats.ncx2
    root: Any = scipy.optimize.brentq(
        lambda d: noncentral.sf(threshold, 2, d**2) - detection, 1e-6, STRONGEST
    )
    return float(root)


def last_crossing(at: Float[np.ndarray, " n"], falling: Float[np.ndarray, " n"]) -> float:
    """Where `falling` last crosses 1, straight between logarithms: NaN where it does not fall so
    far, and the first of `at` where it is below everywhere."""
    above = np.flatnonzero(~(falling < 1))
    if not above.size:
        return float(at[0])
    i = above[-1]
    if i == at.size - 1:
        return float("nan")
    x, y = np.log(at[i : i + 2]), np.log(falling[i : i + 2])
    return float(np.exp(x[0] - y[0] * (x[1] - x[0]) / (y[1] - y[0])))


def power_law_exponent(
    at: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], least: float
) -> float:
    """The slope of a straight line through the logarithms, NaN and values up to `least` left out;
    NaN where fewer than two are left."""
    good = np.isfinite(values) & (values > least)
    if good.sum() < 2:
        return float("nan")
    return float(np.polyfit(np.log(at[good]), np.log(values[good]), 1)[0])


def finest_wavelength_m(
    k: Float[np.ndarray, " k"],
    signal: Float[np.ndarray, " n"],
    noise: Float[np.ndarray, "draw n"],
) -> float:
    """The shortest wavelength [m] at which a signal's power is above that of noise, the mean of
    some draws, at wavenumbers `k` [rad/m]; infinite where it nowhere is.

    The difference is smoothed over nine wavenumbers, as the periodogram of a few draws scatters.
    """
    power = np.abs(np.fft.rfft(signal)) ** 2
    level = np.mean(np.abs(np.fft.rfft(noise)) ** 2, axis=0)
    above = np.flatnonzero(np.convolve(power - level, np.ones(9) / 9, "same")[1:] > 0)
    return float(2 * np.pi / k[above.max() + 1]) if above.size else float("inf")


def resolved_wavelength_m(depth_m: float, strength: float) -> float:
    """The wavelength [m] at which e^(-kz) attenuates a signal of this d' to the noise; NaN where
    the noise is the stronger."""
    return float(2 * np.pi * depth_m / np.log(strength)) if strength > 1 else float("nan")


def _check(false_alarm: float, detection: float) -> None:
    wanted = "a probability, above 0 and below 0.5"
    number("false_alarm", false_alarm, wanted, above=0, below=0.5)
    number("detection", detection, "a probability, from 0.5 to below 1", least=0.5, below=1)
