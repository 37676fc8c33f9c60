"""Tikhonov's method: three paths and a dense solve agree; what is there to recover is recovered."""

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.solve import solve
from srsinv.inverse.method import Method
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.inverse.cases import (
    DEPTH_M,
    SLOW,
    deviation,
    gaps,
    make_case,
    make_line,
    make_operator,
    minimiser,
    penalty_rows,
    relative,
    stderr_of,
)
from tests.refusals import refused
from tests.tiers import quick

ORDERS = (0, 1, 2)
WEIGHTS = (2e-5, 8e-5)
ALL = ("spectral", "direct", "iterative")
SETTINGS = {
    "periodic": ({}, ALL),
    "gaps": ({"kind": "open", "observed": gaps()}, ALL[1:]),
    "odd": ({"n": 47}, ALL[:1]),
    "coloured_apart": ({"colour": "apart"}, ALL),
    "free_offset": ({"amplifier": SLOW, "films": "turned", "free_offset": True}, ALL),
    "friction": ({"films": "one", "friction": 0.3}, ALL[:2]),
    "gaps_and_offset": (
        {"kind": "open", "observed": gaps(), "amplifier": SLOW, "free_offset": True},
        ALL[1:],
    ),
    "coloured_apart_gaps": ({"kind": "open", "observed": gaps(), "colour": "apart"}, ALL[1:2]),
    "coloured_gaps": ({"kind": "open", "observed": gaps(), "colour": True}, ALL[1:2]),
}
# Every order on plain lines, the second order (the hardest) elsewhere.
CASES = [("periodic", 0), ("periodic", 1), ("gaps", 1), ("gaps", 2)]
CASES += [(name, 2) for name in SETTINGS if name not in ("periodic", "gaps")]


@pytest.mark.parametrize(("name", "order"), quick(CASES, ("periodic", 1), ("gaps", 1)))
def test_paths_agree_with_a_dense_solve(name, order):
    settings, paths = SETTINGS[name]
    problem = make_case(**settings).problem
    rows = penalty_rows(problem, order, WEIGHTS[: problem.unknowns])
    dense = minimiser(problem)(rows)
    stderr = stderr_of(problem, dense.covariance)
    for path in paths:
        estimate = Tikhonov(order, *WEIGHTS, length_m=DEPTH_M, path=path)(problem)
        assert (estimate.status, estimate.stats["path"]) == ("converged", path)
        assert relative(estimate.value[: problem.unknowns], dense.value) < 1e-6, path
        if path != "iterative" or problem.forward.is_circular:  # else that of a periodic line
            assert relative(estimate.stderr[: problem.unknowns], stderr) < 1e-6, path
        residual = np.nansum(np.asarray(estimate.whitened) ** 2)
        # Coloured noise is whitened as if the gaps held no residual.
        near = 0.05 if name.startswith("coloured") and name.endswith("gaps") else 1e-6
        assert residual == pytest.approx(dense.residual, rel=near), path


def band_limited(line, rng):
    """Random traction (2, n) without its mean, of wavelengths that the film still feels."""
    k = np.asarray(line.k)
    parts = rng.normal(size=(2, 2, len(k))) * ((k > 0) & (k * DEPTH_M <= 5))
    return 1e3 * np.fft.irfft(parts[0] + 1j * parts[1], line.n)


EXACT = {
    "wiener": Wiener(Exponential(1e3, 1e-3), Exponential(1e3, 1e-3)),
    **{f"tikhonov_{order}": Tikhonov(order, 1e-6, 1e-6) for order in ORDERS},
}


@pytest.mark.parametrize("films", ["pair", "turned"])
@pytest.mark.parametrize("name", EXACT)
def test_noise_free_traction_is_recovered(name, films):
    """Wavelengths down to k z0 = 5, apart from the mean, to 1e-6."""
    line = make_line()
    operator = make_operator(line, films)
    truth = band_limited(line, np.random.default_rng(4))
    assert np.any(np.asarray(line.k) * DEPTH_M > 5)
    signal = np.asarray(operator(jnp.asarray(truth)))
    noise = np.full(line.k.shape, (1e-11 * signal.std()) ** 2)
    problem = LineProblem(line, operator, signal, noise)
    assert relative(EXACT[name](problem).value, truth) < 1e-6


@pytest.mark.parametrize("order", ORDERS)
def test_strong_weights_leave_what_is_not_penalised(order):
    """Under a weight above all the data the value, slope or curvature goes, and no more."""
    problem = make_case("open", observed=gaps()).problem
    value = np.asarray(Tikhonov(order, 1e8, 1e8)(problem).value)
    scale = np.abs(deviation(problem, make_case("open").truth)).max()
    assert np.abs(np.diff(value, order)).max() < 1e-4 * scale
    assert order == 0 or np.abs(value).max() > 1e-3 * scale


def test_weights_act_on_their_own_component():
    """A weight on q alone bends q to nothing and leaves p as it would be were q known."""
    problem = make_case().problem
    free = Tikhonov(0, 1e-6, 1e-6)(problem)
    bound = Tikhonov(0, 1e-6, 1e9)(problem)
    assert np.abs(bound.value[1]).max() < 1e-6 * np.abs(free.value[1]).max()
    assert np.abs(bound.value[0]).max() > 0.1 * np.abs(free.value[0]).max()
    assert np.all(np.asarray(bound.stderr[0]) < np.asarray(free.stderr[0]))


def test_length_only_rescales_the_weight():
    problem = make_case().problem
    one = Tikhonov(2, 1e-5, 1e-4, length_m=1e-3)(problem)
    other = Tikhonov(2, 16e-5, 16e-4, length_m=0.5e-3)(problem)
    assert relative(other.value, one.value) < 1e-9


def test_a_fixed_prior_has_the_weights_that_the_rule_chose():
    """On another line too, where the rule would choose others; of wider cells each counts for more,
    as the penalty is a sum over cells."""
    problem, longer = make_case().problem, make_case(n=47).problem
    stats = Tikhonov()(problem).stats
    prior = Tikhonov().prior_fixed_on(problem)(longer)
    wider = float(longer.line.cell_m / problem.line.cell_m)
    weights = [wider * stats[f"weight_{c}_per_Pa2"] for c in "pq"]
    fixed = solve(longer, prior, "auto", 1e-10)
    assert relative(fixed.value, Tikhonov(1, *weights)(longer).value) < 1e-9


def test_a_method_without_a_prior_is_refused_one():
    class Zero(Method):
        def __call__(self, problem):
            pytest.fail("it is asked for its prior alone")

    problem = make_case().problem
    assert Zero().spectra(problem) is None
    refused(lambda: Zero().prior_fixed_on(problem), "Zero", "prior", "method=[wiener,tikhonov]")
