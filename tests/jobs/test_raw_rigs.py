"""A rig's own files through the four commands of README, by what inspection offers alone."""

import dataclasses

import pytest

from srsinv.inverse.quality import Quality
from tests.claims.raw_rig_list import RIGS
from tests.claims.raw_rigs import row


@pytest.mark.claim
def test_an_awkward_rig_is_calibrated_fitted_and_inverted(tmp_path):
    """One strip of reversed polarity, there and back, centimetres and decimal commas."""
    rig = dataclasses.replace(RIGS[1], rate_hz=1000.0)
    made = row(rig, tmp_path)
    for stage in ("calibrated", "fitted"):
        assert made[stage]["quality"] == Quality.GOOD
        pulls = [each[3] for each in made[stage].values() if isinstance(each, list)]
        assert len(pulls) == 3
        assert max(map(abs, pulls)) < 3
    for method in made["inverted"].values():
        assert method["quality"] == Quality.GOOD
        assert method["coverage"] > 0.85
