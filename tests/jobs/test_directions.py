"""Strips in several directions in a short form: no direction is nearly blind."""

import numpy as np
import pytest

from tests.golden.check import golden_test
from tests.jobs.run import check_page, short_run

pytestmark = pytest.mark.full

FORMS = ("directions",)

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def result():
    return short_run(*FORMS)


def test_several_directions_cover_what_a_pair_loses(result):
    for feature in ("ridge", "grating"):
        own, pair = (
            result.metrics[f"information_worst_over_best_{feature}_{name}"]
            for name in ("own", "pair")
        )
        assert own > 0.1
        assert pair < 0.01


def test_weights_are_shares(result):
    weight = result.dataset["weight"].values
    np.testing.assert_allclose(weight.sum(axis=0), 1.0, rtol=1e-12)


def test_page_is_whole(result):
    check_page(result)
