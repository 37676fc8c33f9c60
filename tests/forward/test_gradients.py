"""Gradients of a number made from the voltage, in every physical parameter and in the traction.

Every parameter enters as a factor on its nominal value, so that one flat vector of ones stands for
the whole experiment, one compiled function serves them all, and steps are relative.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import ChargeReadout, CurrentAmplifier, IntegratedCurrent
from srsinv.forward.film import Film, Offset, Piezo, SampleAverage, StripAverage
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import TractionScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.traction import FrictionStep, PressedStrip
from srsinv.grid import Open, Periodic
from tests.forward.setups import derivatives
from tests.tiers import quick

N = 32
NOMINAL = {
    "depth_m": 0.75e-3,
    "angle_rad": 0.5,
    "width_m": 0.7e-3,
    "length_m": 8e-3,
    "d1": 23e-12,
    "d2": 3e-12,
    "d3": -33e-12,
    "offset_m": 2.5e-4,
    "spacing_m": 6e-5,
    "poisson_ratio": 0.45,
    "speed_m_per_s": 0.05,
    "feedback_resistance_ohm": 1e6,
    "cell_m": 1.9e-4,
    "start_m": -3e-3,
    "pressure_Pa": 2e3,
    "feature_width_m": 1.4e-3,
    "position_m": 0.3e-3,
    "edge_m": 0.25e-3,
    "background_pressure_Pa": 900.0,
    "base_friction": 0.4,
    "change": 0.35,
    "step_position_m": -0.4e-3,
    "step_edge_m": 0.3e-3,
}
NAMES = list(NOMINAL)
LINES = {"periodic": Periodic, "open": Open}
OTHERS = (IntegratedCurrent(1e6), ChargeReadout(1e9, 0.0))
RANDOM = np.random.default_rng(3).normal(size=(2, N))


def voltage(line, factors, added):
    """One element's voltage (1, n) in volts, with `added` (2, n) [kPa] on top of the scene."""
    v = dict(zip(NAMES, factors * jnp.asarray(list(NOMINAL.values())), strict=True))
    grid = LINES[line](N, v["cell_m"], v["start_m"])
    piezo = Piezo(v["d1"], v["d2"], v["d3"])
    effects = (StripAverage(v["width_m"]), Offset(v["offset_m"]), SampleAverage(2, v["spacing_m"]))
    elements = [Film(v["depth_m"], v["angle_rad"], v["width_m"], v["length_m"], piezo, effects)]
    amplifier = CurrentAmplifier(v["feedback_resistance_ohm"])
    sensor = Sensor(elements, HalfSpace(v["poisson_ratio"]), amplifier)
    scan = ConstantSpeed(v["speed_m_per_s"])
    strip = PressedStrip(v["pressure_Pa"], v["feature_width_m"], v["position_m"], v["edge_m"])
    step = FrictionStep(v["change"], v["step_position_m"], v["step_edge_m"])
    scene = TractionScene(v["background_pressure_Pa"], v["base_friction"], [strip], [step])
    traction = scene.traction(grid, scan.direction) + 1e3 * added
    return sensor.operator(grid, scan)(traction)


def number(line, theta):
    """A scalar of the voltage that no parameter leaves alone; theta holds factors and traction."""
    v = 1e5 * voltage(line, theta[: len(NAMES)], theta[len(NAMES) :].reshape(2, N))
    return jnp.log(jnp.sum(v**2)) + jnp.sum(jnp.sin(v) * RANDOM[:1])


THETA = np.concatenate([np.ones(len(NAMES)), 0.3 * np.random.default_rng(4).normal(size=2 * N)])


@cache
def gradients(line):
    """The gradient by finite differences of fourth order, forward and in reverse mode."""
    step, eye = 3e-4, np.eye(THETA.size)
    at = np.stack([THETA + reach * step * eye for reach in (-2, -1, 1, 2)])
    values = jax.jit(jax.vmap(lambda theta: number(line, theta)))
    by_reach = np.asarray(values(jnp.asarray(at.reshape(-1, THETA.size)))).reshape(4, -1)

    others = np.stack([1.01 * THETA, THETA, 0.98 * THETA])
    every = jax.jit(jax.vmap(partial(derivatives, partial(number, line))))(others)
    _, forward, reverse = (np.asarray(each)[1] for each in every)
    return {
        "difference": np.array([1, -8, 8, -1]) @ by_reach / (12 * step),
        "forward": forward,
        "reverse": reverse,
    }


@pytest.mark.full
@pytest.mark.parametrize("line", quick(LINES, "periodic"))
@pytest.mark.parametrize("mode", ["forward", "reverse"])
@pytest.mark.parametrize("name", NAMES)
def test_gradient_in_a_parameter(name, mode, line):
    by_mode, i = gradients(line), NAMES.index(name)
    assert abs(by_mode["difference"][i]) > 1e-4, "the number does not depend on it"
    assert by_mode[mode][i] == pytest.approx(by_mode["difference"][i], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("line", quick(LINES, "periodic"))
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_gradient_in_the_traction(mode, line):
    by_mode = gradients(line)
    expected = by_mode["difference"][len(NAMES) :]
    error = np.abs(by_mode[mode][len(NAMES) :] - expected).max()
    assert error < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("line", quick(LINES, "periodic"))
def test_gradient_in_depth_of_the_other_readouts(line):
    def sums(depth):
        grid = LINES[line](N, 1.3e-4, -3e-3)
        sensors = (Sensor([Film(depth, 0.5)], HalfSpace(), readout) for readout in OTHERS)
        signals = (sensor.operator(grid, ConstantSpeed()) for sensor in sensors)
        return jnp.stack([jnp.sum((1e6 * signal(jnp.asarray(RANDOM))) ** 2) for signal in signals])

    step = 1e-8
    depths = 0.75e-3 + step * jnp.asarray([-2.0, -1, 0, 1, 2])
    values, slopes = jax.jit(jax.vmap(lambda depth: (sums(depth), jax.jacrev(sums)(depth))))(depths)
    difference = np.array([1, -8, 0, 8, -1]) @ np.asarray(values) / (12 * step)
    np.testing.assert_allclose(slopes[2], difference, rtol=1e-6)
