"""Filters in time: against closed forms and scipy, along the line and along a motion."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.signal
import scipy.special

from srsinv.forward.amplifier import ChargeReadout
from srsinv.forward.film import Film, Offset
from srsinv.forward.filter import Butterworth, FirstOrder
from srsinv.forward.operator import PositionInterpolation
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, Periodic, as_real
from tests.forward.setups import derivatives, fitted_order, largest_error
from tests.refusals import refused
from tests.tiers import quick

DEPTH = 0.75e-3
FILTERS = {
    "first_order": FirstOrder(2e-3),
    **{f"butterworth_{order}": Butterworth(80.0, order) for order in range(1, 9)},
}
FEW = ("first_order", "butterworth_3", "butterworth_8")


def scipys(name) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator in s T."""
    if name == "first_order":
        return np.ones(1), np.array([1.0, 1.0])
    return scipy.signal.butter(FILTERS[name].order, 1.0, analog=True)


def scale_of(name) -> float:
    """T, written out."""
    return 2e-3 if name == "first_order" else 1 / (2 * np.pi * 80.0)


# The response.


@pytest.mark.parametrize("name", FILTERS)
def test_response(name):
    turn = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 25), -np.geomspace(1e-3, 1e3, 25)])
    response = np.asarray(FILTERS[name].response(jnp.asarray(turn / scale_of(name))))
    b, a = scipys(name)
    assert response[0] == 1
    np.testing.assert_allclose(response, scipy.signal.freqs(b, a, turn)[1], rtol=1e-12)
    power = 1 / (1 + turn ** (2 * a.size - 2))
    np.testing.assert_allclose(np.abs(response) ** 2, power, rtol=1e-12)


# Along the line.


@eqx.filter_jit
def spread(lag, x):
    """What the lag makes of 1/(1 + (x/depth)^2), x in depths."""
    return lag.spread(lambda at: 1 / (1 + (at / DEPTH)[None] ** 2))(x * DEPTH)[0]


def along(filter, speed):
    return filter.along(as_real(speed), as_real(DEPTH))


def lagged_pole(x, ratio):
    """Integral of e^-s Im 1/(x - ratio s - i): by its asymptotic series, or E1 (DLMF 6.2)."""
    if ratio <= 1e-2:
        n = np.arange(12)
        terms = ratio**n * scipy.special.factorial(n) / (x[:, None] - 1j) ** (n + 1)
        return terms.sum(axis=1).imag
    a = (x - 1j) / ratio
    return (-np.exp(-a) * scipy.special.exp1(-a) / ratio).imag


@pytest.mark.parametrize("ratio", [1e-6, 1e-3, 1e-2, 0.1, 0.7, 1.0, 5.0, 30.0])
def test_first_order_along_the_line(ratio):
    """The kernel's mean over what was met before, for u tau of so many depths; from behind for a
    speed towards -x."""
    x = np.linspace(-6, 40, 47)
    filter = FirstOrder(ratio * DEPTH / 0.05)
    expected = lagged_pole(x, ratio)
    assert largest_error(spread(along(filter, 0.05), x), expected) < 1e-12
    assert largest_error(spread(along(filter, -0.05), -x), expected) < 1e-12


@pytest.mark.parametrize("ratio", quick([1e-3, 0.02, 0.6, 4.0], 0.02, 4.0))
@pytest.mark.parametrize("name", ["butterworth_2", "butterworth_5", "butterworth_8"])
def test_butterworth_along_the_line(name, ratio):
    """Against scipy's state-space impulse response, integrated adaptively."""
    x = np.linspace(-3, 12, 11)
    a, b, c, _ = scipy.signal.tf2ss(*scipys(name))
    values, vectors = np.linalg.eig(a)
    weights = (c @ vectors)[0] * np.linalg.solve(vectors, b.astype(complex))[:, 0]

    def integrand(s):
        return np.real(np.exp(values * s) @ weights) / (1 + (x - ratio * s) ** 2)

    end = 34 / -values.real.max()
    points = np.arange(0, end, 2.0)
    expected = scipy.integrate.quad_vec(integrand, 0, end, epsabs=1e-13, points=points)[0]
    lag = along(FILTERS[name], ratio * DEPTH / scale_of(name))
    assert largest_error(spread(lag, x), expected) < 1e-12


