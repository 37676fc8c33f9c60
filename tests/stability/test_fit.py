"""The general fit where data, units, starts and models are hard: an answer within its error, or a
word that it is none."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import srsinv
from srsinv.inverse.nonlinear import JaxoptLBFGSB, OptaxLBFGS, Optimistix
from tests.stability.matrix import PRECISIONS
from tests.tiers import quick, rare

N = 30
X = np.linspace(0, 1, N)
STDERR = 0.01
NOISE = STDERR * np.random.default_rng(0).normal(size=N)
TRUTH = {"a": 3.0, "k": 2.0}
CLEAN = 3 * np.exp(-2 * X)
SPIKE = 1e6 * STDERR * (np.arange(N) == 7)
MAX_ERROR_SIGMA = 5  # standard errors from the truth at most, where an answer is said to be one
QUICK = ("optimistix", "optax L-BFGS")  # to compile
SOLVERS = {s.name: s for s in (Optimistix(), OptaxLBFGS(), JaxoptLBFGSB())}
# The slow one is in tests/inverse/nonlinear, and here in `make claims` alone.
ONE_AND_OTHER = rare(QUICK, QUICK[1])
MOSTLY_QUICK = rare(SOLVERS, "jaxopt LBFGSB")

# What stays, and how the fit says so.
LIMITS = [
    ("jaxopt LBFGSB, an exponential that overflows",
     "its line search, capped in steps, does not get down a cost that changes by 1e40",
     "thousands of standard errors from the minimum"),
    ("optimistix and jaxopt LBFGSB, a square root from 0",
     "the derivative there is infinite, and no step follows from it", "no step"),
    ("a start ten widths away, noise not known",
     "a minimum in the noise beside the peak is one too: the position's error is that of a height "
     "that may be nothing, and only more starts show it",
     "6.4 standard errors in position, 0.02 of the height's from nothing"),
]  # fmt: skip


def decay(p):
    """In any unit: `ua` and `uk` are how many of a's and k's make one, `uy` is the data's; they are
    not fitted."""
    x = jnp.asarray(X.copy())  # a copy, as jax remembers a constant in its first precision
    return p["uy"] * (p["a"] * p["ua"] * jnp.exp(-p["k"] * p["uk"] * x) + p["c"])


def start(a=1.0, k=1.0, c=0.0, ua=1.0, uk=1.0, uy=1.0):
    return {"a": a * ua, "k": k * uk, "c": c, "ua": 1 / ua, "uk": 1 / uk, "uy": uy}


def fitted(y, first=None, free=("a", "k"), **options):
    return srsinv.fit(decay, first or start(), y, free=free, **options)


def least_squares(y, a, k):
    """a and k of least squares, and their standard errors under unit noise: Newton's method with
    the whole second derivative, in numpy's longest numbers."""
    z, x, y = np.array([a, k], np.longdouble), np.longdouble(X), np.longdouble(y)
    for _ in range(30):
        wave = np.exp(-z[1] * x)
        basis = np.stack([wave, -z[0] * x * wave])
        rest = y - z[0] * wave
        bent = np.array([[0, rest @ (x * wave)], [rest @ (x * wave), -z[0] * rest @ (x**2 * wave)]])
        z = z + _inverse(basis @ basis.T + bent) @ (basis @ rest)
    assert np.max(np.abs(basis @ rest)) < 1e-14 * np.max(np.abs(y))
    return z.astype(float), np.sqrt(np.diagonal(_inverse(basis @ basis.T))).astype(float)


def _inverse(matrix):
    (p, q), (r, s) = matrix
    return np.array([[s, -q], [-r, p]]) / (p * s - q * r)


# A model compiles once for each precision.
@pytest.fixture(params=quick(PRECISIONS, "float64"))
def precision(request):
    solver = request.node.callspec.params.get("solver")
    if solver == "jaxopt LBFGSB" and request.param == "float32":
        pytest.skip("jaxopt takes seconds to compile")
    with jax.enable_x64(request.param == "float64"):
        yield request.param


# What a minimum can be told to, in standard errors: the square root of the cost's rounding.
TOLERANCE_SIGMA = {"float64": 1e-5, "float32": 2e-2}


def largest_z_score(fit, truth, rounding=0.0):
    """The largest error of what the fit is sure of, in standard errors."""
    if not fit.converged or fit.explains is False:
        return 0.0
    errors = [abs(fit.value[n] - t) / (fit.stderr[n] + rounding * abs(t)) for n, t in truth.items()]
    return max(errors)


# --- units --------------------------------------------------------------------------------------


