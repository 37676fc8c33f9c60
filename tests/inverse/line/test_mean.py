"""The mean of p and of q: told by the signal, known from outside, or said to be unobserved."""

import numpy as np
import pytest

from srsinv.inverse.line.rule import Evidence, GeneralisedCrossValidation
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from srsinv.quantities import quantity
from tests.inverse.cases import SLOW, make_case, relative

WIENER = Wiener(Exponential(3e3, 2e-3), Exponential(1e3, 2e-3))
TIKHONOV = Tikhonov(1, 2e-5, 8e-5)
METHODS = {"wiener": WIENER, "tikhonov": TIKHONOV}


def means(traction) -> np.ndarray:
    return np.asarray(traction).mean(axis=-1)


@pytest.mark.parametrize("name", METHODS)
def test_the_rate_signal_is_blind_to_both_means(name):
    problem = make_case(background_Pa=1e3).problem
    estimate = METHODS[name](problem)
    assert np.all(problem.zero_mean)
    assert all("unobserved" in text for text in problem.mean_statement().values())
    assert np.abs(means(estimate.value)).max() < 1e-8 * np.abs(estimate.value).max()


@pytest.mark.parametrize("name", METHODS)
def test_a_known_mean_is_taken_over_and_said(name):
    case = make_case(background_Pa=1e3)
    known = float(case.truth[0].mean())
    problem = make_case(background_Pa=1e3, known_mean_Pa=(known, None)).problem
    estimate, blind = METHODS[name](problem), METHODS[name](case.problem)
    said = problem.mean_statement()
    assert said["p"].startswith("known")
    assert quantity(known, "Pa", 4) in said["p"]
    assert "unobserved" in said["q"]
    np.testing.assert_allclose(means(estimate.value), [known, 0.0], atol=1e-7 * known)
    assert relative(estimate.value[0] - known, blind.value[0]) < 1e-9
    assert relative(estimate.stderr, blind.stderr) < 1e-12


@pytest.mark.parametrize("friction", [0.3, -0.3])
def test_friction_ties_q_to_p(friction):
    """Value, mean and standard error; the words say so."""
    case = make_case(films="one", friction=friction, background_Pa=1e3)
    known = float(case.truth[0].mean())
    problem = make_case(
        films="one", friction=friction, background_Pa=1e3, known_mean_Pa=(known, None)
    ).problem
    estimate = WIENER(problem)
    value, stderr = np.asarray(estimate.value), np.asarray(estimate.stderr)
    np.testing.assert_allclose(value[1], friction * value[0], rtol=1e-12)
    np.testing.assert_allclose(stderr[1], abs(friction) * stderr[0], rtol=1e-12)
    assert f"mu = {friction}" in problem.mean_statement()["q"]
    error = value - case.truth
    assert np.all(np.abs(means(error)) < 1e-8 * known)
    assert np.linalg.norm(error) < 0.1 * np.linalg.norm(case.truth)


def test_friction_decides_the_mean_of_q():
    """A mean of q given beside the friction is not used, and must not be claimed."""
    settings = {"films": "one", "friction": 0.3, "known_mean_Pa": (1e3, 7.0)}
    problem = make_case(**settings).problem
    assert means(WIENER(problem).value)[1] == pytest.approx(300.0)
    assert not problem.mean_statement()["q"].startswith("known")


@pytest.mark.parametrize("name", METHODS)
def test_a_slow_readout_tells_the_mean(name):
    """Turned elements feel the mean of q too, through the shear stress."""
    case = make_case(films="turned", amplifier=SLOW, background_Pa=1e3, noise_fraction=1e-3)
    problem, truth, _ = case
    assert not np.any(problem.zero_mean)
    assert set(problem.mean_statement().values()) == {"from the signal"}
    estimate = METHODS[name](problem)
    np.testing.assert_allclose(means(estimate.value), means(truth), rtol=0.02)


