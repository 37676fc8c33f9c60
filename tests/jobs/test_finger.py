"""How the finger touches, in short forms: a contact zone of finite width, and varying friction."""

import numpy as np
import pytest

from tests.golden.check import golden_test
from tests.jobs.run import check_page, short_run

pytestmark = pytest.mark.full

FORMS = ("finite_patch", "varying_friction")
FITS = "varying_friction"  # takes a fit for each exponent

test_nothing_has_moved = golden_test(FORMS, claims=(FITS,))


@pytest.mark.parametrize("name", [FORMS[0], pytest.param(FITS, marks=pytest.mark.claim)])
def test_page(name):
    check_page(short_run(name))


def test_a_wider_zone_changes_less_and_ridges_select_their_pitch():
    data = short_run("finite_patch").dataset
    narrow, wide = data["change"].values.T
    assert np.all(narrow < 0.2)
    assert np.all(narrow > 2 * wide)
    gain = data["ridge_gain"]
    assert gain.sel(wavelength=4e-4, method="nearest") > 100
    assert gain.sel(wavelength=5e-3, method="nearest") == pytest.approx(1, abs=0.01)


@pytest.mark.claim
def test_a_fit_of_constant_friction_takes_falling_friction_for_less():
    data = short_run(FITS).dataset
    falling = data.sel(exponent=0.2)
    assert falling["change_p"] == 0
    assert 0.1 < falling["change_q"] < 1
    less = data["base_friction"].sel(exponent=0) - falling["base_friction"]
    assert less > 5 * falling["base_friction_stderr"]
