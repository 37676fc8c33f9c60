"""Film: orientation, area and the effects along the line, against stresses turned by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import (
    ORIENTATIONS_RAD,
    Film,
    Offset,
    Piezo,
    SampleAverage,
    StripAverage,
)
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open, Periodic
from tests.forward.setups import apply, fitted_order, largest_error
from tests.reference import closed_forms as cf

DEPTH, NU = 0.75e-3, 0.45
D = (23e-12, 3e-12, -33e-12)
ANGLES_DEG = [0.0, 30.0, 45.0, 72.0, 90.0, 120.0, -30.0]


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_turned_film_against_stresses_turned_by_hand(angle_deg):
    stress = np.array([[1.3, -0.4, 0.2], [-0.7, 0.9, 0.5], [0.6, 0.8, -1.1]])
    angle = np.deg2rad(angle_deg)
    film = Film(DEPTH, angle, 0.5e-3, 6e-3, Piezo(*D), strips=2)
    across = NU * (stress[0] + stress[1])  # sigma_y in plane strain
    ours = np.asarray(film.charge_per_stress()) @ np.vstack([stress, across])
    expected = 2 * 0.5e-3 * 6e-3 * cf.charge_density(stress, angle, D, NU)
    np.testing.assert_allclose(ours, expected, rtol=1e-14, atol=1e-14 * np.abs(expected).max())


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_turned_film_under_a_strip_of_p_and_q(angle_deg):
    """From traction to charge on the open line: every sign on the way counts."""
    line, angle, mu = Open(63, 1.5e-4, -4e-3), np.deg2rad(angle_deg), 0.6
    traction = np.zeros((2, 63))
    traction[0, 20:30], traction[1, 20:30] = 1.0, mu
    charge = apply(
        line, Sensor([Film(DEPTH, angle)], HalfSpace(NU)).charge(), jnp.asarray(traction)
    )
    x = np.asarray(line.x)
    stress = cf.strip_by_angles(x - (x[20] + x[29]) / 2, DEPTH, 10 * 1.5e-4)
    expected = 0.7e-3 * 8e-3 * cf.charge_density(stress[:, 0] + mu * stress[:, 1], angle, D, NU)
    assert largest_error(charge[0], expected) < 1e-10


@pytest.mark.parametrize("line", [Open(96, 1e-4, -4.8e-3), Periodic(96, 1e-4, -4.8e-3)])
def test_an_element_is_read_where_it_sits(line):
    """What is stated of a film acts: its signal is that of a film at the origin, so much later."""
    cells = 7
    film = Film(DEPTH, 0.4, offset_m=cells * 1e-4).with_strip_average()
    traction = np.zeros((2, 96))
    traction[:, 40:50] = 1.0
    placed, at_origin = (
        np.asarray(apply(line, Sensor([each]).charge(), jnp.asarray(traction)))[0]
        for each in (film, film.at_origin())
    )
    assert largest_error(placed[20:60], at_origin[20 + cells : 60 + cells]) < 1e-10
    stated = Film(DEPTH, 0.4, effects=[Offset(cells * 1e-4)]).with_strip_average()
    of_effect = np.asarray(apply(line, Sensor([stated]).charge(), jnp.asarray(traction)))[0]
    assert largest_error(placed, of_effect) < 1e-12


def test_named_orientations_are_the_papers_two():
    """{1 to x, 3 to z} weighs sigma_x with d1 and sigma_z with d3; {1 to z, 3 to x} exchanges."""
    area, piezo = 0.7e-3 * 8e-3, Piezo(1.0, 0.0, 5.0)
    for name, expected in (("1_to_x_3_to_z", [1, 5, 0, 0]), ("1_to_z_3_to_x", [5, 1, 0, 0])):
        film = Film(DEPTH, ORIENTATIONS_RAD[name], piezo=piezo)
        weights = film.charge_per_stress() / area
        np.testing.assert_allclose(weights, expected, atol=1e-15, rtol=0)


# Effects along the line: the mean of the thin film's charge over the points that each one covers.

NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)
EFFECTS = {
    "width": (StripAverage(0.7e-3), 0.35e-3 * NODES, WEIGHTS / 2),
    "offset": (Offset(0.23e-3), np.array([0.23e-3]), np.ones(1)),
    "average": (SampleAverage(3, 0.2e-3), 0.2e-3 * np.array([-1, 0, 1]), np.ones(3) / 3),
}
LINES = {"periodic": Periodic(64, 1.25e-4, -4e-3), "open": Open(64, 1.25e-4, -4e-3)}


def thin_charge(line, x, angle):
    """Charge per area at any x under eight cells of traction (open) or a cosine (periodic)."""
    if isinstance(line, Open):
        stress = cf.strip_by_angles(x - float(line.x[24] + line.x[31]) / 2, DEPTH, 8 * 1.25e-4)
    else:
        stress = cf.stress(cf.cauchy_cosine(x, DEPTH, 2 * np.pi * 5 / 8e-3), DEPTH)
    return cf.charge_density(stress[:, 0] + 0.6 * stress[:, 1], angle, D)


def cell_averages(line):
    if isinstance(line, Open):
        p = np.isin(np.arange(64), np.arange(24, 32)).astype(float)
    else:
        k = 2 * np.pi * 5 / 8e-3
        p = np.cos(k * np.asarray(line.x)) * np.sin(k * 1.25e-4 / 2) / (k * 1.25e-4 / 2)
    return jnp.asarray([p, 0.6 * p])


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_effect_is_the_mean_over_what_it_covers(line, name):
    effect, shifts, weights = EFFECTS[name]
    charge = apply(
        line, Sensor([Film(DEPTH, 0.5, effects=(effect,))]).charge(), cell_averages(line)
    )
    x = np.asarray(line.x)[:, None] + shifts
    expected = thin_charge(line, x.ravel(), 0.5).reshape(x.shape) @ weights
    assert largest_error(charge[0], 0.7e-3 * 8e-3 * expected) < 1e-11


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_a_vanishing_strip_tends_to_the_thin_film(line):
    """The paper's (10) and (11) are the limit of width nothing, reached at second order."""
    widths = 0.8e-3 / 2 ** np.arange(6)
    expected = thin_charge(line, np.asarray(line.x), 0.5)
    errors = []
    for width in widths:
        sensor = Sensor([Film(DEPTH, 0.5, width, effects=(StripAverage(width),))])
        density = apply(line, sensor.charge(), cell_averages(line))[0] / (width * 8e-3)
        errors.append(largest_error(density, expected))
    assert fitted_order(widths, errors) >= 1.9
    assert errors[-1] < 1e-3


