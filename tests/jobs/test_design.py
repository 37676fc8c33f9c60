"""Designs of sensors in short forms: what a run gives, and what it refuses."""

import numpy as np
import pytest

from tests.golden.check import golden_test
from tests.jobs.run import check_page, short_outcome, short_run, words
from tests.refusals import refused

FORMS = ("design", "design_ridge")

test_nothing_has_moved = golden_test(FORMS)


@pytest.mark.full
@pytest.mark.parametrize("name", FORMS)
def test_page_is_whole(name):
    check_page(short_run(name))


@pytest.mark.full
def test_optimum_is_within_the_bounds_and_better():
    m, data = short_run("design").metrics, short_run("design").dataset
    best = data.sel(design="optimum")
    assert np.all((best["depth"] >= 5e-4) & (best["depth"] <= 2e-3))
    assert np.all((best["width"] >= 3e-4) & (best["width"] <= 2e-3))
    assert np.all((best["angle"] >= 0) & (best["angle"] < 180))
    assert m["factor"] == pytest.approx(m["error_given"] / m["error_optimum"])
    assert m["factor"] > 1.2
    assert m["gain_of_grid"] < 1e-6
    assert m["gradient_difference"] < 1e-7
    assert m["error_per_depth_1"] > 0  # the cover limits the error
    for name in ("depth", "width", "angle"):
        assert m["error_optimum"] <= data[f"{name}_profile"].min() + 1e-9
        assert m["error_optimum"] <= m[f"error_{name}_alone"]


@pytest.mark.full
def test_slope_at_the_cover_is_what_less_cover_gains():
    before, step = short_run("design").metrics, 1e-5
    after = short_outcome("design", f"design.depth_m=[{5e-4 - step},0.002]").metrics
    gain = (before["error_optimum"] - after["error_optimum"]) / step
    assert gain == pytest.approx(before["error_per_depth_1"], rel=0.02)


@pytest.mark.full
def test_page_names_what_limits_and_what_has_no_effect():
    text = words(short_run("design"))
    assert "at the least depth" in text
    assert "None" not in text
    assert "No effect on the error: offset" in text


@pytest.mark.full
def test_one_element_detects_by_its_own():
    m = short_run("design_ridge").metrics
    assert m["least_height_optimum_m"] < m["least_height_depth_alone_m"]
    for which in ("given", "optimum"):
        # The skin lifts off beside the ridge, which then is as wide as the lifted stretch.
        by_contact = m[f"least_height_contact_{which}_m"] / m[f"least_height_{which}_m"]
        assert 0.8 < by_contact < 1


REFUSED = [
    (("noise=[snr]",), "in proportion to the signal"),
    (("grid.line=open",), "grid.line=periodic"),
    (("scan.speed_m_per_s=-0.05",), "positive speed"),
    (("design.elements=9",), "from 1 to 8"),
    (("design.task=height",), "least_height"),
    (("design.free=[offset]",), "does not depend"),
    (("design.grid_designs=3",), "design.grid_designs=12"),
    (("grid.cells=128",), "grid.cells=480"),
    (("design.error.correlation_m=0",), "design.error.correlation_m is 0"),
    (("design.growth=0",), "design.growth is 0"),
    (("design.error=null",), "design.error is null"),
    (("precision=float32",), "give float64"),
    (("sensor.piezo_constants_C_per_N={d1:0,d2:0,d3:0}",), "constants other than 0"),
]


@pytest.mark.full
@pytest.mark.parametrize(("overrides", "said"), REFUSED)
def test_refusals(overrides, said):
    refused(lambda: short_outcome("design", *overrides), said)
