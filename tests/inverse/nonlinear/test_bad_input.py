"""What a fit refuses before any computing: one sentence that names what is wrong."""

import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import srsinv
from srsinv.inverse.nonlinear import (
    Correlated,
    Huber,
    JaxoptLBFGSB,
    OptaxLBFGS,
    Optimistix,
    Spectrum,
)
from tests.refusals import refused

N = 20
X = np.linspace(0, 1, N)
Y = 3 * np.exp(-2 * X) + 1
INITIAL = {"amp": 1.0, "rate": 1.0, "c": 0.0}
HOLE = np.where(np.arange(N) == 3, np.nan, Y)
BOX = {"amp": (0, 5), "rate": (0, 5), "c": (-1, 1)}


def model(p):
    return p["amp"] * jnp.exp(-p["rate"] * X) + p["c"]


def fit(of=model, initial: object = INITIAL, y: object = Y, **options):
    return srsinv.fit(of, initial, y, **options)


def many(ys, **options):
    return srsinv.fit_many(model, INITIAL, ys, **options)


REFUSED = {
    "free_name": (lambda: fit(free=["amp", "zz"]), "free", "'zz'", "amp, c, rate"),
    "free_none": (lambda: fit(free=()), "free", "at least one"),
    "free_value": (lambda: fit(free={"amp": "yes"}), "free of amp", "'yes'"),
    "free_count": (lambda: fit(free=[True, False]), "free", "amp, c, rate"),
    "bounds_name": (lambda: fit(bounds={"zz": (0, 1)}), "bound", "'zz'"),
    "bounds_swapped": (lambda: fit(bounds={"amp": (2, 0)}), "amp", "[2, 0]", "lower one first"),
    "bounds_equal": (lambda: fit(bounds={"amp": (1, 1)}), "amp", "[1, 1]", "free"),
    "bounds_nan": (lambda: fit(bounds={"amp": (np.nan, 3)}), "bound", "nan"),
    "bounds_text": (lambda: fit(bounds={"amp": ("a", 3)}), "amp", "'a'"),
    "bounds_texts": (lambda: fit(bounds=("a", "b")), "lower bound", "'a'"),
    "bounds_number": (lambda: fit(bounds=3), "bounds", "3", "mapping"),
    "bounds_one": (lambda: fit(bounds={"amp": 3}), "amp", "3", "(lower, upper)"),
    "bounds_three": (lambda: fit(bounds={"amp": (1, 2, 3)}), "amp", "(1, 2, 3)"),
    "bounds_count": (lambda: fit(bounds=([1, 2], [3, 4])), "lower bound", "3 parameters"),
    "bounds_shape": (lambda: fit(bounds={"amp": ([0, 1], [3, 4])}), "amp", "[0, 1]"),
    "outside": (lambda: fit(bounds={"amp": (2, 3)}), "amp", "1", "[2, 3]", "start inside"),
    "prior_name": (lambda: fit(priors={"zz": (0, 1)}), "prior", "'zz'"),
    "prior_negative": (lambda: fit(priors={"amp": (0, -1)}), "amp", "-1", "above 0"),
    "prior_mean": (lambda: fit(priors={"amp": (np.nan, 1)}), "amp", "nan"),
    "prior_nan": (lambda: fit(priors={"amp": (0, np.nan)}), "amp", "nan"),
    "prior_text": (lambda: fit(priors={"amp": ("a", 1)}), "amp", "'a'"),
    "prior_texts": (lambda: fit(priors={"amp": (1, "b")}), "amp", "'b'"),
    "prior_number": (lambda: fit(priors={"amp": 1}), "amp", "1", "(mean,"),
    "prior_shape": (lambda: fit(priors={"amp": ([1, 2], 1)}), "amp", "[1, 2]"),
    "priors_list": (lambda: fit(priors=[1, 2]), "priors", "by name"),
    "linear_name": (lambda: fit(linear=["zz"]), "linear", "'zz'"),
    "linear_not": (lambda: fit(linear=["rate"]), "not linear", "rate"),
    "linear_bounds": (lambda: fit(linear=["amp"], bounds={"amp": (0, 5)}), "amp", "leave out one"),
    "linear_number": (lambda: fit(linear=3), "linear", "3", "names"),
    "starts_none": (lambda: fit(starts=0), "starts", "0", "from 1"),
    "starts_open": (lambda: fit(starts=3), "starts=3", "amp, c, rate", "bounds"),
    "starts_negative": (lambda: fit(starts=-3, bounds=BOX), "starts", "-3"),
    "starts_half": (lambda: fit(starts=2.5), "starts", "2.5", "whole"),
    "starts_name": (lambda: fit(starts={"zz": [1, 2]}), "starts", "'zz'"),
    "starts_count": (lambda: fit(starts={"amp": [1, 2], "c": [1, 2, 3]}), "c", "(3,)", "as many"),
    "starts_scalar": (lambda: fit(starts={"amp": 1.0}), "amp", "()"),
    "starts_text": (lambda: fit(starts={"amp": ["a"]}), "amp", "['a']", "numbers"),
    "starts_outside": (lambda: fit(starts={"amp": [7]}, bounds=BOX), "amp", "[0, 5]"),
    "starts_nan": (lambda: fit(starts={"amp": [np.nan]}), "amp", "not finite"),
    "starts_inf": (lambda: fit(starts={"amp": [np.inf]}), "amp", "not finite"),
    "starts_empty": (lambda: fit(starts={"amp": []}), "amp", "(0,)", "at least one"),
    "starts_nobody": (lambda: fit(starts={}), "starts", "at least one"),
    "starts_ragged": (lambda: fit(starts={"amp": [[1, 2], [3]]}), "amp", "rows of numbers"),
    "noise_zero": (lambda: fit(noise=0.0), "noise", "above 0"),
    "noise_negative": (lambda: fit(noise=-1), "noise", "above 0"),
    "noise_nan": (lambda: fit(noise=np.nan), "noise", "above 0"),
    "noise_length": (lambda: fit(noise=np.ones(7)), "noise", "(20,)"),
    "noise_text": (lambda: fit(noise="loud"), "noise", "standard deviation"),
    "noise_complex": (lambda: fit(noise=np.array(1 + 1j)), "noise", "standard deviation"),
    "noise_everywhere": (lambda: fit(noise=np.inf), "left out", "finite noise"),
    "spectrum_length": (lambda: fit(noise=Spectrum(np.ones(5))), "spectrum", "5", "11"),
    "spectrum_zero": (lambda: Spectrum(np.zeros(11)), "spectrum", "above 0"),
    "spectrum_text": (lambda: Spectrum("loud"), "spectrum", "above 0"),
    "spectrum_endless": (lambda: fit(noise=Spectrum(np.full(11, np.inf))), "left out"),
    "covariance_size": (lambda: fit(noise=Correlated(np.eye(5))), "covariance", "5", "20"),
    "covariance_skew": (lambda: Correlated(np.triu(np.ones((N, N)))), "symmetric"),
    "covariance_singular": (lambda: Correlated(np.ones((N, N))), "not positive definite"),
    "covariance_text": (lambda: Correlated("loud"), "symmetric"),
    "data_nan": (lambda: fit(y=HOLE), "1 values", "nan", "infinite noise"),
    "data_text": (lambda: fit(y="a"), "data", "str"),
    "data_complex": (lambda: fit(y=Y + 1j), "data", "real numbers"),
    "data_none": (lambda: fit(y=None), "data", "nan"),
    "data_ragged": (lambda: fit(y=[[1, 2], [3]]), "data", "list"),
    "data_empty": (lambda: fit(lambda p: p["amp"] * jnp.zeros(0), y=[]), "left out"),
    "model_shape": (lambda: fit(lambda p: model(p)[:-1]), "(19,)", "(20,)"),
    "model_tuple": (lambda: fit(lambda p: (model(p), 1)), "tuple", "(20,)"),
    "model_none": (lambda: fit(lambda p: None), "NoneType", "(20,)"),
    "model_text": (lambda: fit("exp"), "'exp'", "function"),
    "model_complex": (lambda: fit(lambda p: model(p) + 1j), "complex", "real and imaginary"),
    "model_numpy": (lambda: fit(lambda p: np.exp(np.asarray(p["amp"])) * X), "jax.numpy"),
    "model_float": (lambda: fit(lambda p: float(p["amp"]) * X), "float()", "jax.numpy"),
    "model_if": (lambda: fit(lambda p: X if p["amp"] > 0 else -X), "if", "jax.numpy"),
    "misspelt": (lambda: fit(bounds={"rates": (0, 1)}), "'rates'", "nearest is rate;"),
    "initial_empty": (lambda: fit(initial={}), "no parameter", "empty"),
    "initial_nan": (lambda: fit(initial=INITIAL | {"amp": np.nan}), "amp", "nan", "finite"),
    "initial_text": (lambda: fit(initial=INITIAL | {"amp": "big"}), "amp", "'big'"),
    "initial_complex": (lambda: fit(initial=INITIAL | {"amp": np.array(1j)}), "amp", "real"),
    "loss_name": (lambda: fit(loss="l2"), "'l2'", "huber"),
    "loss_list": (lambda: fit(loss=["huber"]), "['huber']", "huber"),
    "loss_threshold": (lambda: Huber(-1.0), "loss.threshold", "-1.0", "positive"),
    "loss_threshold_text": (lambda: Huber("wide"), "loss.threshold", "'wide'"),
    "solver": (lambda: fit(solver="lm"), "'lm'", "Optimistix()"),
    "max_searches": (lambda: fit(max_searches=0), "max_searches", "0", "from 1"),
    "tolerance": (lambda: Optimistix(tolerance=2.0), "solver.tolerance", "2.0", "0 and 1"),
    "tolerance_text": (lambda: OptaxLBFGS(tolerance="fine"), "solver.tolerance", "'fine'"),
    "steps": (lambda: JaxoptLBFGSB(max_steps=0), "solver.max_steps", "0", "from 1"),
    "steps_half": (lambda: Optimistix(max_steps=10.5), "solver.max_steps", "10.5"),
    "memory": (lambda: OptaxLBFGS(memory=0), "solver.memory", "0"),
    "many_flat": (lambda: many(Y), "leading axis"),
    "many_empty": (lambda: many(np.zeros((0, N))), "leading axis"),
    "many_text": (lambda: many("a"), "data", "str"),
    "many_nan": (lambda: many(np.stack([Y, HOLE])), "1 values", "nan"),
    "many_priors": (lambda: many(Y[None], priors={"amp": (0, 1)}), "priors", "noise"),
    "many_at_once": (lambda: many(Y[None], at_once=0), "at_once", "0", "from 1"),
}


@pytest.fixture
def _as_users_have_it():
    """Without the tests' own check of types, which would refuse first."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.mark.usefixtures("_as_users_have_it")
@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name):
    refused(*REFUSED[name])


def test_allowed():
    """Whole numbers to start from, one name for several, and holes that noise leaves out."""
    noise = np.where(np.isnan(HOLE), np.inf, 0.1)
    solution = fit(initial={"amp": 1, "rate": 1, "c": 0}, y=HOLE, noise=noise, linear="amp")
    assert solution.converged, solution.status
    np.testing.assert_allclose(solution.value["amp"], 3.0, rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(solution.residual), np.isnan(HOLE))
    assert solution.stats["data"] == N - 1
