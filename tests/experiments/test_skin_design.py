"""Stiff films, hard layers and backings, against closed forms and other discretisations."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import j1

from experiments.skin_design.backing import patch_compliance
from experiments.skin_design.hard_skin import hardened
from experiments.skin_design.stiff_film import StiffFilm, charge
from srsinv.forward.film import Film
from srsinv.forward.layered import Layered
from srsinv.forward.skin import HalfSpace
from tests.refusals import refused

RUBBER_Pa, DEPTH, WIDTH = 7e5, 0.75e-3, 0.5e-3
K = np.array([50.0, 200, 500, 1000, 2000, 4000, 8000])


def film(modulus=3e9, thickness=28e-6, depth=DEPTH, width=WIDTH):
    return StiffFilm(modulus, 0.35, thickness, width, depth, RUBBER_Pa)


def test_a_thin_sheet_is_the_layer_of_the_stack():
    """The membrane's equation is the limit of a layer that is thin and as stiff in tension."""
    thin, modulus = 1e-6, 84e9
    rubber = {"youngs_modulus_Pa": RUBBER_Pa, "poisson_ratio": 0.5}
    layer = {"thickness_m": thin, "youngs_modulus_Pa": modulus, "poisson_ratio": 0.35}
    stack = Layered([
        rubber | {"thickness_m": DEPTH - thin / 2}, layer, rubber | {"thickness_m": None}
    ])  # fmt: skip
    given = jnp.asarray(K), jnp.asarray(DEPTH)
    in_film, without = (np.asarray(each.transfer(*given)) for each in (stack, HalfSpace()))
    expected = film(modulus, thin).sheet(K) * (without[0] - without[1])
    np.testing.assert_allclose(in_film[0], expected, rtol=5e-3)
    # Stress across the film changes little, and far less than that along it.
    assert np.abs(in_film[1, 0] / without[1, 0] - 1).max() < 0.15
    assert np.all(np.abs(in_film[0]) > 100 * np.abs(without[0]))


def test_a_stiff_strip_in_much_rubber_collects_force_over_its_width():
    waves = np.array([1e-6, 2e3, 8e3])
    a, own = WIDTH / 2, film(3e13, depth=1.0)
    expected = np.pi * a / (4 * 28e-6) * 2 * j1(waves * a) / (waves * a)
    np.testing.assert_allclose(own.strip(waves), expected, rtol=1e-5)
    assert own.strain_ratio < 1e-6


def test_the_film_s_modulus_hardly_matters():
    stiff, stiffer = (film(modulus).strip(np.zeros(1))[0] for modulus in (3e9, 6e9))
    assert stiffer == pytest.approx(stiff, rel=2e-3)
    assert film().strain_ratio < 2e-3


@pytest.mark.parametrize(("depth", "k"), [(DEPTH, 0.0), (DEPTH, 9e3), (0.2e-3, 2e3)])
def test_strip_against_cells(depth, k):
    """Force in even cells, by the spectrum of a periodic line."""
    own, cells, cell = film(depth=depth), 8192, WIDTH / 128
    wave = 2 * np.pi * np.fft.rfftfreq(cells, cell)
    strain = np.append(0, wave[1:] ** 2 * own.compliance(wave[1:]))
    kernel = np.fft.irfft(strain * np.sinc(wave * cell / (2 * np.pi)) ** 2, cells)
    at = np.arange(128)
    matrix = kernel[(at[:, None] - at) % cells] + np.eye(128) / own.tension_N_per_m
    x = (at - 63.5) * cell
    force = np.linalg.solve(matrix, np.cos(k * x) / (4 * own.shear_Pa))
    assert own.strip(np.array([k]))[0] == pytest.approx(force.mean() / 28e-6, rel=0.02)


def test_the_charge_of_a_film_like_rubber_is_that_of_the_theory():
    """With the stress of the rubber itself: along x sigma_x, not its difference from sigma_z."""
    flat = Film(width_m=WIDTH)
    stress = np.asarray(HalfSpace().transfer(jnp.asarray(K), flat.depth_m))
    along = stress[0] / (stress[0] - stress[1])
    expected = flat.charge_transfer(jnp.asarray(stress), jnp.asarray(K))
    np.testing.assert_allclose(charge(flat, stress, along, 1.0, 0.5), expected, rtol=1e-9)


def test_a_hard_layer_as_soft_as_the_skin_is_no_layer():
    given = jnp.asarray(K), jnp.asarray(DEPTH)
    layered, half = hardened(2e-4, RUBBER_Pa, 1.0), HalfSpace()
    np.testing.assert_allclose(layered.transfer(*given), half.transfer(*given), atol=1e-12)


def test_a_wide_contact_on_foam_yields_by_its_thickness():
    """At a Poisson's ratio of 0 it is h/E, and less by the free sides of a narrow contact."""
    foam = Layered([{"thickness_m": 5e-3, "youngs_modulus_Pa": 5e4, "poisson_ratio": 0.0}])
    assert patch_compliance(foam, 1.0) == pytest.approx(5e-3 / 5e4, rel=1e-2)
    assert patch_compliance(foam, 5e-3) < 0.8 * 5e-3 / 5e4


def test_bad_layers_are_refused():
    refused(lambda: hardened(2e-4, RUBBER_Pa, -1.0), "youngs_modulus_Pa", "positive")
