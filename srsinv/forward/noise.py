"""Noise of the recorded signal, as a power spectrum per sample and as draws from it.

A spectrum (k,) here is the expected squared modulus of the noise's discrete Fourier transform over
n, in signal units squared: white noise of rms s has the constant spectrum s^2, and the mean over
all wavenumbers is the variance. Elements are independent, but for a cause that brings its own draw.
"""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray

from ..compiled import compiled
from ..errors import echo, number, refuse
from ..grid import Line, as_real
from ..known import namespace
from .scan import ConstantSpeed

BOLTZMANN_J_PER_K = 1.380649e-23
MOST_DB = 300  # beyond, float64 has no digit of the smaller one of signal and noise


class Noise(eqx.Module):
    """Base of noises: one cause of noise, by its power over the wavenumbers of a line.

    `spectrum` is to be defined. `needs_noise_free_signal`: whether its level follows from the
    signal without noise, so that it has no meaning for a recording.
    """

    needs_noise_free_signal: ClassVar[bool] = False

    @abc.abstractmethod
    def spectrum(
        self, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""]
    ) -> Float[Array, " k"]:
        """Power per sample at line.k, given the noise-free signal's rms over all elements."""

    def cross_spectrum(
        self, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""], elements: int
    ) -> Float[Array, "e e k"]:
        """Cross-spectral matrix between so many elements: diagonal, as they are independent."""
        power = self.spectrum(line, scan, signal_rms)
        return jnp.eye(elements)[..., None] * power[None, None]

    @property
    def non_gaussian(self) -> "NonGaussianNoise | None":
        """The noise as one that brings its own draw; None where it is Gaussian, and independent
        from element to element."""
        return None


class NonGaussianNoise(Noise):
    """A cause that is not Gaussian, or not independent from element to element, and brings its own
    draw. Its spectrum is then the mean over the elements; `cross_spectrum` has them apart."""

    @property
    def non_gaussian(self) -> "NonGaussianNoise":
        return self

    @abc.abstractmethod
    def draw(
        self,
        key: PRNGKeyArray,
        line: Line,
        scan: ConstantSpeed,
        signal_rms: Float[Array, ""],
    ) -> Float[Array, "e n"]:
        """Noise (element, n) that has the spectrum, periodic over the line's n samples."""


def _not_negative(name: str, value) -> Float[Array, ""]:
    return as_real(number(f"noise {name}", value, "a number that is at least 0", least=0))


class White(Noise):
    """White noise of `rms` in signal units."""

    rms: Float[Array, ""]

    def __init__(self, rms):
        self.rms = _not_negative("rms", rms)

    def spectrum(
        self, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""]
    ) -> Float[Array, " k"]:
        return jnp.full(line.k.shape, self.rms**2)


class SignalToNoise(Noise):
    """White noise at a stated ratio of signal to noise.

    - `snr_dB` [dB]: 20 log10(rms of the noise-free signal over all elements / rms of the noise).

    Raises `BadInput` for what is no number from -300 to 300.
    """

    needs_noise_free_signal: ClassVar[bool] = True
    snr_dB: Float[Array, ""]

    def __init__(self, snr_dB=40.0):
        wanted = f"a finite number of decibels, from -{MOST_DB} to {MOST_DB}"
        self.snr_dB = as_real(number("noise snr_dB", snr_dB, wanted, least=-MOST_DB, most=MOST_DB))

    def spectrum(
        self, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""]
    ) -> Float[Array, " k"]:
        return jnp.full(line.k.shape, (signal_rms * 10 ** (-self.snr_dB / 20)) ** 2)


class Johnson(Noise):
    """Thermal noise of the feedback resistor: 4 k_B T R_f over half the sampling rate."""

    resistance_ohm: Float[Array, ""]
    temperature_K: Float[Array, ""]

    def __init__(self, resistance_ohm=1e6, temperature_K=300.0):
        self.resistance_ohm = _not_negative("resistance_ohm", resistance_ohm)
        self.temperature_K = _not_negative("temperature_K", temperature_K)

    def spectrum(
        self, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""]
    ) -> Float[Array, " k"]:
        density = 4 * BOLTZMANN_J_PER_K * self.temperature_K * self.resistance_ohm
        return jnp.full(line.k.shape, density * scan.sample_rate_hz(line) / 2)


class Sliding(Noise):
    """Sliding noise of `fraction` of the signal's rms, correlated as exp(-|dx|/correlation_m)."""

    fraction: Float[Array, ""]
    correlation_m: Float[Array, ""]

    def __init__(self, fraction=0.01, correlation_m=0.2e-3):
        self.fraction = _not_negative("fraction", fraction)
        self.correlation_m = _not_negative("correlation_m", correlation_m)

    def spectrum(
        self, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""]
    ) -> Float[Array, " k"]:
        shape = exponential_spectrum(line.k, line.cell_m, self.correlation_m)
        return (self.fraction * signal_rms) ** 2 * shape


