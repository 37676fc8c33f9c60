"""How two films differ and what they separate, against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from experiments.fig05_orientation import condition, similarity, stress_gains
from srsinv.forward.film import Film
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


def test_shift_and_size_do_not_change_the_similarity():
    x = np.linspace(-1, 1, 401)
    bump, slope = np.exp(-((x / 0.1) ** 2)), x * np.exp(-((x / 0.1) ** 2))
    moved = -3 * np.exp(-(((x - 0.2) / 0.1) ** 2))
    found = similarity(np.array([[bump, moved], [slope, slope]]))
    np.testing.assert_allclose(found, [-1, 1], atol=1e-12)


def test_similarity_of_narrow_films_under_a_line_load_of_pressure():
    """Of D = (7 +- 56 kz) e^(-kz) pC/N, by integrals of (kz)^n e^(-2kz) = n!/2^(n+1): the charge
    has the weight 1, and the signal (kz)^2."""
    films = [Film(angle_rad=angle) for angle in (0.0, np.pi / 2)]
    line = srsinv.Open(1601, 2e-5, -0.016)
    load = jnp.zeros((2, line.n)).at[0, 800].set(1 / 2e-5)
    sensor, scan = Sensor(films), srsinv.ConstantSpeed(0.05)
    responses = [line.operator(each)(load) for each in (sensor.charge(), sensor.output(scan))]
    found = similarity(np.stack([np.asarray(each) for each in responses]))

    def product(a, b, order):
        power = np.polymul(a, b)[::-1]
        n = np.arange(order, order + 3)
        return power @ ([1, 1, 2, 6, 24] / 2.0 ** np.arange(1, 6))[n]

    flat, edge = [56, 7], [-56, 7]
    expected = [
        product(flat, edge, n) / np.sqrt(product(flat, flat, n) * product(edge, edge, n))
        for n in (0, 2)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-3)
