"""The skin acceleration sensor: against the damped oscillator, event by event, on every line."""

from functools import partial
from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.signal
import scipy.special

from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin_accelerometer import SkinAccelerometer, envelope_transform
from srsinv.forward.snap_back import SnapBackNoise, sum_over_events
from srsinv.forward.vibration import lock_in
from srsinv.grid import Open, Periodic, as_real
from tests.forward.setups import derivatives, largest_error
from tests.refusals import refused
from tests.tiers import hardest

MASS, STIFFNESS, CONTACT, ACROSS = 0.8e-3, 1.3e3, 7e-3, 6e-3
TURN = float(np.sqrt(STIFFNESS / MASS))
SCAN = ConstantSpeed(0.05)
DAMPINGS = [0.01, 0.2, 1.0, 1.0 + 1e-9, 3.0]


def accelerometer(damping_ratio=0.2, axis="tangential", mass_kg=MASS):
    return SkinAccelerometer(mass_kg, STIFFNESS, damping_ratio, axis, CONTACT, ACROSS)


def closed_response(frequency_hz, damping_ratio):
    omega = 2 * np.pi * np.asarray(frequency_hz)
    damping = 2 * damping_ratio * np.sqrt(STIFFNESS * MASS)
    return -(omega**2) / (STIFFNESS - MASS * omega**2 + 1j * omega * damping)


# In time.


SINES = list(product([10.0, 60.0, 203.0, 800.0, 2000.0], [0.1, 0.2, 1.0, 3.0]))
HARD = [(203.0, 3.0), (800.0, 1.0), (2000.0, 0.1)]


@pytest.mark.parametrize(
    ("frequency_hz", "damping_ratio"), hardest(SINES, [(10.0, 0.2), (203.0, 0.2)], HARD)
)
def test_driven_by_sines_it_has_the_oscillators_transfer(frequency_hz, damping_ratio):
    """Sampled so finely that straight lines are the sine: what they add at the sampling rate is
    accelerated by 1/m, a slow sine by w^2/k."""
    step = 1e-3 / max(2 * np.pi * frequency_hz, TURN)
    until = 30 / (TURN * min(damping_ratio, 1 / (2 * damping_ratio))) + 2 / frequency_hz
    time = step * np.arange(int(until / step))
    own = accelerometer(damping_ratio)
    signal = own.in_time(jnp.sin(2 * np.pi * frequency_hz * time)[None], as_real(step))
    last = time > until - 2 / frequency_hz
    measured = lock_in(np.asarray(signal)[:, last], time[last], frequency_hz)
    expected = closed_response(frequency_hz, damping_ratio)
    assert abs(measured[0] / expected - 1) < 1e-6
    response = own.response(as_real([2 * np.pi * frequency_hz]))
    np.testing.assert_allclose(np.asarray(response)[0], expected, rtol=1e-12)


@pytest.mark.parametrize("damping_ratio", hardest(DAMPINGS, [1.0 + 1e-9], [0.2, 3.0]))
def test_straight_forces_are_exact_at_any_sampling(damping_ratio):
    """Against scipy's first-order hold, whose state begins at rest under the first force."""
    c = 2 * damping_ratio * np.sqrt(STIFFNESS * MASS)
    system = (
        np.array([[0, 1], [-STIFFNESS / MASS, -c / MASS]]),
        np.array([[0], [1 / MASS]]),
        np.array([[-STIFFNESS / MASS, -c / MASS]]),
        np.array([[1 / MASS]]),
    )
    force = np.random.default_rng(3).normal(size=40)
    for step in (2e-5, 1e-3, 5e-3):
        time = step * np.arange(force.size)
        _, expected, _ = scipy.signal.lsim(system, force, time, X0=[force[0] / STIFFNESS, 0])
        ours = accelerometer(damping_ratio).in_time(jnp.asarray(force)[None], as_real(step))
        assert largest_error(ours[0], expected) < 1e-10