@pytest.mark.parametrize("name", METHODS)
def test_elements_at_right_angles_feel_the_mean_of_p_alone(name):
    """At 0 and 90 degrees no shear stress enters, so the mean of q is not in the signal."""
    problem, truth, _ = make_case(amplifier=SLOW, background_Pa=1e3)
    said = problem.mean_statement()
    estimate = METHODS[name](problem)
    assert said["p"] == "from the signal"
    assert "unobserved" in said["q"]
    assert means(estimate.value)[0] == pytest.approx(truth[0].mean(), rel=0.01)
    assert np.abs(means(estimate.value)[1]) < 1e-6 * truth[1].max()
    assert np.asarray(estimate.stderr).max() < truth.max()


@pytest.mark.parametrize("name", METHODS)
def test_an_unknown_offset_hides_the_mean(name):
    settings = {"films": "turned", "amplifier": SLOW, "background_Pa": 1e3, "free_offset": True}
    problem = make_case(**settings).problem
    estimate = METHODS[name](problem)
    assert np.all(problem.zero_mean)
    assert all("unobserved" in text for text in problem.mean_statement().values())
    assert np.abs(means(estimate.value)).max() < 1e-8 * np.abs(estimate.value).max()


WITH_KNOWN_MEAN = {
    "slow_friction": {"films": "one", "friction": 0.3, "amplifier": SLOW},
    "slow_turned": {"films": "turned", "amplifier": SLOW},
    "slow_pair": {"amplifier": SLOW},
    "open_rate": {"kind": "open"},
    "open_slow": {"kind": "open", "films": "turned", "amplifier": SLOW},
}


@pytest.mark.full
@pytest.mark.parametrize("name", WITH_KNOWN_MEAN)
def test_a_known_mean_explains_its_own_signal(name):
    """Where the mean acts on the signal, knowing it must help and not leave a misfit."""
    settings = WITH_KNOWN_MEAN[name] | {"background_Pa": 1e3, "noise_fraction": 1e-3}
    problem, truth, sigma = make_case(**settings)
    known = (float(truth[0].mean()), float(truth[1].mean()))
    if problem.friction is not None:
        known = (known[0], None)
    informed = make_case(known_mean_Pa=known, **settings).problem
    estimate = WIENER(informed)
    np.testing.assert_allclose(means(estimate.value), means(truth), rtol=1e-6)
    error = np.linalg.norm(np.asarray(estimate.value) - truth) / np.linalg.norm(truth)
    assert error < 0.1
    assert np.std(np.asarray(estimate.fitted) - np.asarray(problem.data)) < 2 * sigma
    assert np.sqrt(np.nanmean(np.asarray(estimate.whitened) ** 2)) < 2


def test_one_known_mean_does_not_leak_into_the_other():
    """Both elements feel both means: with that of p known, the rest of the level is q's."""
    settings = {"films": "oblique", "amplifier": SLOW, "background_Pa": 1e3, "noise_fraction": 1e-3}
    truth = make_case(**settings).truth
    problem = make_case(known_mean_Pa=(float(truth[0].mean()), None), **settings).problem
    np.testing.assert_allclose(means(TIKHONOV(problem).value), means(truth), rtol=0.02)


@pytest.mark.parametrize("rule", [GeneralisedCrossValidation(), Evidence()])
def test_rules_do_not_see_the_signal_of_a_known_mean(rule):
    settings = {"films": "one", "friction": 0.3, "amplifier": SLOW, "background_Pa": 1e3}
    truth = make_case(**settings).truth
    problem = make_case(known_mean_Pa=(float(truth[0].mean()), None), **settings).problem
    estimate = Tikhonov(1, rule=rule)(problem)
    assert estimate.stats["rule_status"] == "converged"
    error = np.asarray(estimate.value) - truth
    assert np.linalg.norm(error) < 0.1 * np.linalg.norm(truth)


@pytest.mark.full
def test_the_open_line_says_that_its_ends_tell_the_mean():
    problem = make_case("open").problem
    assert all("weakly observed" in text for text in problem.mean_statement().values())
