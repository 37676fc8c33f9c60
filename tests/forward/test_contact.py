"""Contact against its closed forms, its conditions, and its derivatives against differences."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.contact import Contact, cell_compliance, press
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Cylinder, Ridge, Rough, SineWave, Surface, Tape
from srsinv.grid import Periodic
from tests.forward.setups import height_of, solve_contact
from tests.reference import contacts
from tests.refusals import refused
from tests.tiers import rare

LENGTH = 0.02
SKIN = HalfSpace()
MODULUS = 7e5 / 0.75


def window(n, length=LENGTH, shift=0.0):
    cell = length / n
    return Periodic(n, cell, -length / 2 + (0.5 + shift) * cell)


def check(contact: Contact, line, height, nominal, size=1e-8, elastic=None):
    """Equilibrium, signs, complementarity and the skin's own displacement."""
    p, gap, span = np.asarray(contact.pressure_Pa), np.asarray(contact.gap_m), np.ptp(height)
    assert contact.status == "converged"
    assert np.mean(p) == pytest.approx(nominal, rel=1e-10)
    assert np.all(p >= 0)
    assert np.min(gap) >= -size * span
    assert np.max(np.abs(p * gap)) <= size * nominal * span
    k = np.asarray(line.k[1:-1])
    answer = np.fft.rfft(gap + np.asarray(height))[1:-1]
    if elastic is None:
        elastic = 2 / (MODULUS * k) / np.sinc(k * float(line.cell_m) / 2 / np.pi)
    # The transform rounds beside the height that was added.
    rounding = 1e-15 * span * p.size
    np.testing.assert_allclose(
        answer,
        elastic * np.fft.rfft(p)[1:-1],
        rtol=1e-8,
        atol=1e-8 * np.abs(answer).max() + rounding,
    )


def westergaard_error(n, load_fraction, shift):
    depth, line = 1e-5, window(n, shift=shift)
    full = contacts.westergaard_full(depth, LENGTH, MODULUS)
    wave = height_of(SineWave(depth, LENGTH, 0.0), line)
    contact = solve_contact(line, SKIN, wave, load_fraction * full)
    load = partial(
        contacts.westergaard_load,
        length=LENGTH,
        nominal=load_fraction * full,
        load_fraction=load_fraction,
    )
    exact = contacts.cell_averages(load, np.asarray(line.x), float(line.cell_m))
    assert contact.status == "converged"
    return np.linalg.norm(np.asarray(contact.pressure_Pa) - exact) / np.linalg.norm(exact)


@pytest.mark.full
@pytest.mark.parametrize("load_fraction", rare([0.1, 0.5], 0.1))
def test_westergaard_at_every_place_within_a_cell(load_fraction):
    sizes = {1024: 1.1e-3, 4096: 2.6e-4, 16384: 7e-5}
    errors = [
        np.median([westergaard_error(n, load_fraction, turn / 12) for turn in range(12)])
        for n in sizes
    ]
    assert all(error <= goal for error, goal in zip(errors, sizes.values(), strict=True)), errors


@pytest.mark.full
@pytest.mark.parametrize("load_fraction", rare([0.1, 0.5], 0.5))
def test_westergaard_converges_at_first_order(load_fraction):
    """As the edge of contact is known to a cell: in the root mean square over places within one,
    which so few places tell to some per cent."""
    coarse, fine = (
        np.sqrt(
            np.mean([westergaard_error(n, load_fraction, turn / 12) ** 2 for turn in range(12)])
        )
        for n in (4096, 32768)
    )
    assert np.log(coarse / fine) / np.log(8) >= 0.95


@pytest.mark.full
def test_narrow_cells_take_hardly_more_steps():
    """As they begin where those on wider cells end."""
    wide, narrow = (
        float(
            solve_contact(
                line, SKIN, height_of(SineWave(1e-5, LENGTH, 0.0), line), 500.0
            ).iterations
        )
        for line in (window(4096), window(32768))
    )
    assert narrow <= 1.5 * wide


