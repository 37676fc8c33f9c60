"""What a linear problem refuses, each in one sentence that names the value and what to give."""

from typing import Any

import jax
import jax.numpy as jnp
import lineax
import numpy as np
import pytest
import scipy.sparse

import srsinv
from srsinv import GaussianPrior, LinearProblem, Tikhonov, Wiener
from srsinv.inverse.features.method import FeatureFit
from tests.inverse.linear.problems import shaw

M = 8
MATRIX, DATA = shaw(M).matrix, shaw(M).data
ARRAY = jnp.asarray(MATRIX)
IDENTITY = np.eye(M)
EVERYWHERE = np.full(M, np.nan)
TURNED = IDENTITY - 2 * np.outer(IDENTITY[0], IDENTITY[0])  # one eigenvalue of -1


def problem(operator: Any = MATRIX, data: Any = DATA, noise: object = 1e-3, **more):
    return LinearProblem(operator, data, noise, **more)


def function(operator, adjoint=lambda y: ARRAY.T @ y):
    return problem(operator, adjoint=adjoint)


REFUSED = {
    "no_operator": (lambda: problem("blur"), "operator", "'blur'", "matrix"),
    "ragged": (lambda: problem([[1.0, 2.0], [3.0]]), "operator", "matrix"),
    "vector": (lambda: problem(DATA), "operator", "matrix"),
    "samples": (lambda: problem(MATRIX[:-1]), "7 samples", "(8,)"),
    "not_finite": (lambda: problem(MATRIX * np.inf), "operator", "finite"),
    "complex": (lambda: problem(MATRIX + 1j), "complex"),
    "sparse_samples": (lambda: problem(scipy.sparse.csr_array(MATRIX[:-1])), "7 samples"),
    "no_adjoint": (lambda: problem(lambda x: ARRAY @ x), "adjoint=", "lineax"),
    "two_adjoints": (lambda: problem(adjoint=lambda y: y), "adjoint", "leave"),
    "lineax_tree": (
        lambda: problem(lineax.IdentityLinearOperator({"a": jnp.zeros(M)})), "trees of arrays",
    ),
    "lineax_shape": (
        lambda: problem(lineax.MatrixLinearOperator(ARRAY[:-1])), "(7,)", "(8,)",
    ),
    "not_linear": (lambda: function(lambda x: ARRAY @ x + 1), "not linear"),
    "squared": (lambda: function(lambda x: ARRAY @ x**2), "not linear"),
    "wrong_adjoint": (
        lambda: function(lambda x: ARRAY @ jnp.roll(x, 1)), "adjoint is not the adjoint",
    ),
    "adjoint_factor": (
        lambda: function(lambda x: ARRAY @ x, lambda y: 1.01 * ARRAY.T @ y), "not the adjoint",
    ),
    "function_shape": (
        lambda: function(lambda x: (ARRAY @ x)[:-1]), "(7,)", "(8,)",
    ),
    "not_traced": (
        lambda: function(lambda x: np.fft.rfft(np.asarray(x)).real), "traced", "scipy",
    ),
    "data_words": (lambda: problem(data="signal"), "data", "'signal'"),
    "data_missing": (lambda: problem(data=EVERYWHERE), "data", "NaN"),
    "data_infinite": (lambda: problem(data=DATA + np.inf), "data", "infinite"),
    "noise_zero": (lambda: problem(noise=0.0), "noise", "above 0"),
    "noise_nan": (lambda: problem(noise=np.nan), "noise", "finite"),
    "noise_shape": (lambda: problem(noise=np.ones(3)), "noise", "(3,)", "(8, 8)"),
    "noise_skew": (lambda: problem(noise=IDENTITY + np.eye(M, k=1)), "noise", "symmetric"),
    "noise_negative": (lambda: problem(noise=TURNED), "noise", "eigenvalues"),
    "prior_kind": (lambda: problem(prior=1.0), "prior", "GaussianPrior"),
    "prior_none": (lambda: GaussianPrior(), "no width", "covariance"),
    "prior_two": (lambda: GaussianPrior(1.0, covariance=IDENTITY), "stderr and covariance"),
    "prior_zero": (lambda: GaussianPrior(0.0), "stderr", "above 0"),
    "prior_words": (lambda: GaussianPrior("wide"), "stderr", "finite"),
    "prior_skew": (lambda: GaussianPrior(covariance=IDENTITY + np.eye(M, k=1)), "symmetric"),
    "prior_negative": (lambda: GaussianPrior(precision=TURNED), "negative eigenvalue"),
    "prior_flat": (lambda: GaussianPrior(covariance=DATA), "covariance", "(8,)"),
    "mean_shape": (
        lambda: srsinv.invert(problem(prior=GaussianPrior(1.0, mean=np.ones(3)))), "mean", "(3,)",
    ),
    "stderr_shape": (
        lambda: srsinv.invert(problem(prior=GaussianPrior(np.ones(3)))), "stderr", "(3,)",
    ),
    "prior_size": (
        lambda: srsinv.invert(problem(prior=GaussianPrior(covariance=np.eye(3)))),
        "3 unknowns", "of 8",
    ),
    "root_size": (
        lambda: srsinv.invert(problem(prior=GaussianPrior(root=np.eye(3)))), "3 unknowns", "of 8",
    ),
    "wiener": (lambda: Wiener()(problem()), "prior", "GaussianPrior", "Tikhonov"),
    "weight_q": (lambda: Tikhonov(weight_p=1.0, weight_q=1.0)(problem()), "weight_q"),
    "rule_traced": (
        lambda: jax.jit(lambda data: Tikhonov(path="iterative")(problem(data=data)).value)(DATA),
        "jit", "weight_p", "path=direct",
    ),
    "resolution": (
        lambda: Tikhonov(weight_p=1.0, path="iterative")(problem()).resolution, "path=direct",
    ),
    "not_circulant": (lambda: Tikhonov(path="spectral")(problem()), "circulant", "path=auto"),
    "one_unknown": (lambda: srsinv.invert(problem(MATRIX[:, :1])), "order=1", "order=0"),
    "zero": (lambda: srsinv.invert(problem(0 * MATRIX)), "zero"),
    "undetermined": (
        lambda: srsinv.invert(problem(np.diff(IDENTITY, axis=0), DATA[:-1])), "undetermined",
        "order=0",
    ),
    "few_rows": (
        lambda: srsinv.invert(problem(MATRIX[:2], DATA[:2], prior=GaussianPrior(root=MATRIX[:3]))),
        "5 rows", "8 unknowns",
    ),
    "features": (
        lambda: srsinv.invert(problem(), FeatureFit({"strip": srsinv.StripFeature()})),
        "LinearProblem", "Tikhonov",
    ),
    "sensor": (lambda: srsinv.invert(problem(), sensor=srsinv.Sensor()), "sensor"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_in_a_sentence_or_two(case):
    attempt, *words = REFUSED[case]
    with pytest.raises(srsinv.BadInput) as caught:
        attempt()
    sentence = str(caught.value)
    assert sentence.endswith(".")
    assert [word for word in words if word not in sentence] == [], sentence
