"""Hum that nobody named, and textures that pass as often as mains turn."""

import numpy as np
import pytest

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.recorded import problem_of
from srsinv.recording import Recording

RATE_HZ, COUNT = 2000.0, 4000
TIME_S = np.arange(COUNT) / RATE_HZ
UNNAMED, AMBIGUOUS, EITHER = "Hum was found", "may be a texture", "may be hum or a texture"


def problem(hum=0.0, speed=0.02, frequency_Hz=50.0, varying=0.0, seed=0, noise=0.01, **facts):
    """A bump and a step that are passed at this speed, noise, and a wave of `hum` of the signal's
    rms beside them."""
    moved = speed * (1 + varying * np.sin(2 * np.pi * 1.3 * TIME_S))
    x = np.cumsum(moved) / RATE_HZ
    middle, depth = x[-1] / 2, 0.75e-3
    bump = -2 * (x - middle) / depth * np.exp(-(((x - middle) / depth) ** 2))
    step = np.exp(-(((x - 0.7 * x[-1]) / depth) ** 2))
    clean = (bump + step)[None]
    clean = 1e-3 * clean / np.std(clean)
    phase = 2 * np.pi * frequency_Hz * TIME_S
    rng = np.random.default_rng(seed)
    noisy = clean + noise * 1e-3 * rng.normal(size=clean.shape)
    signal = noisy + 1e-3 * hum * np.sqrt(2) * np.sin(phase + 0.3)
    film = Film(depth).with_strip_average()
    sensor = Sensor([film], HalfSpace(0.5, 7e5), CurrentAmplifier(1e6))
    recording = Recording(signal, TIME_S, moved, ("a",), facts, name="scan")
    return problem_of(recording, sensor, friction=0.5)


def says(problem, words):
    return any(words in each for each in problem.warnings)


@pytest.mark.parametrize("frequency_Hz", [50.0, 60.07])
def test_unnamed_hum_is_estimated_and_named_with_its_setting(frequency_Hz):
    found = problem(0.05, frequency_Hz=frequency_Hz)
    (line,) = found.mains
    assert abs(line.frequency_Hz - frequency_Hz) < 0.2
    (warning,) = (each for each in found.warnings if UNNAMED in each)
    assert f"recording.mains_Hz=[{frequency_Hz:.0f}]" in warning


def test_hum_may_be_said_not_to_be_there():
    none = problem(0.05, mains_Hz=[])
    assert not none.mains
    assert not says(none, UNNAMED)


def test_named_hum_says_nothing():
    assert not says(problem(0.05, mains_Hz=[50.0]), UNNAMED)
    assert not says(problem(0.05, mains_Hz=[50.0]), AMBIGUOUS)


# Speed [m/s] and how much it varies, of scans without hum.
SOUND = [(speed, varying) for speed in (0.005, 0.02, 0.05, 0.15) for varying in (0.0, 0.2)]


@pytest.mark.parametrize("noise", [1e-4, 0.01, 0.3])
def test_scans_without_hum_have_none(noise):
    for seed, (speed, varying) in enumerate(SOUND):
        assert not says(problem(0.0, speed, varying=varying, seed=seed, noise=noise), "mains")


def test_a_texture_that_passes_at_the_frequency_of_mains_is_no_unnamed_hum():
    assert not says(problem(1.0, speed=0.1), UNNAMED)


@pytest.mark.parametrize(("frequency_Hz", "is_either"), [(50.2, True), (48.0, False)])
def test_a_line_where_mains_are_may_be_hum_though_the_skin_passes_it_on(frequency_Hz, is_either):
    """As inversions would take it for traction; where mains are not it is a texture."""
    unnamed = problem(1.0, speed=0.1, frequency_Hz=frequency_Hz)
    assert says(unnamed, EITHER) == is_either
    assert says(unnamed, "recording.mains_Hz=[50]") == is_either


@pytest.mark.parametrize("named", ["auto", [50.0]])
def test_a_line_that_may_be_a_texture_is_said(named):
    assert says(problem(1.0, speed=0.1, mains_Hz=named), AMBIGUOUS)
    assert not says(problem(1.0, speed=0.02, mains_Hz=named), AMBIGUOUS)


def test_a_varying_speed_tells_hum_from_texture():
    """A texture's line is as wide as the speed varies."""
    assert not says(problem(1.0, speed=0.1, varying=0.2, mains_Hz=[50.0]), AMBIGUOUS)
