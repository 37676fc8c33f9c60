"""Stress under the surface against closed forms derived apart from it."""

import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open
from tests.forward.setups import apply, full_sensor, largest_error
from tests.reference import closed_forms as cf
from tests.shared import SHARED, needs_shared

SKIN = HalfSpace()
DEPTH = 0.75e-3
STRIP = eqx.filter_jit(SKIN.strip_response)
SLOPE = eqx.filter_jit(SKIN.strip_slope)
TRANSFER = eqx.filter_jit(SKIN.transfer)

# Around the strip, and as far as two hundred depths on both sides.
NEAR = np.linspace(-4e-3, 4e-3, 161)
FAR = DEPTH * np.array([-200.0, -90, -31, -12, 11.0, 29, 88, 190])


def asked(function, x, width):
    return np.asarray(function(jnp.asarray(x), jnp.asarray(DEPTH), jnp.asarray(width)))[:3]


@pytest.mark.parametrize("width", [0.01 * DEPTH, 0.3 * DEPTH, DEPTH, 4 * DEPTH])
def test_uniform_strip_by_its_angles(width):
    ours, reference = asked(STRIP, NEAR, width), cf.strip_by_angles(NEAR, DEPTH, width)
    assert largest_error(ours, reference) < 1e-10


@pytest.mark.parametrize("width", [0.01 * DEPTH, 0.3 * DEPTH, DEPTH, 4 * DEPTH])
def test_uniform_strip_far_away_by_quadrature(width):
    """At every point to its own size: sigma_z has fallen by nine orders at the ends."""
    reference = cf.by_quadrature(np.ones_like, -width / 2, width / 2, FAR, DEPTH)
    np.testing.assert_allclose(asked(STRIP, FAR, width), reference, rtol=1e-10)


@pytest.mark.parametrize("width", [0.01 * DEPTH, 0.3 * DEPTH, DEPTH, 4 * DEPTH])
def test_slope_of_a_uniform_strip(width):
    reference = cf.line_load(NEAR + width / 2, DEPTH) - cf.line_load(NEAR - width / 2, DEPTH)
    assert largest_error(asked(SLOPE, NEAR, width), reference) < 1e-10
    reference = cf.line_load(FAR + width / 2, DEPTH) - cf.line_load(FAR - width / 2, DEPTH)
    np.testing.assert_allclose(asked(SLOPE, FAR, width), reference, rtol=1e-8)


@pytest.mark.parametrize("component", [0, 1], ids=["p", "q"])
def test_strip_of_whole_cells_on_the_open_line(component):
    """A strip that covers whole cells is exact on the grid, whatever the cell."""
    line = Open(96, DEPTH / 6, -5e-3)
    first, last = 30, 41
    traction = np.zeros((2, 96))
    traction[component, first : last + 1] = 1.0
    stress = apply(line, full_sensor().stress(), jnp.asarray(traction))
    x, cell = np.asarray(line.x), DEPTH / 6
    middle, width = (x[first] + x[last]) / 2, (last - first + 1) * cell
    for element, depth in enumerate((0.75e-3, 0.9e-3, 0.6e-3)):
        reference = cf.strip_by_angles(x - middle, depth, width)[:, component]
        assert largest_error(stress[4 * element : 4 * element + 3], reference) < 1e-10


@needs_shared
def test_transfer_against_the_reference_table():
    """From kappa = 1e-6 to 375, and at a negative k."""
    table = json.loads((SHARED / "reference" / "layered_transfer.json").read_text())
    stack = next(s for s in table["stacks"] if s["name"] == "half_space")
    k = np.array([row["k"] for row in stack["rows"]])

    def column(key):
        return np.array([complex(*row[key]) for row in stack["rows"]])

    expected = np.array(
        [[column(f"{stress}_{load}") for load in "pq"] for stress in ("sx", "sz", "txz")]
    )
    ours = np.asarray(TRANSFER(jnp.asarray(k), jnp.asarray(stack["depth_m"])))[:3]
    np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=0)


def test_transfer_is_even_and_odd_about_zero():
    """The stress of a real traction is real: G(-k) is the conjugate of G(k), and G(0) is real."""
    k = jnp.asarray([-2e3, -40.0, 0.0, 40.0, 2e3])
    transfer = np.asarray(TRANSFER(k, jnp.asarray(DEPTH)))
    np.testing.assert_array_equal(transfer[..., ::-1].conj(), transfer)
    np.testing.assert_array_equal(transfer[..., 2], [[-1, 0], [-1, 0], [0, -1], [-1, 0]])
