"""Samples that are taken as missing: outliers, bursts, clipped and stuck stretches; and sound
recordings, which lose none."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from srsinv.recording import Recording
from srsinv.recording.preparation import prepare
from srsinv.recording.unusable import without_unusable

N, RATE_HZ, SPEED, DEPTH_M, NOISE = 1000, 2000.0, 0.04, 0.75e-3, 0.01
TIME_S = np.arange(N) / RATE_HZ
SPEEDS = {
    "even": np.full(N, SPEED),
    "rippled": SPEED * (1 + 0.2 * np.sin(2 * np.pi * 20 * TIME_S)),
    "both ways": np.where(TIME_S < 0.25, SPEED, -SPEED),
    "starts and stops": SPEED * ((TIME_S > 0.1) & (TIME_S < 0.4)),
    "measured with noise": SPEED * (1 + 0.02 * np.random.default_rng(0).normal(size=N)),
}


def rng_of(seed):
    return np.random.default_rng(seed)


def recording(seed=0, speed=SPEEDS["even"], noise=NOISE, change=lambda v: v, **facts: Any):
    """Two elements over a bump, with noise, as `change` leaves the signals."""
    x_m = np.cumsum(speed) / RATE_HZ
    felt = speed / SPEED * np.exp(-(((x_m - 8e-3) / 1.5e-3) ** 2))
    noises = noise * rng_of(seed).normal(size=(2, N))
    signal = change(np.stack([felt, -0.5 * felt]) + noises)
    return Recording(signal, TIME_S, speed, ("a", "b"), facts)


def missing(given):
    """Which samples become missing, and the sentences."""
    left, words = without_unusable(given, DEPTH_M)
    return np.isnan(left.signal), words


def plus(at, value):
    """What adds a value to the first signal."""

    def change(signal):
        signal[0, at] += value
        return signal

    return change


@pytest.mark.parametrize("motion", SPEEDS)
@pytest.mark.parametrize("noise", [1e-12, 1e-6, NOISE, 1.0])
def test_a_sound_recording_stays_the_same(motion, noise):
    for seed in range(10):
        given = recording(seed, SPEEDS[motion], noise)
        left, words = without_unusable(given, DEPTH_M)
        assert left is given
        assert words == ()


def test_noise_alone_hardly_ever_loses_a_sample():
    """A recording in a thousand may: of 500 then four have a chance below 1 %."""
    assert sum(bool(missing(recording(seed))[1]) for seed in range(500)) < 4


@pytest.mark.parametrize("motion", SPEEDS)
@pytest.mark.parametrize("at", [0, 1, 15, 333, N - 1])
def test_an_outlier_is_lost_alone_and_said(motion, at):
    found, words = missing(recording(speed=SPEEDS[motion], change=plus(at, 10.0)))
    assert np.argwhere(found).tolist() == [[0, at]]
    assert len(words) == 1
    for each in ("a: 1 sample", f"number {at + 1}", "taken as missing", "Check the wiring"):
        assert each in words[0]


def test_outliers_of_very_different_sizes_are_lost():
    at = np.array([100, 103, 400, 405, 700])
    found, words = missing(recording(change=plus(at, np.array([100.0, -0.3, 1.0, -0.3, 0.2]))))
    assert np.flatnonzero(found[0]).tolist() == at.tolist()
    assert "5 samples at 5 places, from number 101 on, stand out" in words[0]


def test_a_burst_is_lost():
    loud = 20 * NOISE * rng_of(1).normal(size=10)
    found, _ = missing(recording(change=plus(slice(600, 610), loud)))
    assert found[0, 601:609].all()
    assert found.sum() <= 14


def test_heavy_tails_are_cut_and_most_samples_stay():
    tails = NOISE * rng_of(2).standard_t(2.5, size=N)
    found, _ = missing(recording(noise=0.0, change=lambda v: v + tails))
    assert found[0][np.abs(tails) > 10 * NOISE].all()
    assert 0 < found.mean() < 0.05


@pytest.mark.parametrize(
    "change",
    [
        lambda v: v * (1 + 0.05 * rng_of(3).normal(size=v.shape)),
        lambda v: v + np.array([[10 * NOISE], [0]]) * rng_of(3).normal(size=v.shape),
        lambda v: v + 0.3 * np.sin(2 * np.pi * 150 * TIME_S),
        lambda v: v + np.linspace(5, 7, N),
    ],
    ids=["multiplied", "louder channel", "hum", "ramp"],
)
def test_noise_of_another_kind_loses_hardly_a_sample(change):
    assert np.mean([missing(recording(seed, change=change))[0].mean() for seed in range(5)]) < 2e-3


def test_what_most_of_a_channel_has_is_no_outlier():
    every = np.where(np.arange(N) % 4 == 0, 3.0, 0.0)
    assert not missing(recording(change=lambda v: v + every))[0].any()


def test_steps_above_the_noise_lose_no_sample():
    found, words = missing(recording(change=lambda v: np.round(plus(500, 3.0)(v) / 0.1) * 0.1))
    assert not found.any()
    assert all("equal to the one before" in each for each in words)


def test_a_coarse_sampling_shows_no_outlier():
    """Two samples in a depth, of which the skin transmits every wave."""
    coarse = replace(recording(change=plus(333, 10.0)), time_s=TIME_S * 20)
    assert missing(coarse)[1] == ()


def test_clipped_samples_are_lost_with_those_alone_at_the_limit():
    found, words = missing(recording(change=lambda v: np.minimum(v, 0.9)))
    np.testing.assert_array_equal(found, recording().signal >= 0.9)
    assert len(words) == 1
    assert "a is clipped" in words[0]
    assert "less gain" in words[0]


def test_stuck_samples_are_lost():
    def stuck(signal):
        signal[1, 200:300] = signal[1, 200]
        return signal

    found, words = missing(recording(change=stuck))
    assert np.flatnonzero(found.ravel()).tolist() == list(range(N + 200, N + 300))
    assert "b is stuck: 100 samples, from number 201 on" in words[0]


def test_a_channel_that_is_stuck_but_for_a_few_samples_stays():
    def stuck(signal):
        signal[1, 10:] = 0.0
        return signal

    found, words = missing(recording(change=stuck))
    assert not found.any()
    assert "The answer uses them" in words[0]


@pytest.mark.parametrize("factor", [1e-30, -1.0, 1e30])
def test_the_unit_does_not_matter(factor):
    change = plus([100, 500, 501, 502, 503, 504], [0.5, 0.3, -0.5, 0.1, 0.3, -0.2])
    expected = missing(recording(change=change))[0]
    assert expected.any()
    found = missing(recording(change=lambda v: factor * change(v)))[0]
    np.testing.assert_array_equal(found, expected)


def test_shear_that_turns_over_with_the_motion_is_no_outlier():
    speed = SPEEDS["both ways"]
    turning = np.where((TIME_S >= 0.25) & (TIME_S < 0.253), 5.0, 0.0)
    found, words = missing(recording(speed=speed, change=lambda v: v + turning))
    assert not found.any()
    assert words == ()


def test_missing_samples_are_no_fault_and_hide_none():
    def holed(signal):
        signal[:, 280:300] = np.nan
        signal[0, 500::7] = np.nan
        return plus(310, 1.0)(signal)

    given = recording(change=holed)
    found = missing(given)[0] & np.isfinite(given.signal)
    assert np.argwhere(found).tolist() == [[0, 310]]


def test_a_filter_does_not_spread_what_is_lost():
    """And samples that were left out near turns stay so."""
    facts = {"high_pass_Hz": 10.0, "notch_Hz": 50.0, "notch_width_Hz": 4.0}
    given = prepare(recording(0, SPEEDS["even"], NOISE, plus(333, 50.0), **facts))
    clean = prepare(recording(0, SPEEDS["even"], NOISE, **facts))
    left_out = np.where(np.arange(N) < 20, np.nan, given.signal)
    left, words = without_unusable(replace(given, signal=left_out), DEPTH_M)
    assert len(words) == 1
    assert np.isnan(left.signal[0]).nonzero()[0].tolist() == [*range(20), 333]
    off = np.abs(left.signal - clean.signal)[np.isfinite(left.signal)]
    assert np.max(off) < 0.5 * NOISE


def test_samples_are_kept_where_the_facts_say_so():
    given = recording(change=lambda v: np.minimum(plus(300, 10.0)(v), 0.9), unusable="keep")
    left, words = without_unusable(given, DEPTH_M)
    assert left is given
    assert "recording.unusable=missing" in words[0]
