"""How well two films separate stresses, against the closed form at long waves."""

import numpy as np
import pytest

from experiments.fig05_orientation import condition, stress_gains
from srsinv.forward.sensor import Sensor


def test_a_flat_film_and_one_on_edge_measure_sum_and_difference():
    sensor = Sensor()
    d = sensor.elements[0].piezo
    gains = stress_gains(sensor, 0.0) / sensor.elements[0].strips
    expected = sorted([abs(d.d1 - d.d3), abs(d.d1 + d.d3)], reverse=True)
    np.testing.assert_allclose(gains, expected, rtol=1e-9)


def test_long_waves_are_separated_as_the_stresses_allow():
    # At k = 0 the stresses are [[-1, 2i], [-1, 0]] and the films weigh them by d1 and d3.
    sensor = Sensor()
    films = np.stack([film.charge_per_stress()[:2] for film in sensor.elements])
    plane = films + 0.5 * np.stack([film.charge_per_stress()[3:] for film in sensor.elements])
    expected = np.linalg.cond(plane @ np.array([[-1, 2j], [-1, 0]]))
    long_wave = np.array([1e-4]) / float(sensor.depth_m)
    assert condition(sensor, long_wave)[0] == pytest.approx(expected, rel=1e-2)
