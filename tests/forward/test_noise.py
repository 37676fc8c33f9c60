"""Noise: the spectra as stated, and draws that have them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from srsinv.forward.noise import (
    Johnson,
    SignalToNoise,
    Sliding,
    White,
    draw,
    exponential_spectrum,
    total_spectrum,
)
from srsinv.forward.scan import ConstantSpeed
from srsinv.grid import Open, Periodic, half_spectrum_weights

SCAN, RMS = ConstantSpeed(-0.05), jnp.asarray(2e-3)
LINES = {"even": Periodic(256, 1e-4), "odd": Open(255, 1e-4)}
ALL = (White(3e-4), SignalToNoise(26.0), Johnson(), Sliding(0.2, 0.6e-3))
NOISES = {
    "white": (White(3e-4), 3e-4),
    "snr": (SignalToNoise(40.0), 2e-3 / 100),
    # 0.128717 uV per root Hz of 1 Mohm at 300 K, over half of 500 samples per second.
    "johnson": (Johnson(1e6, 300.0), 0.128717e-6 * np.sqrt(250)),
    "johnson_cold": (Johnson(4e6, 75.0), 0.128717e-6 * np.sqrt(250)),
    "sliding": (Sliding(0.05, 0.3e-3), 0.05 * 2e-3),
    "uncorrelated": (Sliding(0.05, 0.0), 0.05 * 2e-3),
    "silent": (White(0.0), 0.0),
}


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
@pytest.mark.parametrize("name", NOISES)
def test_mean_over_the_spectrum_is_the_variance(name, line):
    noise, rms = NOISES[name]
    spectrum = np.asarray(noise.spectrum(line, SCAN, RMS))
    assert spectrum.shape == line.k.shape
    variance = half_spectrum_weights(line.n) @ spectrum
    assert np.sqrt(variance) == pytest.approx(rms, rel=1e-5)


@pytest.mark.parametrize("name", ["white", "snr", "johnson", "uncorrelated"])
def test_white_noises_are_flat(name):
    spectrum = np.asarray(NOISES[name][0].spectrum(LINES["even"], SCAN, RMS))
    np.testing.assert_allclose(spectrum, spectrum[0], rtol=1e-14)


def test_johnson_density_of_the_paper():
    """0.13 uV per root Hz for 1 Mohm at 300 K, at any speed and any sampling."""
    for speed, cell in ((0.01, 1e-4), (-0.1, 3e-5)):
        line, scan = Periodic(16, cell), ConstantSpeed(speed)
        one_sided = Johnson(1e6, 300.0).spectrum(line, scan, RMS) * 2 / scan.sample_rate_hz(line)
        np.testing.assert_allclose(np.sqrt(one_sided), 0.13e-6, rtol=0.02)


@pytest.mark.parametrize("correlation", [0.5e-4, 2e-4, 3e-3])
@pytest.mark.parametrize("n", [4096, 4095])
def test_sliding_noise_decays_exponentially(correlation, n):
    """On a line long enough that the covariance has died out before it wraps around."""
    line = Periodic(n, 1e-4)
    spectrum = Sliding(0.5, correlation).spectrum(line, SCAN, RMS)
    covariance = np.fft.irfft(np.asarray(spectrum), n)[: n // 2]
    expected = (0.5 * 2e-3) ** 2 * np.exp(-1e-4 * np.arange(n // 2) / correlation)
    np.testing.assert_allclose(covariance, expected, atol=1e-10 * expected[0], rtol=0)


def test_exponential_spectrum_keeps_its_digits_at_long_correlation():
    """Towards a continuous line: 2 l / (1 + (k l)^2) per cell."""
    k, cell, length = jnp.asarray([0.0, 3.0, 40.0]), 1e-9, 0.2
    expected = 2 * length / cell / (1 + (np.asarray(k) * length) ** 2)
    np.testing.assert_allclose(exponential_spectrum(k, cell, length), expected, rtol=1e-12)


def test_causes_add_up():
    line = LINES["even"]
    total = total_spectrum(ALL, line, SCAN, RMS)
    parts = sum(np.asarray(noise.spectrum(line, SCAN, RMS)) for noise in ALL)
    np.testing.assert_allclose(total, parts, rtol=1e-14)
    np.testing.assert_array_equal(total_spectrum((), line, SCAN, RMS), np.zeros(line.k.shape))


# Draws. The bounds are those of a fair draw at one in a thousand; the key is fixed.

DRAW = eqx.filter_jit(draw)
ELEMENTS = 8


@pytest.fixture(params=LINES)
def drawn(request):
    line = LINES[request.param]
    spectrum = total_spectrum(ALL, line, SCAN, RMS)
    return np.asarray(spectrum), np.asarray(DRAW(jax.random.key(5), spectrum, ELEMENTS, line.n))


def test_draws_have_the_stated_power(drawn):
    """The power at all wavenumbers, each in its own units, is chi-square."""
    spectrum, noise = drawn
    n = noise.shape[1]
    power = np.abs(np.fft.rfft(noise)) ** 2 / n / spectrum
    whole = n * half_spectrum_weights(n) @ power.sum(0)
    low, high = stats.chi2(ELEMENTS * n).ppf([0.0005, 0.9995])
    assert low < whole < high
    assert stats.chi2(ELEMENTS).ppf(0.0005) < power[:, 0].sum() < stats.chi2(ELEMENTS).ppf(0.9995)


def test_draws_have_the_stated_spectrum(drawn):
    """Between the ends, each periodogram value is exponential, at low and at high wavenumbers."""
    spectrum, noise = drawn
    power = np.abs(np.fft.rfft(noise)) ** 2 / noise.shape[1] / spectrum
    for band in (power[:, 1:12], power[:, 12:60], power[:, 60:127]):
        assert stats.kstest(band.ravel(), "expon").pvalue > 1e-3


def test_draws_are_gaussian_with_mean_zero(drawn):
    spectrum, noise = drawn
    whitened = np.fft.irfft(np.fft.rfft(noise) / np.sqrt(spectrum), noise.shape[1])
    assert stats.kstest(whitened.ravel(), "norm").pvalue > 1e-3


def test_elements_are_independent(drawn):
    spectrum, noise = drawn
    whitened = np.fft.irfft(np.fft.rfft(noise) / np.sqrt(spectrum), noise.shape[1])
    correlation = np.corrcoef(whitened) - np.eye(ELEMENTS)
    assert np.abs(correlation).max() < 4 / np.sqrt(noise.shape[1])


def test_the_key_decides_every_byte():
    spectrum = total_spectrum(ALL, LINES["even"], SCAN, RMS)
    first, again, other = (DRAW(jax.random.key(s), spectrum, 2, 256) for s in (0, 0, 1))
    assert np.asarray(first).tobytes() == np.asarray(again).tobytes()
    assert np.abs(np.asarray(first - other)).max() > 0


def test_no_noise_draws_nothing():
    silent = DRAW(jax.random.key(0), total_spectrum((), LINES["odd"], SCAN, RMS), 2, 255)
    np.testing.assert_array_equal(silent, 0.0)
