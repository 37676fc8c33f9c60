"""What estimates say against their own bands: where it is true, and not where it is not."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.inverse import diagnostics
from srsinv.inverse.line import answer
from srsinv.inverse.line.rule import Evidence
from srsinv.inverse.line.spectral import orthogonalised
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.inverse.cases import DEPTH_M, gaps, make_case

P, Q = Exponential(1.5e3, 0.8e-3), Exponential(5e2, 1.5e-3)
WIENER = Wiener(P, Q)
SAME = (Film(DEPTH_M, 0.5), Film(DEPTH_M, 0.5))
SHALLOW = (Film(1e-6, 0.2), Film(2e-6, 1.5))


def louder(problem, factor):
    """The problem with `factor` times the stated noise's rms."""
    return eqx.tree_at(lambda p: p.noise, problem, problem.noise * factor**2)


def noise_alone(problem):
    """The problem with nothing but noise of the stated level in its data."""
    rms = np.sqrt(float(problem.noise[0, 1]))
    return eqx.tree_at(
        lambda p: p.data, problem, rms * np.random.default_rng(8).normal(size=problem.data.shape)
    )


# Warning by its first words: a method, and a problem that calls for it and nothing else.
CALLED = {
    "The signal resolves": (WIENER, lambda: louder(make_case().problem, 1e5)),
    "The elements respond to one mix": (WIENER, lambda: make_case(films=SAME).problem),
    "The prior shifts p": (Wiener(Exponential(15.0, 0.8e-3), Q), lambda: make_case().problem),
    "The residual is": (WIENER, lambda: louder(make_case().problem, 0.3)),
    "The noise (": (WIENER, lambda: louder(make_case().problem, 1e-15)),
    "The band takes the weights": (
        Tikhonov(1, rule=Evidence()),
        lambda: noise_alone(make_case().problem),
    ),
}


@pytest.mark.parametrize("words", CALLED)
def test_a_warning_is_given_where_it_is_due(words):
    method, problem = CALLED[words]
    assert any(each.startswith(words) for each in method(problem()).warnings)


# What a warning goes by, a value that is let pass and one that is not: either side of the numbers
# that diagnostics.py gives reasons for.
THRESHOLDS = {
    "numbers told": (lambda resolved_dof: diagnostics.prior_alone("p", resolved_dof, 48), 1.2, 0.8),
    "shortest wave": (lambda fraction: diagnostics.unresolved_waves("p", fraction), 0.4, 0.6),
    "samples missing": (lambda fraction: diagnostics.missing(fraction), 0.03, 0.08),
    "noise off its covariance": (diagnostics.rough_bands, 0.05, 0.07),
    "sliding over signal": (diagnostics.sliding_noise, 0.07, 0.15),
    "rms over noise": (lambda rms: diagnostics.residual_over_noise(rms**2, 1e4), 1.2, 1.3),
    "pull of the prior": (lambda pull: diagnostics.pulled_by_prior("p", pull, 1e4), 0.9, 1.1),
    "pull of one number": (lambda pull: diagnostics.pulled_by_prior("p", pull, 1.0), 2.6, 2.8),
    "variance explained": (lambda part: diagnostics.prior_alone("p", 9.0, 48, part), 0.6, 0.4),
    "a load below zero": (lambda z: diagnostics.negative_load("strip", -z, 1.0), 3.0, 3.2),
    "pressure below zero": (
        lambda z: diagnostics.negative_pressure(np.array([1.0, -z]), np.ones(2), 1e3),
        4.7,
        4.9,
    ),
    "misfit where the feature is": (diagnostics.local_misfit, 1.0, 1.5),
    "chi-square of a fit": (lambda chi2: diagnostics.of_fit(chi2, 1e4, (), ()), 1.05, 1.1),
    "chi-square of few data": (lambda chi2: diagnostics.of_fit(chi2, 20, (), ()), 3.0, 3.4),
    "chi-square of many": (lambda chi2: diagnostics.of_fit(chi2, 4e4, (), (), 0.01), 1.08, 1.14),
    "chi-square of a rough level": (
        lambda chi2: diagnostics.of_fit(chi2, 4e4, (), (), 0.07),
        1.7,
        2.0,
    ),
}


@pytest.mark.parametrize("name", THRESHOLDS)
def test_thresholds(name):
    warnings, passes, does_not = THRESHOLDS[name]
    assert len(warnings(passes)) == 0
    assert len(warnings(does_not)) == 1


# Stated noise over the true one: how many warnings of the residual, and what the estimate is worth.
STATED = {1.0: (0, "good"), 0.9: (0, "good"), 0.5: (1, "doubtful"), 0.3: (1, "failed")}


@pytest.mark.parametrize("noise_ratio", STATED)
@pytest.mark.parametrize("method", [WIENER, Tikhonov(1)], ids=["wiener", "tikhonov"])
def test_noise_that_is_stated_too_small(method, noise_ratio):
    """Bands of half their width cover 59 % in place of 90 %, of 0.3 a good third."""
    estimate = method(louder(make_case(noise_fraction=0.1).problem, noise_ratio))
    warnings, worth = STATED[noise_ratio]
    assert sum(each.startswith("The residual is") for each in estimate.warnings) == warnings
    assert estimate.quality == worth
    assert (estimate.reasons == ()) == (worth == "good")