@pytest.mark.full
@pytest.mark.parametrize("seed", rare([1, 2], 2))
def test_many_small_contacts_take_few_steps(seed):
    line = window(8192)
    height = height_of(Rough(5e-6, 5e-3, 2e-5, 0.8, seed), line)
    contact = solve_contact(line, SKIN, height, 1000.0)
    check(contact, line, height, 1000.0)
    touching = np.asarray(contact.touching)
    assert np.sum(touching != np.roll(touching, 1)) > 100
    assert float(contact.iterations) < 60


@pytest.mark.parametrize("modulus", [7e6, 3e7, 1e8, 7e8])
@pytest.mark.full
def test_a_stiff_layer_on_a_soft_one_bends_over_a_ridge(modulus):
    """Where 447 cells of 512 touched, 25 more came and went in a circle."""
    line = window(512, 0.04)
    skin = Layered([Layer(1.5e-3, modulus), Layer(5e-3, 5e4, 0.3)])
    height = height_of(Ridge(4e-5, 6e-4, 5e-5, 0.0), line)
    compliance = np.asarray(cell_compliance(line, skin))[1:-1]
    check(solve_contact(line, skin, height, 2e4), line, height, 2e4, elastic=compliance)


def test_a_contact_that_ends_too_early_says_so():
    contact = solve_contact(window(64), SKIN, jnp.zeros(64), 1e4)
    assert contact.warnings == ()
    early = eqx.tree_at(lambda c: (c.residual, c.iterations), contact, (jnp.array(3.0), 1000))
    (warning,) = early.warnings
    assert "not converged: after 1000 iterations" in warning


def test_full_contact_is_the_direct_formula():
    line, depth = window(1024), 1e-5
    k, full = 2 * np.pi / LENGTH, contacts.westergaard_full(1e-5, LENGTH, MODULUS)
    contact = solve_contact(line, SKIN, height_of(SineWave(depth, LENGTH, 1e-3), line), 1.5 * full)
    average = np.sinc(k * float(line.cell_m) / 2 / np.pi)
    wave = full * average * np.cos(k * (np.asarray(line.x) - 1e-3))
    np.testing.assert_allclose(contact.pressure_Pa, 1.5 * full + wave, rtol=1e-12)
    assert float(contact.iterations) == 0


def test_a_cylinder_is_hertz():
    """Half the width and the greatest pressure, in a window far wider than the contact."""
    line, radius = window(8192, 0.2), 0.01
    load = 5.0
    contact = solve_contact(line, SKIN, height_of(Cylinder(radius), line), load / 0.2)
    p, cell = np.asarray(contact.pressure_Pa), float(line.cell_m)
    a = contacts.hertz_half_width(load, radius, MODULUS)
    # The outermost cells are touched in part: the load's second moment knows, a^2/4 for Hertz.
    moment = np.sum(p * np.asarray(line.x) ** 2) / np.sum(p) - cell**2 / 12
    assert 2 * np.sqrt(moment) == pytest.approx(a, rel=5e-3)
    assert np.sum(contact.touching) * cell / 2 == pytest.approx(a, abs=cell)
    assert p.max() == pytest.approx(2 * load / (np.pi * a), rel=5e-3)


HARD = {
    "ridge": (Ridge(25e-6, 0.9e-3), 3e4),
    "tape": (Tape(50e-6, 0.012), 2e4),
    "groove": (Ridge(-25e-6, 0.9e-3), 3e4),
    "vertical": (Ridge(25e-6, 0.9e-3, 0.0, 0.0), 3e4),
    "light": (Ridge(25e-6, 0.9e-3), 1e-6),
    "heavy": (Ridge(25e-6, 0.9e-3), 1e12),
    "tall": (Ridge(1e-3, 0.9e-3), 3e4),
    "picometre": (Ridge(1e-12, 0.9e-3), 3e4),
    "narrow": (Ridge(25e-6, 2e-6), 3e4),
    "rough": (Rough(5e-6, 3e-3, 2e-5, 0.3, 7), 2e4),
    "rough, lightly": (Rough(20e-6, 3e-3, 2e-5, 0.3, 7), 50.0),
    "beside the window": (Ridge(25e-6, 0.9e-3, 0.05), 3e4),
}


