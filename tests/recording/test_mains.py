"""Lines of mains: detected, measured, and made of waves that span them."""

import numpy as np
import pytest

from srsinv.recording.mains import MainsLine, mains_lines, waves
from tests.refusals import refused

RATE_HZ, COUNT = 2000.0, 5000
TIME_S = np.arange(COUNT) / RATE_HZ


def noise(seed=0, elements=2):
    return np.random.default_rng(seed).normal(size=(elements, COUNT))


def narrow_band(rng, width_Hz):
    """A process of variance one about zero frequency, its spectrum a Gaussian of this full width at
    half maximum."""
    f = np.fft.fftfreq(4 * COUNT, 1 / RATE_HZ)
    shape = np.exp(-(f**2) / (2 * (width_Hz / 2.3548) ** 2))
    draws = rng.normal(size=(2, f.size))
    z = np.fft.ifft(np.fft.fft(draws[0] + 1j * draws[1]) * np.sqrt(shape))[:COUNT]
    return z / np.sqrt(np.mean(np.abs(z) ** 2))


@pytest.mark.parametrize("size", [0.3, 1.0, 300.0])
def test_a_wave_is_measured(size):
    signal = noise() + size * np.sqrt(2) * np.array([[1.0], [0.5]]) * np.sin(
        2 * np.pi * 50.13 * TIME_S + 0.4
    )
    (line,) = mains_lines(signal, RATE_HZ)
    assert line.frequency_Hz == pytest.approx(50.13, abs=0.1)
    assert line.rms == pytest.approx([size, size / 2], rel=0.1, abs=0.08)


def test_noise_has_no_line():
    assert all(mains_lines(noise(seed), RATE_HZ) == () for seed in range(50))


def test_harmonics_are_those_of_one_fundamental():
    hum = sum(np.sin(2 * np.pi * 60 * h * TIME_S + h) for h in (1, 2, 5))
    lines = mains_lines(noise() + hum, RATE_HZ)
    assert [round(line.frequency_Hz) for line in lines] == [60, 120, 300]


def test_a_grating_elsewhere_is_no_mains():
    assert mains_lines(noise() + 10 * np.sin(2 * np.pi * 37.0 * TIME_S), RATE_HZ) == ()


def test_samples_may_be_missing():
    signal = noise() + 30 * np.sin(2 * np.pi * 50 * TIME_S)
    signal[:, 1000:1003] = np.nan
    signal[0, 4000] = np.nan
    line = mains_lines(signal, RATE_HZ)[0]
    assert line.rms == pytest.approx(30 / np.sqrt(2), rel=0.03)


def test_named_lines_are_taken_as_strong_as_they_are():
    assert [line.frequency_Hz for line in mains_lines(noise(), RATE_HZ, (50.0, 5000.0))] == [
        pytest.approx(50.0, abs=3)
    ]


def test_a_named_line_that_the_signal_hides_may_be_as_strong_as_the_signal():
    """A touch that passes within 10 ms has a broad spectrum, far above a weak hum."""
    time = (TIME_S - 1.25) / 5e-3
    signal = noise() + 300 * time * np.exp(-(time**2) / 2) + 3 * np.sin(2 * np.pi * 50 * TIME_S)
    assert mains_lines(signal, RATE_HZ) == ()
    (line,) = mains_lines(signal, RATE_HZ, (50.0,))
    assert line.frequency_Hz == pytest.approx(50.0, abs=2.5)
    assert line.rms.min() > 2


@pytest.mark.parametrize("width_Hz", [0.0, 0.5, 2.0])
def test_waves_span_a_line_to_below_the_noise(width_Hz):
    rng, size = np.random.default_rng(3), 1000.0
    envelope = narrow_band(rng, width_Hz) if width_Hz else np.exp(0.7j) * np.ones(COUNT)
    hum = size * np.sqrt(2) * np.real(envelope * np.exp(2j * np.pi * 50.2 * TIME_S))
    lines = mains_lines((noise() + hum)[:1], RATE_HZ)
    columns = waves(TIME_S, lines, 1.0)[0]
    # Least squares with the sizes' prior and white noise of one.
    inner = np.eye(len(columns)) + columns @ columns.T
    left = hum - columns.T @ np.linalg.solve(inner, columns @ hum)
    assert np.sqrt(np.mean(left**2)) < 0.2
    assert len(columns) < 0.05 * COUNT


def test_a_line_of_too_many_waves_is_refused():
    line = MainsLine(200.0, 400.0, np.ones(2))
    refused(lambda: waves(TIME_S, (line,), 1e-3), "200 Hz", "mains_Hz")


def test_waves_have_the_line_s_variance():
    line = MainsLine(50.0, 1.0, np.array([2.0, 3.0]))
    variance = np.mean(np.sum(waves(TIME_S, (line,), 1e-3) ** 2, axis=1), axis=-1)
    assert variance == pytest.approx([4.0, 9.0], rel=1e-3)