@pytest.mark.parametrize("damping_ratio", hardest(DAMPINGS, [1.0 + 1e-9], [0.2, 3.0]))
def test_a_step_loses_half_of_its_work_to_damping(damping_ratio):
    """The ramp's acceleration is the step's velocity: c integral of v^2 = F^2/(2 k)."""
    own = accelerometer(damping_ratio)
    slowest = TURN * (damping_ratio if damping_ratio < 1 else 1 / (2 * damping_ratio))
    time = np.linspace(0, 25 / slowest, 400_001)
    velocity = np.asarray(own.ramp_response(jnp.asarray(time)))
    lost = scipy.integrate.simpson(velocity**2, x=time)
    lost *= 2 * damping_ratio * np.sqrt(STIFFNESS * MASS)
    assert abs(lost * 2 * STIFFNESS - 1) < 1e-6
    acceleration = np.asarray(own.step_response(jnp.asarray(time)))
    assert abs(acceleration[0] * MASS - 1) < 1e-12
    assert abs(scipy.integrate.simpson(acceleration, x=time)) < 1e-9 * velocity.max()


@pytest.mark.parametrize("damping_ratio", hardest(DAMPINGS, [1.0], []))
def test_derivatives_are_finite_and_right(damping_ratio):
    """Forward and in reverse, of signals of both kinds, by mass, stiffness and damping."""
    force = jnp.asarray(np.random.default_rng(5).normal(size=(1, 12)))
    k = jnp.asarray([0.0, 300.0, 3e4])

    def signal(log_parts):
        mass, stiffness, damping = jnp.exp(log_parts)
        own = SkinAccelerometer(mass, stiffness, damping, "normal", CONTACT, ACROSS)
        along = own.output(SCAN).transfer(k)[0, 0]
        return jnp.concatenate([own.in_time(force, as_real(1e-3))[0], along.real, along.imag])

    at = jnp.log(jnp.asarray([MASS, STIFFNESS, damping_ratio]))
    _, forward, back = derivatives(signal, at)
    step = 1e-5 * np.eye(3)
    wanted = np.stack([(signal(at + e) - signal(at - e)) / 2e-5 for e in step], axis=-1)
    assert largest_error(np.asarray(forward).T, wanted.T) < 1e-7
    np.testing.assert_allclose(forward, back, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())


def test_a_resting_force_gives_no_signal():
    signal = accelerometer().in_time(jnp.full((1, 9), 3.0), as_real(1e-3))
    np.testing.assert_array_equal(signal, 0.0)


# Along the line.


