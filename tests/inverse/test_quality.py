"""What an answer is worth: the rule, and what its threshold stands for."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import srsinv
from srsinv.inverse.quality import quality, reasons
from srsinv.status import Status
from tests.inverse.cases import gaps, make_case

N = 400
RNG = np.random.default_rng(3)
X = np.linspace(0.0, 1.0, N)
NOISE = RNG.normal(size=N)

# status, chi-square per degree of freedom, warnings, degrees of freedom, what that is worth
CASES = {
    "noise is all that is left": (Status.CONVERGED, 1.0, (), 1000, "good"),
    "the noise is not known": (Status.CONVERGED, None, (), 1000, "good"),
    "a warning": (Status.CONVERGED, 1.0, ("samples are missing",), 1000, "doubtful"),
    "beyond the noise": (Status.CONVERGED, 4.0, ("beyond the noise",), 1000, "doubtful"),
    "far beyond the noise": (Status.CONVERGED, 7.0, ("beyond the noise",), 1000, "failed"),
    "nothing that a band survives": (Status.CONVERGED, 978_422.0, (), 1000, "failed"),
    "not a number": (Status.CONVERGED, np.nan, (), 1000, "failed"),
    "one number, by chance": (Status.CONVERGED, 15.0, (), 1, "good"),
    "one number, no chance": (Status.CONVERGED, 40.0, (), 1, "failed"),
    "no number left": (Status.CONVERGED, 1e9, (), 0, "good"),
    "stopped": (Status.STEP_LIMIT, 1.0, (), 1000, "failed"),
    "stopped, with a warning": (Status.ILL_CONDITIONED, None, ("x",), 1000, "failed"),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_quality(case):
    *given, worth = case
    assert quality(*given) == worth


def test_reasons_name_the_status_and_the_warnings():
    assert reasons(Status.CONVERGED, ()) == ()
    assert reasons(Status.CONVERGED, ("a.",)) == ("a.",)
    stopped, *rest = reasons(Status.NOT_FINITE, ("a.",))
    assert stopped.startswith("There is no answer: not finite. The model")
    assert rest == ["a."]


@pytest.mark.parametrize("status", Status)
def test_what_is_no_answer_advises(status):
    assert status.is_answer == (status.advice == "")
    assert status.is_answer or status.advice.endswith(".")


def test_a_band_that_covers_less_than_half_has_failed():
    """Where errors are those of a noise s times the stated one, on either side of one half."""

    def covered(s):
        return 2 * scipy.stats.norm.cdf(scipy.stats.norm.ppf(0.95) / s) - 1

    for s in np.linspace(1.0, 4.0, 61):
        failed = quality(Status.CONVERGED, s**2, (), 1e9) == "failed"
        assert failed == (covered(s) < 0.5) or abs(covered(s) - 0.5) < 1e-3


@pytest.mark.parametrize("freedom", [1, 2, 3, 5, 10, 100, 10_000])
def test_chance_alone_hardly_ever_fails(freedom):
    """Less than once in 50,000 answers, by the chi-square distribution itself."""
    values = np.geomspace(1.0, 1e3, 2000)
    least = next(c for c in values if quality(Status.CONVERGED, c, (), freedom) == "failed")
    assert scipy.stats.chi2.sf(least * freedom, freedom) < 2e-5


def line(params):
    return params["a"] + params["b"] * X


# What is added to a straight line with noise, over the noise's rms; which bounds; what it is worth
FITS = {
    "a line": (0.0, None, "good", ()),
    "a line with a bend": (1.8, None, "doubtful", ("The residual is",)),
    "no line at all": (30.0, None, "failed", ("The residual is",)),
    "on a bound": (0.0, {"b": (5.0, 9.0)}, "doubtful", ("On a bound",)),
}


@pytest.mark.parametrize("case", FITS.values(), ids=FITS)
def test_a_fit_says_what_it_is_worth(case):
    bend, bounds, worth, words = case
    y = 1.0 + 2.0 * X + 0.02 * (NOISE + bend * np.sin(20 * X))
    if bounds is not None:
        y = y + 2.99 * X  # so that the bound is near, and the residual small
    fit = srsinv.fit(line, {"a": 0.0, "b": 6.0}, y, noise=0.02, bounds=bounds)
    assert fit.status == "converged"
    assert fit.quality == worth
    assert len(fit.warnings) == len(words)
    assert all(said.startswith(word) for said, word in zip(fit.warnings, words, strict=True))
    assert fit.reasons == fit.warnings


def test_a_noise_that_is_not_known_makes_no_failure():
    y = 1.0 + 2.0 * X + np.sin(20 * X)
    assert srsinv.fit(line, {"a": 0.0, "b": 1.0}, y).quality == "good"


def test_a_direction_that_the_data_do_not_determine_is_a_warning():
    fit = srsinv.fit(
        lambda params: line(params) + params["c"], {"a": 0.0, "b": 1.0, "c": 0.0}, X, noise=0.1
    )
    assert fit.quality == "doubtful"
    assert any("do not determine" in said for said in fit.warnings)


def test_a_method_without_standard_errors_has_no_bands():
    on = make_case().problem
    alone = on.estimate(jnp.asarray(make_case().truth))
    assert alone.quality == "no bands"
    assert len(alone.reasons) == 1
    assert on.estimate(jnp.asarray(make_case().truth), jnp.full((2, 48), 9.0)).quality == "good"
    assert on.estimate(jnp.zeros((2, 48))).quality == "failed"
    assert alone.with_warnings(("a.",)).quality == "doubtful"


def test_a_chi_square_that_is_undefined_is_a_warning():
    exact = srsinv.fit(lambda p: p["a"] + p["b"] * X[:2], {"a": 0.0, "b": 1.0}, X[:2], noise=0.1)
    assert exact.known_chi2 is None
    assert exact.quality == "doubtful"


def test_chi_square_is_that_of_the_samples_that_are_there_under_coloured_noise():
    """With the covariance of these samples alone, built densely."""
    case = make_case(colour=True, observed=jnp.asarray(gaps()))
    on = case.problem
    estimate = on.estimate(jnp.asarray(case.truth), jnp.ones((2, 48)))
    left = np.asarray(on.data + on.mean_signal) - np.asarray(estimate.fitted)
    lags = np.fft.irfft(np.asarray(on.noise)[0], on.line.n)
    covariance = scipy.linalg.toeplitz(lags)
    squares = 0.0
    for row, is_there in zip(left, on.is_observed, strict=True):
        own = covariance[np.ix_(is_there, is_there)]
        squares += float(row[is_there] @ np.linalg.solve(own, row[is_there]))
    assert estimate.chi2_per_freedom == pytest.approx(squares / on.sample_count, rel=1e-9)


@pytest.mark.parametrize(
    ("errors", "standard_errors", "worth"),
    [
        (1.0, 1.0, "good"),
        (4.0, 1.0, "doubtful"),  # beyond its band
        (300.0, 400.0, "doubtful"),  # within its band, and larger than p and q themselves
        (0.5, np.nan, "no bands"),
        (300.0, np.nan, "doubtful"),
    ],
)
def test_a_known_truth_grades_an_answer(errors, standard_errors, worth):
    """Errors are in units of a hundredth of the traction's rms; what it leaves of the signal is the
    noise, so that without the truth the answer is good."""
    case = make_case()
    unit = 0.01 * float(np.std(case.truth))
    answer = case.problem.estimate(jnp.asarray(case.truth), jnp.ones((2, 48)))
    assert answer.quality == "good"
    off = errors * unit * np.random.default_rng(0).normal(size=case.truth.shape)
    stderr = np.full(case.truth.shape, standard_errors * unit)
    answer = dataclasses.replace(answer, value=case.truth + off, stderr=stderr)
    graded = answer.against(case.truth, np.ones(48, bool))
    assert graded.quality == worth
    assert bool(graded.warnings) == (worth == "doubtful")


def test_a_truth_that_is_uniform_grades_by_the_band_alone():
    case = make_case()
    answer = case.problem.estimate(jnp.asarray(case.truth), jnp.full((2, 48), 1e9))
    assert answer.against(np.zeros((2, 48)), np.ones(48, bool)).quality == "good"
