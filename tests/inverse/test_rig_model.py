"""The signals of a rig: their derivatives, and lines that one program serves."""

import equinox as eqx
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
from srsinv.inverse.rig_model import KnownTraction, RigModel

DEPTH_M = 1e-3
AT = {"gain_1": 90.0, "gain_2": -110.0, "depth_m": 1.1e-3, "position_m": 3e-4,
      "base_friction": 0.4, "angle_2_rad": 0.7, "offset_2_m": 8e-4}  # fmt: skip


def traction() -> KnownTraction:
    line = Open(300, 4e-5, -6e-3)
    return KnownTraction(line, 1e4 * np.exp(-((np.asarray(line.x) / 5e-4) ** 2)), 0.0)


@pytest.fixture(scope="module")
def model() -> RigModel:
    films = [Film(DEPTH_M), Film(DEPTH_M, 0.6, offset_m=1e-3)]
    sensor = Sensor([film.with_strip_average() for film in films], HalfSpace(), CurrentAmplifier())
    motion = Motion.from_speed(np.arange(60) / 1000, np.full(60, 0.1), -3e-3)
    known = traction().over(-7e-3, 7e-3, 4e-5)
    pressure, place = as_real(known.pressure_Pa), as_real(known.place_m)
    return RigModel(sensor, motion, known.line, pressure, place, motion.ways, False)


@pytest.mark.full
def test_derivatives_are_those_of_differences(model):
    """Forward, by each parameter, and reverse."""
    at = {name: as_real(value) for name, value in AT.items()}
    forward = eqx.filter_jit(lambda rig, params: jax.jacfwd(lambda p: rig(p))(params))(model, at)
    weights = jnp.asarray(np.random.default_rng(0).normal(size=(2, 60)))
    reverse = jax.grad(lambda params: jnp.sum(weights * model(params)))(at)
    for name, value in AT.items():
        step = 1e-4 * abs(value)
        above, below = (model(at | {name: as_real(value + s * step)}) for s in (1, -1))
        slope = (np.asarray(above) - np.asarray(below)) / (2 * step)
        assert np.abs(forward[name] - slope).max() < 1e-6 * np.abs(slope).max(), name
        along = float(np.sum(np.asarray(weights) * np.asarray(forward[name])))
        assert float(reverse[name]) == pytest.approx(along, rel=1e-9), name


def test_a_line_holds_its_stretch_and_its_load():
    known = traction()
    for end_m in (7e-3, 9e-3, 12e-3):
        wide = known.over(-8e-3, end_m, 1e-4)
        x, cell = np.asarray(wide.line.x), float(wide.line.cell_m)
        assert cell <= 1e-4
        assert x[0] <= -8e-3
        assert x[-1] >= end_m
        load, own = wide.pressure_Pa.sum() * cell, known.pressure_Pa.sum() * 4e-5
        assert load == pytest.approx(own, rel=1e-12)
        middle = np.sum(x * wide.pressure_Pa) / wide.pressure_Pa.sum()
        assert abs(middle - known.place_m) < 1e-9


def test_places_beside_one_another_take_lines_of_one_length():
    sizes = {
        traction().moved_to(place).over(-7e-3, 7e-3, 4e-5).line.n for place in (0.0, 3e-5, 3e-4)
    }
    assert len(sizes) == 1
