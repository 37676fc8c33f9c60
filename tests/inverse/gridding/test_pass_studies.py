"""The studies of disturbances and of passes on few draws: bounds are three standard errors wide."""

import pytest

from tests.claims import disturbances, passes
from tests.claims.disturbances import CLEAN, SIZES
from tests.claims.disturbing import Hum


def is_at_most(ratio, most):
    value, stderr = ratio
    return value < most + 3 * stderr


@pytest.mark.claim
@pytest.mark.parametrize("motion", ["six passes, 20 mm/s", "one pass, 20 mm/s"])
def test_hum_costs_less_than_a_tenth(motion):
    scans = disturbances.scans_of(motion)
    for size in SIZES["hum"]:
        rows = disturbances.tallies(Hum(scans, size), (4, 0, 2))[0].summary(1.0)
        assert is_at_most(rows["mains"]["over_clean"], 1.1)
        assert rows["mains"]["coverage"] > 0.8
        if size >= 1:
            assert rows["untreated"]["over_clean"][0] > 2


@pytest.mark.claim
def test_drift_that_is_stated_costs_what_the_exact_posterior_says():
    rows = disturbances.measured("drift", "one pass, 20 mm/s", 0.1, (20, 0, 2))["weights held"]
    assert is_at_most(rows["stated"]["over_exact_of_same_draws"], 1.05)
    assert rows["stated"]["coverage"] > 0.75
    assert rows[CLEAN]["coverage"] > 0.8
    assert rows["high-pass"]["coverage"] < 0.5


@pytest.mark.claim
def test_errors_of_averaged_passes_follow_the_floor():
    draws = {passes.NOISE: 5, **dict.fromkeys((passes.HELD, "shifts"), 12)}
    one, many = (
        {name: passes.measured(2, count, name, number) for name, number in draws.items()}
        for count in (2, 8)
    )
    noise = [each[passes.NOISE]["times_root_of_passes"] for each in (one, many)]
    assert noise[1] == pytest.approx(noise[0], rel=0.06)
    for name in "pq":
        each = [own[passes.HELD][name] for own in (one, many)]
        for row in each:
            assert is_at_most(row["over_floor"], 1.05)
            assert row["coverage"] > 0.8
        assert 1 < each[0]["floor_Pa"] / each[1]["floor_Pa"] < 1.3  # far less than twice
        assert is_at_most(many["shifts"][name]["over_floor"], 1.1)
