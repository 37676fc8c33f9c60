"""Partial slip against closed forms and against a dense tangential contact of its own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.forward.knife_edge import line_response
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.partial_slip import CylinderContact, press_and_shear
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Ridge, Rough
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.grid import Periodic
from tests.forward.setups import height_of
from tests.reference.contacts import hertz_half_width
from tests.reference.dense_contact import half_space, kernel, moved
from tests.refusals import refused
from tests.tiers import quick

SKIN, MODULUS = HalfSpace(), 7e5 / 0.75
RADIUS, LOAD, MU = 0.02, 20.0, 0.6
HALF = hertz_half_width(LOAD, RADIUS, MODULUS)
WINDOW = 80 * HALF  # the neighbours of a periodic window change a by 1.3e-4
LINE = Periodic(16384, WINDOW / 16384, -WINDOW / 2)
PARABOLA = -(np.asarray(LINE.x) ** 2) / (2 * RADIUS)
RATIOS = [0.0, 0.2, 0.5, 0.8, 0.9, 0.95]


@pytest.mark.parametrize("ratio", RATIOS)
def test_the_solver_sticks_over_the_width_of_the_closed_form(ratio):
    slip = press_and_shear(LINE, SKIN, PARABOLA, LOAD / WINDOW, -ratio * MU * LOAD / WINDOW, MU)
    (contact,), (stuck,) = slip.zone_edges_m(LINE)
    assert np.diff(contact)[0] / 2 == pytest.approx(HALF, rel=1e-3)
    assert np.diff(stuck)[0] / 2 == pytest.approx(HALF * np.sqrt(1 - ratio), abs=1e-3 * HALF)
    assert np.mean(slip.shear_Pa) == pytest.approx(-ratio * MU * LOAD / WINDOW, rel=1e-9)
    forces = LOAD, ratio * MU * LOAD, MU
    assert CylinderContact(RADIUS).stick_half_width_m(SKIN, *forces) == pytest.approx(
        HALF * np.sqrt(1 - ratio), rel=1e-12
    )


def log_kernel(n, cell):
    """Displacement (n, n) at the centres of cells by unit traction on one of them, along as well as
    inwards: -2/(pi E*) times the integral of ln|x| (Johnson 1985, 2.2 and 2.3)."""
    ends = cell * (np.subtract.outer(np.arange(n), np.arange(n))[..., None] + np.array([-0.5, 0.5]))
    integral = ends * np.log(np.abs(ends)) - ends
    return -2 / (np.pi * MODULUS) * (integral[..., 1] - integral[..., 0])


def dense_shear(matrix, limit, total):
    """The shear (n,) of this sum that moves all cells along as one where it is below the limit, and
    is at the limit elsewhere: sets of cells, taken until none changes."""
    slips = np.zeros(limit.size, bool)
    for _ in range(limit.size):
        at = np.flatnonzero(~slips)
        system = np.block([[matrix[np.ix_(at, at)], -np.ones((at.size, 1))],
                           [np.ones((1, at.size)), np.zeros((1, 1))]])  # fmt: skip
        q = np.where(slips, limit, 0.0)
        right = np.append(-(matrix @ q)[at], total - q.sum())
        scale = np.abs(matrix).max()
        system[-1] *= scale
        right[-1] *= scale
        solution = np.linalg.solve(system, right)
        q[at] = solution[:-1]
        ahead = slips & (matrix @ q > solution[-1])  # slips along the shear that is to oppose it
        new = (slips & ~ahead) | (q > limit)
        if np.array_equal(new, slips):
            return q, slips
        slips = new
    raise ArithmeticError("the sets do not settle")


@pytest.mark.parametrize("ratio", [0.3, 0.9])
def test_coulombs_law_alone_gives_the_same_shear(ratio):
    """From a matrix of logarithms, and no more than |q| <= mu p with the slip against q."""
    n = 401
    cell = 2 * HALF / n
    x = cell * (np.arange(n) - n // 2)
    contact = CylinderContact(RADIUS)
    nodes = x[:, None] + cell * np.array([-0.4, -0.2, 0, 0.2, 0.4])
    p, q = contact.traction(SKIN, nodes.ravel(), LOAD, ratio * MU * LOAD, MU).reshape(2, n, 5)
    p, q = p.mean(-1), q.mean(-1)
    dense, slips = dense_shear(log_kernel(n, cell), MU * p, q.sum())
    stuck = contact.stick_half_width_m(SKIN, LOAD, ratio * MU * LOAD, MU)
    assert cell * np.sum(~slips) / 2 == pytest.approx(stuck, abs=1.5 * cell)
    assert np.linalg.norm(dense - q) < 5e-3 * np.linalg.norm(q)


PROFILES = {
    "rough": (Rough(5e-6, 3e-3, 2e-4, 0.8, 1), 300.0),
    "ridges": (Ridge(25e-6, 0.9e-3, 0.0, 1e-4), 3e3),
}


@pytest.mark.parametrize("name", quick(PROFILES, "rough"))
@pytest.mark.parametrize("ratio", [0.4, -0.8])
def test_sticking_cells_move_as_one_and_slip_opposes_shear(name, ratio):
    """By a dense matrix in long double, on profiles of one contact and of many."""
    shape, nominal = PROFILES[name]
    line = Periodic(256, 0.02 / 256, -0.01)
    slip = press_and_shear(line, SKIN, height_of(shape, line), nominal, ratio * MU * nominal, MU)
    p, q, sticks = (np.asarray(each) for each in (slip.pressure_Pa, slip.shear_Pa, slip.sticks))
    along = moved(kernel(256, 0.02 / 256, half_space(MODULUS)), q).astype(float)
    relative = along - along[sticks].mean()
    size = np.ptp(along)
    assert 3 < sticks.sum() < (p > 0).sum() < 250
    assert np.abs(relative[sticks]).max() < 1e-7 * size
    slips = (p > 0) & ~sticks
    np.testing.assert_allclose(np.abs(q[slips]), MU * p[slips], rtol=1e-12)
    assert np.all(np.abs(q) <= MU * p * (1 + 1e-12))
    assert np.all(relative[slips] * np.sign(ratio) < 1e-7 * size)


def test_full_slip_is_coulombs_law():
    slip = press_and_shear(LINE, SKIN, PARABOLA, 250.0, MU * 250.0, MU)
    np.testing.assert_allclose(slip.shear_Pa, MU * slip.pressure_Pa)
    assert not slip.sticks.any()
    assert slip.zone_edges_m(LINE)[1].shape == (0, 2)


def test_the_charge_is_the_integral_over_the_traction():
    """Over the closed form by the midpoint rule, for two elements beside the contact."""
    sensor = Sensor([Film(), Film(angle_rad=np.pi / 2)])
    contact = CylinderContact(RADIUS, place_m=0.4e-3)
    charge = contact.charge(sensor, LOAD)
    angle = np.pi * ((np.arange(4000) + 0.5) / 4000 - 0.5)
    for load, ratio in ((LOAD, 0.7), (6.0, -1.0)):
        forces = load, ratio * MU * load, MU
        x = hertz_half_width(load, RADIUS, MODULUS) * np.sin(angle)
        weight = hertz_half_width(load, RADIUS, MODULUS) * np.cos(angle) * np.pi / 4000
        traction = contact.traction(SKIN, x, *forces)
        expected = np.einsum("ecx,cx,x->e", line_response(sensor, -0.4e-3 - x), traction, weight)
        got = charge(*(np.array([each]) for each in forces))[:, 0]
        np.testing.assert_allclose(got, expected, rtol=1e-4)
    assert not charge(np.zeros(1), np.zeros(1), np.full(1, MU)).any()


@pytest.mark.full
def test_it_is_differentiable():
    line = Periodic(512, 0.02 / 512, -0.01)
    height = height_of(Rough(5e-6, 3e-3, 2e-4, 0.8, 1), line)

    def total(shear):
        q = press_and_shear(line, SKIN, height, 300.0, shear, MU).shear_Pa
        return jnp.cos(400 * line.x) @ q

    slope = float(jax.grad(total)(50.0))
    assert slope == pytest.approx(float(total(50.01) - total(49.99)) / 0.02, rel=1e-3)


def test_what_the_law_does_not_hold_for_is_refused():
    layers = Layered([Layer(1.5e-3, 7e5), Layer(5e-3, 5e4, 0.3)])
    for skin in (layers, Viscoelastic(SKIN, [0.5], [1e-3])):
        refused(lambda skin=skin: press_and_shear(LINE, skin, PARABOLA, 250.0, 50.0, MU),
                "HalfSpace", "poisson_ratio=0.5")  # fmt: skip
    compressible = HalfSpace(0.4)
    refused(lambda: CylinderContact(RADIUS).stick_half_width_m(compressible, 1.0, 0.1, MU),
            "poisson_ratio is 0.4")  # fmt: skip
    refused(lambda: press_and_shear(LINE, SKIN, PARABOLA, 250.0, 151.0, MU), "nominal_shear_Pa")
    refused(lambda: press_and_shear(LINE, SKIN, PARABOLA, 250.0, 10.0, 0.0), "friction")
    refused(lambda: CylinderContact(RADIUS).traction(SKIN, 0.0, 1.0, 0.7, MU), "shear_N_per_m")
    refused(lambda: CylinderContact(RADIUS).traction(SKIN, 0.0, 1.0, 0.0, 0.0), "friction")
    refused(lambda: CylinderContact(RADIUS).stick_half_width_m(SKIN, 1.0, 0.1, -MU), "friction")
    charge = CylinderContact(RADIUS).charge(Sensor(), 5.0)
    refused(lambda: charge(np.array([6.0]), np.zeros(1), np.full(1, MU)), "most_N_per_m")
    refused(lambda: CylinderContact(-1.0), "radius_m")
