"""The paper's Figs. 10 and 11: theory, a measured kernel and the true one on the same signals."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.inverse.kernel.measured import load_kernel
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run

FORMS = ("fig10_11",)

test_nothing_has_moved = golden_test(FORMS)


@pytest.mark.full
def test_the_measured_kernel_is_better_than_theory():
    metrics = short_run("fig10_11").metrics
    assert metrics["error_p_measured"] < 0.8 * metrics["error_p_theoretical"]
    assert metrics["error_p_true"] < 0.8 * metrics["error_p_theoretical"]
    assert metrics["error_ratio_p_floor"] == pytest.approx(
        metrics["error_p_true"] / metrics["error_p_theoretical"]
    )
    excess = metrics["error_p_theoretical"] ** 2 - metrics["error_p_true"] ** 2
    assert metrics["excess_error_p_theoretical"] == pytest.approx(np.sqrt(excess))


@pytest.mark.full
def test_what_theory_leaves_repeats_and_what_the_measured_kernel_leaves_does_not():
    metrics = short_run("fig10_11").metrics
    assert metrics["residual_repeating_share_theoretical"] > 0.95
    assert metrics["residual_repeating_share_measured"] < 0.3


@pytest.mark.full
def test_page_and_files(tmp_path):
    result = short_run("fig10_11")
    check_page(result)
    for name in ("kernel.nc", "fitted_kernel.nc"):
        path = tmp_path / name
        path.write_bytes(result.files[name])
        assert len(load_kernel(path).value) == 2


@pytest.mark.claim
@pytest.mark.parametrize(
    "changed",
    [
        ("calibration=line", "passes=10"),
        ("calibration=step", "passes=100"),
        ("skin@truth.skin=layered", "truth.depth_m=0.00075", "truth.tilt_deg=0", "truth.blur_m=0"),
    ],
    ids=["line", "step", "layers"],
)
def test_excess_error_is_at_most_a_quarter_of_that_of_theory(changed):
    metrics = outcome("experiment=fig10_11", "draws=2", *changed).metrics
    assert metrics["excess_ratio_p_measured"] < 0.25
    assert metrics["excess_ratio_p_fitted"] < 0.25


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("calibration=wedge", "calibration is 'wedge'"),
        ("passes=0", "passes is 0: give a whole number from 1"),
        ("truth.depth_m=-1", "truth.depth_m is -1"),
        ("truth.gain=0", "truth.gain is 0"),
        ("method=[wiener,tikhonov]", "give one, by which the kernels are compared"),
        ("effects=[strip_width,snap_back,sampling]", "takes one sample per cell"),
    ],
)
def test_bad_input(override, sentence):
    with pytest.raises(BadInput, match=sentence):
        outcome(*short_form("fig10_11"), override)
