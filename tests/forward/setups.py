"""Sensors, lines and fitted orders that several test files share."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from srsinv.forward.amplifier import ChargeReadout, CurrentAmplifier, IntegratedCurrent
from srsinv.forward.contact import Contact, press
from srsinv.forward.envelope import FingerprintRidges, HertzPatch
from srsinv.forward.film import Film, Offset, Piezo, SampleAverage, StripAverage
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open, Periodic

SCAN = ConstantSpeed(0.05)
AMPLIFIERS = {
    "current": CurrentAmplifier(1e6),
    "integrated": IntegratedCurrent(1e6),
    "slow": ChargeReadout(2e9, 0.1),
}
LINES = {
    "periodic_even": Periodic(64, 1e-4, -3.15e-3),
    "periodic_odd": Periodic(63, 1e-4, -3.1e-3),
    "open_even": Open(64, 1e-4, -3.15e-3),
    "open_odd": Open(63, 1e-4, -3.1e-3),
}


@eqx.filter_jit
def apply(line, stage, r):
    """The stage's signals under the traction r (2, n)."""
    return line.operator(stage)(r)


_pressed = eqx.filter_jit(press)


def solve_contact(line, skin, height, nominal) -> Contact:
    """`press`, compiled once for all loads on lines of one length, with arrays of numpy."""
    return jax.device_get(_pressed(line, skin, height, jnp.asarray(nominal)))


@eqx.filter_jit
def _height(shape, line):
    return shape.height(line)


def height_of(shape, line) -> np.ndarray:
    """The shape's height [m] at the cells (n,), compiled once for all of its kind."""
    return np.asarray(_height(shape, line))


def derivatives(function, at):
    """The function's value at a point (m,), and its derivatives (..., m) forward and in reverse;
    the function is traced once for all of them."""
    value, push = jax.linearize(function, at)
    pull = jax.linear_transpose(push, at)
    forward = jax.vmap(push, out_axes=-1)(jnp.eye(at.size))
    each = jnp.eye(value.size).reshape(-1, *value.shape)
    return value, forward, jax.vmap(pull)(each)[0].reshape(forward.shape)


def full_sensor(amplifier=None) -> Sensor:
    """Three elements, no two alike, with every effect along the line."""
    return Sensor(
        [
            Film(0.75e-3, 0.0, effects=(StripAverage(0.7e-3), Offset(0.3e-3))),
            Film(0.9e-3, np.pi / 2, effects=(SampleAverage(3, 4e-5), StripAverage(0.5e-3))),
            Film(0.6e-3, 0.5, 0.5e-3, 6e-3, Piezo(20e-12, 2e-12, -30e-12), (Offset(-2e-4),), 2),
        ],
        HalfSpace(0.45),
        amplifier,
    )


def zoned_sensor() -> Sensor:
    """An element beside the middle of a zone with ridges."""
    ridges = FingerprintRidges(0.4, 0.5e-3, 0.3)
    return Sensor([Film(0.9e-3, 0.3, offset_m=2e-4)], envelopes=[ridges, HertzPatch(1e-3)])


def fitted_order(steps, errors) -> float:
    """The slope of log error against log step."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def largest_error(ours, reference) -> float:
    """Largest error over the last axis in units of the reference's largest value there.

    Rows that are nothing in the reference are measured against its largest row.
    """
    ours, reference = np.asarray(ours), np.asarray(reference)
    peak = np.abs(reference).max(-1)
    peak = np.where(peak > 1e-14 * peak.max(), peak, peak.max())
    return float((np.abs(ours - reference).max(-1) / peak).max())