class FitUnits(NamedTuple):
    ua: float
    uk: float
    uy: float
    noise: float | None


UNITS = {
    "data of 1e-30": FitUnits(1.0, 1.0, 1e-30, None),
    "data of 1e30": FitUnits(1.0, 1.0, 1e30, None),
    "data of 1e-30, known noise": FitUnits(1.0, 1.0, 1e-30, STDERR),
    "parameters of 1e-10 and 1e10": FitUnits(1e-10, 1e10, 1.0, STDERR),
    "a parameter of 1e-20": FitUnits(1e-20, 1.0, 1.0, STDERR),
    "a parameter of 1e20": FitUnits(1e20, 1.0, 1.0, None),
    "all of 1e-25": FitUnits(1e-25, 1e-25, 1e-25, None),
}
BY_SOLVER = [
    *((name, solver) for name in UNITS for solver in QUICK),
    pytest.param("data of 1e30", "jaxopt LBFGSB", marks=pytest.mark.claim),
]


@pytest.mark.parametrize(("name", "solver"), BY_SOLVER)
def test_units(name, solver, precision, margin):
    """The square of each overflows or vanishes in single precision; the fit is that of one's."""
    u = UNITS[name]
    y = CLEAN + NOISE
    (a, k), unit = least_squares(y, 3, 2)
    level = u.noise or float(np.linalg.norm(y - a * np.exp(-k * X)) / np.sqrt(N - 2))
    fit = fitted(
        u.uy * y, start(ua=u.ua, uk=u.uk, uy=u.uy),
        noise=u.noise and u.noise * u.uy, solver=SOLVERS[solver],
    )  # fmt: skip
    assert fit.converged, fit.status
    scale = {"a": u.ua, "k": u.uk}
    wanted = dict(zip("ak", zip((a, k), unit * level, strict=True), strict=True))
    error = max(abs(fit.value[n] / scale[n] - v) / s for n, (v, s) in wanted.items())
    margin(error, TOLERANCE_SIGMA[precision])
    assert error < TOLERANCE_SIGMA[precision]
    for n, (_, s) in wanted.items():
        np.testing.assert_allclose(fit.stderr[n] / scale[n], s, rtol=TOLERANCE_SIGMA[precision])
    if u.noise is None:
        np.testing.assert_allclose(fit.noise_rms / u.uy, level, rtol=1e-4)
        np.testing.assert_allclose(
            np.linalg.norm(fit.whitened.astype(float)),
            np.sqrt(N - 2) * fit.noise_rms,
            rtol=1e-4,
        )


# --- data ---------------------------------------------------------------------------------------


def test_an_outlier_among_squares(precision, margin):
    """Least squares follow it, as they must; known noise says that it does not explain the data."""
    y = CLEAN + NOISE + SPIKE
    value, unit = least_squares(y, 767, 1.74)
    fit = fitted(y, noise=STDERR)
    freely = fitted(y)
    assert fit.converged, fit.status
    assert fit.explains is False
    assert freely.explains is None
    rms = np.linalg.norm(y - value[0] * np.exp(-value[1] * X)) / np.sqrt(N - 2)
    off = max(abs(fit.value[n] - v) / (s * rms) for n, v, s in zip("ak", value, unit, strict=True))
    margin(off, TOLERANCE_SIGMA[precision])
    assert off < TOLERANCE_SIGMA[precision]
    assert largest_z_score(freely, TRUTH) < MAX_ERROR_SIGMA


@pytest.mark.parametrize("noise", [STDERR, None])
@pytest.mark.parametrize("loss", rare(["huber", "soft_l1", "cauchy"], "soft_l1"))
def test_an_outlier_among_robust_losses(loss, noise, precision, margin):
    """Within its own error of the truth, which is no wider than twice that of clean data."""
    fit = fitted(CLEAN + NOISE + SPIKE, noise=noise, loss=loss)
    clean = least_squares(CLEAN + NOISE, 3, 2)[1] * STDERR
    assert fit.converged, fit.status
    error = largest_z_score(fit, TRUTH)
    margin(error, MAX_ERROR_SIGMA)
    assert error < MAX_ERROR_SIGMA
    for n, s in zip("ak", clean, strict=True):
        assert fit.stderr[n] < 2 * s


FLAT = {"all equal": 2.5, "nothing": 0.0}


