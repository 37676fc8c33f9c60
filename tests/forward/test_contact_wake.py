"""A lagging contact that stands alone, against a half space without a window, and what warns."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import digamma, expi

from srsinv.forward.contact import WakeFriction, press
from srsinv.forward.contact_wake import wake_friction, windows_for
from srsinv.forward.scene import SurfaceScene
from srsinv.forward.shape import Shape
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Cylinder, Ridge, Rough
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.grid import Periodic
from tests.refusals import refused
from tests.tiers import rare

LENGTH_M, N = 0.02, 256
LINE = Periodic(N, LENGTH_M / N, -LENGTH_M / 2)
X = np.asarray(LINE.x)
MODULUS_PA = 7e5 / 0.75  # of contact, at rest
RADIUS_M, NOMINAL_PA = 0.05, 3e3
LOAD_N_PER_M = NOMINAL_PA * LENGTH_M
BALL = Cylinder(RADIUS_M)


def skin(wake_m, fraction=1.0):
    """Recovering over `wake_m` = (1 + f) u tau behind a load, at 1 m/s."""
    return Viscoelastic(HalfSpace(), [fraction], [wake_m / (1 + fraction)], 1.0)


def scene(wake_m, windows=None, shape: Shape = BALL):
    return SurfaceScene(NOMINAL_PA, [shape], 0.4, skin(wake_m), windows)


def friction(pressure):
    """Of the lag: mean p dh/dx over mean p, with h' = -x/R."""
    pressure = np.asarray(pressure)
    return -np.sum(pressure * X) / RADIUS_M / np.sum(pressure)


def antiderivative(x, wake_m, fraction=1.0):
    """Of the displacement under a line load at 0, which repeats nowhere, times pi E*/2.

    A load that came by leaves -ln|x| J(t), J = 1 - f/(1 + f) exp(-u t/wake), and
    int_0^inf e^-s ln|x - c s| ds = ln|x| - e^(-x/c) Ei(x/c).
    """
    late, c = fraction / (1 + fraction), wake_m
    log = np.log(np.abs(x))
    return -(x * log - x + late * c * (np.exp(-x / c) * expi(x / c) - log))


def alone(wake_m):
    """The pressure of the cylinder without any window, by its influence matrix, cell by cell."""
    cell = float(LINE.cell_m)
    apart = X[:, None] - X[None]
    ends = (antiderivative(apart + side * cell / 2, wake_m) for side in (1, -1))
    matrix = 2 / (np.pi * MODULUS_PA) * np.subtract(*ends)
    height, touching = -(X**2) / (2 * RADIUS_M), np.abs(X) < 2e-3
    for _ in range(50):
        inside = np.flatnonzero(touching)
        system = np.block([
            [matrix[np.ix_(inside, inside)], np.ones((inside.size, 1))],
            [np.ones((1, inside.size)), np.zeros((1, 1))],
        ])  # fmt: skip
        *solution, constant = np.linalg.solve(system, [*height[inside], LOAD_N_PER_M / cell])
        pressure = np.zeros(N)
        pressure[inside] = solution
        gap = matrix @ pressure + constant - height
        new = (pressure > 0) | (~touching & (gap < 0))
        if np.array_equal(new, touching):
            return pressure
        touching = new
    raise AssertionError("the contact set has not settled")


@pytest.mark.full
@pytest.mark.parametrize("wake_m", rare([0.002, 0.008, 0.032], 0.002, 0.008))
def test_a_cylinder_that_stands_alone(wake_m):
    """Wakes of a tenth of the window to half as long again."""
    reference = alone(wake_m)
    contact = scene(wake_m).contact(LINE)
    own = scene(wake_m, 1).contact(LINE)
    assert contact.status == own.status == "converged"
    assert np.mean(np.asarray(contact.pressure_Pa)) == pytest.approx(NOMINAL_PA, rel=1e-9)
    assert friction(contact.pressure_Pa) == pytest.approx(friction(reference), rel=0.01)
    assert contact.warnings == ()
    missing = 1 - friction(own.pressure_Pa) / friction(reference)
    assert missing > 0.03
    assert own.wake is not None
    assert float(own.wake.missing_fraction[0]) == pytest.approx(missing, abs=0.03)
    assert len(own.warnings) == 1
    assert "wake" in own.warnings[0]


