"""Speed profiles: the motion against closed forms, its end, and what is refused."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from srsinv.forward.film import Film
from srsinv.forward.sensor import Sensor
from srsinv.forward.speed_profile import (
    ReversalProfile,
    RippleProfile,
    StandstillProfile,
    at_times,
    paced,
)
from srsinv.grid import Open
from tests.refusals import refused

SPEED, LENGTH, START = 0.05, 0.02, -3e-3
STOP = StandstillProfile(0.1, 0.05, 0.013)
BACK = ReversalProfile(0.1213, 0.07, 0.0111)
RIPPLE = RippleProfile(0.4, 130.0, 1.0)


def way(motion, start=START):
    return np.asarray(motion.position_m) - start


@pytest.mark.parametrize("rate", [2000.0, 277.7])
@pytest.mark.parametrize("speed", [SPEED, -SPEED])
def test_ripple_has_its_closed_form(speed, rate):
    motion = paced(START, LENGTH, speed, rate, [RIPPLE])
    time, turn = np.asarray(motion.time_s), 2 * np.pi * 130.0
    start = START if speed > 0 else START + LENGTH
    expected = speed * (time + 0.4 / turn * (np.sin(turn * time + 1) - np.sin(1)))
    np.testing.assert_allclose(way(motion, start), expected, rtol=0, atol=1e-14)
    expected = speed * (1 + 0.4 * np.cos(turn * time + 1))
    np.testing.assert_allclose(motion.speed_m_per_s, expected, rtol=1e-13)


def test_samples_are_even_and_start_at_the_start():
    motion = paced(START, LENGTH, SPEED, 1234.5, [STOP])
    time = np.asarray(motion.time_s)
    np.testing.assert_allclose(time, np.arange(time.size) / 1234.5, rtol=1e-14)
    assert motion.position_m[0] == START


# Fast and slow sampling: a ramp of 13 ms has many samples, or falls between two of them.
@pytest.mark.parametrize("rate", [5000.0, 170.0, 40.0])
def test_standstill_costs_its_time_and_one_ramp(rate):
    """Two ramps cost half of their time each."""
    motion = paced(START, LENGTH, SPEED, rate, [STOP])
    time = np.asarray(motion.time_s)
    before, after = time <= 0.1, time >= 0.1 + 0.05 + 2 * 0.013
    np.testing.assert_allclose(way(motion)[before], SPEED * time[before], rtol=0, atol=1e-15)
    expected = SPEED * (time[after] - 0.05 - 0.013)
    np.testing.assert_allclose(way(motion)[after], expected, rtol=0, atol=1e-15)


def test_standstill_rests():
    motion = paced(START, LENGTH, SPEED, 5000.0, [STOP])
    time = np.asarray(motion.time_s)
    resting = (time > 0.1131) & (time < 0.1629)
    assert resting.sum() > 200
    np.testing.assert_array_equal(np.asarray(motion.speed_m_per_s)[resting], 0.0)
    np.testing.assert_allclose(way(motion)[resting], SPEED * (0.1 + 0.013 / 2), atol=1e-15)


def test_ramps_are_raised_cosines():
    motion = paced(START, LENGTH, SPEED, 50e3, [BACK])
    time = np.asarray(motion.time_s)
    turning = (time > 0.1213) & (time < 0.1213 + 0.0111)
    expected = SPEED * np.cos(np.pi * (time[turning] - 0.1213) / 0.0111)
    speeds = np.asarray(motion.speed_m_per_s)[turning]
    np.testing.assert_allclose(speeds, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("rate", [5000.0, 170.0])
@pytest.mark.parametrize("speed", [SPEED, -SPEED])
def test_reversal_returns_its_way(speed, rate):
    """Its ramps lead as far forward as back."""
    motion = paced(START, LENGTH, speed, rate, [BACK])
    time = np.asarray(motion.time_s)
    start = START if speed > 0 else START + LENGTH
    after = time >= 0.1213 + 0.07 + 2 * 0.0111
    expected = speed * (time[after] - 2 * 0.0111 - 2 * 0.07)
    np.testing.assert_allclose(way(motion, start)[after], expected, rtol=0, atol=1e-15)
    back = (time > 0.1213 + 0.0111) & (time < 0.1213 + 0.0111 + 0.07)
    np.testing.assert_allclose(np.asarray(motion.speed_m_per_s)[back], -speed, rtol=1e-14)
    assert motion.directions == (True, False)


def test_paces_multiply():
    """Against adaptive quadrature of the product, as the classes' texts have it."""
    motion = paced(START, LENGTH, SPEED, 400.0, [RIPPLE, STOP, BACK])

    def step(time, at, ramp, duration):
        up = np.clip((time - at) / ramp, 0, 1)
        down = np.clip((time - at - ramp - duration) / ramp, 0, 1)
        return (np.cos(np.pi * down) - np.cos(np.pi * up)) / 2

    def factor(time):
        ripple = 1 + 0.4 * np.cos(2 * np.pi * 130 * time + 1)
        stop, back = step(time, 0.1, 0.013, 0.05), step(time, 0.1213, 0.0111, 0.07)
        return ripple * (1 - stop) * (1 - 2 * back)

    time, position = np.asarray(motion.time_s), np.asarray(motion.position_m)
    steps = [quad(factor, a, b, epsabs=1e-13, limit=200)[0] for a, b in pairwise(time)]
    expected = START + SPEED * np.concatenate([[0.0], np.cumsum(steps)])
    np.testing.assert_allclose(position, expected, rtol=0, atol=1e-12)


