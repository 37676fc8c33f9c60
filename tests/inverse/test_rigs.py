"""Calibrations of thirty random rigs: intervals that cover as they say.

Those of `python -m tests.claims.rigs`, made quick: strips of no width, 300 samples over fifteen
depths, two strips and one way.
"""

import numpy as np
import pytest
from scipy.stats import binom, chi2

from srsinv.inverse.quality import Quality
from tests.claims.rig_scans import Setup, random_rig
from tests.claims.rigs import BAND, LIMIT, calibrated, pulls

RIGS = 30
QUICK = Setup(samples=300, scan_depths=15.3, window_depths=19.9, average=False)
FALSE_ALARM = 1e-4  # of each bound: three of each of seven parameters, one draw in 500 in all


def _pulls(seed: int) -> dict[str, float]:
    rng = np.random.default_rng([seed, 3])
    rig = random_rig(rng, setup=QUICK)
    made = calibrated(rig, rng)
    assert made.quality is not Quality.FAILED
    return pulls(rig, made)


@pytest.mark.full
def test_intervals_of_thirty_rigs_cover():
    """At least 20 of 30 intervals, where 27 are expected, and pulls whose squares add up to 9.3 to
    67, where 30 are."""
    every = [_pulls(seed) for seed in range(RIGS)]
    least, most = chi2.ppf([FALSE_ALARM, 1 - FALSE_ALARM], RIGS)
    for name in every[0]:
        own = np.array([each[name] for each in every])
        assert np.sum(np.abs(own) <= LIMIT) >= binom.ppf(FALSE_ALARM, RIGS, BAND), name
        assert least < np.sum(own**2) < most, name