@pytest.mark.full
@pytest.mark.parametrize(("shape", "nominal"), HARD.values(), ids=HARD)
def test_hard_profiles(shape, nominal):
    line = window(2048)
    height = height_of(shape, line)
    contact = solve_contact(line, SKIN, jnp.asarray(height), nominal)
    if np.ptp(height) == 0:
        np.testing.assert_allclose(contact.pressure_Pa, nominal)
    else:
        check(contact, line, height, nominal)


def test_a_flat_surface_is_pressed_evenly():
    contact = solve_contact(window(256), SKIN, jnp.zeros(256), 1e4)
    np.testing.assert_array_equal(contact.pressure_Pa, 1e4)
    np.testing.assert_array_equal(contact.gap_m, 0.0)


@pytest.mark.full
def test_odd_lengths_and_single_precision():
    line = window(1003)
    height = height_of(Ridge(25e-6, 0.9e-3), line)
    double = solve_contact(line, SKIN, height, 3e4)
    assert double.status == "converged"
    with jax.enable_x64(False):
        small = jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), (line, SKIN, height, 3e4))
        single = solve_contact(*small)
        assert single.pressure_Pa.dtype == jnp.float32
        assert single.status == "converged"
    error = np.asarray(single.pressure_Pa) - np.asarray(double.pressure_Pa)
    assert np.linalg.norm(error) < 2e-3 * np.linalg.norm(double.pressure_Pa)


# --- invariances -----------------------------------------------------------------------------


@pytest.mark.full
def test_it_scales_and_shifts_as_elasticity_does():
    """Height, modulus and pressure by one factor; a shift by whole cells; a mirror."""
    line = window(512)
    height = height_of(Rough(5e-6, 3e-3, 2e-4, 0.8, 1), line)
    one = solve_contact(line, SKIN, height, 500.0)
    assert 0.02 < np.mean(one.touching) < 0.98
    stiff = solve_contact(line, HalfSpace(0.5, 7e5 * 8), height, 4000.0)
    np.testing.assert_allclose(stiff.pressure_Pa, 8 * one.pressure_Pa, atol=1e-5)
    high = solve_contact(line, SKIN, 8 * height, 4000.0)
    np.testing.assert_allclose(high.pressure_Pa, 8 * one.pressure_Pa, atol=1e-5)
    rolled = solve_contact(line, SKIN, np.roll(height, 37), 500.0)
    np.testing.assert_allclose(rolled.pressure_Pa, np.roll(one.pressure_Pa, 37), atol=1e-5)
    mirrored = solve_contact(line, SKIN, height[::-1], 500.0)
    np.testing.assert_allclose(mirrored.pressure_Pa, one.pressure_Pa[::-1], atol=1e-5)


@pytest.mark.full
def test_more_load_touches_more():
    line = window(1024)
    height = height_of(Rough(5e-6, 3e-3, 1e-4, 0.8, 3), line)
    areas = [
        float(np.mean(solve_contact(line, SKIN, height, p).touching)) for p in 10.0 ** np.arange(6)
    ]
    assert areas == sorted(areas)
    assert areas[0] < 0.1
    assert areas[-1] == 1.0


# --- derivatives -----------------------------------------------------------------------------

UNITS = {"height_m": 25e-6, "width_m": 0.9e-3, "nominal_pressure_Pa": 3e4, "modulus_Pa": 7e5}