PACES = {
    "constant": [],
    "ripple": [RippleProfile(1.0, 40.0, 2.0)],
    "rest_before_the_end": [StandstillProfile(0.39, 0.2, 0.02)],
    "back_after_arrival": [ReversalProfile(0.5, 0.2, 0.01)],
    "back_to_before_the_start": [ReversalProfile(0.01, 0.3, 0.01)],
    "slow_start": [RippleProfile(1.0, 0.3, 3.0)],
}


@pytest.mark.parametrize("speed", [SPEED, -SPEED])
@pytest.mark.parametrize("name", PACES)
def test_ends_where_it_has_arrived_for_good(name, speed):
    """With the first sample beyond the end: a longer motion never comes back from there."""
    motion = paced(START, LENGTH, speed, 1000.0, PACES[name])
    left = LENGTH - np.abs(way(motion, START if speed > 0 else START + LENGTH))
    assert left[-2] > 0
    assert -2 * SPEED / 1000 < left[-1] <= 1e-12 * LENGTH
    longer = np.asarray(paced(START, 2 * LENGTH, speed, 1000.0, PACES[name]).position_m)
    count = left.size
    np.testing.assert_allclose(longer[:count], motion.position_m + (speed < 0) * LENGTH, atol=1e-15)
    assert np.all(np.sign(speed) * np.diff(longer[count - 1 :]) >= 0)


def test_constant_speed_takes_its_time():
    motion = paced(0.0, 0.1, 0.05, 1000.0)
    assert motion.time_s.size == 2001
    assert float(motion.position_m[-1]) == pytest.approx(0.1, abs=1e-15)


# Gradients: of a motion at given times, whose positions are those of the one that is counted out.

THETA = np.array([0.4, 130.0, 1.0, 0.1, 0.05, 0.013, 0.2, 0.06, 0.0111, SPEED])


def paces_of(theta):
    return [RippleProfile(*theta[:3]), StandstillProfile(*theta[3:6]), ReversalProfile(*theta[6:9])]


@pytest.mark.full
def test_gradients_of_the_motion():
    """In all numbers of three profiles and the speed, against differences of numpy's motion."""
    first = paced(START, LENGTH, SPEED, 700.0, paces_of(THETA))
    time = np.asarray(first.time_s)
    weights = np.random.default_rng(4).normal(size=(2, time.size)) / [[SPEED], [50 * SPEED]]

    def numbers(motion, count):
        return [weights[0, :count] @ motion.position_m[:count],
                weights[1, :count] @ motion.speed_m_per_s[:count]]  # fmt: skip

    def traced(theta):
        motion = at_times(jnp.asarray(time), START, theta[9], paces_of(theta))
        return jnp.stack(numbers(motion, time.size)), motion.position_m

    @jax.jit
    def both_ways(theta):
        _, push, position = jax.linearize(traced, theta, has_aux=True)
        pull = jax.linear_transpose(push, theta)
        return position, jax.vmap(push)(jnp.eye(10)).T, jax.vmap(pull)(jnp.eye(2))[0]

    position, forward, reverse = both_ways(THETA)
    np.testing.assert_allclose(position, first.position_m, rtol=0, atol=1e-15)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9 * np.abs(forward).max())

    def apart(theta):
        motion = paced(START, 1.5 * LENGTH, theta[9], 700.0, paces_of(theta))
        return np.array(numbers(motion, time.size))

    steps = np.diag(1e-6 * THETA)
    expected = [(apart(THETA + step) - apart(THETA - step)) / 2e-6 for step in steps]
    scale = 1e-6 * np.abs(expected).max()
    np.testing.assert_allclose(
        np.asarray(forward) * THETA, np.transpose(expected), rtol=1e-6, atol=scale
    )


