"""The level of a random walk on a signal, beside noise, hum, a ridge and textures."""

import numpy as np
import pytest
import scipy

from srsinv.recording.drift import common_level, drift_levels, shared_levels

RATE_HZ, SECONDS = 2000.0, 2.0
N = int(RATE_HZ * SECONDS)
TIME_S = np.arange(N) / RATE_HZ
RNG = np.random.default_rng


def walks(rng, reach, draws, n=N):
    """Random walks whose rms is `reach` at the end."""
    return reach / np.sqrt(n) * np.cumsum(rng.normal(size=(draws, n)), axis=1)


def ridge(u_s=0.06):
    """The rate of stress under two opposite line loads on a half space (Flamant), of rms one."""
    signal = np.zeros(N)
    for place_s, load in ((1.06, 1.0), (1.13, -0.6)):
        u = (TIME_S - place_s) / u_s
        signal += load * np.gradient(1 / (1 + u**2) ** 2 + 0.3 * u**2 / (1 + u**2) ** 2, TIME_S)
    return signal / signal.std()


@pytest.mark.full
@pytest.mark.parametrize("over_noise", [30, 100])
@pytest.mark.parametrize("reach", [0.1, 0.3])
@pytest.mark.parametrize("has_ridge", [False, True])
def test_level_of_a_walk(over_noise, reach, has_ridge):
    rng = RNG(1)
    signal = walks(rng, reach, 60) + rng.normal(size=(60, N)) / over_noise + has_ridge * ridge()
    ratio = drift_levels(signal, RATE_HZ) * np.sqrt(SECONDS) / reach
    found = ratio[ratio > 0]
    assert found.size >= 56
    assert found.mean() == pytest.approx(1.0, abs=0.1)
    assert found.std() < 0.25


def test_a_weak_walk_in_little_noise():
    rng = RNG(2)
    signal = walks(rng, 0.03, 60) + rng.normal(size=(60, N)) / 100 + ridge()
    ratio = drift_levels(signal, RATE_HZ) * np.sqrt(SECONDS) / 0.03
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)


def test_a_longer_recording_tells_more():
    n = 10 * N
    signal = walks(RNG(3), 0.3, 20, n) + RNG(4).normal(size=(20, n)) / 30
    ratio = drift_levels(signal, RATE_HZ) * np.sqrt(10 * SECONDS) / 0.3
    assert ratio[ratio > 0] == pytest.approx(1.0, abs=0.25)
    expected = 0.3 / np.sqrt(10 * SECONDS)
    assert common_level(drift_levels(signal, RATE_HZ)) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("width_Hz", [0.0, 2.0])
def test_hum_of_ten_times_the_signal_does_not_matter(width_Hz):
    rng, draws = RNG(5), 30
    phase = 2 * np.pi * 50.1 * TIME_S + rng.uniform(0, 6, size=(draws, 1))
    # A slowly varying phase makes a line of about this width.
    phase = phase + np.sin(np.pi * width_Hz * TIME_S + rng.uniform(0, 6, size=(draws, 1)))
    signal = walks(rng, 0.1, draws) + rng.normal(size=(draws, N)) / 100 + ridge()
    hum = 10 * np.sqrt(2) * (np.sin(phase) + 0.3 * np.sin(3 * phase))
    ratio = drift_levels(signal + hum, RATE_HZ) * np.sqrt(SECONDS) / 0.1
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)


@pytest.mark.full
def test_white_noise_has_no_drift():
    levels = drift_levels(RNG(6).normal(size=(200, N)), RATE_HZ)
    assert np.count_nonzero(levels) <= 2  # 0.2 expected; more once in a thousand


@pytest.mark.claim
def test_false_alarms_are_as_frequent_as_stated():
    levels = drift_levels(RNG(7).normal(size=(1000, N)), RATE_HZ)
    assert np.count_nonzero(levels) <= 5  # 1 expected; more once in a thousand


