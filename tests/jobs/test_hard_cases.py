"""The hard cases of the inversions in a short form: nothing that is called good is wrong."""

import numpy as np
import pytest

from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_run
from tests.refusals import refused

pytestmark = pytest.mark.full

FORMS = ("hard_cases",)

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def result():
    return short_run(*FORMS)


def test_page(result):
    check_page(result, images=("error_p", "error_q", "z_rms", "condition"))


def test_nothing_that_is_called_good_is_wrong(result):
    for precision in ("float64", "float32"):
        assert result.metrics[f"silent_failures_{precision}"] == 0
        assert result.metrics[f"good_{precision}"] >= 3
        assert result.metrics[f"refused_{precision}"] == 3  # nothing but clipped samples


def test_the_words_fit_the_case(result):
    reasons = result.dataset["reasons"].sel({"precision": "float64", "estimator": "Wiener"})
    assert "The residual is" in str(reasons.sel(case="Wiener's prior a millionth").values)
    assert "The signal resolves" in str(reasons.sel(case="noise 80 dB above the signal").values)
    assert "one mix" in str(reasons.sel(case="elements 1e-12 rad apart").values)
    assert str(reasons.sel(case="nothing is hard").values) == ""
    assert np.isnan(result.dataset["condition"].values).sum() == 6
    assert np.sum(result.dataset["quality"].values == "refused") == 6


def test_no_case_is_refused():
    refused(lambda: outcome("experiment=hard_cases", "~hard_cases.cases"), "hard_cases.cases")
