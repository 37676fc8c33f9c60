"""The iterative path: its operator, and what it says when its limit is hit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.inverse import spectral
from srsinv.inverse.iterative import NormalEquations
from srsinv.inverse.tikhonov import DerivativePenalty, Tikhonov
from srsinv.inverse.wiener import Exponential, SpectralPrior
from srsinv.status import Status
from tests.inverse.cases import (
    DEPTH_M,
    SLOW,
    N,
    gaps,
    make_case,
    minimiser,
    penalty_rows,
    relative,
)

CASES = {
    "periodic": {},
    "coloured": {"colour": True},
    "open": {"kind": "open"},
    "gaps": {"kind": "open", "observed": gaps()},
    "offset": {"films": "turned", "amplifier": SLOW, "free_offset": True},
    "gaps_and_offset": {
        "kind": "open",
        "amplifier": SLOW,
        "free_offset": True,
        "observed": gaps(),
    },
}


def priors(problem):
    weights = jnp.array([2e-5, 8e-5])
    power = [Exponential(1e3, 1e-3).power(problem), Exponential(3e2, 2e-3).power(problem)]
    return {
        "first": DerivativePenalty(weights, jnp.asarray(DEPTH_M), 1),
        "second": DerivativePenalty(weights, jnp.asarray(DEPTH_M), 2),
        "spectra": SpectralPrior(jnp.stack(power)),
    }


@jax.jit
def matrices(problem, prior):
    """The normal equations and their preconditioner as matrices (2 n, 2 n)."""
    normal = NormalEquations(problem, prior, spectral.factorise(problem, prior))
    basis = jnp.eye(2 * N).reshape(-1, 2, N)
    return [jax.vmap(f)(basis).reshape(2 * N, 2 * N) for f in (normal, normal.precondition)]


@pytest.mark.full
@pytest.mark.parametrize("prior", ["first", "second", "spectra"])
@pytest.mark.parametrize("name", CASES)
def test_operator_and_preconditioner_are_symmetric_and_semidefinite(name, prior):
    problem = make_case(**CASES[name]).problem
    for matrix in np.asarray(matrices(problem, priors(problem)[prior])):
        assert relative(matrix.T, matrix) < 1e-11
        values = np.linalg.eigvalsh((matrix + matrix.T) / 2)
        assert values[0] > -1e-12 * values[-1]
        # Only the means that are not solved for may be null.
        assert np.sum(values < 1e-12 * values[-1]) <= np.sum(problem.zero_mean) + 2


TOO_HARD = {
    "next_to_no_weight": Tikhonov(1, 1e-13, 1e-13, path="iterative"),
}


@pytest.mark.parametrize("name", TOO_HARD)
def test_the_limit_of_iterations_is_said(name):
    """An open line with gaps, where hundreds of steps are not enough."""
    estimate = TOO_HARD[name](make_case("open", observed=gaps()).problem)
    assert estimate.status is Status.STEP_LIMIT
    assert estimate.stats["iterations"] > 100
    assert "more steps" in estimate.reasons[0]


@pytest.mark.parametrize("log_weight", [-16, -14, -13, -12, -10, -8, -6, -4, 0])
@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("path", ["direct", "iterative"])
def test_what_is_called_converged_is_the_solution(path, order, log_weight):
    """Against QR of the stacked rows, which does not square the condition number."""
    problem = make_case("open", observed=gaps()).problem
    weights = [10.0**log_weight] * 2
    estimate = Tikhonov(order, *weights, path=path)(problem)
    if estimate.status == "converged":
        dense = minimiser(problem)(penalty_rows(problem, order, weights))
        assert relative(estimate.value, dense.value) < (1e-2 if log_weight <= -8 else 1e-6)
    assert log_weight <= -8 or estimate.status == "converged"


def test_a_looser_tolerance_takes_fewer_steps():
    problem = make_case("open", observed=gaps()).problem
    steps = [
        Tikhonov(1, 2e-5, 8e-5, path="iterative", tolerance=t)(problem).stats["iterations"]
        for t in (1e-12, 1e-6, 1e-2)
    ]
    assert steps[0] > steps[1] > steps[2] > 0


def test_a_periodic_line_takes_next_to_no_steps():
    """There the preconditioner is the answer."""
    estimate = Tikhonov(1, 2e-5, 8e-5, path="iterative")(make_case().problem)
    assert estimate.stats["iterations"] <= 4


def test_standard_error_on_the_open_line_is_of_the_right_size():
    """It is that of the nearest periodic problem, which must not be another order of magnitude."""
    problem = make_case("open", observed=gaps()).problem
    direct, iterative = (Tikhonov(1, 2e-5, 8e-5, path=p)(problem) for p in ("direct", "iterative"))
    ratio = np.median(np.asarray(iterative.stderr) / np.asarray(direct.stderr), axis=-1)
    assert np.all((ratio > 0.3) & (ratio < 3))
