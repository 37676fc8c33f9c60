"""Single precision: the same estimates at float32, to bounds that say what it costs."""

import jax
import numpy as np
import pytest

from srsinv.inverse.line.rule import GeneralisedCrossValidation
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from tests.inverse.cases import gaps, make_case, relative

OPEN = {"kind": "open", "observed": gaps()}
# What is run, on which problem, and the largest relative difference of value and standard error.
RUNS = {
    "wiener": (lambda: Wiener(Exponential(1.5e3, 8e-4), Exponential(5e2, 1.5e-3)), {}, 1e-5),
    "iterative_open": (
        lambda: Tikhonov(1, 2e-4, 8e-4, path="iterative", tolerance=1e-5),
        OPEN,
        1e-2,
    ),
    "direct_open": (lambda: Tikhonov(1, 2e-4, 8e-4), OPEN, 1e-2),
    "spectral_gcv": (lambda: Tikhonov(1, rule=GeneralisedCrossValidation()), {}, 1e-2),
}


def run(name):
    """The estimate, everything built anew in the precision that is on."""
    method, settings, _ = RUNS[name]
    return jax.device_get(method()(make_case(**settings).problem))


@pytest.mark.full
@pytest.mark.parametrize("name", RUNS)
def test_single_precision(name):
    double = run(name)
    with jax.enable_x64(False):
        single = run(name)
    bound = RUNS[name][2]
    assert (double.value.dtype.name, single.value.dtype.name) == ("float64", "float32")
    assert single.status == double.status == "converged"
    assert single.stats.get("rule_status") == double.stats.get("rule_status")
    assert np.all(np.isfinite(single.value))
    assert relative(single.value, double.value) < bound
    assert relative(single.stderr, double.stderr) < bound


@pytest.mark.full
def test_the_default_tolerance_is_within_reach():
    """The iterative path converges in single precision as it is, or the name means nothing."""
    with jax.enable_x64(False):
        problem = make_case(**OPEN).problem
        estimate = Tikhonov(1, 2e-4, 8e-4, path="iterative")(problem)
    assert estimate.status == "converged"