@pytest.mark.full
def test_an_estimate_that_did_not_converge_failed():
    estimate = Wiener(P, Q, path="iterative", tolerance=1e-12)(
        louder(make_case("open", observed=gaps()).problem, 1e-6)
    )
    assert estimate.status != "converged"
    assert estimate.quality == "failed"
    assert estimate.status in estimate.reasons[0]


def test_waves_shorter_than_cells_are_warned_of():
    warnings = WIENER(make_case(films=SHALLOW, noise_fraction=1e-4).problem).warnings
    assert any("down to waves of two cells" in each for each in warnings)


def test_cells_beyond_the_scan_are_no_missing_samples():
    observed = np.ones((2, 48), bool)
    observed[:, :10] = observed[:, -10:] = False
    warnings = WIENER(make_case("open", noise_fraction=0.1, observed=observed).problem).warnings
    assert not any("samples are missing" in each for each in warnings)


def test_missing_samples_are_warned_of():
    problem = make_case("open", observed=gaps()).problem
    assert any("samples are missing" in each for each in WIENER(problem).warnings)


def test_a_plain_case_has_no_warnings():
    assert WIENER(make_case(noise_fraction=0.1).problem).warnings == ()


@pytest.mark.full
@pytest.mark.parametrize("path", ["spectral", "direct"])
def test_draws_from_the_model_itself_are_hardly_ever_warned_of(path):
    """Traction from the prior and noise as stated: five standard deviations are no chance."""
    case = make_case(noise_fraction=0.1)
    problem, rng = case.problem, np.random.default_rng(5)
    method, warned = Wiener(P, Q, path=path), 0
    power = np.stack([np.asarray(each.power(problem)) for each in (P, Q)])
    for _ in range(20):
        white = np.fft.rfft(rng.normal(size=(2, problem.line.n)))
        white[:, 0] = 0.0
        truth = np.fft.irfft(white * np.sqrt(power), problem.line.n)
        signal = np.asarray(problem.forward(jnp.asarray(truth)))
        data = signal + case.sigma * rng.normal(size=signal.shape)
        estimate = method(eqx.tree_at(lambda p: p.data, problem, jnp.asarray(data)))
        warned += bool(estimate.warnings)
    assert warned == 0


def second_direction(gain):
    """That of a whitened model (e, 2, k)."""
    model = orthogonalised(gain, np.zeros(2, bool))
    return answer.second_direction(model.squares[0], model.shared, model.squares[1])


def test_the_second_direction_is_that_of_a_singular_value_decomposition():
    """To round-offs of the larger direction, for columns that are from far apart to nearly one."""
    rng = np.random.default_rng(0)
    gain = rng.normal(size=(3, 2, 60)) + 1j * rng.normal(size=(3, 2, 60))
    gain[:, 1] = (1 + 1j) * gain[:, 0] + gain[:, 1] * np.logspace(-12, 3, 60)
    small, of_p = second_direction(gain)
    _, sizes, turned = np.linalg.svd(np.moveaxis(gain, -1, 0), full_matrices=False)
    np.testing.assert_allclose(np.sqrt(small), sizes[:, 1], rtol=1e-9, atol=1e-15 * sizes.max())
    np.testing.assert_allclose(of_p, np.abs(turned[:, 1, 0]) ** 2, atol=1e-13)


def test_the_second_direction_of_the_smallest_numbers_is_a_number():
    """Squares of short waves in a deep film are below the smallest: nothing is resolved of them."""
    gain = np.random.default_rng(0).normal(size=(2, 2, 3)) + 0j
    usual, _ = second_direction(gain)
    small, of_p = second_direction(gain * 2.0 ** np.array([-500, -900, -1060]))
    np.testing.assert_allclose(small, usual * [2.0**-1000, 0.0, 0.0], rtol=1e-12)
    assert np.all((of_p >= 0) & (of_p <= 1))


def test_what_is_told_is_so_with_samples_missing():
    """Exactly, for a periodic line."""
    problem = make_case(observed=gaps(), noise_fraction=0.1).problem
    exact, near = (Wiener(P, Q, path=path)(problem).stats for path in ("direct", "iterative"))
    for name in ("resolved_dof_p", "resolved_dof_q"):
        assert near[name] == pytest.approx(exact[name], rel=1e-6)


@pytest.mark.parametrize("path", ["spectral", "direct", "iterative"])
def test_what_is_told_is_the_trace_of_the_resolution(path):
    """Of the dense answer: the derivative of the estimate by the traction behind the data."""
    problem = make_case().problem
    method = Wiener(P, Q, path=path)
    zero = eqx.tree_at(lambda p: p.data, problem, jnp.zeros_like(problem.data))
    offset = np.asarray(method(zero).value)
    for c, name in enumerate("pq"):
        impulse = np.zeros((2, problem.line.n))
        impulse[c, 7] = 1.0
        data = problem.forward(jnp.asarray(impulse))
        answer = np.asarray(method(eqx.tree_at(lambda p: p.data, problem, data)).value) - offset
        # On a periodic line every cell is resolved alike.
        resolved_dof = method(problem).stats[f"resolved_dof_{name}"]
        assert resolved_dof == pytest.approx(problem.line.n * answer[c, 7], rel=1e-6)
