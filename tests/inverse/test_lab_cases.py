"""Some of the study of what laboratories have (tests/claims/lab_cases.py)."""

import json

import pytest

from tests.claims.lab_cases import answers, is_beyond
from tests.claims.study import RESULTS

# A ridge in a prior of smooth tractions, and weak hum that a quarter of a second does not tell from
# a texture.
KNOWN = {"ridge_inverted: wiener", "hum_03_fast: wiener"}


def test_what_is_good_and_beyond_is_known():
    """Else: python -m tests.claims lab_cases."""
    assert set(json.loads((RESULTS / "lab_cases.json").read_text())["good_and_beyond"]) == KNOWN


@pytest.mark.claim
@pytest.mark.parametrize("case", ["slip_100um", "tape_edge_3"])
def test_no_answer_is_good_and_beyond(case):
    for by, row in answers(case).items():
        assert row["quality"] != "good" or not is_beyond(row), by