@pytest.mark.parametrize("level", FLAT.values(), ids=FLAT)
def test_flat_data(level, precision):
    """A decay and a constant: what is told is their sum."""
    fit = fitted(np.full(N, level), noise=STDERR, free=("a", "k", "c"))
    assert fit.converged, fit.status
    assert np.isposinf([fit.stderr["a"], fit.stderr["c"]]).all()
    total, stderr = fit.derive(lambda p: p["a"] + p["c"])
    assert abs(total - level) <= stderr < np.inf


@pytest.mark.parametrize("loss", ["squares", "huber", "cauchy"])
def test_no_noise(loss, precision):
    """Nothing is left but rounding, and the error is rounding's."""
    eps = float(np.finfo(precision).eps)
    y = CLEAN.astype(precision).astype(float)
    fit = fitted(y, loss=loss)
    assert fit.converged, fit.status
    # The model's own rounding, some 4 eps of each datum, moves a and k alike.
    assert largest_z_score(fit, TRUTH, rounding=4 * eps) < MAX_ERROR_SIGMA
    # A robust search ends linearly: at eps^(2/3) of the data what is left counts as rounding.
    most = 100 * eps if loss == "squares" else eps ** (2 / 3)
    assert max(abs(fit.value[n] / t - 1) for n, t in TRUTH.items()) < most


@pytest.mark.parametrize("loss", ["squares", "huber"])
def test_zeros_without_noise(loss, precision):
    """Nothing tells a rate of nothing: its error is no less than itself."""
    fit = fitted(np.zeros(N), loss=loss)
    assert abs(fit.value["a"]) < 1e-6
    assert not fit.converged or fit.stderr["k"] > abs(fit.value["k"])


def test_noise_below_rounding(precision):
    """Known noise that the precision cannot hold: no answer sure of it."""
    fit = fitted(CLEAN + 1e-3 * NOISE, noise=1e-3 * STDERR * np.finfo(precision).eps)
    assert largest_z_score(fit, TRUTH) < MAX_ERROR_SIGMA


@pytest.mark.parametrize("solver", ONE_AND_OTHER)
def test_more_parameters_than_data(solver, precision):
    """Of three numbers two data tell two combinations; a third stands alone."""
    noise = np.full(N, np.inf)
    noise[[0, -1]] = STDERR
    fit = fitted(CLEAN, noise=noise, free=("a", "k", "c"), solver=SOLVERS[solver])
    if solver == "optimistix":
        assert fit.converged, fit.status
        left = fit.residual[[0, -1]]
        np.testing.assert_allclose(left, 0.0, atol=TOLERANCE_SIGMA[precision] * STDERR)
    assert not fit.converged or len(fit.undetermined) == 1
    assert np.isposinf([fit.stderr[n] for n in fit.names]).all()


# --- starts -------------------------------------------------------------------------------------

WIDTH, AT, HEIGHT = 0.03, 0.4, 2.0
PEAK = HEIGHT * np.exp(-(((X - AT) / WIDTH) ** 2))
AWAY = {"a": 1.0, "x": AT + 10 * WIDTH, "w": WIDTH}
BOX = {"a": (0.0, 10.0), "x": (0.0, 1.0), "w": (0.01, 0.3)}


def bell(p):
    return p["a"] * jnp.exp(-(((jnp.asarray(X.copy()) - p["x"]) / p["w"]) ** 2))


@pytest.mark.parametrize("noise", [STDERR, None])
@pytest.mark.parametrize("level", [0.0, 1.0])
def test_ten_widths_away(noise, level, precision):
    """The slope is 1e-40 of the data and less: alone it finds nothing and is not sure; from points
    over the bounds it finds the peak."""
    y, truth = PEAK + level * NOISE, {"a": HEIGHT, "x": AT, "w": WIDTH}
    alone = srsinv.fit(bell, AWAY, y, noise=noise)
    assert abs(alone.value["x"] - AT) > WIDTH
    assert not (alone.converged and alone.explains)
    if noise is None:  # LIMITS: that there is a peak at all is not sure
        assert not alone.stderr["a"] < abs(alone.value["a"]) / MAX_ERROR_SIGMA
    else:
        assert largest_z_score(alone, truth) < MAX_ERROR_SIGMA
    fit = srsinv.fit(bell, AWAY, y, noise=noise, bounds=BOX, starts=63)
    assert fit.converged, fit.status
    assert (
        largest_z_score(fit, truth, rounding=4 * float(np.finfo(precision).eps)) < MAX_ERROR_SIGMA
    )
    assert abs(fit.value["x"] - AT) < 0.1 * WIDTH


def circle(p):
    return jnp.stack([jnp.cos(p["x"]), p["b"] * jnp.sin(p["x"])])


