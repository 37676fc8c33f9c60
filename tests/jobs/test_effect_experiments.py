"""The experiments on effects in short forms."""

import numpy as np
import pytest

from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_run

pytestmark = pytest.mark.full

FORMS = ("effects", "effects_auto", "fig09_sliding_impulse", "model_error")

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def outcomes():
    return {name: short_run(name) for name in FORMS}


@pytest.mark.parametrize("name", FORMS)
def test_page(name):
    check_page(short_run(name), images=("bounds",))


def test_each_effect_is_within_its_bound():
    metrics = short_run("effects").metrics
    for name in ("film_angle", "speed_ripple", "clipping"):
        assert 0.01 < metrics[f"change_{name}"] <= 1.05 * metrics[f"bound_{name}"], name


def test_what_scenes_leave_out_is_within_the_tolerance():
    result = short_run("effects_auto")
    assert result.metrics["error_over_tolerance_max"] < 1
    on = result.dataset["on"].values.sum(-1)[0]
    assert 0 < on[0] < on[1] < 16


def test_tilt_takes_of_the_leading_lobe_and_bursts_scatter_it(outcomes):
    metrics = outcomes["fig09_sliding_impulse"].metrics
    assert metrics["leading_lobe_ratio"] < 0.9 < 1.05 < metrics["trailing_lobe_ratio"]
    assert metrics["leading_lobe_scatter"] > 0.005
    assert 1e-4 < metrics["finest_wavelength_m"] < 3e-3


def test_a_wrong_sensor_is_worse_than_the_right_one(outcomes):
    metrics = outcomes["model_error"].metrics
    for name in ("layered", "tilted", "deeper", "all_three"):
        assert metrics[f"error_q_{name}"] > 1.2 * metrics["error_q_as_assumed"]
    gain = outcomes["model_error"].dataset["gain"].sel(component_out="p", component_in="p")
    # A long wave's p is recovered whole by the right sensor, and a deeper one's as well.
    np.testing.assert_allclose(gain.sel(case=["as assumed", "deeper"])[:, 0], 1.0, atol=0.02)
    assert abs(gain.sel(case="layered")[1] - 1) > 0.05


@pytest.mark.parametrize("effect", ["layered_skin", "antialias_filter", "speed_ripple"])
def test_a_sensor_is_inverted_with_the_effects_that_it_has(effect):
    """As well as the ideal one; not so where the inversion does not know of them (model_error)."""
    small = ("grid.cells=256", "grid.refinement=2", "method=wiener")
    with_effect, ideal = (
        outcome(*small, f"effects=[{','.join(names)}]").metrics
        for names in (("strip_width", effect), ("strip_width",))
    )
    assert with_effect["status_wiener"] == "converged"
    assert with_effect["error_p_wiener"] < 1.3 * ideal["error_p_wiener"] < 0.13
    assert with_effect["error_q_wiener"] < 1.3 * ideal["error_q_wiener"] < 0.13
