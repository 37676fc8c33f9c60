"""Starts, solvers, what is said of a search that fails, units, precision, and compilation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.inverse.nonlinear import JaxoptLBFGSB, OptaxLBFGS, Optimistix
from srsinv.status import Status

X = np.linspace(0, 1, 60)
NOISE = np.random.default_rng(4).normal(size=60)
SOLVERS = (Optimistix, OptaxLBFGS, JaxoptLBFGSB)
START = {"a": 1.0, "k": 1.0, "c": 0.0}
TRUTH = np.array([3.0, 1.0, 2.0])  # a, c, k
Y = 3 * np.exp(-2 * X) + 1 + 0.01 * NOISE


def model(p):
    return p["a"] * jnp.exp(-p["k"] * X) + p["c"]


def wave(p):
    return p["s"] * jnp.sin(p["w"] * X) + p["c"] * jnp.cos(p["w"] * X)


def values(fit):
    return np.array([fit.value[name] for name in ("a", "c", "k")])


# --- starts ------------------------------------------------------------------------------------

W = 41.0
RINGING = np.sin(W * X) + 0.5 * np.cos(W * X) + 0.1 * NOISE
BOUNDS = {"w": (1.0, 100.0)}
LISTED = {"w": np.linspace(2.0, 99.0, 40)}


def ringing(starts):
    start = {"s": 0.0, "c": 0.0, "w": 3.0}
    return srsinv.fit(wave, start, RINGING, bounds=BOUNDS, linear=("s", "c"), starts=starts)


@pytest.mark.full
@pytest.mark.parametrize("starts", [40, LISTED], ids=["number", "listed"])
def test_global_minimum(starts):
    alone, fit = ringing(None), ringing(starts)
    assert abs(alone.value["w"] - W) > 10
    assert fit.converged
    np.testing.assert_allclose(fit.value["w"], W, atol=4 * fit.stderr["w"])
    assert fit.stats["starts"] == 41
    assert fit.stats["searches"] == 8
    assert 1 <= fit.stats["searches_at_best"] <= 8
    again = ringing(starts)
    assert again.value == fit.value
    assert again.stats == fit.stats


def test_a_wide_valley_does_not_take_all_starts():
    """Its points are all lower than the only one beside the narrow valley, which is the deeper."""

    def residual(p):
        wide = 0.7 * jnp.exp(-(((p["x"] + 0.5) / 0.4) ** 2))
        narrow = jnp.exp(-(((p["x"] - 0.8) / 0.03) ** 2))
        return jnp.stack([1 - wide - narrow])

    starts = {"x": np.linspace(-0.93, 0.92, 38)}  # 0.82 is the nearest, at 0.36
    bounds = {"x": (-1.0, 1.0)}
    fit = srsinv.fit(
        residual, {"x": -1.0}, np.zeros(1), noise=1.0, bounds=bounds, starts=starts, max_searches=2
    )
    np.testing.assert_allclose(fit.value["x"], 0.8, atol=1e-3)


# --- solvers -----------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.__name__)
def test_too_few_steps_and_no_finite_start(solver):
    """By one compiled program; that the solvers reach the same minimum is in `test_bounds`."""
    few = solver(max_steps=2)
    fit = srsinv.fit(model, START, Y, solver=few)
    assert not fit.converged
    assert fit.status is Status.STEP_LIMIT
    assert "more steps" in fit.reasons[0]
    assert_not_finite(srsinv.fit(model, START | {"k": -1e4}, Y, solver=few))


def assert_not_finite(fit):
    assert not fit.converged
    assert fit.status.startswith("not finite")
    assert np.isposinf(list(fit.stderr.values())).all()


@pytest.mark.full
def test_a_logarithm_of_what_is_negative_is_not_finite():
    assert_not_finite(srsinv.fit(lambda p: jnp.log(p["a"]) * X, {"a": -1.0}, Y))


def test_a_last_step_to_where_the_model_is_infinite_is_not_taken():
    """The minimum is at a = 1, beyond the wall by less than the tolerance."""

    def walled(p):
        return jnp.where(p["a"] < 1 - 1e-9, p["a"], jnp.inf) * (1 + X)

    fit = srsinv.fit(walled, {"a": 0.5}, 1 + X, noise=0.1, solver=Optimistix(tolerance=1e-6))
    assert fit.converged
    assert fit.value["a"] == pytest.approx(1, rel=1e-6)


def test_minimum_at_a_kink_is_no_answer():
    """a^2 cannot follow falling data: the best a is 0, where the model does not respond."""
    fit = srsinv.fit(lambda p: p["a"] ** 2 * X, {"a": 1.0}, -2 * X + 0.01 * NOISE)
    assert not fit.converged or fit.undetermined or fit.stderr["a"] > 1e3


def test_minimum_where_the_derivative_jumps_is_no_answer():
    """|a| cannot follow falling data: the best a is 0, where the slope changes its sign and not by
    its curvature, so that no standard error follows from it."""
    fit = srsinv.fit(
        lambda p: jnp.abs(p["a"]) * X, {"a": 1.0}, -2 * X + 0.01 * NOISE,
        solver=Optimistix(rounding=0.1),
    )  # fmt: skip
    assert abs(fit.value["a"]) < 1e-2
    assert not fit.converged


@pytest.mark.full
def test_saddle_beside_a_rank_that_is_lost_is_no_answer():
    """Freudenstein and Roth's minimum in x and y, where the Jacobian loses rank; a stands on a
    maximum of its own, from which no slope leads away: the cost is lower at a^2 = 5/2."""

    def residual(p):
        a, x, y = p["a"], p["x"], p["y"]
        return jnp.stack([
            a, 3 - a**2, -13 + x + ((5 - y) * y - 2) * y, -29 + x + ((y + 1) * y - 14) * y,
        ])  # fmt: skip

    fit = srsinv.fit(residual, {"a": 0.0, "x": 0.5, "y": -2.0}, np.zeros(4))
    assert 2 * fit.stats["cost"] == pytest.approx(48.9842 + 9, rel=1e-5)
    assert not fit.converged


@pytest.mark.full
def test_a_looser_tolerance_is_kept_in_fewer_steps():
    fit = srsinv.fit(model, START, Y, solver=Optimistix(tolerance=1e-2))
    best = srsinv.fit(model, START, Y)
    assert np.max(np.abs(values(fit) - values(best)) / TRUTH) < 1e-2
    assert fit.stats["iterations"] < best.stats["iterations"]


def test_bad_start_among_good_ones():
    fit = srsinv.fit(
        lambda p: jnp.log(p["a"]) * X, {"a": -1.0}, 2 * X + 0.01 * NOISE, starts={"a": [-2.0, 3.0]}
    )
    assert fit.converged, fit.status
    np.testing.assert_allclose(fit.value["a"], np.exp(2), rtol=0.02)


# --- units and precision -----------------------------------------------------------------------


def in_units(p):
    return p["unit"] * (p["a"] / p["s"][0] * jnp.exp(-p["k"] / p["s"][1] * X) + p["c"] / p["s"][2])


@pytest.mark.full
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("scales", [(1.0, 1.0, 1.0), (1e9, 1e-9, 1e-6)])
def test_units_change_nothing(unit, scales):
    s = dict(zip(("a", "k", "c"), scales, strict=True))
    start = {name: s[name] * START[name] for name in START} | {"s": np.array(scales), "unit": unit}
    fit = srsinv.fit(in_units, start, unit * Y, noise=0.01 * unit, free=("a", "k", "c"))
    unscaled = srsinv.fit(model, START, Y, noise=0.01)
    assert fit.converged, fit.status
    assert abs(fit.stats["iterations"] - unscaled.stats["iterations"]) <= 1
    for name in START:
        np.testing.assert_allclose(fit.value[name] / s[name], unscaled.value[name], rtol=1e-8)
        np.testing.assert_allclose(fit.stderr[name] / s[name], unscaled.stderr[name], rtol=1e-8)


@pytest.mark.full
def test_single_precision_with_what_is_linear_solved_out():
    """A search of all parameters in single precision is in `tests.stability.test_fit`."""
    linear = ("a", "c")
    double = srsinv.fit(model, START, Y, linear=linear)
    x = X.copy()  # jax remembers a numpy constant in the precision in which it met it first

    def again(p):
        return p["a"] * jnp.exp(-p["k"] * x) + p["c"]

    with jax.enable_x64(False):
        single = srsinv.fit(again, START, Y, linear=linear)
    assert single.converged, single.status
    for name in START:
        np.testing.assert_allclose(single.value[name], double.value[name], rtol=2e-4)
        np.testing.assert_allclose(single.stderr[name], double.stderr[name], rtol=1e-2)


# --- compilation -------------------------------------------------------------------------------


def test_compiles_once():
    """The same model for other data of the same shape, noise, start and bounds is the same
    program."""
    traces = []

    def counted(p):
        traces.append(1)
        return model(p)

    def fit(y, k, level, upper):
        start = START | {"k": k}
        return srsinv.fit(counted, start, y, noise=level, bounds={"k": (0.0, upper)})

    fit(Y, 1.0, 0.01, 9.0)
    first = len(traces)
    for k in (1.5, 2.5):
        fit(2 * Y, k, 0.02, 8.0)
    assert len(traces) == first > 0