@pytest.mark.parametrize("solver", MOSTLY_QUICK)
def test_on_a_maximum(solver, precision):
    """The farthest point of a circle: no slope leads away."""
    first = {"x": 0.0, "b": 1.0}
    y = np.array([-1.0, 0.0])
    fit = srsinv.fit(circle, first, y, noise=STDERR, free=["x"], solver=SOLVERS[solver])
    assert fit.converged, fit.status
    assert largest_z_score(fit, {"x": np.pi * np.sign(fit.value["x"])}) < MAX_ERROR_SIGMA
    assert fit.explains


def test_on_a_maximum_among_many(precision):
    first = {"x": 0.0, "b": 1.0}
    ys = np.array([[-1.0, 0.0], [1.0, 0.0]])
    up, down = srsinv.fit_many(circle, first, ys, noise=STDERR, free=["x"])
    assert abs(abs(up.value["x"]) - np.pi) < 1e-3
    assert abs(down.value["x"]) < 1e-3
    assert up.explains
    assert down.explains


@pytest.mark.parametrize("solver", QUICK)
@pytest.mark.parametrize(
    ("first", "bounds"),
    [(start(a=3.0, k=2.0), None), (start(), {"k": (1.0, 9.0)}), (start(k=9.0), {"k": (1.0, 9.0)})],
    ids=["optimum", "lower bound", "upper bound"],
)
def test_start_on(first, bounds, solver, precision, margin):
    """Exactly in the minimum of clean data, and on a bound."""
    fit = fitted(CLEAN, first, noise=STDERR, bounds=bounds, solver=SOLVERS[solver])
    assert fit.converged, fit.status
    error = max(abs(fit.value[n] - t) / fit.stderr[n] for n, t in TRUTH.items())
    margin(error, TOLERANCE_SIGMA[precision])
    assert error < TOLERANCE_SIGMA[precision]


@pytest.mark.parametrize("solver", MOSTLY_QUICK)
@pytest.mark.parametrize("at", [1.0, 2.0])
def test_bounds_one_rounding_apart(at, solver, precision, margin):
    """No room is left, in single precision none at all: the others are the best beside it."""
    bounds = {"k": (at, float(np.nextafter(at, 3.0)))}
    y = CLEAN + NOISE
    fit = fitted(y, start(k=at), noise=STDERR, bounds=bounds, solver=SOLVERS[solver])
    assert fit.converged, fit.status
    assert bounds["k"][0] <= fit.value["k"] <= bounds["k"][1]
    wave = np.exp(-at * X)
    error = abs(fit.value["a"] - wave @ y / (wave @ wave)) * np.linalg.norm(wave) / STDERR
    margin(error, TOLERANCE_SIGMA[precision])
    assert error < TOLERANCE_SIGMA[precision]
    assert fit.at_bound == ("k",)


# --- models -------------------------------------------------------------------------------------


def steep(p):
    return jnp.exp(p["k"] * (20 * jnp.asarray(X.copy()) + 1))


@pytest.mark.parametrize("solver", QUICK)
def test_an_exponential_that_overflows(solver, precision, margin):
    """From k = -3 a step of the linearised model ends at 1e18, where nothing is finite."""
    height = np.exp(20 * X + 1)
    noise = 1e-3 * height
    y = height + 0.1 * height * NOISE
    fit = srsinv.fit(steep, {"k": -3.0}, y, noise=noise, solver=SOLVERS[solver])
    assert fit.converged, fit.status
    slope = (20 * X + 1) * height / noise
    stderr = 1 / np.linalg.norm(slope)
    error = abs(fit.value["k"] - 1 - slope @ (0.1 * height * NOISE / noise) * stderr**2) / stderr
    # Linear in the noise to 1e-3 of its square's share; exp(21) rounds to 21 eps.
    bound = {"float64": 0.05, "float32": 0.2}[precision]
    margin(error, bound)
    assert error < bound


@pytest.mark.parametrize("solver", QUICK)
def test_a_square_root_from_zero(solver, precision):
    """Its derivative is infinite there: an answer, or a word."""

    def root(p):
        return jnp.sqrt(p["a"]) * (1 + jnp.asarray(X.copy()))

    fit = srsinv.fit(
        root, {"a": 0.0}, 2 * (1 + X), noise=STDERR, bounds={"a": (0.0, None)},
        solver=SOLVERS[solver],
    )  # fmt: skip
    if solver == "optax L-BFGS":  # which begins off the bound
        assert abs(fit.value["a"] - 4) < MAX_ERROR_SIGMA * fit.stderr["a"] < 0.1
    else:
        assert fit.status.startswith("not finite")
        assert np.isposinf(fit.stderr["a"])


