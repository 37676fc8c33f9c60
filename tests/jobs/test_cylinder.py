"""The cylinder's experiment in a short form, coverage of a cylinder's fit, and refusals."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run

FORMS = ("cylinder",)

test_nothing_has_moved = golden_test(FORMS, claims=FORMS)


@pytest.fixture(scope="module")
def result():
    return short_run(*FORMS)


@pytest.mark.claim
def test_radius_and_angle_are_found(result):
    found = result.dataset
    assert np.all(found["error_over_bound"] < 3)
    assert np.all(found["identified"] == 1)
    assert np.all(found["contact_width"] < 0.2 * float(found["resolved_wavelength_m"]))


@pytest.mark.claim
def test_page_is_whole(result):
    check_page(result)


@pytest.mark.claim
def test_coverage_of_a_scenes_cylinder():
    given = "experiment=coverage scene=cylinder feature=[] coverage.draws=8 coverage.angle_deg=30"
    metrics = outcome(*given.split(), "noise.snr.snr_dB=50").metrics
    assert metrics["cylinder_converged"] == 8
    for part in ("radius_m", "angle_rad", "position_m", "base_friction"):
        over = metrics[f"cylinder_{part}_rmse_over_crb"]
        assert over == pytest.approx(1.05, abs=0.65), part


@pytest.mark.parametrize("override", ["radii_m=[]", "angle_deg=0", "draws=1", "load_N_per_m=-1"])
def test_refused(override):
    with pytest.raises(BadInput, match=f"cylinder.{override.partition('=')[0]}"):
        outcome(*short_form("cylinder"), f"cylinder.{override}")
