"""The sensor of the library without any argument is that of the command without any."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv import config
from srsinv.forward.amplifier import ChargeReadout, CurrentAmplifier, IntegratedCurrent
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, Periodic
from srsinv.targets import make
from tests.jobs.run import composed


@pytest.fixture(scope="module")
def of_the_command():
    return config.scenario(composed())


@pytest.mark.parametrize("kind", [Periodic, Open])
def test_the_default_sensor_has_the_transfer_of_the_commands(kind, of_the_command):
    line = kind(256, 1e-4)
    ours = Sensor().operator(line, ConstantSpeed()).transfer
    theirs = of_the_command.sensor.operator(line, of_the_command.scan).transfer
    np.testing.assert_allclose(ours, theirs, rtol=1e-15, atol=0)


def test_the_default_sensor_is_the_commands_in_every_number(of_the_command):
    ours, theirs = Sensor(), of_the_command.sensor
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-15)


@pytest.mark.parametrize("amplifier", [CurrentAmplifier, IntegratedCurrent, ChargeReadout])
def test_an_amplifier_has_the_defaults_of_its_file(amplifier):
    name = {"IntegratedCurrent": "integrated", "ChargeReadout": "charge_dc"}
    cfg = composed(f"amplifier={name.get(amplifier.__name__, 'current')}")
    theirs = make(cfg["amplifier"], "amplifier", "amplifier")
    assert jax.tree.leaves(amplifier()) == jax.tree.leaves(theirs)


def test_the_default_sensor_can_be_made_within_a_compiled_program():
    k = jnp.asarray([1e2, 1e3])
    made_inside = jax.jit(lambda k: Sensor().charge().transfer(k))(k)
    np.testing.assert_allclose(made_inside, Sensor().charge().transfer(k), rtol=1e-12)
