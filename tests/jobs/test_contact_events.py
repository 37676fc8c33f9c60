"""Contact events in a short form: their page, numbers and refusals."""

import numpy as np
import pytest

from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_run
from tests.refusals import refused

FORMS = ("contact_events",)

test_nothing_has_moved = golden_test(FORMS)


@pytest.mark.full
def test_page_and_numbers():
    """Of a contact that slips from its edges inwards, and events that matched filters find."""
    check_page(short_run(*FORMS))
    result = short_run(*FORMS)
    metrics, data = result.metrics, result.dataset
    assert float(data["greatest_half_width_error"]) < 1e-3
    assert metrics["detected_first_contact"] == metrics["detected_edge"] == 1
    contact, stick = data["contact_half_width"].values, data["stick_half_width"].values
    assert np.all(stick <= contact)
    time = data["time"].values
    before, after = (time > 0.16) & (time < 0.35), (time > 0.48) & (time < 1.2)
    np.testing.assert_allclose(stick[before], contact[before])
    assert not stick[after].any()
    assert np.all(np.diff(data["matched_operating"].values, axis=-1) >= 0)


@pytest.mark.full
def test_settings_out_of_bounds_are_refused():
    def asked(*words):
        return lambda: outcome("experiment=contact_events", *words)

    own = "contact_events."
    refused(asked(f"{own}start_s=[0.1,0.2]"), "start_s", "three numbers")
    refused(asked(f"{own}start_s=[0.1,0.12,1.2]"), "order touch, pull, edge, release")
    refused(asked(f"{own}shear_ratios=[1.0]"), "shear_ratios")
    refused(asked(f"{own}samples=5000"), "samples", "at least 6051")
    refused(asked("effects=[layered_skin]"), "partial slip is not solved")
    refused(asked("noise=[]"), "noise=[johnson]")
    refused(asked("noise=[sliding]"), "at rest")
