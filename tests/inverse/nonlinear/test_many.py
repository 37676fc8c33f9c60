"""Many data under one model: the fits are those of each alone, but for false minima."""

import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.inverse.nonlinear import OptaxLBFGS

X = np.linspace(0.0, 1.0, 60)
NOISE = 0.02
START = {"a": 1.0, "w": 12.0, "c": 0.0}


def wave(p):
    """Minima in w lie about a turn over the whole of X apart."""
    return p["a"] * jnp.sin(p["w"] * X) + p["c"]


def data(frequencies, seed=3):
    rng = np.random.default_rng(seed)
    clean = np.stack([1.5 * np.sin(w * X) + 0.3 for w in frequencies])
    return clean + NOISE * rng.normal(size=clean.shape)


@pytest.mark.full
@pytest.mark.parametrize(
    ("priors", "linear"), [(None, ("a", "c")), ({"a": (1.0, 2.0), "w": (12.0, 3.0)}, ())]
)
def test_a_batch_has_the_fits_of_its_data(linear, priors):
    ys, options = data(np.linspace(11.0, 13.0, 11)), {"noise": NOISE, "linear": linear}
    options |= {"bounds": {"w": (11.5, 20.0)}, "priors": priors}
    many = srsinv.fit_many(wave, START, ys, at_once=4, **options)
    for y, fit in zip(ys, many, strict=True):
        one = srsinv.fit(wave, START, y, **options)
        assert fit.status == one.status == "converged"
        assert fit.at_bound == one.at_bound
        for name in START:
            assert fit.value[name] == pytest.approx(one.value[name], abs=1e-5 * one.stderr[name])
        np.testing.assert_allclose(fit.covariance, one.covariance, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(fit.whitened, one.whitened, atol=1e-5)
        assert fit.stats["cost"] == pytest.approx(one.stats["cost"], rel=1e-9)


@pytest.mark.full
def test_false_minima_are_left():
    """Alone most end in a false one; in a batch the minimum of one is a start for the others."""
    frequencies = np.linspace(12.0, 30.0, 37)
    ys = data(frequencies)
    alone = [srsinv.fit(wave, START, y, noise=NOISE, linear=("a", "c")) for y in ys[::8]]
    assert sum(not fit.explains for fit in alone) >= 2
    many = srsinv.fit_many(wave, START, ys, noise=NOISE, linear=("a", "c"))
    for w, fit in zip(frequencies, many, strict=True):
        assert fit.value["w"] == pytest.approx(w, abs=5 * fit.stderr["w"])
        assert not fit.notes


def test_a_false_minimum_that_stays_has_a_warning():
    ys = data([12.0, 12.3, 60.0])
    *right, wrong = srsinv.fit_many(wave, START, ys, noise=NOISE, linear=("a", "c"))
    assert not any(fit.warnings for fit in right)
    assert any("false minimum" in warning for warning in wrong.warnings)
    assert wrong.quality != "good"


def test_starts_of_each():
    frequencies = np.array([12.0, 25.0, 60.0])
    each = {"w": frequencies + 0.4}
    fits = srsinv.fit_many(wave, START, data(frequencies), noise=NOISE, each=each)
    values = [fit.value["w"] for fit in fits]
    np.testing.assert_allclose(values, frequencies, atol=0.05)
    with pytest.raises(srsinv.BadInput, match="each gives 3 values to start from for 2 data"):
        srsinv.fit_many(wave, START, data(frequencies[:2]), noise=NOISE, each=each)


@pytest.mark.full
def test_clean_data_have_the_warning_once_in_a_thousand():
    """In 2,000 draws about 2; more than 9 are less probable than 1e-4."""
    ys = data(np.full(2000, 12.0))
    fits = srsinv.fit_many(wave, START, ys, noise=NOISE, linear=("a", "c"), at_once=64)
    assert sum(bool(fit.notes) for fit in fits) <= 9


@pytest.mark.full
def test_other_solvers_fit_one_after_the_other():
    ys = data([12.0, 12.2])
    solver = OptaxLBFGS()  # pyright: ignore[reportCallIssue]
    fits = srsinv.fit_many(wave, START, ys, noise=NOISE, solver=solver)
    assert all(fit.explains for fit in fits)
