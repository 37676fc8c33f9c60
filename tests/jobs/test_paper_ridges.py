"""Ridges on a pitch, and the limits of detection, in short forms: what their numbers must say."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from srsinv.errors import BadInput
from srsinv.inverse.detection import needed_known, needed_wave
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run
from tests.tiers import quick

FORMS = ("fig12_ridges", "detection_limit")

TWO_SHAPES = (
    "+scene.surfaces.more={_target_:srsinv.forward.surface.Bump,height_m:1e-6,sigma_m:1e-4}"
)

test_nothing_has_moved = golden_test(FORMS, "fig12_ridges")


def run(name, *overrides):
    return outcome(*short_form(name), *overrides)


@pytest.fixture(scope="module")
def ridges():
    return short_run("fig12_ridges")


@pytest.fixture(scope="module", params=quick(["detection_limit"]))
def limits(request):
    return short_run(request.param)


def slope(x, y):
    """Of a straight line through the logarithms."""
    return np.polyfit(np.log(x), np.log(y), 1)[0]


def test_pitch_is_recovered(ridges):
    m = ridges.metrics
    assert abs(m["pitch_m"] - 0.7e-3) < 3 * m["pitch_m_stderr"]
    assert abs(m["pitch_error"]) < 0.01
    assert 0.5 < m["pitch_m_stderr"] / m["pitch_m_stderr_bound"] < 2


def test_strip_as_wide_as_the_pitch_is_blind(ridges):
    assert ridges.metrics["amplitude_blind_strip_V"] < 1e-9 * ridges.metrics["amplitude_V"]


def test_signal_and_noise(ridges):
    m = ridges.metrics
    assert 0.4e-6 < m["amplitude_V"] < 1.8e-6  # docs/explanation/paper.md for one strip; here two
    assert m["noise_rms_V"] == pytest.approx(np.sqrt(4 * 1.380649e-23 * 300 * 1e6 * 2500))
    assert m["noise_rms_in_band_V"] == pytest.approx(m["noise_rms_V"] * np.sqrt(40 / 2500))
    samples = ridges.dataset.sizes["position"]
    assert samples == 12500
    assert m["strength_over_scan"] == pytest.approx(m["snr_per_sample"] * np.sqrt(samples))
    wave = np.abs(np.fft.rfft(ridges.dataset["signal"].values)[50]) * 2 / samples
    assert wave == pytest.approx(m["amplitude_V"], rel=1e-6)


def test_load_that_closes_the_gap(ridges):
    m = ridges.metrics
    expected = m["load_to_touch_between_closed_form_N_per_m"]
    assert expected == pytest.approx(3.31, abs=0.01)
    # The closed form's ridge has vertical walls.
    assert m["load_to_touch_between_N_per_m"] == pytest.approx(expected, rel=0.08)
    assert m["amplitude_most_at_Pa"] == 5e3  # 3.5 N/m per ridge


def test_amplitude_is_linear_in_a_small_height(ridges):
    size = ridges.dataset["amplitude_by_height"]
    small = size.sel(ridge_height=slice(None, 0.4e-6))
    assert slope(small["ridge_height"], small) == pytest.approx(1.0, abs=0.01)


def test_least_height_falls_as_one_over_root_length(ridges):
    least = ridges.dataset["least_height"].dropna("averaging_length")
    small = least.where(least < 0.4e-6, drop=True)
    assert slope(small["averaging_length"], small) == pytest.approx(-0.5, abs=0.02)
    assert np.all(np.diff(least) < 0)
    m = ridges.metrics
    assert m["averaging_length_0.65um_m"] > 50 * m["averaging_length_6.5um_m"]


def test_half_the_noise_halves_what_the_paper_needs(ridges):
    cooler = run("fig12_ridges", "noise.johnson.temperature_K=75.0").metrics
    for name in ("snr_shortfall", "noise_rms_V"):
        assert cooler[name] == pytest.approx(ridges.metrics[name] / 2)
    for name in ("averaging_length_6.5um_m", "averaging_length_0.65um_m"):
        assert cooler[name] == pytest.approx(ridges.metrics[name] / 4)


@pytest.mark.full
def test_least_height_is_linear_in_the_noise_where_the_skin_lies_on_the_plate(limits):
    low = limits.dataset.isel(noise=slice(None, 2))
    exponent = slope(low["noise"], low["least_height_against_noise"])
    assert exponent == pytest.approx(1.0, abs=0.05)
    assert 0.7 < limits.metrics["least_height_against_noise_exponent"] < 1.0


def test_depth_hides(limits):
    for limit in ("least_height", "narrowest_pair", "resolved_wavelength"):
        values = limits.dataset[f"{limit}_against_depth"].values
        assert np.all(np.diff(values) > 0)


def test_speed_shows_as_less_noise_does(limits):
    # d' goes as root(speed)/noise, so that 10 times the speed is root(10) times less noise.
    cut = "detection_limit.noise_range_V=[6.4357958e-6,2.03517734e-5]"
    of_noise = run("detection_limit", cut).dataset
    for limit in ("least_height", "narrowest_pair"):
        slow_to_fast = limits.dataset[f"{limit}_against_speed"].values
        noisier = of_noise[f"{limit}_against_noise"].values
        ratio = slow_to_fast[0] / slow_to_fast[-1]
        assert ratio == pytest.approx(noisier[-1] / noisier[0], rel=0.15)


def test_fit_tells_apart_what_a_picture_does_not(limits):
    m = limits.metrics
    assert m["least_distance_m"] < m["narrowest_pair_m"] < m["resolved_wavelength_m"] / 3
    # Two close ridges differ from one as the square of their distance.
    assert m["narrowest_pair_against_noise_exponent"] == pytest.approx(0.5, abs=0.15)


@pytest.mark.claim
def test_narrowest_pair_does_not_depend_on_the_cells(limits):
    finer = run("detection_limit", "grid.cells=8192", "detection_limit.points=3")
    for name in ("narrowest_pair_m", "least_height_m"):
        assert finer.metrics[name] == pytest.approx(limits.metrics[name], rel=0.05)


def test_needed_strengths():
    assert needed_known(0.05, 0.9) == pytest.approx(norm.ppf(0.95) + norm.ppf(0.9))
    draws = np.random.default_rng(0).normal(size=(200_000, 2))
    draws[:, 0] += needed_wave(0.05, 0.9)
    detected = np.mean(np.sum(draws**2, axis=1) > chi2.isf(0.05, 2))
    assert detected == pytest.approx(0.9, abs=3e-3)


@pytest.mark.parametrize("name", quick(FORMS, "fig12_ridges"))
def test_page_is_whole(name):
    result = short_run(name)
    assert result.metrics["contact_converged"] is True
    check_page(result)


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "override", "words"),
    [
        ("fig12_ridges", "grid.length_m=0.002", "whole number of pitches"),
        ("fig12_ridges", "scene=ridge", "not one set of ridges"),
        ("fig12_ridges", "scan.speed_m_per_s=-0.014", "positive speed"),
        ("fig12_ridges", "fig12_ridges.ridges=2", "ridges is 2"),
        ("fig12_ridges", "fig12_ridges.sample_rate_hz=10.0", "sample_rate_hz is 10.0"),
        ("fig12_ridges", "fig12_ridges.heights=1", "heights is 1"),
        ("fig12_ridges", "fig12_ridges.pressures_Pa=[-1.0]", "pressures_Pa is -1.0"),
        ("fig12_ridges", "noise=[]", "no noise"),
        ("fig12_ridges", "fig12_ridges.false_alarm=0.7", "false_alarm is 0.7"),
        ("detection_limit", TWO_SHAPES, "not one ridge"),
        ("detection_limit", "noise=[sliding]", "not white"),
        ("detection_limit", "detection_limit.points=1", "points is 1"),
        ("detection_limit", "detection_limit.depth_range_m=[1e-3,1e-4]", "depth_range_m is"),
        ("detection_limit", "detection_limit.distance_range_m=[1e-5,1e-3]", "distances above"),
    ],
)
def test_refused(name, override, words):
    with pytest.raises(BadInput, match=words):
        run(name, override)
