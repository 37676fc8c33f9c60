"""Hard sensors: elements that say the same, elements that say nothing, friction of either sign."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.film import Film
from srsinv.grid import Convolution
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.rule import Evidence, GeneralisedCrossValidation
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.inverse.cases import DEPTH_M, SLOW, deviation, make_case, relative

P, Q = Exponential(1.5e3, 0.8e-3), Exponential(5e2, 1.5e-3)
RULES = (GeneralisedCrossValidation(), Evidence())
METHODS = {
    "wiener": Wiener(P, Q),
    "wiener_direct": Wiener(P, Q, path="direct"),
    "wiener_iterative": Wiener(P, Q, path="iterative"),
    "wiener_evidence": Wiener(P, Q, scale="evidence"),
    "tikhonov": Tikhonov(1, 2e-5, 8e-5),
    **{f"tikhonov_{rule.name}": Tikhonov(1, rule=rule) for rule in RULES},
}
# Angles between two elements at one depth; the second pair differs by round-off alone.
APART_RAD = (0.0, 1e-15, 1e-9, 1e-4)


def nearly_equal(apart_rad):
    return (Film(DEPTH_M, 0.4), Film(DEPTH_M, 0.4 + apart_rad))


@pytest.mark.full
@pytest.mark.parametrize("apart_rad", APART_RAD)
@pytest.mark.parametrize("name", METHODS)
def test_nearly_equal_elements_give_a_finite_unsure_answer(name, apart_rad):
    estimate = METHODS[name](make_case(films=nearly_equal(apart_rad)).problem)
    assert estimate.status == "converged"
    value, stderr = np.asarray(estimate.value), np.asarray(estimate.stderr)
    assert np.all(np.isfinite(value))
    assert np.all(stderr > 0)
    if name == "wiener":
        # Half of what is asked is not in the data: the prior's level stays in p and in q.
        apart = np.asarray(METHODS[name](make_case().problem).stderr)
        assert np.all(stderr > 1.5 * apart)
        assert np.all(stderr < np.array([[1.5e3], [5e2]]))


@pytest.mark.parametrize("path", ["spectral", "direct"])
def test_answers_change_smoothly_as_two_elements_become_one(path):
    method = Wiener(P, Q, path=path)
    same = method(make_case(films=nearly_equal(0.0)).problem)
    for apart_rad in APART_RAD[1:3]:
        near = method(make_case(films=nearly_equal(apart_rad)).problem)
        assert relative(near.value, same.value) < 1e-5
        assert relative(near.stderr, same.stderr) < 1e-5


def test_means_that_two_equal_elements_cannot_part_are_not_claimed():
    """Both means act on both signals in one proportion: no path may call the split observed."""
    problem, truth, _ = make_case(films="same_turned", amplifier=SLOW, background_Pa=1e3)
    for path in ("spectral", "direct", "iterative"):
        estimate = Tikhonov(1, 2e-5, 8e-5, path=path)(problem)
        error = np.abs(np.asarray(estimate.value) - truth).mean(axis=-1)
        stderr = np.asarray(estimate.stderr).mean(axis=-1)
        said = problem.mean_statement()
        for c, name in enumerate("pq"):
            honest = stderr[c] > error[c] / 4 or said[name] != "from the signal"
            assert honest, (path, name, error[c], stderr[c], said[name])


@pytest.mark.parametrize("friction", [-2.0, -0.3, 0.0, 0.3, 2.0])
def test_friction_of_either_sign(friction):
    problem, truth, _ = make_case(films="one", friction=friction)
    estimate = Wiener(P)(problem)
    assert estimate.status == "converged"
    wanted = truth - truth.mean(axis=-1, keepdims=True)
    assert np.linalg.norm(np.asarray(estimate.value) - wanted) < 0.25 * np.linalg.norm(wanted)
    np.testing.assert_allclose(estimate.value[1], friction * estimate.value[0], atol=1e-9)


STATIC = {"given": Tikhonov(1, 2e-5, 8e-5), "wiener": Wiener(P, Q)}
STATIC |= {rule.name: Tikhonov(1, rule=rule) for rule in RULES}
STATIC["wiener_evidence"] = Wiener(P, Q, scale="evidence")


@pytest.mark.parametrize("name", STATIC)
def test_a_model_that_feels_nothing_is_never_sure(name):
    """A static touch: no number may come with a standard error of nothing, or it is refused."""
    case = make_case()
    line, forward = case.problem.line, case.problem.forward
    silent = Convolution(0 * forward.transfer, line.cell_m, line.n, line.n)
    try:
        problem = LineProblem(case.problem.line, silent, case.problem.data, case.problem.noise)
        estimate = STATIC[name](problem)
    except BadInput:
        return
    certain = np.asarray(estimate.stderr) < 1e-3 * np.abs(case.truth).max()
    assert estimate.status != "converged" or not np.any(certain)


@pytest.mark.parametrize("noise_fraction", [1e-9, 1e3])
@pytest.mark.parametrize("name", ["wiener", "tikhonov", "wiener_direct"])
def test_noise_of_any_size(name, noise_fraction):
    """A signal a thousand times below the noise says nothing; one far above it says all."""
    problem, truth, _ = make_case(noise_fraction=noise_fraction)
    estimate = METHODS[name](problem)
    wanted = deviation(problem, truth)
    error = np.abs(np.asarray(estimate.value) - wanted).max(axis=-1)
    assert estimate.status == "converged"
    if noise_fraction < 1:
        assert np.all(error < 0.3 * np.abs(wanted).max(axis=-1))
    else:
        assert np.all(np.asarray(estimate.stderr) > 0)
        assert np.abs(estimate.value).max() < 5 * np.asarray(estimate.stderr).max()
