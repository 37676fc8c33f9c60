"""Linear problems: exact posteriors, every kind of operator, every path, derivatives."""

from typing import Any

import jax
import jax.numpy as jnp
import lineax
import mpmath
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse

import srsinv
from srsinv import GaussianPrior, LinearProblem, Tikhonov, Wiener
from srsinv.inverse.line.rule import Evidence, GeneralisedCrossValidation, LCurve
from srsinv.status import Status
from tests.inverse.linear.problems import PROBLEMS
from tests.tiers import quick

M = 24
DIGITS = 40  # of the exact posterior
AT = np.arange(M) / M
BLUR = np.exp(-0.5 * ((AT[:, None] - AT) / 0.06) ** 2) / M
CIRCULANT = scipy.linalg.circulant(np.exp(-0.5 * (np.minimum(AT, 1 - AT) / 0.06) ** 2) / M)
TRUTH = np.sin(2 * np.pi * AT) + 0.5
NOISE = 1e-3
SMOOTH = np.exp(-np.abs(AT[:, None] - AT) / 0.3)


def noisy(matrix=BLUR, seed=0):
    return matrix @ TRUTH + NOISE * np.random.default_rng(seed).standard_normal(len(matrix))


def exact(matrix, data, noise, precision, mean):
    """Mean and standard deviation of the posterior in `DIGITS` digits; `noise` is a covariance."""
    with mpmath.workdps(DIGITS):
        a, y, m = (mpmath.matrix(np.asarray(each).tolist()) for each in (matrix, data, mean))
        weighed = a.T * mpmath.matrix(noise.tolist()) ** -1
        covariance = (weighed * a + precision) ** -1
        value = m + covariance * (weighed * (y - a * m))
        stderr = [mpmath.sqrt(covariance[i, i]) for i in range(len(mean))]
        return np.array(value.tolist(), float).ravel(), np.array(stderr, float)


def inverse(matrix):
    with mpmath.workdps(DIGITS):
        return mpmath.matrix(matrix.tolist()) ** -1


WHITE = NOISE**2 * np.eye(M)
COLOURED = NOISE**2 * np.exp(-np.abs(np.arange(M)[:, None] - np.arange(M)) / 2.0)
UNEVEN = NOISE * (1 + AT)
PRIORS = {
    "stderr": (GaussianPrior(0.7, mean=0.5), inverse(0.7**2 * np.eye(M))),
    "stderrs": (GaussianPrior(0.7 + AT, mean=0.5), inverse(np.diag((0.7 + AT) ** 2))),
    "covariance": (GaussianPrior(covariance=SMOOTH, mean=0.5), inverse(SMOOTH)),
    "precision": (GaussianPrior(precision=np.linalg.inv(SMOOTH), mean=0.5), None),
    "root": (GaussianPrior(root=np.eye(M) - 0.9 * np.eye(M, k=1), mean=0.5), None),
}


@pytest.mark.parametrize("noise", [NOISE, UNEVEN, COLOURED], ids=["white", "uneven", "coloured"])
@pytest.mark.parametrize("name", PRIORS)
def test_posterior_is_the_exact_one(name, noise):
    """To 1e-10 of its largest value, of a deconvolution with a condition number of 1e6."""
    prior, precision = PRIORS[name]
    if name == "precision":
        precision = mpmath.matrix(np.linalg.inv(SMOOTH).tolist())
    elif name == "root":
        root = np.eye(M) - 0.9 * np.eye(M, k=1)
        precision = mpmath.matrix((root.T @ root).tolist())
    data = noisy()
    covariance = {0: WHITE, 1: np.diag(UNEVEN**2)}.get(np.ndim(noise), COLOURED)
    value, stderr = exact(BLUR, data, covariance, precision, np.full(M, 0.5))
    found = srsinv.invert(LinearProblem(BLUR, data, noise, prior=prior))
    assert np.allclose(found.value, value, rtol=0, atol=1e-10 * np.abs(value).max())
    assert np.allclose(found.stderr, stderr, rtol=1e-10)


@pytest.mark.parametrize("order", [1, 2])
def test_penalty_on_differences_is_the_exact_one(order):
    data, weight = noisy(), 30.0
    rows = np.diff(np.eye(M), order, axis=0)
    precision = mpmath.matrix((weight * rows.T @ rows).tolist())
    value, stderr = exact(BLUR, data, WHITE, precision, np.zeros(M))
    found = Tikhonov(order, weight_p=weight)(LinearProblem(BLUR, data, NOISE))
    assert np.allclose(found.value, value, rtol=0, atol=1e-10 * np.abs(value).max())
    assert np.allclose(found.stderr, stderr, rtol=1e-10)