@pytest.mark.full
def test_times_may_begin_later():
    late = jnp.asarray([0.13, 0.19, 0.3])

    @jax.jit
    def places(late):
        times = jnp.concatenate([jnp.zeros(1), late]), late
        return [at_times(time, START, SPEED, [STOP, BACK]).position_m for time in times]

    whole, moved = map(np.asarray, places(late))
    np.testing.assert_allclose(moved, whole[1:], rtol=0, atol=1e-9)
    refused(lambda: at_times(late - 0.2, START, SPEED), "begins at -0.07", "from 0")


def test_gradient_of_a_signal_in_the_ripple():
    """Through a sensor's signal at the positions and speeds of the motion."""
    sensor, line = Sensor([Film()]), Open(64, 3e-4, -3e-3)
    r = jnp.asarray(np.random.default_rng(5).normal(size=(2, 64)))
    time = jnp.arange(80) / 300.0

    @jax.jit
    def signal(fraction):
        return sensor.operator_along(
            line, at_times(time, 0.0, SPEED, [RippleProfile(fraction, 20.0)])
        )(r)

    derivative = jax.jit(jax.jacfwd(signal))(0.3)
    expected = (signal(0.3 + 1e-5) - signal(0.3 - 1e-5)) / 2e-5
    assert np.abs(derivative - expected).max() < 1e-7 * np.abs(expected).max()


def test_single_precision():
    double = paced(START, LENGTH, SPEED, 1000.0, [RIPPLE, STOP])
    with jax.enable_x64(False):
        single = paced(START, LENGTH, SPEED, 1000.0, [RIPPLE, STOP])
    assert single.position_m.dtype == single.speed_m_per_s.dtype == np.float32
    np.testing.assert_array_equal(single.position_m, np.float32(double.position_m))


REFUSED = {
    "fraction": (lambda: RippleProfile(1.5, 10.0), "ripple.fraction", "1.5", "between 0 and 1"),
    "frequency": (lambda: RippleProfile(0.5, 0.0), "frequency_hz", "0.0", "positive"),
    "phase": (lambda: RippleProfile(0.5, 1.0, np.nan), "phase_rad", "nan", "angle"),
    "early": (lambda: StandstillProfile(-1.0, 1.0, 0.1), "standstill.at_s", "-1.0", "at least 0"),
    "duration": (
        lambda: ReversalProfile(1.0, -0.5, 0.1),
        "reversal.duration_s",
        "-0.5",
        "at least 0",
    ),
    "ramp": (lambda: ReversalProfile(1.0, 0.5, 0), "reversal.ramp_s", "0", "positive"),
    "start": (lambda: paced(np.inf, 1.0, 1.0, 10.0), "start_m", "inf", "finite"),
    "length": (lambda: paced(0.0, -0.1, 1.0, 10.0), "length_m", "-0.1", "positive"),
    "rate": (lambda: paced(0.0, 0.1, 1.0, 0.0), "rate_hz", "0.0", "positive"),
    "rest": (lambda: paced(0.0, 0.1, 0.0, 10.0), "speed_m_per_s", "0.0", "other than 0"),
    "coarse": (lambda: paced(0.0, 0.1, 0.1, 260.0, [RIPPLE]), "rate_hz", "260.0", "130.0"),
    "too_many": (
        lambda: paced(0.0, 1.0, 1e-4, 1e3),
        "4194304 samples",
        "has not reached its end",
        "lower",
    ),
    "too_late": (
        lambda: paced(0.0, 0.1, 0.1, 1e3, [StandstillProfile(1e5, 1, 1)]),
        "profiles",
        "4194 s",
    ),
    "too_few": (lambda: paced(0.0, 0.1, 1.0, 10.0), "2 samples", "rate_hz", "at least 3"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])
