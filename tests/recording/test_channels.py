"""Faults that a channel's samples show by themselves, and sound channels that they are not found
in."""

import numpy as np
import pytest

from srsinv import false_alarm
from srsinv.recording.channels import channel_findings

N, NOISE = 1000, 0.01
PULSE = np.exp(-(((np.arange(N) - 500) / 60) ** 2))


def sound(seed=0, step=0.0):
    """A pulse in white noise, in steps where they are given."""
    signal = PULSE + NOISE * np.random.default_rng(seed).normal(size=N)
    return step * np.round(signal / step) if step else signal


def held(signal, start, stop):
    """The value at `start` over and over."""
    return np.where((np.arange(N) > start) & (np.arange(N) < stop), signal[start], signal)


def findings(signal):
    """What is found of one channel."""
    return channel_findings(["ch"], signal[None], "V")


FAULTS = {
    "stuck": (held(sound(), 100, 108), "is stuck: 8 samples, from number 101"),
    "stuck in steps": (held(sound(step=NOISE), 100, 150), "is stuck: 5"),
    "clipped": (np.minimum(sound(), 0.8), "is clipped"),
    "rounded": (sound(step=5 * NOISE), "of its samples are equal to the one before, in steps of"),
    "stored four times": (np.repeat(sound()[::4], 4), "of its samples are equal to the one before"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found(name):
    signal, words = FAULTS[name]
    assert words in findings(signal)[0]


@pytest.mark.parametrize("step", [0.0, 0.1 * NOISE, NOISE, 1.5 * NOISE])
def test_a_sound_channel_is_hardly_ever_warned_of(step):
    """Of as many as the stated probability makes one of in ten."""
    draws = round(0.1 / false_alarm.CHANNEL)
    assert not any(findings(sound(seed, step)) for seed in range(draws))


def test_samples_that_are_missing_are_no_fault():
    signal = sound()
    signal[100:300] = np.nan
    assert findings(signal) == ()
    assert findings(np.full(N, np.nan)) == ()