def test_singular_covariance_leaves_the_rest_at_the_mean():
    waves = np.stack([np.ones(M), np.cos(2 * np.pi * AT)], axis=1)
    prior = GaussianPrior(covariance=waves @ waves.T, mean=1.0)
    found = srsinv.invert(LinearProblem(BLUR, noisy(), NOISE, prior=prior))
    left = found.value - 1 - waves @ np.linalg.lstsq(waves, found.value - 1)[0]
    assert np.abs(left).max() < 1e-10
    assert np.linalg.matrix_rank(found.covariance, tol=1e-9) == 2


def test_more_unknowns_than_samples():
    matrix, data = BLUR[::3], noisy(BLUR[::3])
    prior = GaussianPrior(covariance=SMOOTH)
    white = NOISE**2 * np.eye(len(matrix))
    value, stderr = exact(matrix, data, white, inverse(SMOOTH), np.zeros(M))
    found = srsinv.invert(LinearProblem(matrix, data, NOISE, prior=prior))
    assert np.allclose(found.value, value, rtol=0, atol=1e-10 * np.abs(value).max())
    assert np.allclose(found.stderr, stderr, rtol=1e-10)


def test_missing_samples_are_left_out():
    data = noisy()
    some = np.where(np.arange(M) % 5 == 2, np.nan, data)
    kept = np.isfinite(some)
    for noise, own in (
        (NOISE, NOISE), (UNEVEN, UNEVEN[kept]), (COLOURED, COLOURED[np.ix_(kept, kept)])
    ):  # fmt: skip
        with_gaps = srsinv.invert(LinearProblem(BLUR, some, noise))
        without = srsinv.invert(LinearProblem(BLUR[kept], data[kept], own))
        assert np.allclose(with_gaps.value, without.value, rtol=0, atol=1e-12)
        assert np.array_equal(np.isnan(with_gaps.whitened), ~kept)


def as_function(x):
    return jnp.asarray(BLUR) @ x


def as_adjoint(y):
    return jnp.asarray(BLUR).T @ y


OPERATORS = {
    "jax": (jnp.asarray(BLUR), {}),
    "function": (as_function, {"adjoint": as_adjoint}),
    "lineax": (lineax.MatrixLinearOperator(jnp.asarray(BLUR)), {}),
    "lineax_function": (
        lineax.FunctionLinearOperator(as_function, jax.ShapeDtypeStruct((M,), float)), {}
    ),
    "scipy": (scipy.sparse.linalg.aslinearoperator(BLUR), {}),
    "sparse": (scipy.sparse.csr_array(BLUR), {}),
}  # fmt: skip


@pytest.mark.parametrize("name", quick(OPERATORS, "function", "sparse"))
def test_every_kind_of_operator_has_the_same_answer(name):
    operator, more = OPERATORS[name]
    method = Tikhonov(order=1, weight_p=100.0)
    wanted = method(LinearProblem(BLUR, noisy(), NOISE))
    problem = LinearProblem(operator, noisy(), NOISE, **more)
    found = method(problem)
    assert np.allclose(found.value, wanted.value, rtol=0, atol=1e-12)
    iterated = Tikhonov(order=1, weight_p=100.0, path="iterative", tolerance=1e-13)(problem)
    assert iterated.status == Status.CONVERGED
    assert np.allclose(iterated.value, wanted.value, rtol=0, atol=1e-7)
    # The mean over the unknowns of 64 draws' variance over the exact one: its standard deviation is
    # at most root 2/64, 18 %, that of one unknown. Five of them.
    ratio = np.mean(iterated.stderr**2 / wanted.stderr**2)
    assert abs(ratio - 1) < 5 * np.sqrt(2 / 64)
    assert "64 draws" in " ".join(iterated.warnings)


def test_function_of_an_image():
    kernel = jnp.fft.fft2(jnp.zeros((6, 8)).at[:2, :2].set(0.25))

    def blur(x):
        return jnp.fft.ifft2(jnp.fft.fft2(x) * kernel).real

    def adjoint(y):
        return jnp.fft.ifft2(jnp.fft.fft2(y) * kernel.conj()).real

    truth = np.outer(np.hanning(6), np.hanning(8))
    data = np.array(blur(truth)) + NOISE * np.random.default_rng(0).standard_normal((6, 8))
    problem = LinearProblem(blur, data, NOISE, adjoint=adjoint, name="Image")
    found = srsinv.invert(problem)
    assert found.value.shape == found.stderr.shape == (6, 8)
    assert found.to_xarray()["value"].dims == ("index_0", "index_1")
    assert "Image by Tikhonov; quality: good." in str(found)


