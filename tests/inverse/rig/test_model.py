"""The signals of a rig: their derivatives, and lines that one program serves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open, as_real
from srsinv.inverse.rig.model import KnownTraction, RigModel
from tests.reference.line_rig import Strip, rate

DEPTH_M = 1e-3
AT = {"gain_1": 90.0, "gain_2": -110.0, "depth_m": 1.1e-3, "position_m": 3e-4,
      "base_friction": 0.4, "angle_2_rad": 0.7, "offset_2_m": 8e-4}  # fmt: skip


def traction(cell_m=4e-5) -> KnownTraction:
    line = Open(round(0.012 / cell_m), cell_m, -6e-3)
    return KnownTraction(line, 1e4 * np.exp(-((np.asarray(line.x) / 5e-4) ** 2)), 0.0)


@pytest.fixture(scope="module")
def model() -> RigModel:
    films = [Film(DEPTH_M), Film(DEPTH_M, 0.6, offset_m=1e-3)]
    sensor = Sensor([film.with_strip_average() for film in films], HalfSpace(), CurrentAmplifier())
    motion = Motion.from_speed(np.arange(60) / 1000, np.full(60, 0.1), -3e-3)
    known = traction().over(-7e-3, 7e-3, 4e-5)
    pressure, place = as_real(known.pressure_Pa), as_real(known.place_m)
    return RigModel(sensor, motion, known.line, pressure, place, motion.directions, False)


@pytest.mark.full
def test_derivatives_are_those_of_differences(model):
    """Forward, by each parameter, and reverse."""
    at = {name: as_real(value) for name, value in AT.items()}
    signal = jax.jit(lambda params: model(params))
    forward = jax.jit(jax.jacfwd(lambda params: model(params)))(at)
    weights = np.random.default_rng(0).normal(size=(2, 60))
    reverse = jax.jit(jax.grad(lambda params: jnp.sum(weights * model(params))))(at)
    for name, value in AT.items():
        step = 1e-4 * abs(value)
        above, below = (signal(at | {name: as_real(value + s * step)}) for s in (1, -1))
        slope = (np.asarray(above) - np.asarray(below)) / (2 * step)
        assert np.abs(forward[name] - slope).max() < 1e-6 * np.abs(slope).max(), name
        along = float(np.sum(weights * np.asarray(forward[name])))
        assert float(reverse[name]) == pytest.approx(along, rel=1e-9), name


@pytest.mark.parametrize("end_m", [7e-3, 9e-3])
def test_wider_cells_hold_their_stretch_and_make_the_signal_of_line_loads(end_m):
    """On cells of a tenth of the depth, wider than any in use: 43/10^8 may be left."""
    known = traction(4e-6)
    wide = known.over(-8e-3, end_m, 1e-4)
    x = np.asarray(wide.line.x)
    assert float(wide.line.cell_m) == 1e-4
    assert x[0] <= -8e-3
    assert x[-1] >= end_m
    at = np.linspace(-4e-3, 4e-3, 101)
    sensor = Sensor([Film(DEPTH_M, 0.6)], amplifier=CurrentAmplifier(1e6))
    motion = Motion.from_speed(np.arange(101) / 1000, np.full(101, 0.08), -4e-3)
    one = {"gain_1": 1.0, "depth_m": DEPTH_M, "position_m": 0.0, "base_friction": 0.4}
    pressure, place = as_real(wide.pressure_Pa), as_real(wide.place_m)
    rig = RigModel(sensor, motion, wide.line, pressure, place, motion.directions, False)
    charge = np.asarray(rig(one))[0] / 1e6 / 0.08
    halves = 4e-6 / np.sqrt(12) * np.array([[-1.0], [1.0]])  # a cell's two Gaussian nodes
    places = (np.asarray(known.line.x) + halves).ravel()
    loads = np.tile(known.pressure_Pa * 4e-6 / 2, 2)
    film = sensor.elements[0]
    area = float(film.width_m * film.length_m) * film.strips
    exact = rate(Strip(DEPTH_M, 0.6, 0.0, 0.0, area), at, np.ones(101), places, loads, 0.4)
    assert np.abs(charge - exact).max() < 1e-6 * np.abs(exact).max()


def test_places_beside_one_another_take_lines_of_one_length():
    sizes = {
        traction().moved_to(place).over(-7e-3, 7e-3, 4e-5).line.n for place in (0.0, 3e-5, 3e-4)
    }
    assert len(sizes) == 1
