"""Some of the study of faults (tests/claims/faults.py), and clean draws that nothing is said of."""

import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.scans import SCENES
from tests.claims.clean_draws import drawn
from tests.claims.faults import METHODS, errors, measured, problem
from tests.tiers import hardest

SAID = [
    ("dead_second", "wiener, friction known", "seems to be dead"),
    ("flipped_one", "wiener, friction known", "of the other sign"),
    ("stuck_half", "gcv, one element", "is stuck"),
    ("clipped_little", "fit of a strip", "is clipped"),
    ("flipped_all", "fit of a strip", "a contact cannot pull"),
    ("quantised", "fit of a strip", "equal to the one before"),
]


@pytest.mark.parametrize(("fault", "method", "words"), hardest(SAID, [], SAID[1:4]))
def test_a_fault_is_said(fault, method, words):
    row = measured(fault, method)
    assert any(words in each for each in row["warnings"])
    assert row["quality"] != "good"


LOST = {  # what is said of samples that are then missing
    "outlier": "1 sample,",
    "impulses": "stand out of the noise",
    "bursts": "stand out of the noise",
    "heavy_tails": "stand out of the noise",
    "clipped_little": "is clipped",
    "lost_as_zeros": "is stuck",
}


def error(fault):
    """The relative error of p and q by Wiener's filter, and what is said."""
    scene = SCENES[METHODS["wiener"].scene]
    made = faulty(faults()[fault], scene, 0)
    stated = problem(made, known_friction=False)
    wrong, truth = errors(made, stated, METHODS["wiener"].method(scene)(stated))
    parts = np.sum(wrong**2, axis=-1) / np.sum(truth**2, axis=-1)
    return float(np.sqrt(np.mean(parts))), stated.warnings


@pytest.mark.parametrize("fault", hardest(LOST, [], ["outlier", "bursts", "lost_as_zeros"]))
def test_samples_at_fault_cost_little(fault):
    clean, said = error("none")
    assert said == ()
    with_fault, said = error(fault)
    assert with_fault < 1.3 * clean
    assert any(LOST[fault] in each and "taken as missing" in each for each in said)


@pytest.mark.claim
def test_nothing_is_said_of_a_clean_scan():
    row = measured("none", "wiener, friction known")
    assert (row["warnings"], row["quality"]) == ([], "good")


@pytest.mark.claim
def test_clean_draws_are_hardly_ever_warned_of():
    """One in twenty at most: of 50 draws then seven or more have a chance of 1 %."""
    assert drawn("wiener, friction known", 50)["warned"] <= 6 / 50
