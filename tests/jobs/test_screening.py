"""One of the random scenes of tests/claims/screening.py, what is left out really left out, and
bursts behind layers: programs that take long to compile."""

import jax
import pytest

from srsinv import config
from srsinv.effects import screen
from srsinv.forward.trace import difference, pair
from tests.claims.random_scenes import configuration
from tests.claims.screening import measured

OF_SURFACES = 3


@pytest.mark.full
def test_what_is_left_out_changes_less_than_its_bound():
    for tolerance, row in measured(OF_SURFACES, is_silenced=False).items():
        assert row["error"] <= row["bound"] <= tolerance


@pytest.mark.full
def test_layers_change_loud_bursts_by_no_more_than_their_bound():
    cfg = config.select_effects(configuration(2), ("layered_skin", "snap_back"))
    cfg["effects"]["snap_back"] |= {"shear_Pa": 1e5, "rate_hz": 200.0}
    both, loud, ideal = (
        config.simulation(config.select_effects(cfg, on))
        for on in (("layered_skin", "snap_back"), ("snap_back",), ())
    )
    with_it, without = pair(both, loud, jax.random.key(0))
    assert difference(pair(both, ideal, jax.random.key(0))[1], with_it) > 0.5
    screening = screen(ideal.scenario, ideal.line, config.effects(cfg), 1e-3)
    change = difference(without, with_it)
    assert 1e-3 < change <= screening.relative_change_bounds["layered_skin"]
