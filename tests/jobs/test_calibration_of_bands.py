"""Whether bands are calibrated: ranks that are uniform, and ranks that are not."""

import numpy as np
import pytest

from experiments.calibration_of_bands.ranks import RankTest, normal_rank
from tests.golden.check import golden_test
from tests.jobs.run import check_page, short_run

FORMS = ("calibration_of_bands",)
test_nothing_has_moved = pytest.mark.full(golden_test(FORMS))


def ranks(draws: int, bias: float = 0.0, size: float = 1.0) -> np.ndarray:
    """Of truths that are normal about the value with another bias and size than stated."""
    return normal_rank(bias + size * np.random.default_rng(0).standard_normal(draws), 0.0, 1.0)


def test_the_p_value_of_uniform_ranks_is_uniform():
    """So that one in a thousand methods is rejected at 1e-3; few ranks are joined in fewer bins."""
    rng = np.random.default_rng(1)
    for draws in (30, 400):
        found = [RankTest.of(rng.random(draws), 20).p_value for _ in range(400)]
        low, high = np.quantile(found, [0.1, 0.9])
        assert 0.06 < low < 0.14
        assert 0.85 < high <= 1.0


@pytest.mark.parametrize("broken", [{"size": 1.4}, {"size": 0.7}, {"bias": 0.4}])
def test_wrong_bands_are_found(broken):
    assert RankTest.of(ranks(400), 20).p_value > 1e-3
    assert RankTest.of(ranks(400, **broken), 20).p_value < 1e-4


def test_the_coverage_and_the_band_of_counts():
    """Of normal errors 1.4 times those stated: 2 Phi(1.645 / 1.4) - 1 = 76 %."""
    test = RankTest.of(ranks(20_000, size=1.4), 20)
    np.testing.assert_allclose(test.coverage, 0.7599, atol=0.01)
    np.testing.assert_allclose(test.density.mean(), 1.0)
    low, high = RankTest.of(ranks(20_000), 20).band
    assert 0.85 < low < 1.0 < high < 1.15


@pytest.mark.full
def test_page_and_verdicts():
    result = short_run("calibration_of_bands")
    check_page(result)
    metrics = result.metrics
    assert metrics["methods_calibrated"] == metrics["methods"] == 6
    assert metrics["broken_is_found"]
    assert 0.86 < float(metrics["coverage_of_all"] or 0.0) < 0.94