def pressure(relative, line):
    """p over its mean, of a ridge whose parameters are so many times those above."""
    height, width, nominal, modulus = (
        r * unit for r, unit in zip(relative, UNITS.values(), strict=True)
    )
    shape = Ridge(height, width, 0.3e-3, 4e-5)
    skin = HalfSpace(0.5, modulus)
    return press(line, skin, shape.height(line), nominal).pressure_Pa / 3e4


LINE = window(1024)
forward = jax.jit(jax.jacfwd(partial(pressure, line=LINE)))
value = jax.jit(partial(pressure, line=LINE))


@pytest.mark.parametrize("name", UNITS)
def test_derivatives_are_the_differences_where_the_contact_stays(name):
    at, step = list(UNITS).index(name), 1e-6
    one = jnp.ones(4)
    above, below = (value(one.at[at].add(s * step)) for s in (1, -1))
    np.testing.assert_array_equal(above > 0, below > 0)
    differences = (above - below) / (2 * step)
    error = np.linalg.norm(forward(one)[:, at] - differences)
    assert error <= 1e-4 * np.linalg.norm(differences)


@pytest.mark.full
def test_reverse_is_the_transpose_of_forward_also_under_vmap():
    weight = jnp.sin(3e3 * LINE.x)
    points = jnp.ones((3, 4)) * jnp.array([[1.0], [0.7], [1.4]])
    reverse = jax.jit(jax.vmap(jax.grad(lambda r: weight @ pressure(r, LINE))))(points)
    for point, gradient in zip(points, reverse, strict=True):
        np.testing.assert_allclose(gradient, weight @ forward(point), rtol=1e-10)


@pytest.mark.full
@pytest.mark.parametrize(("shape", "nominal"), HARD.values(), ids=HARD)
def test_derivatives_are_finite(shape, nominal):
    line = window(512)

    inputs = height_of(shape, line), jnp.asarray(nominal), jnp.asarray(7e5)
    for gradient in GRADIENT(line, *inputs):
        assert np.all(np.isfinite(gradient))


def total(line, height, nominal, modulus):
    contact = press(line, HalfSpace(0.5, modulus), height, nominal)
    return jnp.sum(jnp.sin(500 * line.x) * contact.pressure_Pa) + jnp.sum(contact.gap_m)


GRADIENT = eqx.filter_jit(jax.grad(total, argnums=(1, 2, 3)))


@pytest.mark.full
def test_no_pressure_is_refused_and_traced_it_is_nan():
    line = window(64)
    height = height_of(Ridge(25e-6, 2e-3), line)
    for nominal in (0.0, -1.0, np.nan, np.inf):
        refused(lambda nominal=nominal: press(line, SKIN, height, nominal), "nominal_pressure_Pa")
    refused(
        lambda: press(line, SKIN, np.where(np.arange(64) == 3, np.nan, height), 1e4),
        "height",
        "finite",
    )
    slope = jax.jit(jax.value_and_grad(lambda p: jnp.sum(press(line, SKIN, height, p).pressure_Pa)))
    assert np.all(np.isnan(slope(jnp.asarray(0.0))))


def test_two_overlapping_ridges():
    """Their heights add, where they overlap too."""
    line = window(1024)
    pair = Surface([Ridge(20e-6, 1e-3, -0.2e-3), Ridge(20e-6, 1e-3, 0.2e-3)])
    height = height_of(pair, line)
    assert float(height.max()) == pytest.approx(40e-6, rel=1e-9)
    check(solve_contact(line, SKIN, height, 2e4), line, height, 2e4)


@pytest.mark.full
def test_the_compliance_of_cells_is_that_of_points_at_long_waves():
    compliance = np.asarray(cell_compliance(LINE, SKIN))
    k = np.asarray(LINE.k)
    assert compliance[0] == 0
    assert compliance[1] == pytest.approx(2 / (MODULUS * k[1]), rel=1e-5)
    assert compliance[-1] == pytest.approx(np.pi / (MODULUS * k[-1]), rel=1e-12)
