"""Films whose response was measured, beside films that are computed."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film, SampleAverage
from srsinv.forward.measured import KernelTable, MeasuredFilm
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, Periodic
from srsinv.inverse.kernel.measured import kernels

DEPTH_M = 7.5e-4
SCAN = ConstantSpeed(0.05)
LINES = {"open": Open(600, 5e-5, -0.015), "periodic": Periodic(600, 5e-5, -0.015)}
X = np.linspace(-0.03, 0.03, 60 * 12 + 1)


def measured(film: Film, stated: Film) -> MeasuredFilm:
    """The stated film with the kernel of the other: in a table, and beyond it by the ratio of the
    two there, as both decay alike."""
    own, other = kernels(Sensor([stated]), [stated, film], X)
    far = other[:, -1] / own[:, -1]
    taper = np.clip((1 - np.abs(X) / X[-1]) / 0.1, 0, 1)
    return MeasuredFilm.of(stated, far, KernelTable.of(X, taper * (other - far[:, None] * own)))


TRUE = Film(1.3 * DEPTH_M, 0.3).with_strip_average()
STATED = Film(DEPTH_M).with_strip_average()
FILM = measured(TRUE, STATED)


@pytest.mark.parametrize("line", LINES.values(), ids=list(LINES))
def test_a_table_of_a_film_is_that_film(line):
    traction = np.zeros((2, line.n))
    traction[:, line.n // 2 - 10 : line.n // 2 + 10] = 1e4
    here, there = (
        np.asarray(Sensor([film]).operator(line, SCAN)(traction)) for film in (FILM, TRUE)
    )
    stated = np.asarray(Sensor([STATED]).operator(line, SCAN)(traction))
    scale = np.abs(there).max()
    assert np.abs(here - there).max() < 1e-3 * scale < 0.1 * np.abs(stated - there).max()


@pytest.mark.parametrize("line", LINES.values(), ids=list(LINES))
def test_what_is_added_later_acts_on_what_was_measured(line):
    average = SampleAverage(4, 3e-4)
    traction = np.zeros((2, line.n))
    traction[:, line.n // 2] = 1e5
    after, before = (
        np.asarray(Sensor([film.with_effect(average)]).operator(line, SCAN)(traction))
        for film in (FILM, TRUE)
    )
    scale = np.abs(before).max()
    assert np.abs(after - before).max() < 1e-3 * scale
    sharp = np.asarray(Sensor([TRUE]).operator(line, SCAN)(traction))
    assert np.abs(sharp - before).max() > 0.02 * scale


def test_backwards_the_measured_kernel_of_q_turns():
    line = LINES["open"]
    both = Sensor([FILM, FILM.backward()]).operator(line, SCAN)
    p, q = np.random.default_rng(0).normal(size=(2, line.n))
    forth, back = np.asarray(both(np.stack([p, q])))
    np.testing.assert_allclose(np.asarray(both(np.stack([p, -q])))[0], back, rtol=1e-9)
    assert np.abs(forth - back).max() > 0.1 * np.abs(forth).max()


def test_a_strip_is_the_integral_of_the_table():
    """Against trapezoidal sums of the spline's values on a far finer grid."""
    table = KernelTable.of(
        X, np.stack([np.exp(-((X / 2e-3) ** 2)), X * np.exp(-((X / 2e-3) ** 2))])
    )
    at, width = np.array([-1e-3, 2e-4, 4e-3]), 7e-4
    inside = np.linspace(-width / 2, width / 2, 20001)
    fine = at[:, None] - inside
    want = np.stack([
        np.trapezoid(np.exp(-((fine / 2e-3) ** 2)), inside, axis=1),
        np.trapezoid(fine * np.exp(-((fine / 2e-3) ** 2)), inside, axis=1),
    ])  # fmt: skip
    got = np.asarray(table.strip_response(jnp.asarray(at), jnp.asarray(width), 0))
    np.testing.assert_allclose(got, want, atol=1e-9 * np.abs(want).max())


@pytest.mark.full
def test_adjoint_along_a_motion_that_turns():
    rng = np.random.default_rng(1)
    time_s = np.arange(500) / 1000
    speed = 0.04 * np.sign(0.25 - time_s - 5e-4)
    motion = Motion.from_speed(time_s, speed, -5e-3)
    sensor = Sensor([FILM])
    operator = sensor.operator_along(LINES["open"], motion, directions=motion.directions)
    r, y = rng.normal(size=(2, 2, 600)), rng.normal(size=(1, 500))

    @eqx.filter_jit
    def both(operator, r, y):
        return operator(r), operator.adjoint(y, each_way=True)

    signal, back = both(operator, jnp.asarray(r), jnp.asarray(y))
    size = np.linalg.norm(y) * np.linalg.norm(signal)
    assert abs(np.vdot(y, signal) - np.vdot(back, r)) < 1e-10 * size