@pytest.mark.parametrize("solver", ONE_AND_OTHER)
def test_only_a_product_is_told(solver, precision, margin):
    def product(p):
        return p["a"] * p["b"] * jnp.exp(-2 * jnp.asarray(X.copy())) + 0 * p["n"]

    y = CLEAN + NOISE
    fit = srsinv.fit(
        product, {"a": 1.0, "b": 7.0, "n": 5.0}, y, noise=STDERR, solver=SOLVERS[solver]
    )
    assert fit.converged, fit.status
    assert np.isposinf([fit.stderr[n] for n in "abn"]).all()
    assert sorted("".join(sorted(d)) for d in fit.undetermined) == ["ab", "n"]
    assert fit.value["n"] == 5.0
    value, stderr = fit.derive(lambda p: p["a"] * p["b"])
    wave = np.exp(-2 * X)
    wanted, length = wave @ y / (wave @ wave), np.linalg.norm(wave)
    error = abs(value - wanted) * length / STDERR
    margin(error, TOLERANCE_SIGMA[precision])
    assert error < TOLERANCE_SIGMA[precision]
    np.testing.assert_allclose(stderr, STDERR / length, rtol=1e-4)


def test_a_compiled_model(precision):
    uncompiled, compiled = (
        srsinv.fit(of, start(), CLEAN + NOISE, free=("a", "k"), noise=STDERR)
        for of in (decay, jax.jit(decay))
    )
    for n in "ak":
        assert (
            abs(uncompiled.value[n] - compiled.value[n])
            < TOLERANCE_SIGMA[precision] * uncompiled.stderr[n]
        )


def two(p):
    x = jnp.asarray(X.copy())
    return p["a"] * jnp.exp(-p["j"] * x) + p["b"] * jnp.exp(-p["k"] * x)


def standard_errors(apart, noise):
    """Of a, b, j, k at the truth, in 60 digits."""
    with mp.workdps(60):
        j, k = mp.mpf(2), 2 + mp.mpf(apart)
        x = [mp.mpf(float(v)) for v in X]
        rows = [
            [mp.exp(-j * v), mp.exp(-k * v), -v * mp.exp(-j * v), -v * mp.exp(-k * v)] for v in x
        ]
        jacobian = mp.matrix(rows)
        inverse = (jacobian.T * jacobian) ** -1
        return [float(noise * mp.sqrt(inverse[i, i])) for i in range(4)]


@pytest.mark.parametrize("apart", [1.0, 0.1, 1e-2, 1e-4, 1e-8])
def test_rates_nearly_equal(apart, precision, margin):
    """Never sure and wrong; and where the precision tells them, with the error of 60 digits."""
    noise = 1e-6
    truth = {"a": 1.0, "b": 1.0, "j": 2.0, "k": 2.0 + apart}
    y = np.exp(-2 * X) + np.exp(-(2 + apart) * X)
    first = {"a": 1.1, "b": 0.9, "j": 2.0 - 0.1 * apart, "k": 2.0 + 1.1 * apart}
    fit = srsinv.fit(two, first, y, noise=noise)
    swapped = truth | {"j": truth["k"], "k": truth["j"]}
    error = min(largest_z_score(fit, truth), largest_z_score(fit, swapped))
    margin(error, MAX_ERROR_SIGMA)
    assert error < MAX_ERROR_SIGMA
    if precision == "float64" and apart >= 0.1:
        wanted = standard_errors(apart, noise)
        assert fit.converged, fit.status
        np.testing.assert_allclose([fit.stderr[n] for n in "abjk"], wanted, rtol=1e-3)


def test_nearly_equal_columns_solved_for(margin):
    """Two linear parameters told apart by 1e-10 of their columns: their damping must be less, and
    what is left is rounding over that."""
    columns = np.stack([1 + X, 1 + X + 1e-9 * X**2])
    fit = srsinv.fit(
        lambda p: p["a"] * columns[0] + p["b"] * columns[1], {"a": 0.0, "b": 0.0},
        columns[0] + 3 * columns[1], noise=1e-12, linear=("a", "b"),
    )  # fmt: skip
    least = np.linalg.svd(columns / np.linalg.norm(columns, axis=1)[:, None])[1][1]
    assert fit.converged, fit.status
    error, bound = max(abs(fit.value["a"] - 1), abs(fit.value["b"] - 3)), 64 * 2.2e-16 / least
    margin(error, bound)
    assert error < bound
