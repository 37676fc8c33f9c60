"""Friction that falls with pressure: q follows the local pressure, p does not change."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv import config
from srsinv.errors import BadInput
from srsinv.forward.scene import TractionScene
from srsinv.forward.simulation import Simulation
from srsinv.forward.varying_friction import RubberFriction
from srsinv.grid import Periodic
from tests.effects.test_effects import configuration
from tests.refusals import refused

LINE, MEAN = Periodic(64, 1e-4), 1e4
PLATE = TractionScene(MEAN, 0.4)


def shear(pressure, exponent=1 / 3, **law):
    scene = RubberFriction(PLATE, exponent, **law)
    return np.asarray(scene.traction(LINE, 1.0, jnp.asarray(pressure))[1])


def test_shear_grows_less_than_the_pressure():
    p = MEAN * np.geomspace(0.1, 100, 64)
    np.testing.assert_allclose(shear(p), 0.4 * MEAN * (p / MEAN) ** (2 / 3), rtol=1e-12)
    np.testing.assert_allclose(shear(p, 0.0), 0.4 * p, rtol=1e-12)
    faster = shear(p, speed_exponent=0.2, relative_speed=3.0)
    np.testing.assert_allclose(faster, 3**0.2 * shear(p), rtol=1e-12)


def test_no_contact_is_no_shear_and_has_a_gradient():
    p = np.where(np.arange(64) < 20, 0.0, MEAN)
    q = shear(p)
    assert np.all(q[:20] == 0)
    assert np.all(q[20:] == pytest.approx(0.4 * MEAN))

    def total(p, exponent):
        return jnp.sum(RubberFriction(PLATE, exponent).traction(LINE, 1.0, p)[1])

    by_p, by_exponent = jax.grad(total, (0, 1))(jnp.asarray(p), 0.25)
    np.testing.assert_allclose(by_p[20:], 0.4 * 0.75, rtol=1e-12)
    assert np.all(np.isfinite(by_p))
    assert by_exponent == pytest.approx(0.0, abs=1e-9)


def test_a_pressed_scene_keeps_its_pressure():
    sims = [
        config.simulation(configuration(f"effects={names}", "scene=ridge"))
        for names in ("[]", "[varying_friction]")
    ]
    (p, q), (own_p, own_q) = (np.asarray(sim.traction(sim.line)) for sim in sims)
    np.testing.assert_array_equal(p, own_p)
    touches = p > 0
    nominal = 2e4
    wanted = q[touches] * (p[touches] / nominal) ** -0.1
    np.testing.assert_allclose(own_q[touches], wanted, rtol=1e-9)
    assert np.all(own_q[~touches] == 0)


def test_refusals():
    refused(lambda: RubberFriction(PLATE, 1.5), "pressure_exponent", "1.5")
    refused(lambda: RubberFriction(TractionScene(0.0, 0.4), 0.1), "reference_pressure_Pa")
    settings = ("effects=[varying_friction,speed_ripple]", "grid.cells=64")
    even = config.simulation(configuration(*settings))
    uneven = config.simulation(
        configuration(*settings, "effects.varying_friction.speed_exponent=1")
    )

    def along(sim: Simulation):
        return sim.signal_along(sim.scenario.recorder.motion(sim.line, sim.fine, sim.scan))

    assert np.all(np.isfinite(along(even)))
    with pytest.raises(BadInput, match="follows the speed"):
        along(uneven)
