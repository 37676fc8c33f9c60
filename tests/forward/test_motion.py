"""Sliding at a measured x(t): the signal against charge differentiated in time, and its pieces.

The reference knows nothing of lines, transfers or u Q': it is the closed-form charge of the film at
x(t + j tau), differentiated by central differences of eighth order over a short time tau.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import (
    Amplifier,
    ChargeReadout,
    CurrentAmplifier,
    IntegratedCurrent,
)
from srsinv.forward.film import Film, Offset, StripAverage
from srsinv.forward.operator import PositionInterpolation
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open, Periodic, as_real
from tests.forward.setups import AMPLIFIERS, derivatives, fitted_order, full_sensor, largest_error
from tests.reference import closed_forms as cf
from tests.refusals import refused
from tests.tiers import quick

OHM, NU, MU = 2e6, 0.45, 0.6
D = (23e-12, 3e-12, -33e-12)
WINDOW = 16e-3

# Two elements: (depth, angle, width, offset), active over 8 mm.
ELEMENTS = ((0.75e-3, 0.0, 0.7e-3, 0.0), (0.9e-3, 1.3, 0.5e-3, 3e-4))
SENSOR = Sensor(
    [Film(z, angle, w, effects=(StripAverage(w), Offset(o))) for z, angle, w, o in ELEMENTS],
    HalfSpace(NU),
    CurrentAmplifier(OHM),
)

# Motions as x(t) and u(t), each over 0.2 s.

TURN = 2 * np.pi / 0.2
MOTIONS = {
    "varying_by_40_percent": (
        lambda t: -5e-3 + 0.05 * t + 0.05 * 0.4 / (2 * TURN) * np.sin(2 * TURN * t),
        lambda t: 0.05 * (1 + 0.4 * np.cos(2 * TURN * t)),
    ),
    "towards_minus_x": (
        lambda t: 5e-3 - 0.05 * t + 0.05 * 0.4 / TURN * np.sin(TURN * t),
        lambda t: -0.05 * (1 - 0.4 * np.cos(TURN * t)),
    ),
    "stopping_and_reversing": (
        lambda t: -4e-3 + 0.12 / TURN * (2 / 3 - np.cos(TURN * t) + np.cos(TURN * t) ** 3 / 3),
        lambda t: 0.12 * np.sin(TURN * t) ** 3,
    ),
}
TIME = np.linspace(0, 0.2, 1001)
GIVEN = {
    "both": lambda t, x, u: Motion(t, x, u),
    "speed": lambda t, x, u: Motion.from_speed(t, u, x[0]),
    "position": lambda t, x, u: Motion.from_position(t, x),
}


def motion(name, given="both", time=TIME):
    x, u = MOTIONS[name]
    return GIVEN[given](time, x(time), u(time))


# Tractions as (line, cell averages of p, Cauchy transform of p): exact on their line.

STRIPS = ((2e3, -20, 37), (-700.0, 55, 9))  # pressure, first cell from the middle, cells
WAVES = ((900.0, 2, 0.3), (2e3, 5, 1.0))  # pressure, periods in the window, phase


def strips(x, z, cell):
    """Uniform strips of whole cells."""
    return sum_of(
        (P, cf.cauchy_strip(x - (first + count / 2) * cell, z, count * cell))
        for P, first, count in STRIPS
    )


def cosines(x, z, _):
    k = 2 * np.pi / WINDOW
    return sum_of((P, cf.cauchy_cosine(x, z, m * k, phase)) for P, m, phase in WAVES)


def sum_of(waves):
    parts = [[P * part for part in wave] for P, wave in waves]
    return tuple(sum(each) for each in zip(*parts, strict=True))


def on_open(n):
    cell = WINDOW / n
    p = np.zeros(n)
    for P, first, count in STRIPS:
        p[n // 2 + first : n // 2 + first + count] = P
    return Open(n, cell, -WINDOW / 2 + cell / 2), p, strips


def on_periodic(n):
    # A window that begins in the middle of the motion, which then crosses its ends.
    line = Periodic(n, WINDOW / n, 1e-3)
    x, k = 1e-3 + WINDOW / n * np.arange(n), 2 * np.pi / WINDOW
    p = sum(P * np.cos(m * k * x + phase) * np.sinc(m / n) for P, m, phase in WAVES)
    return line, p, cosines


TRACTIONS = {"open": on_open(480), "periodic": on_periodic(256)}


def charge(element, x, cell, cauchy, q_per_p):
    """Charge [C] of one element standing at x, its strip's width averaged by Gauss's rule."""
    z, angle, width, offset = element
    nodes, weights = np.polynomial.legendre.leggauss(24)
    under = x[:, None] + offset + width / 2 * nodes
    stress = cf.stress(cauchy(under.ravel(), z, cell), z)
    total = stress[:, 0] + np.repeat(q_per_p, nodes.size) * stress[:, 1]
    density = cf.charge_density(total, angle, D, NU).reshape(under.shape)
    return width * 8e-3 * density @ weights / 2


def going(speed):
    """The way of each sample; every motion that starts at rest sets off towards +x."""
    return np.where(speed(TIME) < 0, -1.0, 1.0)


def reference_voltage(name, line, cauchy, mu):
    """R_f dQ/dt (element, sample), the shear at each sample as the motion is going there."""
    at, speed = MOTIONS[name]
    tau = 2e-4  # 10 um of sliding, a 75th of the depth
    stencil = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    q_per_p = mu * going(speed)

    def rate(element):
        def then(j):
            return charge(element, at(TIME + j * tau), float(line.cell_m), cauchy, q_per_p)

        return sum(c * (then(j) - then(-j)) for j, c in stencil.items()) / tau

    return OHM * np.stack([rate(element) for element in ELEMENTS])


@eqx.filter_jit
def scan_both_ways(sensor, line, moving, forward, backward):
    return sensor.operator_along(line, moving)(jnp.stack([forward, backward]))


def voltage(sensor, line, moving, p, mu):
    """Ours, for friction mu: q = mu p on the way towards +x, -mu p on the way back."""
    return scan_both_ways(sensor, line, moving, np.stack([p, mu * p]), np.stack([p, -mu * p]))


@pytest.mark.parametrize("given", GIVEN)
@pytest.mark.parametrize("name", quick(MOTIONS, *[*MOTIONS][::3]))
@pytest.mark.parametrize("kind", TRACTIONS)
def test_voltage_is_the_time_derivative_of_charge(kind, name, given):
    line, p, cauchy = TRACTIONS[kind]
    ours = voltage(SENSOR, line, motion(name, given), p, MU)
    expected = reference_voltage(name, line, cauchy, MU)
    assert largest_error(ours, expected) < 1e-6


def test_a_slow_readout_is_the_charge_where_the_sensor_stands():
    line, p, cauchy = TRACTIONS["open"]
    name = "stopping_and_reversing"
    sensor = Sensor(SENSOR.elements, SENSOR.skin, ChargeReadout(1e9, 0.1))
    at, speed = MOTIONS[name]
    q_per_p, cell = MU * going(speed), float(line.cell_m)
    expected = [charge(element, at(TIME), cell, cauchy, q_per_p) for element in ELEMENTS]
    ours = voltage(sensor, line, motion(name), p, MU)
    assert largest_error(ours, 1e9 * np.stack(expected)) < 1e-6


# Against the signal at constant speed.


@eqx.filter_jit
def steady_and_scanned(line, sensor, moving, r, speed):
    return sensor.operator(line, ConstantSpeed(speed))(r), sensor.operator_along(line, moving)(r)


@pytest.mark.full
@pytest.mark.parametrize("speed", [0.05, -0.03])
@pytest.mark.parametrize("kind", TRACTIONS)
@pytest.mark.parametrize("amplifier", ["current", "slow"])
def test_at_constant_speed_and_the_samples_it_is_the_signal_of_the_line(kind, speed, amplifier):
    line, p, _ = TRACTIONS[kind]
    moving = Motion(np.arange(line.n), line.x, np.full(line.n, speed))
    sensor, r = full_sensor(AMPLIFIERS[amplifier]), np.stack([p, 0.3 * p])
    steady, ours = steady_and_scanned(line, sensor, moving, r, np.asarray(speed))
    assert largest_error(ours, steady) < 1e-12


@pytest.mark.full
@pytest.mark.parametrize("make", [on_open, on_periodic])
def test_between_the_samples_it_converges_to_it_at_eighth_order(make):
    """The signal between the samples is that of an element moved by part of a cell."""

    @eqx.filter_jit
    def both(line):
        shift = 0.37 * line.cell_m
        p = jnp.exp(8 * jnp.cos(2 * np.pi * (np.arange(line.n) + 0.5) / line.n - np.pi) - 8)
        r, speed = jnp.stack([p, 0.3 * p]), np.full(line.n - 1, 0.05)
        still, moved = (Sensor([Film(0.75e-3, 0.5, effects=(Offset(o),))]) for o in (0.0, shift))
        moving = Motion(np.arange(line.n - 1), line.x[:-1] + shift, speed)
        exact = moved.operator(line, ConstantSpeed(0.05))(r)[:, :-1]
        return still.operator_along(line, moving)(r), exact

    cells = np.array([96, 120, 150])
    errors = [largest_error(*both(make(int(n))[0])) for n in cells]
    assert 7.5 < fitted_order(1 / cells, errors) < 9


# The sampling.


@eqx.filter_jit
def sampled(line, at, signal):
    return PositionInterpolation(line, at)(signal)


@pytest.mark.parametrize(
    ("kind", "low", "high"), [(Open, 0.0, 1.0), (Periodic, -0.7, 2.3)], ids=["open", "periodic"]
)
def test_order_of_the_sampling(kind, low, high):
    cells, errors = np.array([56, 80, 112]), []
    at = np.linspace(low, high, 501)
    for n in cells:
        # The open line's samples reach from 0 to 1, the periodic one's window is 1.
        line = kind(int(n), 1 / (n - 1) if kind is Open else 1 / n)
        signal = np.exp(np.cos(2 * np.pi * np.asarray(line.x) + 0.2))[None]
        exact = np.exp(np.cos(2 * np.pi * at + 0.2))[None]
        errors.append(largest_error(sampled(line, at, signal), exact))
    assert 7.5 < fitted_order(1 / cells, errors) < 9
    assert errors[-1] < 1e-9


@pytest.mark.parametrize("n", [3, 7])
@pytest.mark.parametrize("kind", [Open, Periodic])
def test_a_short_line_is_sampled_by_all_it_has(kind, n):
    """A polynomial of degree n - 1 through n samples is exact for one."""
    line = kind(n, 1.0)
    at = np.linspace(n // 2 - 0.5, n // 2 + 0.5, 9)
    power = n - 1 if kind is Open else 0
    values = sampled(line, at, np.arange(float(n))[None] ** power)
    np.testing.assert_allclose(values[0], at**power, rtol=1e-12)


OUTSIDE = {
    "ahead": (np.array([0.0, 1e-3, 3.2e-3]), "0.0002 m", "at 0.003 m"),
    "behind": (np.array([1e-3, -0.5e-3, 0.0]), "0.0005 m", "at 0 m"),
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_positions_beyond_an_open_line_are_refused(name):
    at, *words = OUTSIDE[name]
    refused(lambda: PositionInterpolation(Open(4, 1e-3), at), *words)
    assert PositionInterpolation(Periodic(4, 1e-3), at)


# Linear algebra and gradients.


@pytest.mark.parametrize("kind", TRACTIONS)
def test_adjoint_identity(kind):
    line = TRACTIONS[kind][0]
    draw = np.random.default_rng(5).normal
    forward, backward = jnp.asarray(draw(size=(2, 2, line.n)))
    y = jnp.asarray(draw(size=(2, TIME.size)))

    @eqx.filter_jit
    def solve(line):
        scanned = SENSOR.operator_along(line, motion("stopping_and_reversing"))
        signals = scanned(forward), scanned(jnp.stack([forward, backward]))
        return *signals, scanned.adjoint(y), scanned.adjoint(y, each_way=True)

    one, both, adjoint, (ahead, back) = solve(line)
    scale = np.linalg.norm(both) * np.linalg.norm(y)
    assert abs(jnp.vdot(y, one) - jnp.vdot(adjoint, forward)) < 1e-12 * scale
    pair = jnp.vdot(ahead, forward) + jnp.vdot(back, backward)
    assert abs(jnp.vdot(y, both) - pair) < 1e-12 * scale
    assert float(jnp.abs(back).max()) > 0
    np.testing.assert_allclose(adjoint, ahead + back, rtol=0, atol=1e-12 * np.abs(adjoint).max())


@pytest.mark.full
@pytest.mark.parametrize("kind", [Open, Periodic])
def test_gradients_in_position_and_speed(kind):
    """Forward and in reverse, of a number made from the voltage, in a batch of motions, against
    differences of it.

    The second position is a sample of the line, where the slope jumps by the sampling's error (here
    2e-6 of it); the second motion has a standstill.
    """
    line = kind(64, 4e-5, -1e-3)
    draw = np.random.default_rng(6).normal
    forward, weights = jnp.asarray(draw(size=(2, 64))), draw(size=(1, 6))
    sensor, time = Sensor([Film(0.75e-3, 0.5)]), np.arange(6)
    x = jnp.asarray([-0.99e-3, -0.2e-3, 0.3e-3, 0.31e-3, -0.7e-3, 1.5e-3])
    u = jnp.asarray([0.05, 0.01, -0.02, 0.03, 0.04, -0.05])

    def number(theta):
        moving = Motion(time, x + 1e-4 * theta[:6], u * (1 + theta[6:]))
        v = sensor.operator_along(line, moving)(jnp.stack([forward, -0.5 * forward]))
        return jnp.sum(jnp.sin(1e5 * v) * weights)

    step, origin = 1e-3, np.zeros(12)
    moved = (step * reach * np.eye(12) for reach in (-2, -1, 1, 2))
    values = np.asarray(jax.jit(jax.vmap(number))(np.concatenate([*moved])))
    difference = np.array([1, -8, 8, -1]) @ values.reshape(4, 12) / (12 * step)
    standstill = np.where(np.arange(12) == 7, -1.0, 0.0)

    every = jax.jit(jax.vmap(partial(derivatives, number)))(np.stack([origin, standstill]))
    for gradient, still in map(np.asarray, every[1:]):
        np.testing.assert_allclose(gradient, difference, rtol=1e-5)
        assert np.all(np.isfinite(still))
        assert still[1] == 0.0


# What the physics says.


def test_a_standstill_is_exactly_silent():
    line, p, _ = TRACTIONS["open"]
    speed = np.concatenate([np.zeros(50), np.linspace(0, 0.05, 201), np.zeros(50), [-0.02] * 700])
    speed[270] = -0.0
    signal = np.asarray(voltage(SENSOR, line, Motion.from_speed(TIME, speed), p, MU))
    still = speed == 0
    assert not np.any(signal[:, still])
    assert np.all(signal[:, ~still])


@pytest.mark.parametrize(("amplifier", "sign"), [(CurrentAmplifier(OHM), -1), (ChargeReadout(), 1)])
def test_time_reversed(amplifier, sign):
    """Without friction the way back gives the same charges, and minus the voltages; with friction
    it does not."""
    line, p, _ = TRACTIONS["open"]
    sensor = Sensor(SENSOR.elements, SENSOR.skin, amplifier)
    forward = motion("varying_by_40_percent")
    back = Motion(TIME, forward.position_m[::-1], -forward.speed_m_per_s[::-1])
    free, rubbing = (
        [voltage(sensor, line, way, p, mu) for way in (forward, back)] for mu in (0.0, MU)
    )
    assert largest_error(sign * free[1][:, ::-1], free[0]) < 1e-13
    assert largest_error(sign * rubbing[1][:, ::-1], rubbing[0]) > 0.1


def test_one_traction_costs_one_convolution():
    line, p, _ = TRACTIONS["open"]
    scanned = eqx.filter_jit(SENSOR.operator_along)(line, motion("stopping_and_reversing"))
    r = jnp.stack([p, MU * p])
    solve = jax.jit(lambda traction: scanned(traction))
    lowered = (solve.lower(given) for given in (r, jnp.stack([r, r])))
    programs = [each.compile().as_text() for each in lowered]
    assert [program.count(" fft(") for program in programs] == [2, 4]


DIRECTIONS = {
    "kept_through_standstill": ([0.1, 0, 0, -0.1, 0], [1, 1, 1, -1, -1], True),
    "of_the_first_motion_ahead_of_it": ([0, 0, -0.1, 0, 0.1], [-1, -1, -1, -1, 1], True),
    "one_way": ([0.0, 0.1, 0, 0.2, 0], [1, 1, 1, 1, 1], False),
    "never": ([0.0, 0, 0, 0, 0], [0, 0, 0, 0, 0], False),
}


@pytest.mark.parametrize("name", DIRECTIONS)
def test_direction(name):
    speed, expected, reverses = DIRECTIONS[name]
    moving = Motion.from_speed(np.arange(len(speed)), speed)
    np.testing.assert_array_equal(moving.direction, expected)
    assert (len(moving.directions) > 1) is reverses


# Motions from one column.


@pytest.mark.parametrize(
    ("given", "least", "column"),
    [("speed", 3.7, "position_m"), ("position", 4.7, "speed_m_per_s")],
)
def test_order_of_the_integral_and_of_the_derivative(given, least, column):
    """At unevenly spaced times, from an origin far away."""
    samples, errors = np.array([160, 256, 400]), []
    for n in samples:
        s = np.linspace(0, 1, n)
        time = 0.2 * (s + 0.1 * np.sin(3 * s))
        exact = motion("stopping_and_reversing", "both", time)
        x, u = exact.position_m, exact.speed_m_per_s
        derived = GIVEN[given](time + 64.0, np.asarray(x), np.asarray(u))
        errors.append(largest_error(getattr(derived, column), getattr(exact, column)))
    assert fitted_order(1 / samples, errors) > least


def test_a_number_is_a_constant_speed():
    moving = Motion.from_speed([1.0, 1.5, 3.0], -0.02, start_m=4e-3)
    np.testing.assert_allclose(moving.position_m, [4e-3, -6e-3, -36e-3], rtol=1e-14)
    np.testing.assert_array_equal(moving.speed_m_per_s, [-0.02] * 3)


T = [0.0, 1.0, 2.0, 3.0]
REFUSED = {
    "lengths": (lambda: Motion(T, T, T[:3]), "speed_m_per_s", "(3,)", "(4,)", "each sample"),
    "speed_lengths": (lambda: Motion.from_speed(T, T[1:]), "speed_m_per_s", "(3,)", "(4,)"),
    "position_lengths": (lambda: Motion.from_position(T, T[1:]), "position_m", "(3,)", "(4,)"),
    "table": (lambda: Motion([T], [T], [T]), "time_s", "(1, 4)", "(sample,)"),
    "few": (lambda: Motion.from_position(T[:2], T[:2]), "2 samples", "at least 3"),
    "position_nan": (lambda: Motion(T, [0, 1, np.nan, 2], T), "position_m", "nan at sample 3"),
    "speed_inf": (lambda: Motion.from_speed(T, [0, np.inf, 1, 1]), "speed_m_per_s", "inf", "2"),
    "time_nan": (lambda: Motion([0, 1, 2, np.nan], T, T), "time_s", "nan at sample 4"),
    "time_back": (lambda: Motion([0, 2, 1, 3], T, T), "time_s", "sample 3 (1 s)", "increase"),
    "time_stuck": (lambda: Motion.from_position([0, 1, 1, 3], T), "time_s", "sample 3", "drop"),
    "start": (lambda: Motion.from_speed(T, T, np.nan), "start_m", "nan", "finite"),
    "integrated": (
        lambda: Sensor([Film()], amplifier=IntegratedCurrent()).operator_along(
            Periodic(8, 1.0), Motion(T, T, T)
        ),
        "amplifier=integrated",
        "4 samples",
        "amplifier=current",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])


@pytest.mark.full
@pytest.mark.parametrize("make", [on_open, on_periodic])
def test_single_precision(make):
    p = make(480)[1]
    x, u = (f(TIME) for f in MOTIONS["stopping_and_reversing"])

    def run():
        @jax.jit
        def all_of_it():
            line = make(480)[0]
            film = Film(0.75e-3, 1.3, effects=(StripAverage(0.7e-3), Offset(3e-4)))
            scanned = Sensor([film]).operator_along(line, Motion(TIME, x, u))
            r = as_real(np.stack([p, MU * p]))
            signal = scanned(jnp.stack([r, 0.5 * r]))
            return signal, scanned.adjoint(signal)

        return jax.device_get(all_of_it())

    double = run()
    with jax.enable_x64(False):
        single = run()
    for narrow, wide in zip(single, double, strict=True):
        assert narrow.dtype == np.float32
        assert largest_error(narrow, wide) < 128 * np.finfo(np.float32).eps


class OneGain(Amplifier):
    """A charge readout whose gain is one number for all speeds."""

    order, unit, offset = 0, "V", 0.0

    def gain(self, speed_m_per_s):
        return -2e9


@pytest.mark.full
def test_one_gain_serves_all_speeds():
    motion = Motion.from_speed(np.arange(20) / 100, np.linspace(0.01, 0.05, 20), -5e-3)
    line = Open(64, 2e-4, -6.4e-3)
    traction = jnp.asarray(np.random.default_rng(0).normal(size=(2, 64)))
    solve = eqx.filter_jit(lambda sensor, r: sensor.operator_along(line, motion)(r))
    own, known = (
        solve(Sensor([Film()], amplifier=amplifier), traction)
        for amplifier in (OneGain(), ChargeReadout(-2e9, 0.0))
    )
    np.testing.assert_array_equal(own, known)