CIRCULAR = {
    "none": None,
    "stderr": GaussianPrior(0.7, mean=0.5),
    "covariance": GaussianPrior(
        covariance=scipy.linalg.circulant(np.exp(-np.minimum(AT, 1 - AT) / 0.3))
    ),
    "root": GaussianPrior(root=scipy.linalg.circulant(np.r_[1.0, -0.9, np.zeros(M - 2)])),
}


@pytest.mark.parametrize("odd", quick([False, True], False))
@pytest.mark.parametrize("name", CIRCULAR)
def test_waves_have_the_same_answer_as_the_matrix(name, odd):
    """The given matrix is found to be circulant by itself."""
    matrix, prior = CIRCULANT, CIRCULAR[name]
    if odd:
        matrix = scipy.linalg.circulant(np.r_[0.5, 0.2, np.zeros(M - 4), 0.1])
        if name in ("covariance", "root"):
            return
    data = matrix @ np.resize(TRUTH, len(matrix))
    data = data + NOISE * np.random.default_rng(1).standard_normal(len(data))
    problem = LinearProblem(matrix, data, NOISE, prior=prior)
    by_waves, direct = Tikhonov()(problem), Tikhonov(path="direct")(problem)
    assert (by_waves.stats["path"], direct.stats["path"]) == ("spectral", "direct")
    weight = direct.stats["weight"]
    # The weight is where a slope is zero, found to rounding over the criterion's curvature.
    assert by_waves.stats["weight"] == pytest.approx(weight, rel=1e-6)
    given = (Tikhonov(weight_p=weight, path=path)(problem) for path in ("spectral", "direct"))
    first, second = given
    assert np.allclose(first.value, second.value, rtol=0, atol=1e-10)
    assert np.allclose(first.stderr, second.stderr, rtol=1e-10)
    assert np.allclose(first.resolution, second.resolution, rtol=0, atol=1e-10)


def test_resolution_is_what_unit_unknowns_give():
    problem = LinearProblem(BLUR, noisy(), NOISE)
    method = Tikhonov(2, weight_p=40.0)
    found = method(problem)
    one = method(LinearProblem(BLUR, BLUR[:, 7], NOISE))
    assert np.allclose(found.resolution[:, 7], one.value, rtol=0, atol=1e-10)
    assert np.trace(found.resolution) == pytest.approx(found.stats["resolved_dof"], rel=1e-9)
    assert np.allclose(np.sqrt(np.diag(found.covariance)), found.stderr, rtol=1e-12)


def test_scale_of_greatest_evidence_multiplies_the_prior():
    """Checked against the log density of the data, by numpy, on either side."""
    data = noisy()
    prior = GaussianPrior(covariance=SMOOTH)
    found = Wiener(scale="evidence")(LinearProblem(BLUR, data, NOISE, prior=prior))

    def density(weight):
        covariance = WHITE + BLUR @ SMOOTH @ BLUR.T / weight
        return -np.linalg.slogdet(covariance)[1] - data @ np.linalg.solve(covariance, data)

    best = found.stats["weight"]
    assert density(best) > max(density(best * 1.01), density(best / 1.01))
    same = Tikhonov(rule=Evidence())(LinearProblem(BLUR, data, NOISE, prior=prior))
    assert same.stats["weight"] == pytest.approx(best, rel=1e-9)


@pytest.mark.full
def test_bands_cover_as_often_as_they_say():
    """Draws from the prior: 90 % bands hold 90 % of the truths. 200 draws resolve three independent
    values or more each, so that five standard deviations are 5 sqrt(0.09 / 600)."""
    rng, root = np.random.default_rng(3), np.linalg.cholesky(SMOOTH)
    inside = []
    for _ in range(200):
        truth = root @ rng.standard_normal(M)
        data = BLUR @ truth + NOISE * rng.standard_normal(M)
        problem = LinearProblem(BLUR, data, NOISE, prior=GaussianPrior(covariance=SMOOTH))
        found = srsinv.invert(problem)
        inside.append(np.abs(found.value - truth) <= 1.6449 * found.stderr)
    assert abs(np.mean(inside) - 0.9) < 5 * np.sqrt(0.09 / 600)


def under(theta, kind, method):
    """The estimate of a problem whose operator, data, noise and prior hang on `theta` (4,)."""
    shape = np.random.default_rng(5).standard_normal((M, M)) / M
    matrix = jnp.asarray(BLUR) + 0.1 * theta[0] * shape
    data, noise = jnp.asarray(noisy()) * (1 + theta[1]), NOISE * (1 + theta[2])
    prior = {
        "stderr": lambda: GaussianPrior(0.7 * (1 + theta[3]), mean=0.1 + theta[3]),
        "covariance": lambda: GaussianPrior(covariance=(1 + theta[3]) * jnp.asarray(SMOOTH)),
        "none": lambda: None,
    }[kind]()
    return method(LinearProblem(matrix, data, noise, prior=prior))


