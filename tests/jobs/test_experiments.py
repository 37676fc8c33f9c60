"""The experiments in short forms: what their numbers must say, and that their figures draw."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run

FORMS = ("elements", "fig05_orientation", "fig06_spectra", "two_element")

test_nothing_has_moved = golden_test(FORMS, "fig05_orientation")


def run(name, *overrides):
    """The outcome of an experiment in its short form."""
    return outcome(*short_form(name), *overrides)


@pytest.fixture(scope="module")
def outcomes():
    return {name: short_run(name) for name in FORMS}


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "metric", "expected", "tolerance"),
    [
        ("fig05_orientation", "gain_difference_C_per_N", 56e-12, 1e-20),
        ("fig05_orientation", "gain_sum_C_per_N", 7e-12, 1e-20),
        ("fig05_orientation", "fwhm_sigma_z_over_depth", 2 * np.sqrt(np.sqrt(2) - 1), 1e-3),
        # At k = 0 the stresses are [[-1, 2i], [-1, 0]] and the films weigh them 56 to 7.
        ("fig05_orientation", "condition_long_waves", 8.0, 0.1),
        ("fig06_spectra", "slope_rate_dB_per_octave", 20 * np.log10(2), 0.02),
        ("fig06_spectra", "slope_charge_dB_per_octave", 0.0, 0.02),
    ],
)
def test_number(outcomes, name, metric, expected, tolerance):
    assert outcomes[name].metrics[metric] == pytest.approx(expected, abs=tolerance, rel=0)


@pytest.mark.full
def test_pressure_is_even_and_shear_odd(outcomes):
    charge = outcomes["fig05_orientation"].dataset["charge"].values
    for load, sign in ((0, 1), (1, -1)):
        np.testing.assert_allclose(charge[load, :, ::-1], sign * charge[load], atol=1e-18)
    np.testing.assert_allclose(charge[2], charge[0] + 0.4 * charge[1], atol=1e-18)


@pytest.mark.full
def test_filter_keeps_half_at_the_cutoff(outcomes):
    result = outcomes["fig06_spectra"]
    k = result.dataset["wavenumber"].values
    at_cutoff = np.interp(
        result.metrics["cutoff_wiener_rad_per_m"], k, result.dataset["resolution"][0]
    )
    assert 0.5 <= at_cutoff < 0.8
    above_cutoff = result.dataset["resolution"][0].values[
        k > result.metrics["cutoff_wiener_rad_per_m"]
    ]
    assert np.all(above_cutoff < 0.5)


@pytest.mark.full
@pytest.mark.parametrize("component", ["p", "q"])
@pytest.mark.parametrize("method", ["wiener", "tikhonov"])
def test_error_grows_as_the_angle_shrinks(outcomes, method, component):
    metrics = outcomes["two_element"].metrics
    error = [metrics[f"error_{component}_{method}_at_{angle}_deg"] for angle in (5, 20, 90)]
    assert error[0] > 1.2 * error[1] > 1.2 * error[2]
    assert error[2] < 0.15
    assert metrics[f"error_{component}_{method}_one_element"] > 3 * error[2]


@pytest.mark.full
@pytest.mark.parametrize("name", FORMS)
def test_page_is_whole(outcomes, name):
    check_page(outcomes[name])


@pytest.mark.parametrize(
    ("name", "override", "words"),
    [
        ("elements", "elements.shown=5", "elements.shown is 5"),
        ("elements", "method=[wiener]", "method lacks bursts"),
        ("fig05_orientation", "sensor=one_element", "has 1 elements"),
        ("fig06_spectra", "sensor=two_element", "has 2 elements"),
        ("fig06_spectra", "friction=null", "friction is null"),
        ("two_element", "two_element.shown_deg=[45.0]", "shown_deg is"),
        ("two_element", "two_element.seeds=0", "seeds is 0"),
    ],
)
def test_refused(name, override, words):
    with pytest.raises(BadInput, match=words):
        run(name, override)
