"""Some of the study of faults (tests/claims/faults.py), and clean draws that nothing is said of."""

import pytest

from tests.claims.clean_draws import drawn
from tests.claims.faults import measured
from tests.tiers import quick

SAID = [
    ("dead_second", "wiener, friction known", "seems to be dead"),
    ("flipped_one", "wiener, friction known", "of the other sign"),
    ("stuck_half", "gcv, one element", "is stuck"),
    ("clipped_little", "fit of a strip", "is clipped"),
    ("flipped_all", "fit of a strip", "a contact cannot pull"),
    ("quantised", "fit of a strip", "equal to the one before"),
]


@pytest.mark.full
@pytest.mark.parametrize(("fault", "method", "words"), quick(SAID, SAID[2]))
def test_a_fault_is_said(fault, method, words):
    row = measured(fault, method)
    assert any(words in each for each in row["warnings"])
    assert row["quality"] != "good"


@pytest.mark.claim
def test_nothing_is_said_of_a_clean_scan():
    row = measured("none", "wiener, friction known")
    assert (row["warnings"], row["quality"], row["rejected"]) == ([], "good", False)


@pytest.mark.claim
def test_clean_draws_are_hardly_ever_warned_of():
    """One in twenty at most: of 50 draws then seven or more have a chance of 1 %."""
    assert drawn("wiener, friction known", 50)["warned"] <= 6 / 50