def test_without_delay_nothing_happens():
    x = np.linspace(-2, 3, 7)
    filter, signal = FirstOrder(0.0), np.random.default_rng(2).normal(size=(2, 9))
    assert largest_error(spread(along(filter, 0.05), x), 1 / (1 + x**2)) < 1e-13
    assert not np.any(np.asarray(filter.response(jnp.asarray([0.0, 1e5]))) != 1)
    np.testing.assert_array_equal(filter.in_time(jnp.asarray(signal), as_real(1e-3)), signal)


def test_a_high_cutoff_delays_by_its_time_alone():
    """H = 1 - i omega T sum of -1/P to first order, so that the kernel is moved by so much."""
    x = np.linspace(-2, 3, 7)
    filter = Butterworth(1e5, 4)
    moved = 0.05 / (2 * np.pi * 1e5) * 2 * (np.sin(np.pi / 8) + np.sin(3 * np.pi / 8)) / DEPTH
    assert largest_error(spread(along(filter, 0.05), x), 1 / (1 + (x - moved) ** 2)) < 1e-7


@pytest.mark.full
@pytest.mark.parametrize("speed", [0.05, -0.03])
def test_the_open_lines_kernel_has_the_transfer_for_its_spectrum(speed):
    """Kernels sampled eight times a depth, over a window so long that what wraps around, 1/x^3 of a
    rate from p and 1/x^2 from q, is nothing."""
    n, step = 16384, DEPTH / 8
    elements = [Film(DEPTH, 0.4), Film(1.2 * DEPTH, 1.3)]
    filters = (FirstOrder(1e-3), Butterworth(60.0, 3))

    @eqx.filter_jit
    def both(stage):
        x = step * (jnp.arange(n) - n // 2)
        kernel = jnp.roll(stage.cell_response(x, as_real(2e-4)), -(n // 2), axis=-1)
        k = 2 * jnp.pi * jnp.arange(n // 2 + 1) / (n * step)
        averaged = stage.transfer(k) * (2e-4 * jnp.sinc(k * 1e-4 / jnp.pi))[None, None]
        return kernel, jnp.fft.irfft(averaged, n) / step

    stage = Sensor(elements, filters=filters[:1]).output(ConstantSpeed(speed))
    cell_response, expected = both(stage)
    assert largest_error(cell_response[:, 0], expected[:, 0]) < 1e-8
    assert largest_error(cell_response[:, 1], expected[:, 1]) < 1e-5
    k = jnp.asarray([300.0])

    @jax.jit
    def transfers():
        stages = (
            Sensor(elements, filters=each).output(ConstantSpeed(speed))
            for each in (filters[:1], filters)
        )
        return *(stage.transfer(k) for stage in stages), filters[1].response(k * speed)

    one, two, factor = map(np.asarray, transfers())
    np.testing.assert_allclose(two, one * factor[None, None], rtol=1e-13)


def test_charge_and_current_are_those_before_the_filters():
    r, scan = jnp.ones((2, 16)).at[:, 8:].set(0.0), ConstantSpeed(0.05)
    line = Open(16, 1e-4)
    unfiltered, slow = Sensor([Film()]), Sensor([Film()], filters=[FirstOrder(1e-2)])
    for stage in ("charge", "current"):
        given = () if stage == "charge" else (scan,)
        same = (line.operator(getattr(sensor, stage)(*given))(r) for sensor in (unfiltered, slow))
        np.testing.assert_array_equal(*same)
    assert largest_error(*(s.operator(line, scan)(r) for s in (slow, unfiltered))) > 0.1


def test_beyond_what_the_nodes_hold_the_kernel_is_nan():
    """Traced, they are for a quarter of one."""
    x, speeds = np.linspace(-2, 3, 7), jnp.asarray([0.2, 0.25, 0.27, -0.3]) * DEPTH / 2e-3

    @jax.jit
    def lagged(speed):
        return spread(FirstOrder(2e-3).along(speed, as_real(DEPTH)), x)

    kernels = np.stack([lagged(speed) for speed in speeds])
    for row, ratio in zip(kernels, (0.2, 0.25), strict=False):
        assert largest_error(row, lagged_pole(x, ratio)) < 1e-12
    assert np.all(np.isnan(kernels[2:]))


# Along a motion.


@pytest.mark.parametrize("ratio", [0.0, 1e-9, 1e-5, 1e-3, 0.3, 3.0, 1e3, 1e6])
def test_a_ramp_from_rest_is_exact(ratio):
    """tau of so many intervals, the ramp beginning at the third sample."""
    interval, start = 1e-4, 3
    tau = ratio * interval
    since = np.clip(np.arange(400) - start, 0, None) * interval
    u = since / tau if tau else np.full(400, np.inf)
    series = since * u / 2 * (1 - u / 3 * (1 - u / 4 * (1 - u / 5))) if ratio > 1e5 else None
    expected = since + tau * np.expm1(-u) if series is None else series
    expected = np.where(since > 0, expected, 0.0)
    filtered = FirstOrder(tau).in_time(jnp.asarray([since, 2 * since]), as_real(interval))
    assert np.abs(filtered[0] - expected).max() < 1e-13 * since.max()
    np.testing.assert_array_equal(filtered[1], 2 * filtered[0])


@pytest.mark.parametrize("per_interval", [0.05, 1.0, 40.0])
@pytest.mark.parametrize("name", FEW)
def test_in_time_against_scipy(name, per_interval):
    """scipy's lsim, which takes a signal as linear between samples too, from rest."""
    signal = np.random.default_rng(1).normal(size=300)
    signal[0] = 0.0
    interval = per_interval * scale_of(name)
    filtered = FILTERS[name].in_time(jnp.asarray(signal)[None], as_real(interval))
    time = per_interval * np.arange(signal.size)
    expected = scipy.signal.lsim(scipys(name), signal, time)[1]
    assert np.abs(filtered[0] - expected).max() < 1e-11 * np.abs(signal).max()


@pytest.mark.parametrize("name", FEW)
def test_a_constant_stays(name):
    signal = jnp.full((1, 50), 3.7)
    np.testing.assert_array_equal(FILTERS[name].in_time(signal, as_real(1e-5)), signal)


@pytest.mark.full
@pytest.mark.parametrize("speed", [0.05, -0.05])
def test_along_a_steady_motion_it_becomes_that_of_constant_speed(speed):
    """At second order in the sampling interval, once the beginning is forgotten."""
    line = Periodic(96, 16e-3 / 96)
    x = np.asarray(line.x)
    p = sum(np.cos(2 * np.pi * m * x / 16e-3 + m) for m in (1, 3, 6))
    traction = jnp.stack([jnp.asarray(p), 0.3 * jnp.asarray(p)])
    filters = (FirstOrder(3e-3), Butterworth(150.0, 3))
    sensor = Sensor([Film(), Film(angle_rad=1.3, effects=[Offset(2e-4)])], filters=filters)
    steady = sensor.operator(line, ConstantSpeed(speed))(traction)

    @eqx.filter_jit
    def both(moving):
        expected = PositionInterpolation(line, moving.position_m)(steady)
        return sensor.operator_along(line, moving)(traction), expected

    samples, errors = np.array([301, 601]), []
    for n in samples:
        time = np.linspace(0, 0.64, n)
        signal, expected = both(Motion(time, speed * time, np.full(n, speed)))
        errors.append(largest_error(signal[:, n // 2 :], expected[:, n // 2 :]))
    assert 1.9 < fitted_order(1 / samples, errors) < 2.1


TIME_24 = 1e-3 * np.arange(24)
MOVING = Motion.from_speed(1e-3 * np.arange(40), 0.05 * np.cos(0.08 * np.arange(40)))
SENSOR = Sensor([Film(), Film(angle_rad=1.3)], filters=[FirstOrder(4e-3), Butterworth(90.0, 3)])


@pytest.mark.parametrize("name", FEW)
def test_adjoint_of_a_filter(name):
    s, y = jnp.asarray(np.random.default_rng(3).normal(size=(2, 2, 60)))
    interval = as_real(7e-4)
    forward = jnp.vdot(y, FILTERS[name].in_time(s, interval))
    back = jnp.vdot(FILTERS[name].in_time_adjoint(y, interval), s)
    assert abs(forward - back) < 1e-13 * 60


@pytest.mark.full
def test_adjoint_along_a_motion():
    line = Open(80, 1e-4, -2e-3)
    draw = np.random.default_rng(5).normal
    forward, backward = jnp.asarray(draw(size=(2, 2, line.n)))
    y = jnp.asarray(draw(size=(2, 40)))

    @eqx.filter_jit
    def solve(line):
        scanned = SENSOR.operator_along(line, MOVING)
        signals = scanned(forward), scanned(jnp.stack([forward, backward]))
        return *signals, scanned.adjoint(y), scanned.adjoint(y, each_way=True)

    one, both, adjoint, (ahead, back) = solve(line)
    scale = np.linalg.norm(both) * np.linalg.norm(y)
    assert abs(jnp.vdot(y, one) - jnp.vdot(adjoint, forward)) < 1e-12 * scale
    pair = jnp.vdot(ahead, forward) + jnp.vdot(back, backward)
    assert abs(jnp.vdot(y, both) - pair) < 1e-12 * scale
    assert np.any(MOVING.direction < 0)


def test_what_lies_beyond_the_line_is_filtered_too():
    """A strip beyond the end, as part of the line and as beyond a shorter one; its shear turns
    with the motion, ahead of the filters."""
    whole, part = Open(100, 1e-4, -2e-3), Open(70, 1e-4, -2e-3)
    nothing = jnp.zeros((2, 2, 70))

    @eqx.filter_jit
    def both():
        strip = jnp.zeros((2, 100)).at[:, 70:].set(jnp.asarray([[1.0], [0.4]]))
        expected = SENSOR.operator_along(whole, MOVING)(
            jnp.stack([strip, strip * jnp.asarray([[1.0], [-1.0]])])
        )
        end = jnp.asarray([[1.0, 0.4], [1.0, -0.4]])
        return SENSOR.operator_along(part, MOVING, 30e-4)(nothing, end), expected

    # The line is sampled by polynomials of eighth order, of cells of a seventh of the depth.
    assert largest_error(*both()) < 1e-5


# Gradients.


@pytest.mark.full
@pytest.mark.parametrize("kind", [Open, Periodic])
def test_gradients(kind):
    """In time constant, cutoff, depth and speed, of numbers from the signal at constant speed, for
    each filter alone, and from that along a motion, for both."""
    line = kind(24, 2.5e-4, -3e-3)
    draw = np.random.default_rng(6).normal
    r, weights = jnp.asarray(draw(size=(2, 24))), jnp.asarray(draw(size=(1, 24)))

    def numbers(theta):
        filters = (FirstOrder(3e-3 * theta[0]), Butterworth(90.0 * theta[1], 2))
        scan = ConstantSpeed(0.05 * theta[2])
        moving = Motion(
            TIME_24, scan.speed_m_per_s * TIME_24 - 2.01e-3, jnp.full(24, 0.05) * theta[2]
        )

        def sensor(*given):
            return Sensor([Film(DEPTH * theta[3], 0.5)], filters=given)

        steady = [sensor(each).operator(line, scan)(r) for each in filters]
        signals = (*steady, sensor(*filters).operator_along(line, moving)(r))
        return 1e5 * jnp.stack([jnp.sum(signal * weights) for signal in signals])

    all_of = jax.jit(partial(derivatives, numbers))
    step = 2e-3
    at = np.ones(4) + step * np.asarray([-2.0, -1, 1, 2])[:, None, None] * np.eye(4)
    by_reach = np.stack([[all_of(theta)[0] for theta in each] for each in at])
    difference = np.tensordot([1, -8, 8, -1], by_reach, 1).T / (12 * step)
    for jacobian in map(np.asarray, all_of(np.ones(4))[1:]):
        error = np.abs(jacobian - difference).max(axis=1)
        assert np.all(error < 1e-7 * np.abs(difference).max(axis=1)), jacobian - difference
    unmoved = np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]], dtype=bool)
    largest = np.abs(difference).max(axis=1)[:, None]
    np.testing.assert_array_equal(np.abs(difference) < 1e-2 * largest, unmoved)


@pytest.mark.full
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_gradient_where_there_is_no_delay_yet(mode):
    """In time the signal's slope, taken negative; along the line that of the kernel."""
    signal = jnp.asarray(np.random.default_rng(7).normal(size=(1, 20)))
    x = jnp.linspace(-2, 3, 7)

    @jax.jit
    def at_nothing(tau):
        timed = mode(lambda t: FirstOrder(t).in_time(signal, as_real(1e-3)))(tau)
        lag = mode(lambda t: spread(along(FirstOrder(t), 0.05), x))(tau)
        return timed, lag

    timed, lag = at_nothing(0.0)
    assert largest_error(timed[:, 1:], -jnp.diff(signal) / 1e-3) < 1e-14
    assert largest_error(lag, 2 * x / (1 + x**2) ** 2 * 0.05 / DEPTH) < 1e-11


# Precision and refusals.


@pytest.mark.full
def test_single_precision():
    step = np.where(np.arange(64) < 30, 1.0, 0.0) * np.ones((2, 1))

    @eqx.filter_jit
    def solve(line, sensor, moving, r):
        scanned = sensor.operator_along(line, moving)
        steady = sensor.operator(line, ConstantSpeed(0.1))(r)
        return steady, scanned(r), scanned.adjoint(scanned(r))

    def run():
        films = (Film(), Film(angle_rad=1.3))
        sensor = Sensor(
            films, amplifier=ChargeReadout(1e9), filters=[FirstOrder(3e-4), Butterworth(2e3, 3)]
        )
        moving = Motion(1e-3 * np.arange(40), 1e-4 * np.arange(40) - 2e-3, np.full(40, 0.1))
        return jax.device_get(solve(Open(64, 1e-4, -3e-3), sensor, moving, as_real(step)))

    double = run()
    with jax.enable_x64(False):
        single = run()
    for narrow, wide in zip(single, double, strict=True):
        assert (narrow.dtype.name, wide.dtype.name) == ("float32", "float64")
        assert largest_error(narrow, wide) < 64 * np.finfo(np.float32).eps


def _uneven():
    time = 1e-3 * np.arange(40)
    time[7] += 2e-6
    moving = Motion(time, np.linspace(0, 1e-3, 40), np.full(40, 0.02))
    return SENSOR.operator_along(Open(64, 1e-4), moving)


REFUSED = {
    "time_constant": (lambda: FirstOrder(-1e-3), "time_constant_s", "-0.001", "at least 0"),
    "cutoff": (lambda: Butterworth(0.0), "cutoff_hz", "0.0", "positive"),
    "endless_cutoff": (lambda: Butterworth(np.inf), "cutoff_hz", "inf", "positive"),
    "no_order": (lambda: Butterworth(100.0, 0), "order", "0", "1 to 8"),
    "high_order": (lambda: Butterworth(100.0, 9), "order", "9", "1 to 8"),
    "half_order": (lambda: Butterworth(100.0, 2.5), "order", "2.5", "1 to 8"),
    "uneven": (_uneven, "scan.time_s", "0.001002", "sample 7", "resample", "leave"),
    "too_slow": (
        lambda: Open(8, 1e-4).operator(
            Sensor([Film()], filters=[FirstOrder(10.0)]).output(ConstantSpeed(0.05))
        ),
        "1024",
        "grid.line=periodic",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])


def test_a_periodic_line_takes_the_slowest_filter():
    line, sensor = Periodic(8, 1e-4), Sensor([Film()], filters=[FirstOrder(10.0)])
    r = jnp.asarray(np.random.default_rng(1).normal(size=(2, 8)))
    assert np.all(np.isfinite(sensor.operator(line, ConstantSpeed(0.05))(r)))
