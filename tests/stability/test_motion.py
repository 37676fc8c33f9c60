"""Motions as hard as they get: through zero and back, at rest, very slow and fast, with gaps, from
a far origin of time, and ten million samples long."""

from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film
from srsinv.forward.filter import even_interval
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.speed_profile import ReversalProfile, RippleProfile, StandstillProfile, at_times
from srsinv.grid import Periodic
from srsinv.recording import Recording
from srsinv.recording._timing import timing
from tests.reference import closed_forms, exact
from tests.stability.matrix import PRECISIONS, Group, HardCase
from tests.tiers import rare

EPS = {precision: float(np.finfo(precision).eps) for precision in PRECISIONS}
EACH = np.array(list(EPS.values()))
OHM, NU, DEPTH_M, ANGLE_RAD = 2e6, 0.45, 7.5e-4, 0.3
D = (23e-12, 3e-12, -33e-12)
WINDOW_M, N, PRESSURE_PA = 16e-3, 256, 1e3
K = 2 * 2 * np.pi / WINDOW_M  # two waves in the window: eight points interpolate to 1e-12
SAMPLES = 33


# The signal along x(t) = x0 + u t + a sin(w t + phase) over a wave of pressure.
def signal(v):
    line = Periodic(N, WINDOW_M / N, -WINDOW_M / 2)
    sensor = Sensor([Film(DEPTH_M, ANGLE_RAD)], HalfSpace(NU), CurrentAmplifier(OHM))
    angle = v["turn_rad_per_s"] * v["time_s"] + v["phase_rad"]
    position = v["start_m"] + v["speed_m_per_s"] * v["time_s"] + v["swing_m"] * jnp.sin(angle)
    speed = v["speed_m_per_s"] + v["swing_m"] * v["turn_rad_per_s"] * jnp.cos(angle)
    wave = PRESSURE_PA * float(np.sinc(K * WINDOW_M / N / 2 / np.pi)) * jnp.cos(K * line.x)
    moved = sensor.operator_along(line, Motion(v["time_s"], position, speed))
    return moved(jnp.stack([wave, 0 * wave]))[0] / v["size_V"]


def signal_reference(v):
    """The charge at x(t), differentiated in time by mpmath's own differences."""
    stress = exact.as_float(exact.stress(K, DEPTH_M)[:, 0].tolist()).astype(complex)
    density = complex(closed_forms.charge_density(stress, ANGLE_RAD, D, NU)[0])
    film = 0.7e-3 * 8e-3 * PRESSURE_PA * OHM * mp.mpc(density)
    x0, u, a, w, phase = (
        mp.mpf(float(v[name]))
        for name in ("start_m", "speed_m_per_s", "swing_m", "turn_rad_per_s", "phase_rad")
    )

    def charge(t):
        return mp.re(film * mp.expj(K * (x0 + u * t + a * mp.sin(w * t + phase))))

    with mp.workdps(60):
        derivatives = [mp.diff(charge, mp.mpf(float(t)), h=mp.mpf(10) ** -25) for t in v["time_s"]]
    return np.array([float(each) for each in derivatives]) / v["size_V"]


def sliding(name, hard, end_s, speed, swing=0.0, turn=0.0, start=1e-4):
    fastest = abs(speed) + abs(swing * turn)
    farthest = abs(start) + abs(speed) * end_s + abs(swing)
    angle = turn * end_s + 0.5
    # Round-offs of the position and of the swing's angle, as the wave makes them felt.
    amplification = 1 + K * (farthest + abs(swing) * angle) + angle
    numbers = {
        "time_s": np.linspace(0, end_s, SAMPLES),
        "start_m": start,
        "speed_m_per_s": speed,
        "swing_m": swing,
        "turn_rad_per_s": turn,
        "phase_rad": 0.5,
        "size_V": OHM * 33e-12 * 0.7e-3 * 8e-3 * PRESSURE_PA * K * (fastest or 1.0),
    }
    return HardCase(name, hard, numbers, tuple(np.maximum(16 * EACH * amplification, 1e-12)))


# Speed profiles at given times: a standstill, a reversal, a ripple, each alone.
def paced(v):
    time, u = v["time_s"], v["speed_m_per_s"]
    stretch = v["at_s"], v["duration_s"], v["ramp_s"]
    each = (
        StandstillProfile(*stretch),
        ReversalProfile(*stretch),
        RippleProfile(v["fraction"], v["frequency_hz"], v["phase_rad"]),
    )
    return (
        jnp.stack([at_times(time, 0.0, u, (profile,)).position_m for profile in each]) / v["size_m"]
    )