def exponential_spectrum(k, cell_m, correlation_m) -> Float[Any, " k"]:
    """Spectrum per sample of unit-variance samples correlated as exp(-|dx|/correlation_m).

    The sum over all lags of samples `cell_m` apart, (1 - a^2)/(1 - 2 a cos(k cell) + a^2) with
    a = exp(-cell/correlation), written so that a near 1 loses no digits.
    """
    ratio, xp = cell_m / correlation_m, namespace(k, cell_m, correlation_m)
    correlation, one_less = xp.exp(-ratio), -xp.expm1(-ratio)
    swing = 4 * correlation * xp.sin(k * cell_m / 2) ** 2
    # Over 1 - a above and below: its fourth power, in the derivative, is beyond single precision.
    return (1 + correlation) / (one_less + swing / one_less)


def split_gaussian(
    noises: tuple[Noise, ...],
) -> tuple[tuple[Noise, ...], tuple[NonGaussianNoise, ...]]:
    """The Gaussian causes, and those that bring their own draw."""
    gaussian = tuple(noise for noise in noises if noise.non_gaussian is None)
    return gaussian, tuple(own for noise in noises if (own := noise.non_gaussian) is not None)


def total_spectrum(
    noises: tuple[Noise, ...], line: Line, scan: ConstantSpeed, signal_rms
) -> Float[Array, " k"]:
    """The sum of independent causes; zero where none is named."""
    if not noises:
        return as_real(np.zeros(line.n // 2 + 1))
    return _total(noises, line, scan, as_real(signal_rms))


@compiled
def _total(noises, line: Line, scan: ConstantSpeed, signal_rms) -> Float[Array, " k"]:
    spectra = [_power(noise, line, scan, signal_rms) for noise in noises]
    return sum(spectra, jnp.zeros(line.k.shape))


@compiled
def with_noise(
    noises: tuple[Noise, ...],
    line: Line,
    scan: ConstantSpeed,
    signal: Float[Array, "e n"],
    key: PRNGKeyArray,
) -> tuple[Float[Array, "e n"], Float[Array, " k"], Float[Array, ""]]:
    """The signal with noise, the noise's power at line.k, and the signal's rms, which some causes
    scale with."""
    rms = jnp.sqrt(jnp.mean(signal**2))
    gaussian, others = split_gaussian(noises)
    spectrum = total_spectrum(gaussian, line, scan, rms)
    noisy = signal + draw(key, spectrum, *signal.shape)
    for at, noise in enumerate(others):
        noisy = noisy + noise.draw(jax.random.fold_in(key, at), line, scan, rms)
        spectrum = spectrum + _power(noise, line, scan, rms)
    return noisy, spectrum, rms


@compiled
def cross_spectrum(
    noises: tuple[NonGaussianNoise, ...], line: Line, scan: ConstantSpeed, signal_rms, elements: int
) -> Float[Array, "e e k"]:
    """The cross-spectral matrix of independent causes that bring their own draws."""
    each = (noise.cross_spectrum(line, scan, signal_rms, elements) for noise in noises)
    return sum(each, jnp.zeros((elements, elements, line.k.size)))


def _power(noise: Noise, line: Line, scan: ConstantSpeed, signal_rms) -> Float[Array, " k"]:
    """The power of one cause, which may be a stranger's."""
    power, wanted = noise.spectrum(line, scan, signal_rms), line.k.shape
    refuse(
        getattr(power, "shape", None) != wanted or jnp.iscomplexobj(power),
        f"{type(noise).__name__}.spectrum gives {echo(power)}: give the power at every wavenumber "
        f"of line.k, an array of real numbers of the shape {wanted}.",
    )
    return power


def check_power(noises: Sequence[Noise], power: Float[ArrayLike, " k"]) -> None:
    """Refuse a total power that cannot be."""
    values, names = np.asarray(power), ", ".join(type(noise).__name__ for noise in noises)
    bad = ~(values >= 0) | np.isinf(values)
    refuse(
        bool(bad.any()),
        f"The noise ({names}) has the power {values[bad.argmax()]} at the wavenumber "
        f"{bad.argmax()}: give finite numbers that are at least 0.",
    )


@compiled
def draw(
    key: PRNGKeyArray, spectrum: Float[Array, " k"], elements: int, n: int
) -> Float[Array, "e n"]:
    """Gaussian noise (element, n) of the given spectrum, periodic over its n samples."""
    white = jax.random.normal(key, (elements, n))
    return jnp.fft.irfft(jnp.sqrt(spectrum)[None] * jnp.fft.rfft(white), n)
