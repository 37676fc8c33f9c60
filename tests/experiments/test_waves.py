"""Detection of a wave of known pitch: bounds, levels and averages against simulated noise."""

import numpy as np
import pytest

from experiments.fig12_ridges.waves import (
    averaged_pitch,
    detectable_amplitude,
    inverse_of_rising,
    low_passed,
    noise_beside,
    pitch_stderr_bound,
    samples_to_detect,
    wave_spectrum,
)
from srsinv.inverse.detection import finest_wavelength_m, needed_wave

PITCH_M, PER_PERIOD, PERIODS, AMPLITUDE, NOISE = 0.7e-3, 100, 40, 0.5, 1.0
RANGE_M = (0.68e-3, 0.72e-3)
X = np.arange(PER_PERIOD * PERIODS) * PITCH_M / PER_PERIOD


def noisy(seed: int, amplitude: float = AMPLITUDE) -> np.ndarray:
    noise = NOISE * np.random.default_rng(seed).normal(size=X.size)
    return amplitude * np.cos(2 * np.pi * X / PITCH_M + 0.4) + noise


def test_pitches_scatter_as_cramer_and_rao_have_it():
    pitches = [
        averaged_pitch(X, noisy(seed), float(PER_PERIOD), RANGE_M).pitch_m for seed in range(24)
    ]
    bound = pitch_stderr_bound(X, PITCH_M, AMPLITUDE, NOISE)
    assert np.std(pitches) == pytest.approx(bound, rel=0.43)  # three standard errors of 24 draws
    assert abs(np.mean(pitches) - PITCH_M) < 4 * bound / np.sqrt(24)


def test_noise_alone_passes_the_level_as_often_as_is_allowed():
    power = np.full(X.size // 2 + 1, NOISE**2)
    false_alarm, draws = 0.2, 300
    passed = 0
    for seed in range(draws):
        _, amplitude, level = wave_spectrum(X, noisy(seed, 0.0), power, PITCH_M, false_alarm)
        passed += bool(np.any(amplitude > level))
    # Tapered waves next to each other are not independent: the level is not exact.
    assert 0.5 * false_alarm < passed / draws < 2 * false_alarm


def test_spectrum_has_the_amplitude_of_a_wave():
    power = np.ones(X.size // 2 + 1)
    per_m, amplitude, _ = wave_spectrum(X, noisy(0, 20.0), power, PITCH_M, 0.05)
    top = np.argmax(amplitude)
    assert per_m[top] == pytest.approx(1 / PITCH_M, rel=1e-2)
    assert amplitude[top] == pytest.approx(20.0, rel=0.02)
    assert per_m[-1] < 5.5 / PITCH_M


def test_a_low_pass_filter_leaves_the_slow_wave():
    slow, fast = (np.cos(2 * np.pi * cycles * X / X.size / (X[1] - X[0])) for cycles in (20, 900))
    np.testing.assert_allclose(low_passed(slow + fast, 0.01), slow, atol=1e-12)


def test_averaging_reaches_the_strength_that_it_is_for():
    strength = needed_wave(0.05, 0.9)
    samples = samples_to_detect(strength, NOISE, AMPLITUDE)
    assert detectable_amplitude(strength, NOISE, samples) == pytest.approx(AMPLITUDE)
    # d' = A / sqrt(2) / sigma sqrt(n)
    assert np.sqrt(samples / 2) * AMPLITUDE / NOISE == pytest.approx(strength)
    assert samples_to_detect(strength, NOISE, AMPLITUDE / 10) == pytest.approx(100 * samples)


def test_inverse_of_a_power_law():
    heights = np.geomspace(1e-8, 1e-5, 5)
    reached = inverse_of_rising(np.array([4e-12, 1e-17, 1.0]), 4.0 * heights**2, heights)
    np.testing.assert_allclose(reached, [1e-6, np.nan, np.nan])


def test_the_finest_wavelength_is_where_the_signal_falls_below_the_noise():
    n, cell, width = 4096, 1e-5, 1e-4
    x, k = cell * (np.arange(n) - n / 2), 2 * np.pi * np.fft.rfftfreq(n, cell)
    signal = np.exp(-(x**2) / (2 * width**2))
    noise = 0.1 * np.random.default_rng(1).normal(size=(200, n))
    # |S|^2 = 2 pi (width/cell)^2 e^(-(k width)^2) reaches 0.1^2 n.
    expected = np.sqrt(np.log(2 * np.pi * (width / cell) ** 2 / (0.01 * n))) / width
    highest = 2 * np.pi / finest_wavelength_m(k, signal, noise)
    assert highest == pytest.approx(expected, abs=9 * k[1])
    assert finest_wavelength_m(k, 1e-6 * signal, noise) == np.inf


def test_noise_beside_a_wave():
    power = np.full(X.size // 2 + 1, NOISE**2)
    numbers = noise_beside(X, power, PITCH_M, AMPLITUDE)
    rms = np.std(low_passed(noisy(3, 0.0), 2 / PER_PERIOD))
    assert numbers["noise_rms_in_band_V"] == pytest.approx(rms, rel=0.2)
    strength = numbers["strength_over_scan"]
    assert detectable_amplitude(strength, NOISE, X.size) == pytest.approx(AMPLITUDE)
