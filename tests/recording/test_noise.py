"""The white noise of a signal, whatever is missing of it."""

import numpy as np
import pytest

from srsinv.recording.noise import white_levels
from tests.tiers import quick

N, DEPTH_M, SPACING_M = 2000, 7.5e-4, 1e-5
AT = np.arange(N)
RNG = np.random.default_rng(0)
# Which samples are missing, and how far the mean of eight estimates may be off.
MISSING = {
    "none": (AT < 0, 0.02),
    "one": (AT == 700, 0.02),
    "1 %": (RNG.random(N) < 0.01, 0.02),
    "10 %": (RNG.random(N) < 0.1, 0.02),
    "50 %": (RNG.random(N) < 0.5, 0.03),
    "one in ten": (AT % 10 == 0, 0.02),
    "every other": (AT % 2 == 0, 0.03),
    "a quarter at once": ((AT > 500) & (AT < 1000), 0.02),
    "ten at a time": ((AT // 10) % 2 == 0, 0.03),
    "twenty bursts, half": ((AT // 50) % 2 == 0, 0.03),
    "the ends": ((AT < 300) | (AT > 1800), 0.02),
}


def scan(level, rng):
    """What two elements feel of a ridge, and white noise of a sixtieth."""
    x = (AT - N / 2) * SPACING_M / DEPTH_M
    signal = np.exp(-(x**2) / 2) * np.stack([np.sin(x), np.cos(x)]) + x / 20
    return level * (60 * signal + rng.normal(size=(2, N)))


@pytest.mark.parametrize("name", quick(MISSING, "none", "1 %", "ten at a time"))
def test_white_noise_is_found_whatever_is_missing(name):
    (missing, most), level = MISSING[name], 1e-6
    rng = np.random.default_rng(1)
    levels = [
        white_levels(np.where(missing, np.nan, scan(level, rng)), DEPTH_M, SPACING_M)
        for _ in range(8)
    ]
    assert np.mean(levels) == pytest.approx(level, rel=most)


def test_elements_may_miss_samples_of_their_own():
    rng = np.random.default_rng(2)
    missing = np.stack([MISSING["50 %"][0], MISSING["a quarter at once"][0]])
    levels = white_levels(np.where(missing, np.nan, scan(2.0, rng)), DEPTH_M, SPACING_M)
    assert levels == pytest.approx(2.0, rel=0.08)


def test_a_texture_all_along_the_scan_is_no_noise():
    """Of a thousand times the noise, damped by e^(-k z) on its way to the film: in samples ten
    times as far apart it is above the noise in a third of all waves."""
    rng, spacing_m = np.random.default_rng(3), 10 * SPACING_M
    damped = 1e3 * np.exp(-2 * np.pi * np.fft.rfftfreq(N, spacing_m) * DEPTH_M)
    levels = []
    for _ in range(8):
        texture = np.fft.irfft(damped * np.fft.rfft(rng.normal(size=(2, N))), N)
        levels.append(white_levels(texture + rng.normal(size=(2, N)), DEPTH_M, spacing_m))
    assert np.mean(levels) == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("signal", [np.zeros((1, N)), np.full((1, N), np.nan)])
def test_no_noise_where_nothing_varies(signal):
    assert white_levels(signal, DEPTH_M, SPACING_M) == 0


def test_elements_have_a_level_of_their_own_where_they_differ():
    rng = np.random.default_rng(4)
    alike, apart = [], []
    for _ in range(40):
        signal = scan(1.0, rng)
        alike.append(white_levels(signal, DEPTH_M, SPACING_M).size)
        louder = signal + np.array([[0.0], [3.0]]) * rng.normal(size=signal.shape)
        apart.append(white_levels(louder, DEPTH_M, SPACING_M))
    assert alike.count(1) >= 39  # chance makes 15 % once in some thousands
    assert np.mean(apart, axis=0) == pytest.approx([1.0, np.sqrt(10)], rel=0.02)
    # One that is dead has none to be found: the others' is as good as any.
    signal[1] = 0.0
    assert white_levels(signal, DEPTH_M, SPACING_M).shape == (1,)
