"""The comparison in a short form: who is ahead, what a band is worth, and what gives a fit away."""

from typing import Any

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.jobs._statistics import differences, ranks
from srsinv.jobs.monte_carlo import simulate_and_fit
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run

FORMS = ("compare", "compare_recording")

test_nothing_has_moved = golden_test(FORMS)


@pytest.fixture(scope="module")
def scene():
    return short_run("compare")


@pytest.mark.full
def test_the_right_feature_is_ahead_and_near_the_truth(scene):
    assert scene.metrics["rank_mean_feature_fit"] == 1.0
    for component in "pq":
        right = scene.metrics[f"error_{component}_feature_fit_40_dB"]
        assert right < 0.01 < scene.metrics[f"error_{component}_tikhonov_40_dB"]


@pytest.mark.full
def test_the_residual_gives_a_wrong_feature_away(scene):
    assert scene.metrics["misfit_feature_fit_40_dB"] == pytest.approx(1, abs=0.25)
    assert scene.metrics["misfit_wrong_feature_40_dB"] > 1.5
    assert scene.metrics["error_overall_wrong_feature_40_dB"] > 0.05


@pytest.mark.full
def test_a_feature_is_put_on_the_cells_as_the_truth_is(scene):
    ds = scene.dataset
    truth = ds["traction"].values
    estimate = (
        ds["estimate"].sel(snr=40.0).values[list(ds["estimator"].values).index("Feature fit"), 0]
    )
    # The signal is blind to the mean alone: the deviations agree cell by cell.
    wrong = (estimate - truth) - (estimate - truth).mean(axis=-1, keepdims=True)
    assert np.abs(wrong).max() < 0.05 * np.ptp(truth)


@pytest.mark.full
def test_page(scene):
    check_page(scene)
    assert len(scene.page.figures) == 5


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (["compare.snr_dB=[]"], "snr_dB"),
        (["compare.snr_dB=[20.0,20.0]"], "snr_dB"),
        (["compare.seeds=0"], "seeds"),
        (["feature=[]"], "fewer than two methods"),
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
    check_page(recorded)
    assert len(recorded.page.figures) == 4


def pairs(score: np.ndarray) -> dict[tuple[str, str], dict[str, Any]]:
    """The differences by the names of the two methods."""
    named = differences(score, ["a", "b", "c"][: len(score)])
    columns = {name: each[1] for name, each in named.items()}
    return {
        (better, worse): {name: values[i] for name, values in columns.items()}
        for i, (better, worse) in enumerate(zip(columns["better"], columns["worse"], strict=True))
    }


def test_methods_differ_by_the_spread_of_their_difference():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=8)
    score = np.stack([10 + noise, 11 + noise + 0.1 * rng.normal(size=8), 11 + rng.normal(size=8)])
    compared = pairs(score)
    # The same draws: a difference far below the scores' own spread shows.
    assert compared["a", "b"]["differs"]
    assert compared["a", "b"]["difference"] == pytest.approx(1, abs=0.1)
    assert not next(each for names, each in compared.items() if set(names) == {"b", "c"})["differs"]


def test_one_draw_says_nothing_of_differences():
    (pair,) = pairs(np.array([[1.0], [5.0]])).values()
    assert not pair["differs"]
    assert np.isnan(pair["difference_spread"])


def test_equal_scores_have_the_same_rank():
    np.testing.assert_array_equal(ranks(np.array([[1.0], [1.0], [2.0]]))[:, 0], [1.5, 1.5, 3])


def test_every_method_answers_every_problem_in_order():
    answers = simulate_and_fit(range(6), {"once": lambda n: n, "twice": lambda n: 2 * n}, (2, 3))
    np.testing.assert_array_equal(answers.each(lambda n: n)[1], [[0, 2, 4], [6, 8, 10]])
    assert answers.each(lambda n: [n, n]).shape == (2, 2, 3, 2)
    assert answers.first_call_s.shape == answers.steady_call_s.shape == (2,)
    assert np.all(answers.first_call_s >= 0)
