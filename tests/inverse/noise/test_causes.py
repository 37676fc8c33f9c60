"""What a misfit comes from: the fact that is wrong is named, with what it is."""

import numpy as np
import pytest

from experiments.robustness.faults import faults, faulty
from experiments.robustness.scans import SCENES
from srsinv.inverse.noise.causes import LikelyCause
from srsinv.inverse.noise.correlated import cell_noise
from tests.inverse.noise.test_correlated import DEPTH_M, TWO, as_white
from tests.tiers import quick

WRONG = {
    "gain_of_one_20": ("gain_2", 1.2, 0.03),
    "angle_10": ("angle_2_deg", 80.0, 1.0),
    "element_offset": ("offset_2_m", 3e-4, 3e-5),
    "saturated": ("saturation", 1 - 0.9 * np.tanh(1 / 0.9), 0.03),
}


@pytest.mark.parametrize("fault", quick(WRONG, "angle_10"))
def test_the_fact_that_is_wrong_is_named_with_its_value(fault):
    name, value, within = WRONG[fault]
    for seed in range(2):
        made = faulty(faults()[fault], SCENES[TWO], seed)
        (found,) = cell_noise(as_white(made, cell_m=2e-4), DEPTH_M).causes
        assert found.name == name
        assert found.value == pytest.approx(value, abs=within)


def test_every_cause_has_words():
    names = (
        "gain_2", "angle_2_deg", "offset_2_m", "depth_m", "low_pass_1_Hz", "low_pass_Hz",
        "saturation", "hum_Hz", "load_m",
    )  # fmt: skip
    said = [LikelyCause(name, 0.5).words for name in names]
    assert len({*said}) == len(names)


def test_a_wrong_fact_is_named_where_friction_is_known():
    made = faulty(faults()["gain_of_one_20"], SCENES[TWO], 0)
    (found,) = cell_noise(as_white(made, cell_m=2e-4, is_apart=False), DEPTH_M).causes
    assert found.name == "gain_2"
    assert found.value == pytest.approx(1.2, abs=0.05)
