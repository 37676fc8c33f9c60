"""Traction: cell averages against quadrature, gradients at the edges, friction and scenes."""

from functools import partial
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from srsinv.forward.scene import TractionScene
from srsinv.forward.traction import FrictionStep, Hertz, PressedStrip, Sinusoid, UniformStrip
from srsinv.grid import Open, Periodic, as_real
from tests.forward.setups import derivatives

LINE = Open(40, 1.1e-4, -2e-3)
# The features' edges fall inside cells; for each, p(x) written again and where it is not smooth.
PRESSURES = {
    "pressed_strip": (
        PressedStrip(2e3, 1.4e-3, 0.21e-3, 0.15e-3),
        lambda x: 1e3 * (np.tanh((x + 0.49e-3) / 0.15e-3) - np.tanh((x - 0.91e-3) / 0.15e-3)),
        (),
    ),
    "sharp_pressed_strip": (
        PressedStrip(2e3, 1.4e-3, 0.21e-3, 1e-7),
        lambda x: 2e3 * (abs(x - 0.21e-3) < 0.7e-3),
        (-0.49e-3, 0.91e-3),
    ),
    "uniform_strip": (
        UniformStrip(2e3, 1.4e-3, 0.21e-3),
        lambda x: 2e3 * (abs(x - 0.21e-3) < 0.7e-3),
        (-0.49e-3, 0.91e-3),
    ),
    "hertz": (
        Hertz(2e3, 0.7e-3, 0.21e-3),
        lambda x: 2e3 * np.sqrt(max(0.0, 1 - ((x - 0.21e-3) / 0.7e-3) ** 2)),
        (-0.49e-3, 0.91e-3),
    ),
    "sinusoid": (
        Sinusoid(2e3, 0.9e-3, 0.21e-3),
        lambda x: 2e3 * np.cos(2 * np.pi * (x - 0.21e-3) / 0.9e-3),
        (),
    ),
}
ON_EDGES = {
    "pressed_strip": PressedStrip(2e3, 1.1e-3, 0.0, 1e-4),
    "very_sharp": PressedStrip(2e3, 1.1e-3, 0.0, 1e-9),
    "uniform_strip": UniformStrip(2e3, 1.1e-3, 0.0),
    "hertz": Hertz(2e3, 0.55e-3, 0.0),
    "sinusoid": Sinusoid(2e3, 1.1e-3, 0.0),
}


def cell_average(pressure, line=LINE):
    return np.asarray(eqx.filter_jit(lambda p: p.cell_average(line))(pressure))


@pytest.mark.parametrize("name", PRESSURES)
def test_cell_averages_by_quadrature(name):
    pressure, p, edges = PRESSURES[name]
    ours = cell_average(pressure)
    for x, average in zip(np.asarray(LINE.x), ours, strict=True):
        low, high = x - 0.55e-4, x + 0.55e-4
        inside = [low, *(edge for edge in edges if low < edge < high), high]
        parts = pairwise(inside)
        total = sum(quad(p, a, b, epsabs=1e-14, epsrel=1e-12)[0] for a, b in parts)
        assert average == pytest.approx(total / 1.1e-4, abs=1e-11 * 2e3)


@pytest.mark.parametrize("name", PRESSURES)
def test_coarse_cells_hold_the_same_load(name):
    """Averages are exact: cells three times as wide hold the mean of three."""
    pressure = PRESSURES[name][0]
    fine = cell_average(pressure, Open(39, 1.1e-4, -2e-3))
    coarse = cell_average(pressure, Open(13, 3.3e-4, -2e-3 + 1.1e-4))
    np.testing.assert_allclose(coarse, fine.reshape(13, 3).mean(1), atol=1e-10 * 2e3, rtol=0)


def test_far_features_do_not_overflow():
    """A million edge lengths away, where cosh itself would."""
    np.testing.assert_allclose(cell_average(PressedStrip(2e3, 1e-3, 1.0, 1e-6)), 0.0, atol=1e-7)


@pytest.mark.full
@pytest.mark.parametrize("name", ON_EDGES)
def test_gradients_are_finite_with_edges_on_cell_edges(name):
    """The contact ends at +-0.55 mm: cell edges of the first line, cell centres of the second."""
    lines = [Open(41, 1.1e-4, -2.2e-3 + shift) for shift in (0.0, 0.55e-4)]
    leaves, structure = jax.tree.flatten(ON_EDGES[name])

    def averages(leaves):
        pressure = jax.tree.unflatten(structure, list(leaves))
        return jnp.stack([pressure.cell_average(line) for line in lines])

    every = jax.jit(partial(derivatives, averages))(np.stack(leaves))
    _, forward, reverse = map(np.asarray, every)
    assert np.isfinite(forward).all()
    # At the end of Hertz's contact they are sqrt(1 - t^2) of a t that is 1 but for its rounding.
    close = 2 * np.finfo(float).eps ** 0.5
    np.testing.assert_allclose(forward, reverse, rtol=close, atol=close * np.abs(forward).max())


@pytest.mark.parametrize("edge", [0.2e-3, 1e-9])
def test_friction_step(edge):
    """Base far before the step, half of the change on it, all of it far behind."""
    line = Open(3, 2e-3, -2e-3)
    scene = TractionScene(0.0, 0.4, (), [FrictionStep(-0.3, 0.0, edge)])
    friction = eqx.filter_jit(scene.friction)(line)
    np.testing.assert_allclose(friction, [0.4, 0.25, 0.1], atol=1e-8, rtol=0)


@pytest.mark.parametrize("direction", [1.0, -1.0, 0.0])
def test_scene_traction(direction):
    """q = sign(u) mu p on top of a background that is there without any feature."""
    steps = [FrictionStep(0.3, 0.2e-3, 0.3e-3), FrictionStep(-0.1, -0.5e-3, 0.3e-3)]
    features = [UniformStrip(2e3, 1.4e-3), Hertz(1e3, 0.5e-3, 0.4e-3)]
    scene = TractionScene(150.0, 0.4, features, steps)
    (p, q), friction, background = jax.device_get(
        eqx.filter_jit(lambda s, d: (s.traction(LINE, d), s.friction(LINE), s.background(d)))(
            scene, as_real(direction)
        )
    )
    np.testing.assert_allclose(p, 150 + sum(cell_average(f) for f in features), rtol=1e-14)
    x = np.asarray(LINE.x)
    mu = 0.4 + 0.15 * (1 + np.tanh((x - 0.2e-3) / 0.3e-3))
    mu -= 0.05 * (1 + np.tanh((x + 0.5e-3) / 0.3e-3))
    np.testing.assert_allclose(friction, mu, rtol=1e-14)
    np.testing.assert_allclose(q, direction * mu * p, rtol=1e-14)
    np.testing.assert_allclose(background, [150, direction * 60], rtol=1e-14)


def test_an_empty_scene_is_no_traction():
    np.testing.assert_array_equal(TractionScene().traction(Periodic(8, 1e-3)), np.zeros((2, 8)))