def test_a_strip_is_blind_to_a_pitch_of_its_own_width():
    """The 0.7 mm strip does not see the paper's 0.7 mm ridges, the 0.5 mm one does."""
    k = jnp.asarray([2 * np.pi / 0.7e-3])
    assert abs(float(StripAverage(0.7e-3).transfer(k)[0])) < 1e-15
    assert abs(float(StripAverage(0.5e-3).transfer(k)[0])) > 0.3


def test_wide_strips_keep_their_digits():
    """Ten depths wide, on the open line, against the closed form under a narrow load."""
    film = Film(DEPTH, 0.0, effects=(StripAverage(10 * DEPTH),))
    line = Open(65, DEPTH / 4, -32 * DEPTH / 4)
    traction = jnp.zeros((2, 65)).at[0, 32].set(1.0)
    charge = apply(line, Sensor([film]).charge(), traction)[0]
    panels = (np.arange(20)[:, None] - 9.5 + NODES / 2) * DEPTH / 2
    x = np.asarray(line.x)[:, None] + panels.ravel()
    thin = cf.charge_density(cf.strip_by_angles(x.ravel(), DEPTH, DEPTH / 4)[:, 0], 0.0, D)
    expected = thin.reshape(x.shape) @ np.tile(WEIGHTS / 40, 20)
    assert largest_error(charge, 0.7e-3 * 8e-3 * expected) < 1e-9