def paced_reference(v):
    t = np.asarray(v["time_s"], np.longdouble)
    at, rest, ramp = (np.longdouble(v[name]) for name in ("at_s", "duration_s", "ramp_s"))

    def begun(t):  # a raised cosine's integral
        s = np.clip(t / ramp, 0, 1)
        return ramp * (s / 2 - np.sin(np.pi * s) / (2 * np.pi)) + np.maximum(t - ramp, 0)

    paused = begun(t - at) - begun(t - at - ramp - rest)
    turn = 2 * np.arccos(np.longdouble(-1)) * v["frequency_hz"]
    wave = 2 * np.cos(v["phase_rad"] + turn * t / 2) * np.sin(turn * t / 2)
    ways = [t - paused, t - 2 * paused, t + v["fraction"] * wave / turn]
    return np.array(ways, float) * v["speed_m_per_s"] / v["size_m"]


def profile(name, hard, at, rest, ramp, fraction=1.0, frequency=7.0, speed=0.05, end=1.0):
    numbers = {
        "time_s": np.linspace(0, end, SAMPLES),
        "at_s": at,
        "duration_s": rest,
        "ramp_s": ramp,
        "fraction": fraction,
        "frequency_hz": frequency,
        "phase_rad": 0.3,
        "speed_m_per_s": speed,
        "size_m": speed * end,
    }
    return HardCase(name, hard, numbers, tuple(16 * EACH))


GROUPS = (
    Group(
        "signal",
        signal,
        signal_reference,
        (
            sliding("turns", "through zero between samples, and back", 0.2, 0.0, 1e-3, 60.0),
            sliding("turns often", "faster than it is sampled", 0.2, 0.0, 1e-4, 3e3),
            sliding("ripple of one", "touches zero and goes on", 0.2, 0.06, 1e-3, 60.0),
            sliding("rests", "nothing moves", 0.2, 0.0),
            sliding("creeps", "1e-9 m/s", 0.2, 1e-9),
            sliding("flies", "1e3 m/s, two windows a sample", 1e-3, 1e3),
            sliding("trembles", "1e-12 m about a place", 0.2, 0.0, 1e-12, 60.0),
            sliding("backwards", "from far off", 0.2, -0.05, start=10.0),
        ),
        frozenset(("time_s", "size_V")),
    ),
    Group(
        "profile",
        paced,
        paced_reference,
        (
            profile("rests", "as usual", 0.3, 0.2, 0.05),
            profile("rests nearly all along", "moves a hundredth of the time", 0.005, 10.0, 0.005),
            profile("stops dead", "a ramp shorter than a sample", 0.3, 0.2, 1e-9),
            profile("no rest", "a ramp and back", 0.3, 0.0, 0.1),
            profile("rests later", "after the last sample", 5.0, 1.0, 1.0),
            profile("at once", "begins with the first sample", 0.0, 0.5, 0.2),
            profile("creeps", "1e-9 m/s", 0.3, 0.2, 0.05, speed=1e-9),
            profile("flies", "1e3 m/s", 0.3, 0.2, 0.05, speed=1e3, end=1e-3, frequency=7e3),
            profile("a slow ripple", "1e-9 Hz", 0.3, 0.2, 0.05, frequency=1e-9),
            profile("no ripple", "of fraction 0", 0.3, 0.2, 0.05, fraction=0.0),
        ),
        frozenset(("time_s", "size_m")),
    ),
)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound


SAMPLES, RATE_HZ = rare([3_000_000, 10_000_000], 10_000_000), 1e5


@pytest.mark.parametrize("samples", SAMPLES)
def test_the_position_does_not_drift_in_millions_of_samples(samples, margin):
    """In single precision a sum from sample to sample would be off by thousands of round-offs."""
    ripple = RippleProfile(1.0, 3.0, 0.3)
    with jax.enable_x64(False):
        time = jnp.asarray(np.arange(samples, dtype="float32") / np.float32(RATE_HZ))
        moved = jax.jit(lambda t: at_times(t, 0.0, 0.05, (ripple,)).position_m)(time)
        position_m, time = np.asarray(moved, float), np.asarray(time, float)
    turn = 2 * np.pi * 3.0
    exact_m = 0.05 * (time + (np.sin(turn * time + 0.3) - np.sin(0.3)) / turn)
    error, bound = np.max(np.abs(position_m - exact_m)) / exact_m[-1], 16 * EPS["float32"]
    margin(error, bound)
    assert error < bound