DERIVED = {
    "posterior": ("stderr", Wiener(), 4),
    "covariance": ("covariance", Wiener(), 4),
    "evidence": ("none", Tikhonov(1), 3),
    "gcv": ("none", Tikhonov(1, rule=GeneralisedCrossValidation()), 3),
    "l_curve": ("none", Tikhonov(0, rule=LCurve()), 3),
}


@pytest.mark.parametrize("name", quick(DERIVED, "covariance"))
def test_derivatives_are_those_of_differences(name):
    """By operator, data, noise and prior, through the choice of the weight, too. Differences of
    fourth order with steps of 1e-4 leave errors of about 1e-8."""
    kind, method, count = DERIVED[name]
    mix = np.random.default_rng(6).standard_normal(M)

    def number(theta):
        found = under(theta, kind, method)
        return mix @ found.value + 3 * jnp.sum(found.stderr)

    slopes = jax.grad(number)(jnp.zeros(4))
    step = 1e-4
    for i, aside in enumerate(step * np.eye(4)[:count]):
        near = number(aside) - number(-aside)
        far = number(2 * aside) - number(-2 * aside)
        wanted = (8 * near - far) / (12 * step)
        assert float(slopes[i]) == pytest.approx(float(wanted), rel=1e-6), i


def test_traced_problem_has_the_answer_of_a_known_one():
    known = under(np.zeros(4), "none", Tikhonov(1))

    @jax.jit
    def compiled(theta):
        found = under(theta, "none", Tikhonov(1))
        return found.value, found.stderr, found.stats["weight"]

    value, stderr, weight = compiled(jnp.zeros(4))
    assert np.allclose(value, known.value, rtol=0, atol=1e-8)
    assert np.allclose(stderr, known.stderr, rtol=1e-8)
    assert float(weight) == pytest.approx(known.stats["weight"], rel=1e-7)


@pytest.mark.parametrize("kind", ["matrix", "function"])
def test_circulant_operator_wraps_under_jit_too(kind):
    matrix, data = jnp.asarray(CIRCULANT), noisy(CIRCULANT)
    given: Any = matrix
    more: dict[str, Any] = {}
    if kind == "function":
        given, more = (lambda x: matrix @ x), {"adjoint": lambda y: matrix.T @ y}

    def value(data):
        method = Tikhonov(1, weight_p=100.0)
        return method(LinearProblem(given, data, NOISE, **more)).value

    assert np.allclose(jax.jit(value)(data), value(data), rtol=0, atol=1e-9)
    iterated = Tikhonov(1, weight_p=100.0, path="iterative", tolerance=1e-13)
    if kind == "matrix":
        found = iterated(LinearProblem(given, data, NOISE)).value
        assert np.allclose(found, value(data), rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", PROBLEMS)
def test_evidence_serves_the_seven_problems(name):
    """The truth is in the bands' reach: its error is below the norm of the truth, and the residual
    is that of the noise to five standard deviations of a chi-square."""
    matrix, truth = PROBLEMS[name](32)
    clean = matrix @ truth
    sigma = 1e-3 * np.linalg.norm(clean) / np.sqrt(32)
    data = clean + sigma * np.random.default_rng(2).standard_normal(32)
    found = Tikhonov(order=1)(LinearProblem(matrix, data, sigma))
    assert np.linalg.norm(found.value - truth) < np.linalg.norm(truth)
    freedom = found.stats["degrees_of_freedom"]
    assert abs(found.stats["chi2_per_freedom"] - 1) < 5 * np.sqrt(2 / freedom)


def test_warnings_say_what_the_answer_lacks():
    prior = GaussianPrior(1.0)
    loud = srsinv.invert(LinearProblem(BLUR, noisy(), 1e3, prior=prior))
    assert "resolve less than 0.01 of the 24 unknowns" in " ".join(loud.warnings)
    spikes = noisy() + 0.1 * (-1.0) ** np.arange(M)
    wrong = srsinv.invert(LinearProblem(BLUR, spikes, NOISE, prior=prior))
    assert "times the noise" in " ".join(wrong.warnings)
    assert wrong.quality == "failed"


def test_views():
    pytest.importorskip("pandas")
    found = srsinv.invert(LinearProblem(BLUR, noisy(), NOISE, name="Deconvolution"))
    assert str(found).startswith("Deconvolution by Tikhonov; quality: good.")
    assert found.to_dataframe().columns.tolist() == ["index", "value", "stderr"]
    figure = found.plot(truth=TRUTH)
    assert figure.get_suptitle() == "Deconvolution by Tikhonov: good"
    with pytest.raises(srsinv.BadInput, match="truth"):
        found.plot(truth=TRUTH[1:])
