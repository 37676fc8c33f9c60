"""The hard cases of the inversions in a short form: nothing that is called good is wrong."""

import numpy as np
import pytest
from hydra import compose, initialize_config_dir

from srsinv.__main__ import find_config_root
from tests.jobs.run import check_page, outcome
from tests.refusals import refused

pytestmark = pytest.mark.full

KEPT = ("none", "angle_1e12", "noise_80_above", "small_prior", "all_clipped")
SHORT = (
    "grid.cells=64",
    "~method.wiener_direct",
    "~method.wiener_iterative",
    "~method.tikhonov_gcv",
)


@pytest.fixture(scope="module")
def found():
    with initialize_config_dir(str(find_config_root()), version_base="1.3"):
        cases = compose("config", ["experiment=hard_cases"]).hard_cases.cases
    left_out = [f"~hard_cases.cases.{name}" for name in cases if name not in KEPT]
    left_out += [
        f"~hard_cases.cases.small_prior.method.wiener_{path}" for path in ("direct", "iterative")
    ]
    return outcome("experiment=hard_cases", *SHORT, *left_out)


def test_page(found):
    check_page(found, images=("error_p", "error_q", "over_band", "condition"))


def test_nothing_that_is_called_good_is_wrong(found):
    for precision in ("float64", "float32"):
        assert found.metrics[f"silent_failures_{precision}"] == 0
        assert found.metrics[f"good_{precision}"] >= 3
        assert found.metrics[f"refused_{precision}"] == 3  # nothing but clipped samples


def test_the_words_fit_the_case(found):
    reasons = found.dataset["reasons"].sel({"precision": "float64", "method": "Wiener"})
    assert "The residual is" in str(reasons.sel(case="Wiener's prior a millionth").values)
    assert "The signal tells" in str(reasons.sel(case="noise 80 dB above the signal").values)
    assert "one mix" in str(reasons.sel(case="elements 1e-12 rad apart").values)
    assert str(reasons.sel(case="nothing is hard").values) == ""
    assert np.isnan(found.dataset["condition"].values).sum() == 6
    assert np.sum(found.dataset["quality"].values == "refused") == 6


def test_no_case_is_refused():
    refused(lambda: outcome("experiment=hard_cases", "~hard_cases.cases"), "hard_cases.cases")