def test_what_is_missing_is_that_of_a_narrow_load():
    """2 P/(pi E*) f/(1 + f)/wake [Re psi(1 + i b) - ln b], b = window/(2 pi wake)."""
    pressure = jnp.asarray(NOMINAL_PA * N * (np.arange(N) == N // 2))
    for wake_m in (0.002, 0.008, 0.032):
        b = LENGTH_M / (2 * np.pi * wake_m)
        expected = LOAD_N_PER_M / (np.pi * MODULUS_PA) / wake_m
        expected *= digamma(1 + 1j * b).real - np.log(b)
        wake = wake_friction(LINE, skin(wake_m), pressure)
        assert float(wake.missing[0]) == pytest.approx(expected, rel=0.02)


MISSING_FRACTIONS = {  # missing in 1, 2, 4, ... 64 windows
    1: (0.019, 0.015, 0.012, 0.012, 0.012, 0.012, 0.012),
    32: (0.5, 0.2, 0.1, 0.05, 0.02, 0.005, 0.001),
    64: (0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2),
}


@pytest.mark.parametrize("windows", MISSING_FRACTIONS)
def test_as_many_windows_as_the_wake_asks_and_the_most_where_none_are_enough(windows):
    missing = 0.1 * jnp.asarray(MISSING_FRACTIONS[windows])
    assert windows_for(WakeFriction(0.1 - missing[0], missing)) == windows


@pytest.mark.full
def test_nothing_is_touched_in_the_windows_added():
    """The skin beside a tall ridge sags by 2 P/(pi E*) ln 8 on the way there, 85 um: more than the
    26 um that part it from the plate at the ends of one window."""
    tall = scene(0.008, 8, Ridge(100e-6, 2e-3, 0.0, 4e-4))
    pressure = tall.contact(LINE).pressure_Pa
    assert np.mean(np.asarray(pressure)) == pytest.approx(NOMINAL_PA, rel=1e-9)


@pytest.mark.full
def test_a_short_wake_changes_nothing():
    at_once = scene(2e-4)
    contact = at_once.contact(LINE)
    own = press(LINE, at_once.skin, at_once.height(LINE), at_once.nominal_pressure_Pa)
    np.testing.assert_array_equal(contact.pressure_Pa, own.pressure_Pa)
    np.testing.assert_array_equal(contact.gap_m, own.gap_m)
    assert contact.warnings == ()


@pytest.mark.parametrize("shape", [Ridge(25e-6, 2e-3, 0.0, 4e-4), Rough(5e-6, 3e-3, 2e-4, 0.8, 1)])
def test_where_the_skin_lies_on_the_plate_no_wake_is_met(shape):
    """Its load is even but for a little, and a texture that repeats has no end to recover in."""
    surface_scene = scene(0.032, shape=shape)
    contact = surface_scene.contact(LINE)
    own = press(
        LINE, surface_scene.skin, surface_scene.height(LINE), surface_scene.nominal_pressure_Pa
    )
    np.testing.assert_array_equal(contact.pressure_Pa, own.pressure_Pa)
    assert surface_scene.warnings(LINE) == ()


def test_an_elastic_skin_is_not_looked_at():
    rest = eqx.tree_at(lambda s: s.skin, scene(0.008), HalfSpace())
    assert rest.contact(LINE).wake is None
    assert rest.warnings(LINE) == ()


def test_refusals():
    for windows in (0, -1, 1.5, "a"):
        refused(lambda w=windows: scene(0.008, w), "contact_windows", "whole number from 1")
    refused(lambda: scene(0.008, 4, Rough(5e-6, 3e-3, 2e-4)), "contact_windows", "continues")
    ridge = scene(0.008, 4, Ridge(25e-6, 2e-3, 0.0, 4e-4))
    refused(lambda: ridge.contact(LINE), "contact_windows", "ends", "null")