@pytest.mark.parametrize("samples", SAMPLES)
def test_a_recording_of_millions_of_samples_does_not_drift(samples, margin):
    time_s = np.arange(samples) / RATE_HZ
    long = Recording(np.zeros((1, samples)), time_s, np.full(samples, 0.05), ("a",))
    error, bound = abs(long.position_m[-1] / (0.05 * time_s[-1]) - 1), 16 * EPS["float64"]
    margin(error, bound)
    assert error < bound


@pytest.mark.parametrize("make", ["from_speed", "from_position"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_motion_from_a_far_origin_of_time(make, precision, margin):
    """A clock's 1e9 s hide every millisecond from single precision, but not the motion."""
    since = np.arange(513) / 512  # exact in float64 beside 1e9
    far = {
        "from_speed": partial(Motion.from_speed, speed_m_per_s=0.05 * np.cos(6 * since)),
        "from_position": partial(Motion.from_position, position_m=0.05 / 6 * np.sin(6 * since)),
    }[make]
    with jax.enable_x64(precision == "float64"):
        moved = far(1e9 + since)
        interval = float(even_interval(moved.time_s))
        position, speed = np.asarray(moved.position_m), np.asarray(moved.speed_m_per_s)
    # Cubic and quintic splines on 512 samples are off by less than 1e-9.
    bound = max(64 * EPS[precision], 1e-9)
    error = max(
        np.max(np.abs(position - 0.05 / 6 * np.sin(6 * since))) / 0.05,
        np.max(np.abs(speed - 0.05 * np.cos(6 * since))) / 0.05,
        abs(512 * interval - 1),
    )
    margin(error, bound)
    assert error < bound


@pytest.mark.parametrize("precision", PRECISIONS)
def test_times_that_a_motion_can_tell_apart_stay(precision):
    with jax.enable_x64(precision == "float64"):
        moved = Motion([2.0, 2.5, 3.0], [0.0, 1.0, 2.0], [2.0, 2.0, 2.0])
        assert np.array_equal(np.asarray(moved.time_s), [2.0, 2.5, 3.0])


@pytest.mark.parametrize("hole_s", [0.004, 0.05])
def test_the_integral_goes_over_a_gap(hole_s, margin):
    """Cubic across the hole: off by its length's fifth power times the fourth derivative / 720."""
    time = np.linspace(0, 1, 1001)
    time = time[(time <= 0.4) | (time >= 0.4 + hole_s)]
    moved = Motion.from_speed(time, 0.05 * np.cos(6 * time))
    error = np.max(np.abs(np.asarray(moved.position_m) - 0.05 / 6 * np.sin(6 * time)))
    bound = 0.05 * 6**4 * (hole_s + 2e-3) ** 5 / 100 + 1e-12
    margin(error, bound)
    assert error < bound


@pytest.mark.parametrize("origin_s", [0.0, 1e9])
def test_gaps_are_found_far_from_the_origin(origin_s):
    """To the rounding of the stamps, about a ten-thousandth of an interval at 1e9 s."""
    remaining = np.delete(np.arange(2000), np.r_[500:503, 1500])
    summary = timing(origin_s + remaining / 1e3)
    assert summary is not None
    assert [(gap.row, gap.missing) for gap in summary.gaps] == [(500, 3), (1497, 1)]
    assert summary.disorder == ()
    assert summary.rate_hz == pytest.approx(1e3, rel=1e-6)
    assert summary.jitter_largest < 1e-3


def test_stamps_that_rounding_repeats_are_refused():
    """At 1e9 s the next number is 1.2e-7 s off: samples at 20 MHz share their times."""
    time_s = 1e9 + np.arange(50) / 2e7
    summary = timing(time_s)
    assert summary is not None
    assert summary.disorder
    with pytest.raises(BadInput, match="does not come after"):
        Recording(np.zeros((1, 50)), time_s, np.full(50, 0.05), ("a",))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_repeated_positions_are_a_standstill(precision):
    """Positions that stay for nearly all of the record: no speed, and a direction that is kept."""
    time = np.linspace(0, 1, 400)
    position = np.where(time < 0.99, 1e-3, 1e-3 + (time - 0.99) ** 3)
    with jax.enable_x64(precision == "float64"):
        moved = Motion.from_position(time, position)
        speed, direction = np.asarray(moved.speed_m_per_s), np.asarray(moved.direction)
        still = Motion(time, np.full(400, 1e-3), np.zeros(400))
        nowhere = np.asarray(still.direction)
    assert np.all(np.isfinite(speed))
    assert np.max(np.abs(speed[:300])) < 1e-9 * np.max(speed)
    assert np.all(np.isin(direction, (-1.0, 1.0)))
    assert not nowhere.any()
