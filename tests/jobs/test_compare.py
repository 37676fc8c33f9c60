"""The comparison in a short form: who is ahead, what a band is worth, and what gives a fit away."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.jobs import contest
from tests.golden.check import golden_test
from tests.jobs.run import outcome, short_form, short_run

FORMS = ("compare", "compare_recording")

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def scene():
    return short_run("compare")


def test_the_right_feature_is_ahead_and_near_the_truth(scene):
    assert scene.metrics["rank_mean_feature_fit"] == 1.0
    for component in "pq":
        right = scene.metrics[f"error_{component}_feature_fit_40_dB"]
        assert right < 0.01 < scene.metrics[f"error_{component}_tikhonov_40_dB"]


def test_the_residual_gives_a_wrong_feature_away(scene):
    assert scene.metrics["misfit_feature_fit_40_dB"] == pytest.approx(1, abs=0.25)
    assert scene.metrics["misfit_wrong_feature_40_dB"] > 1.5
    assert scene.metrics["error_overall_wrong_feature_40_dB"] > 0.05


def test_a_feature_is_put_on_the_cells_as_the_truth_is(scene):
    ds = scene.dataset
    truth = ds["traction"].values
    estimate = (
        ds["estimate"].sel(snr=40.0).values[list(ds["method"].values).index("Feature fit"), 0]
    )
    # The signal is blind to the mean alone: the deviations agree cell by cell.
    wrong = (estimate - truth) - (estimate - truth).mean(axis=-1, keepdims=True)
    assert np.abs(wrong).max() < 0.05 * np.ptp(truth)


def test_every_figure_draws_and_every_variable_has_units(scene):
    assert all("units" in scene.dataset[name].attrs for name in scene.dataset.variables)
    drawn = [draw() for section in scene.sections for draw in section.figures.values()]
    assert len(drawn) == 5


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (["compare.snr_dB=[]"], "snr_dB"),
        (["compare.snr_dB=[20.0,20.0]"], "snr_dB"),
        (["compare.seeds=0"], "seeds"),
        (["feature=[]"], "contestants"),
        (["scene.pressures.strip.pressure_Pa=0.0"], "uniform"),
    ],
)
def test_bad_settings_are_refused(overrides, named):
    with pytest.raises(BadInput, match=named):
        outcome(*short_form("compare"), *overrides)


@pytest.fixture(scope="module")
def recorded():
    return short_run("compare_recording")


@pytest.mark.full
def test_a_feature_that_is_there_predicts_what_it_did_not_see(recorded):
    assert recorded.metrics["holdout_chi2_feature_fit"] == pytest.approx(1, abs=0.25)
    assert recorded.metrics["rank_mean_feature_fit"] == 1.0
    assert recorded.metrics["converged_feature_fit"]


@pytest.mark.full
def test_halves_repeat_as_well_as_the_band_states(recorded):
    for component in "pq":
        stated = recorded.metrics[f"{component}_stderr_rms_Pa_feature_fit"]
        repeatability = recorded.metrics[f"{component}_repeatability_Pa_feature_fit"]
        assert 0.1 * stated < repeatability < 4 * stated


@pytest.mark.full
def test_a_recording_s_page_draws(recorded):
    drawn = [draw() for section in recorded.sections for draw in section.figures.values()]
    assert len(drawn) == 4


def test_pairs_are_told_apart_by_their_spread():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=8)
    score = np.stack([10 + noise, 11 + noise + 0.1 * rng.normal(size=8), 11 + rng.normal(size=8)])
    by_indices = {(pair.better, pair.worse): pair for pair in contest.pairs(score)}
    # The same draws: a difference far below the scores' own spread shows.
    assert by_indices[0, 1].apart
    assert by_indices[0, 1].difference == pytest.approx(1, abs=0.1)
    assert not next(p for key, p in by_indices.items() if set(key) == {1, 2}).apart


def test_one_draw_tells_nobody_apart():
    assert not any(pair.apart for pair in contest.pairs(np.array([[1.0], [5.0]])))


def test_equal_scores_share_a_rank():
    np.testing.assert_array_equal(
        contest.ranks(np.array([[1.0], [1.0], [2.0]]))[:, 0], [1.5, 1.5, 3]
    )
