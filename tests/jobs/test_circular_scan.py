"""The circle's experiment in a short form: what its numbers must say, and that its figures draw."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run

pytestmark = pytest.mark.full

FORMS = ("circular_scan",)

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def result():
    return short_run(*FORMS)


@pytest.mark.parametrize("angle", ["10", "90"])
def test_direction(result, angle):
    assert abs(result.metrics[f"direction_error_deg_at_{angle}"]) < 2


def test_gain_falls_to_nothing(result):
    gain = result.dataset["gain"].values
    assert np.all(gain[:, 0] == 1)
    assert np.all(np.diff(gain) < 0)
    assert np.all(gain[:, -1] == 0)


def test_page_is_whole(result):
    check_page(result)


@pytest.mark.parametrize("override", ["angles_deg=[]", "shown_deg=[45.0]"])
def test_refused(override):
    with pytest.raises(BadInput, match=f"{override.partition('=')[0]} is"):
        outcome(*short_form(*FORMS), f"circular_scan.{override}")