def test_the_envelopes_transform_is_bessels():
    ka = np.concatenate([[0.0], np.geomspace(1e-6, 2e3, 200), [24.999999, 25.0, 25.000001]])
    k = ka / (CONTACT / 2)
    ours = np.asarray(envelope_transform(jnp.asarray(k), as_real(CONTACT)))
    bessel = np.where(ka > 0, scipy.special.j1(ka) / np.where(ka > 0, ka, 1), 0.5)
    np.testing.assert_allclose(ours, np.pi * CONTACT / 2 * bessel, rtol=1e-10, atol=1e-16)
    slope = jax.grad(lambda k: envelope_transform(k, as_real(CONTACT)).sum())(jnp.asarray(k))
    expected = -np.pi * CONTACT**2 / 4 * scipy.special.jv(2, ka) / np.where(ka > 0, ka, 1)
    np.testing.assert_allclose(slope, expected, rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize("axis", ["normal", "tangential"])
def test_a_uniform_traction_is_the_envelopes_area(axis):
    """The whole of a half ellipse, pi a/2, times the length across, from one component alone."""
    force = accelerometer(axis=axis).force()
    area = np.pi * CONTACT / 4 * ACROSS
    expected = area * (np.array([1, 0]) if axis == "normal" else np.array([0, 1]))
    ours = force.cell_response(jnp.asarray([1e-3]), as_real(0.1))[0, :, 0]
    np.testing.assert_allclose(ours, expected, rtol=1e-12)
    ours = force.transfer(jnp.asarray([0.0]))[0, :, 0]
    np.testing.assert_allclose(ours, expected, rtol=1e-12)


PASSES = list(product([0.05, -0.02, 0.4], [0.05, 0.2, 1.0, 3.0]))


@pytest.mark.parametrize(
    ("speed", "damping_ratio"), hardest(PASSES, [(0.05, 0.2)], [(-0.02, 0.05)])
)
def test_the_open_lines_kernel_is_that_of_the_passing_force(speed, damping_ratio):
    """Against the force of a cell that passes, sampled finely in time."""
    own, cell = accelerometer(damping_ratio), as_real(3e-4)
    step = 5e-7  # of square roots that are sampled at their ends
    x = np.sign(speed) * (np.arange(36_000) * step - 5e-3)
    force = own.force().cell_response(jnp.asarray(x), cell)[0, 1:]
    expected = own.in_time(force, as_real(step / abs(speed)))[0, ::1000]
    ours = own.output(ConstantSpeed(speed)).cell_response(jnp.asarray(x[::1000]), cell)[0]
    assert largest_error(ours[1], expected) < 2e-4
    np.testing.assert_array_equal(ours[0], 0.0)


@pytest.mark.full
def test_open_and_periodic_lines_agree():
    """On a smooth load that is nothing near the ends, to the second order in the cell."""

    def error(times):
        n, cell = 400 * times, 1e-4 / times
        x = cell * (np.arange(n) + 0.5)
        load = np.exp(-(((x - 0.012) / 1.5e-3) ** 2)) * np.cos(x / 2e-4)
        r = jnp.asarray(np.stack([0 * x, load]))
        periodic, straight = Periodic(n, cell), Open(n, cell)
        around, open_ended = (accelerometer().operator(line, SCAN)(r)
                              for line in (periodic, straight))  # fmt: skip
        return largest_error(open_ended, around)

    assert error(4) < 0.01
    assert error(1) / error(4) > 10


def test_a_static_touch_gives_no_signal():
    own, rest = accelerometer(), ConstantSpeed(0.0)
    for line in (Periodic(32, 1e-4), Open(32, 1e-4)):
        np.testing.assert_array_equal(own.operator(line, rest)(jnp.ones((2, 32))), 0.0)


# Along a motion.


@pytest.mark.claim
def test_an_even_motion_is_the_constant_speed():
    """Once what the first samples left has decayed, and to the second order in the sampling."""
    line = Periodic(512, 5e-5)
    own = accelerometer()
    r = jnp.stack([jnp.zeros(512), jnp.cos(2 * jnp.pi * 9 * jnp.arange(512) / 512)])
    expected = own.operator(line, SCAN)(r)[0]

    def error(times):
        time = np.arange(512 * times) * 1e-3 / times
        motion = Motion.from_speed(time, 0.05)
        signal = own.operator_along(line, motion)(r)[0, ::times]
        return largest_error(signal[200:], expected[200:])

    assert error(8) < 3e-3
    assert error(2) / error(8) > 12


def test_the_adjoint_is_the_transpose():
    random = np.random.default_rng(7)
    time = np.arange(60) * 1e-3
    motion = Motion.from_position(time, 1e-3 + 8e-4 * np.sin(50 * time))
    for line in (Periodic(40, 1e-4), Open(40, 1e-4)):
        for operator in (
            accelerometer().operator_along(line, motion),
            accelerometer().operator(line, SCAN),
        ):
            r = jnp.asarray(random.normal(size=(2, 40)))
            signal = operator(r)
            y = jnp.asarray(random.normal(size=signal.shape))
            ours, theirs = jnp.vdot(y, signal), jnp.vdot(operator.adjoint(y), r)
            size = jnp.linalg.norm(y) * jnp.linalg.norm(signal)
            assert abs(ours - theirs) < 1e-12 * size


# Events.

LINE, DT, NODES = Periodic(256, 1e-4), 2e-3, 40


def snap_back(decay_s=5e-3, rate_hz=40.0):
    return SnapBackNoise.recorded_by(Sensor(), rate_hz, 1e3, 1.2e-3, decay_s, 9e-3)


def mean_before(own, bursts, time_s):
    """Mean of an event's acceleration over the interval before each of these times."""
    at, weights = np.polynomial.legendre.leggauss(NODES)
    start = np.maximum(time_s - DT, 0.0)
    half = np.maximum(time_s - start, 0.0) / 2
    places = start[:, None] + half[:, None] * (1 + at)
    each = own.event(bursts, jnp.asarray(places.ravel()))
    return half / DT * (np.asarray(each).reshape(places.shape) @ weights)


@eqx.filter_jit
def _events(own, bursts, key, scan):
    return own.events(bursts, key, LINE, scan)


DECAYS = list(product([1e-4, 5e-3, 2e-2], [0.05, 0.2, 1.0, 3.0]))


@pytest.mark.parametrize(
    ("decay_s", "damping_ratio"), hardest(DECAYS, [(5e-3, 0.2)], [(1e-4, 0.05), (2e-2, 3.0)])
)
def test_events_add_up(decay_s, damping_ratio):
    """The samples are the sum of every event's closed response, as the film's key draws them."""
    bursts, key = snap_back(decay_s), jax.random.key(4)
    own = accelerometer(damping_ratio)
    drawn = np.asarray(_events(own, bursts, key, SCAN))[0]
    # Amplitude, and amplitude times age, of at most one event for each sample.
    expected_count = as_real(40.0 * 256 * DT)
    size, age = sum_over_events(
        key, expected_count, 256, 2, lambda _, age: jnp.stack([jnp.ones_like(age), age])
    )
    at = np.flatnonzero(size)
    assert 5 < at.size < 60
    total = np.zeros(256)
    for i in at:
        since = (np.arange(3 * 256) - i + float(age[i] / size[i])) * DT
        total += float(size[i]) * mean_before(own, bursts, since).reshape(3, 256).sum(axis=0)
    assert largest_error(drawn, total) < 1e-8
    back = _events(own, bursts, key, ConstantSpeed(-0.05))
    np.testing.assert_allclose(np.asarray(back)[0, ::-1], drawn, rtol=1e-12, atol=1e-14)


@pytest.mark.full
def test_an_event_is_a_step_that_relaxes():
    """At first all of the force accelerates the mass; a slow one is the step's response."""
    own, bursts = accelerometer(), snap_back(1e5)
    time = jnp.asarray([-1e-3, 0.0, 1e-4, 2e-3])
    step = np.asarray(own.step_response(time))
    expected = 1e3 * 1.2e-3 * ACROSS * np.where(time < 0, 0.0, step)
    np.testing.assert_allclose(own.event(bursts, time), expected, rtol=1e-6)
    np.testing.assert_array_equal(accelerometer(axis="normal").event(bursts, time), 0.0)


@pytest.mark.claim
def test_event_spectrum_is_campbells():
    own, bursts = accelerometer(), snap_back()
    ages = (np.arange(60) + 0.5) / 60
    times = DT * (np.arange(256)[None] + ages[:, None])
    each = mean_before(own, bursts, times.ravel()).reshape(times.shape)
    expected = 40.0 * DT * np.mean(np.abs(np.fft.rfft(each)) ** 2, axis=0)
    ours = own.event_spectrum(bursts, LINE, SCAN)
    np.testing.assert_allclose(ours, expected, rtol=2e-3, atol=1e-6 * expected.max())


# Noise, and what cannot be.


def test_noise_is_its_density_over_half_the_rate():
    rms = float(accelerometer().noise_rms_m_per_s2(2000.0))
    assert abs(rms - 0.5e-3 * 9.80665 * np.sqrt(1000.0)) < 1e-12


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"mass_kg": 0.0}, ["mass_kg is 0.0"]),
        ({"stiffness_N_per_m": -1.0}, ["stiffness_N_per_m is -1.0"]),
        ({"damping_ratio": None}, ["damping_ratio is null"]),
        ({"contact_m": "wide"}, ["contact_m is 'wide'"]),
        ({"length_m": 0}, ["length_m is 0"]),
        ({"axis": "x"}, ["axis is 'x'", "normal, tangential"]),
        ({"noise_density_m_per_s2_per_rtHz": -1e-3}, ["at least 0"]),
    ],
)
def test_refusals(given, words):
    refused(partial(SkinAccelerometer, **given), *words)


def test_an_open_line_refuses_an_endless_ring():
    own = SkinAccelerometer(damping_ratio=1e-6)
    refused(partial(own.operator, Open(16, 1e-4), ConstantSpeed(1e-4)), "rings", "damping")


@eqx.filter_jit
def _traced(own, r):
    return own.operator(Open(64, 1e-4), SCAN)(r)


@pytest.mark.claim
def test_traced_sensors_have_the_same_signal():
    r = jnp.asarray(np.random.default_rng(2).normal(size=(2, 64)))
    expected = accelerometer().operator(Open(64, 1e-4), SCAN)(r)
    assert largest_error(_traced(accelerometer(), r), expected) < 1e-10
