"""Scales that are wrong: pressures that no skin bears."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import pytest

import srsinv
from srsinv.forward.feature import StripFeature
from srsinv.forward.layered import Layered
from srsinv.forward.skin import HalfSpace
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.inverse.features import FeatureFit
from srsinv.inverse.wiener import Exponential, Wiener
from srsinv.recorded import problem_of, ready
from srsinv.recording import load
from tests.tiers import quick

EXAMPLE = Path(srsinv.__file__).parent / "examples" / "strip_two_element.csv"
WORDS = "Young's modulus"


def recorded(factor=1.0, unit="V"):
    """The bundled recording of a strip of 6 kPa, its signals times a factor."""
    recording = ready(load(EXAMPLE))
    return replace(recording, signal=factor * recording.signal, signal_unit=unit)


# Factor on the signals: whether a skin of 700 kPa bears what they say.
FACTORS = {1.0: True, 50.0: True, 1e3: False, -1e3: False}


@pytest.mark.parametrize("factor", quick(FACTORS, 1.0, -1e3))
def test_a_load_beyond_the_skins_modulus_is_doubtful(factor):
    problem = problem_of(recorded(factor))
    fitted = FeatureFit({"strip": StripFeature()})(problem)
    prior = Exponential(1e3 * abs(factor), 1e-3)
    inverted = Wiener(prior, prior)(problem.to_grid())
    for estimate in (fitted, inverted):
        assert any(WORDS in each for each in estimate.warnings) != FACTORS[factor]
        assert FACTORS[factor] or estimate.quality != "good"
    assert fitted.quality == "good" or factor != 1.0


def test_an_estimate_of_ones_own_has_the_check():
    line = problem_of(recorded(1e3)).to_grid()
    p = jnp.zeros((line.unknowns, line.line.n)).at[0, line.line.n // 2].set(1e6)
    assert any(WORDS in each for each in line.estimate(p).warnings)
    assert not any(WORDS in each for each in line.estimate(0.1 * p).warnings)


LAYER = {"thickness_m": 1e-3, "youngs_modulus_Pa": 2e5, "poisson_ratio": 0.5}
BELOW = {"thickness_m": None, "youngs_modulus_Pa": 1e4, "poisson_ratio": 0.3}


def test_the_modulus_is_that_at_the_surface_and_the_largest():
    assert HalfSpace(0.5, 7e5).surface_modulus_Pa == 7e5
    assert Layered([LAYER, BELOW]).surface_modulus_Pa == 2e5
    lagging = Viscoelastic(HalfSpace(0.5, 7e5), [1.0], [1e-3])
    assert lagging.surface_modulus_Pa == pytest.approx(1.4e6)
