"""Load drift: the signal against (1 + d) Q differentiated by itself, and its gradients."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from srsinv.forward.amplifier import ChargeReadout, CurrentAmplifier
from srsinv.forward.drift import SinusoidalLoad
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.speed_profile import RippleProfile, StandstillProfile, paced
from srsinv.grid import Periodic
from tests.forward.setups import derivatives
from tests.refusals import refused

OHM = 2e6
DRIFT = SinusoidalLoad(0.3, 0.17, 0.8)
LINE = Periodic(320, 5e-5)
X = np.asarray(LINE.x)
TURN = 2 * np.pi / 16e-3
# Over a load of its own, which a rate signal does not feel unless it drifts.
P = 4e3 + 900 * np.cos(2 * TURN * X) + 500 * np.sin(5 * TURN * X)
TRACTION = jnp.asarray(np.stack([P, 0.4 * P]))
STOP = StandstillProfile(0.1, 0.05, 0.02)
MOTION_BENDS = (0.1, 0.12, 0.17, 0.19)
MOTION = paced(1e-3, 12e-3, 0.05, 4e3, [RippleProfile(0.3, 60.0), STOP])


def sensor(amplifier):
    films = [Film(0.75e-3, 0.0, effects=(StripAverage(0.7e-3, 12),)), Film(0.9e-3, 0.7)]
    return Sensor(films, HalfSpace(0.45), amplifier)


def load(time):
    """1 + d, as the class's text has it."""
    return 1 + 0.3 * np.sin(2 * np.pi * time / 0.17 + 0.8)


def slope(time, values):
    return make_interp_spline(time, np.asarray(values), 7, axis=1).derivative()(time)


@pytest.fixture(scope="module")
def along():
    """Rate and charge (e, sample) along the motion."""
    return [
        eqx.filter_jit(sensor(amplifier).operator_along)(LINE, MOTION)(TRACTION)
        for amplifier in (CurrentAmplifier(OHM), ChargeReadout(OHM))
    ]


@pytest.mark.full
def test_rate_is_the_derivative_of_the_drifting_charge(along):
    rate, charge_signal = along
    time = np.asarray(MOTION.time_s)
    expected = slope(time, load(time)[None] * np.asarray(charge_signal))
    drifted = np.asarray(DRIFT(MOTION.time_s, rate, charge_signal))
    # The spline does not follow the bends of the speed nor its own ends, and forgets them from
    # sample to sample.
    bends = np.asarray([time[0], *MOTION_BENDS, time[-1]])
    smooth = np.abs(time[:, None] - bends).min(1) > 60 / 4e3
    assert smooth.sum() > 400
    error = np.abs(drifted - expected)[:, smooth].max() / np.abs(expected).max()
    assert error < 1e-9
    assert np.abs(drifted - np.asarray(rate))[:, smooth].max() > 0.1 * np.abs(expected).max()


def test_at_rest_the_drift_alone_is_felt(along):
    """R_f d' Q of the film's charge where it rests."""
    rate, charge_signal = along
    time = np.asarray(MOTION.time_s)
    resting = (time > 0.121) & (time < 0.169)
    drifted = np.asarray(DRIFT(MOTION.time_s, rate, charge_signal))[:, resting]
    turn = 2 * np.pi / 0.17
    expected = 0.3 * turn * np.cos(turn * time[resting] + 0.8)[None]
    expected = expected * np.asarray(charge_signal)[:, resting][:, :1]
    np.testing.assert_allclose(drifted, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_at_constant_speed_a_uniform_load_is_felt_by_its_drift():
    """On the line itself: nothing but d' times the closed-form charge of a uniform pressure."""
    scan = ConstantSpeed(-0.05)
    traction = jnp.zeros((2, LINE.n)).at[0].set(4e3)
    device = sensor(CurrentAmplifier(OHM))
    rate = LINE.operator(device.output(scan))(traction)
    charge = LINE.operator(device.charge())(traction)
    time = scan.time_s(LINE)
    drifted = np.asarray(DRIFT(time, rate, OHM * charge))
    # sigma_z = sigma_x = -p, sigma_y = -2 nu p and no shear: the angle does not matter.
    q = -4e3 * 0.7e-3 * 8e-3 * (23e-12 - 33e-12 + 2 * 0.45 * 3e-12)
    turn = 2 * np.pi / 0.17
    expected = OHM * q * 0.3 * turn * np.cos(turn * np.asarray(time) + 0.8)
    np.testing.assert_allclose(drifted, np.broadcast_to(expected, drifted.shape), rtol=1e-9)


def test_a_readout_of_charge_is_scaled(along):
    time = np.asarray(MOTION.time_s)
    drifted = DRIFT(MOTION.time_s, along[1])
    np.testing.assert_allclose(drifted, load(time)[None] * np.asarray(along[1]), rtol=1e-13)


def test_no_drift_changes_nothing(along):
    still = SinusoidalLoad(0.0, 1.0, 0.3)(MOTION.time_s, *along)
    np.testing.assert_array_equal(still, along[0])


@pytest.mark.full
def test_gradients_are_those_of_differences(along):
    time, (rate, charge) = MOTION.time_s[::16], (signal[:, ::16] for signal in along)
    scale = float(jnp.max(jnp.abs(rate)))

    def total(values):
        drift = SinusoidalLoad(*values)
        return jnp.sum(jnp.sin(drift(time, rate, charge) / scale))

    all_of = jax.jit(partial(derivatives, total))
    values, steps = np.array([0.3, 0.17, 0.8]), 1e-6 * np.eye(3)
    _, forward, reverse = all_of(values)
    moved = [float(all_of(values + step)[0] - all_of(values - step)[0]) for step in steps]
    np.testing.assert_allclose(forward, np.array(moved) / 2e-6, rtol=1e-6)
    np.testing.assert_allclose(reverse, np.array(moved) / 2e-6, rtol=1e-6)


def test_single_precision(along):
    with jax.enable_x64(False):
        args = [jnp.asarray(np.asarray(a), "float32") for a in (MOTION.time_s, *along)]
        single = SinusoidalLoad(0.3, 0.17, 0.8)(*args)
    double = np.asarray(DRIFT(MOTION.time_s, *along))
    assert single.dtype == np.float32
    error = np.abs(np.asarray(single) - double).max() / np.abs(double).max()
    assert error < 64 * np.finfo(np.float32).eps


REFUSED = {
    "fraction": (lambda: SinusoidalLoad(-0.1, 1.0), "drift.fraction", "-0.1", "between 0 and 1"),
    "pull": (lambda: SinusoidalLoad(1.1, 1.0), "drift.fraction", "1.1", "between 0 and 1"),
    "period": (lambda: SinusoidalLoad(0.1, 0.0), "drift.period_s", "0.0", "positive"),
    "phase": (lambda: SinusoidalLoad(0.1, 1.0, np.inf), "drift.phase_rad", "inf", "angle"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])
