"""A wave of known pitch in white noise: its spectrum, and what averaging over many periods shows.

Over n samples of noise of rms sigma a wave of amplitude A has d' = A/sqrt(2)/sigma sqrt(n).
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from srsinv.inverse.board.pitch import Pitch, drift, scan_pitch

BLOCKS_PER_PERIOD = 20  # whose means hold all but 0.4 % of the wave
OVERSAMPLING = 4  # of the spectrum
HARMONICS = 5.5  # up to the fifth
LOWEST = 0.1  # of the wave's wavenumber: below, drift


def averaged_pitch(
    x_m: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, " n"],
    per_period: float,
    range_m: tuple[float, float],
) -> Pitch:
    """The pitch within `range_m`, from means over blocks of even samples, `per_period` of them."""
    block = max(int(per_period / BLOCKS_PER_PERIOD), 1)
    n = x_m.size // block * block
    x, y = (each[:n].reshape(-1, block).mean(axis=1) for each in (x_m, signal))
    return scan_pitch(x, y[None], drift(x, 2 * range_m[1]), range_m, 1)


def pitch_stderr_bound(
    x_m: Float[np.ndarray, " n"], pitch_m: float, amplitude: float, noise: float
) -> float:
    """Cramer and Rao's bound [m] for a wave over even x of unknown phase, amplitude and pitch."""
    span = np.ptp(x_m) * x_m.size**0.5
    return float(np.sqrt(6) * pitch_m**2 * noise / (np.pi * amplitude * span))


def wave_spectrum(
    x_m: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, " n"],
    noise_power: Float[np.ndarray, " m"],
    pitch_m: float,
    false_alarm: float,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Wavenumbers [cycles/m] up to the fifth harmonic, the amplitude of the Hann-tapered signal
    there, and the level that noise alone reaches anywhere in this band with probability
    `false_alarm`; `noise_power` is the noise's per sample, at the wavenumbers of x."""
    taper, bins, step = np.hanning(x_m.size), OVERSAMPLING * x_m.size, x_m[1] - x_m[0]
    per_m = np.fft.rfftfreq(bins, step)
    in_band = (per_m > LOWEST / pitch_m) & (per_m <= HARMONICS / pitch_m)
    amplitude = 2 / taper.sum() * np.abs(np.fft.rfft(signal * taper, bins)[in_band])
    at = np.fft.rfftfreq(x_m.size, step)
    power = np.interp(per_m[in_band], at, noise_power) * np.sum(taper**2)
    trials = x_m.size * step * np.ptp(per_m[in_band])  # independent waves; |.|^2 is exponential
    level = 2 / taper.sum() * np.sqrt(power * np.log(trials / false_alarm))
    return per_m[in_band], amplitude, level


def low_passed(values: Float[np.ndarray, " n"], most: float) -> Float[np.ndarray, " n"]:
    """Even values without the waves of more than `most` cycles per sample."""
    wave = np.fft.rfft(values)
    wave[np.fft.rfftfreq(values.size) > most] = 0
    return np.fft.irfft(wave, values.size)


def noise_beside(
    x_m: Float[np.ndarray, " n"],
    noise_power: Float[np.ndarray, " m"],
    pitch_m: float,
    amplitude: float,
) -> dict[str, float]:
    """Numbers of the noise [V^2], per sample at the wavenumbers of even samples, beside a wave [V].

    In volts the rms of white noise as strong as it is at the pitch, of the noise itself, and of the
    white noise up to twice the wave's frequency; the wave's rms over the latter two, its d', and
    the bound on the pitch's standard error.
    """
    step = float(x_m[1] - x_m[0])
    power = np.interp(1 / pitch_m, np.fft.rfftfreq(x_m.size, step), noise_power)
    level, noise = float(np.sqrt(power)), float(np.sqrt(np.mean(noise_power)))
    in_band, rms = level * float(np.sqrt(4 * step / pitch_m)), amplitude / float(np.sqrt(2))
    return {
        "noise_at_pitch_V": level,
        "noise_rms_V": noise,
        "noise_rms_in_band_V": in_band,
        "snr_per_sample": rms / noise,
        "snr_in_band": rms / in_band,
        "strength_over_scan": rms / level * float(np.sqrt(x_m.size)),
        "pitch_m_stderr_bound": pitch_stderr_bound(x_m, pitch_m, amplitude, level),
    }


def detectable_amplitude(strength: float, noise: float, samples: Any) -> Any:
    """The amplitude of the wave that has this d' over so many samples."""
    return strength * noise * np.sqrt(2 / samples)


def samples_to_detect(strength: float, noise: float, amplitude: float) -> float:
    """Over how many samples a wave of this amplitude reaches a d' of `strength`."""
    return 2 * (strength * noise / amplitude) ** 2


def inverse_of_rising(
    wanted: Float[np.ndarray, " m"], values: Float[np.ndarray, " n"], at: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " m"]:
    """Where `values` over `at` reach those `wanted`, straight between logarithms; NaN where they
    never do."""
    rising = np.log(np.maximum.accumulate(values))
    return np.exp(np.interp(np.log(wanted), rising, np.log(at), left=np.nan, right=np.nan))
