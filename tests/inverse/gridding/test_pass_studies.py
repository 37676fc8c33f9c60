"""The studies of disturbances and of passes on few draws: bounds are three standard errors wide."""

import numpy as np
import pytest

from tests.claims import disturbances, passes
from tests.claims.disturbances import CLEAN

pytestmark = pytest.mark.full


def is_at_most(ratio, most):
    value, stderr = ratio
    return value < most + 3 * stderr


@pytest.mark.parametrize(
    "motion",
    ["six passes, 20 mm/s", pytest.param("one pass, 20 mm/s", marks=pytest.mark.claim)],
)
def test_hum_costs_less_than_a_tenth(motion):
    scans = disturbances.scans_of(motion)
    sizes = disturbances.hum_draws(scans, (4, 0, 2))[0]
    for size, tally in sizes.items():
        rows = tally.summary(1.0)
        assert is_at_most(rows["mains"]["over_clean"], 1.1)
        assert rows["mains"]["coverage"] > 0.8
        if float(size) >= 1:
            assert rows["untreated"]["over_clean"][0] > 2


def test_drift_that_is_stated_costs_what_the_exact_posterior_says():
    scans = disturbances.scans_of("one pass, 20 mm/s")
    rows = disturbances.drift_case(scans, 0.1, (20, 0, 2))["weights held"]
    assert is_at_most(rows["stated"]["over_exact_of_same_draws"], 1.05)
    assert rows["stated"]["coverage"] > 0.75
    assert rows[CLEAN]["coverage"] > 0.8
    assert rows["high-pass"]["coverage"] < 0.5


def test_errors_of_averaged_passes_follow_the_floor():
    scans = [passes.scans_of(count) for count in (2, 8)]
    one, many = (passes.measured(each, (12, 0), each is scans[1]) for each in scans)
    noise = [passes.noise_of_mean(each, 5) for each in scans]
    assert noise[1] == pytest.approx(noise[0], rel=0.06)
    for each in (one, many):
        for row in each["weights held"].values():
            assert is_at_most(row["over_floor"], 1.05)
            assert row["coverage"] > 0.8
    gain = np.array(one["floor_Pa"]) / many["floor_Pa"]
    assert np.all((gain > 1) & (gain < 1.3))  # far less than twice
    for row in many["shifts"].values():
        assert is_at_most(row["over_floor"], 1.1)