@pytest.mark.parametrize("over_noise", [5, 30, 100, 300])
def test_a_clean_ridge_is_no_drift(over_noise):
    signal = ridge() + RNG(8).normal(size=(40, N)) / over_noise
    assert np.count_nonzero(drift_levels(signal, RATE_HZ)) <= 2


def test_a_touch_that_lasts_throughout_is_no_drift():
    signal = ridge()[1800:2600] + RNG(14).normal(size=(40, 800)) / 50
    assert not drift_levels(signal, RATE_HZ).any()


@pytest.mark.parametrize(("frequency_Hz", "seconds"), [(40, 1), (20, 1), (8, 3), (5, 3), (3, 1)])
@pytest.mark.parametrize("over_noise", [5, 100])
def test_a_texture_is_no_drift(frequency_Hz, seconds, over_noise):
    n = seconds * N
    phase = 2 * np.pi * frequency_Hz * np.arange(n) / RATE_HZ
    phase = phase + RNG(9).uniform(0, 6, size=(20, 1))
    texture = np.sqrt(2) * (np.sin(phase) + 0.3 * np.sin(2 * phase))
    signal = texture + RNG(10).normal(size=(20, n)) / over_noise
    levels = drift_levels(signal, RATE_HZ) * np.sqrt(n / RATE_HZ)
    assert np.count_nonzero(levels) <= (5 if frequency_Hz * seconds == 3 else 1)


def test_noise_below_a_low_pass_is_no_drift():
    low_pass = scipy.signal.butter(4, 400, fs=RATE_HZ, output="sos")
    noise = scipy.signal.sosfilt(low_pass, RNG(11).normal(size=(60, 2 * N)))[:, N:]
    assert np.count_nonzero(drift_levels(noise, RATE_HZ)) <= 1


def test_missing_samples_and_scale():
    rng = RNG(12)
    signal = walks(rng, 0.3, 12) + rng.normal(size=(12, N)) / 100
    holes = np.where(rng.uniform(size=signal.shape) < 0.03, np.nan, signal)
    holes[:, 1000:1400] = np.nan
    whole = drift_levels(signal, RATE_HZ)
    assert np.median(drift_levels(holes, RATE_HZ) / whole) == pytest.approx(1.0, abs=0.15)
    assert drift_levels(1e-9 * signal, RATE_HZ) == pytest.approx(1e-9 * whole, rel=1e-5)


@pytest.mark.parametrize(
    "row", [np.ones(99), np.full(99, np.nan), RNG(13).normal(size=40), np.arange(3.0)]
)
def test_nothing_to_tell_it_from(row):
    assert drift_levels(row[None], RATE_HZ) == 0.0


def test_elements_share_a_drift_unless_theirs_are_far_apart():
    assert shared_levels(np.array([1.0, 2.0])) == pytest.approx([np.sqrt(2.5)])
    assert shared_levels(np.array([1.0, 5.0, 0.0])) == pytest.approx([1.0, 5.0, np.sqrt(26 / 3)])
    assert shared_levels(np.zeros(2)) == 0.0


@pytest.mark.full
def test_a_drift_that_is_known_to_be_there_is_missed_less():
    """In much noise: as often as not by inspection, hardly where it is named."""
    rng = RNG(14)
    signal = walks(rng, 0.3, 60) + rng.normal(size=(60, N)) / 3 + ridge()
    found = [drift_levels(signal, RATE_HZ, chance) for chance in (1e-3, 0.2)]
    missed = [float(np.mean(levels == 0)) for levels in found]
    assert missed[1] < 0.5 * missed[0]
    there = found[1][found[1] > 0] * np.sqrt(SECONDS) / 0.3
    assert np.median(there) == pytest.approx(1.0, abs=0.3)
    nothing = drift_levels(rng.normal(size=(60, N)), RATE_HZ, 0.2)
    assert np.mean(nothing > 0) < 0.3
