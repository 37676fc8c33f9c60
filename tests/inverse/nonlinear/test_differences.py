"""Standard errors by differences over steps: the cost, not these, decides what is a minimum."""

import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.inverse.nonlinear import Optimistix
from srsinv.status import Status

X = np.linspace(-4, 4, 161)
NOISE = 0.02
WHITE = NOISE * np.random.default_rng(3).normal(size=X.size)
STEP = {"at": 0.3}
START = {"height": 1.0, "at": 0.1}
ROUGH = Optimistix(rounding=1e-4)


def hill(p):
    return p["height"] * jnp.exp(-((X - p["at"]) ** 2))


# What no height and place of the hill fits, and what its derivative by the place bends into.
LOPSIDED = np.asarray(hill({"height": 1.0, "at": 0.2})) + 0.1 * X**3 * np.exp(-(X**2))


def fitted(y, noise, steps=None, solver=ROUGH):
    return srsinv.fit(hill, START, y, noise=noise, steps=steps, solver=solver)


@pytest.mark.parametrize("noise", [NOISE, None], ids=["known", "unknown"])
def test_a_minimum_that_misfits_is_a_doubtful_answer(noise):
    y = LOPSIDED + WHITE
    fit, own = fitted(y, noise, STEP), fitted(y, noise)
    assert fit.converged
    assert fit.quality == "doubtful"
    assert set(fit.reasons) - set(own.reasons)
    assert fit.value == own.value
    assert fit.stats["distance_to_minimum"] < 1e-3
    # The errors are those of the differences, which are less steep.
    assert fit.stderr["at"] > 1.02 * own.stderr["at"]


@pytest.mark.parametrize("step", [0.02, 0.6])
def test_a_minimum_down_to_the_noise_is_good(step):
    """Over the wide step noise alone makes a slope."""
    fit = fitted(np.asarray(hill({"height": 1.0, "at": 0.2})) + WHITE, NOISE, {"at": step})
    assert fit.quality == "good", fit.reasons


def test_a_dent_within_a_step_is_no_answer():
    """One sample goes up and down as the hill moves on: the search ends in a dent of the cost near
    its start, and the cost is lower at the hill's place."""

    def model(p):
        wave = 1 + jnp.cos(2 * jnp.pi * p["at"] / 0.3)
        return jnp.append(hill(p), wave)

    y = np.append(np.asarray(hill({"height": 1.0, "at": 1.05})) + WHITE, 0.0)
    settings = {"noise": NOISE, "solver": ROUGH}
    alone = srsinv.fit(model, START, y, **settings)
    assert alone.converged
    assert alone.value["at"] < 0.7
    fit = srsinv.fit(model, START, y, steps={"at": 0.15}, **settings)
    assert fit.status is Status.STALLED


def test_steps_that_end_close_to_a_minimum_are_an_answer():
    """The errors hold how far it is."""
    y = LOPSIDED + WHITE
    whole = fitted(y, NOISE, STEP)
    few = Optimistix(rounding=1e-4, max_steps=2)
    fit = srsinv.fit(hill, {"height": 1.0, "at": 0.3}, y, noise=NOISE, steps=STEP, solver=few)
    assert fit.converged
    off = abs(fit.value["at"] - whole.value["at"])
    assert 0 < off < fit.stderr["at"]
    assert fit.stderr["at"] > 1.02 * whole.stderr["at"]


def test_too_few_steps_are_still_too_few():
    fit = fitted(LOPSIDED + WHITE, NOISE, STEP, Optimistix(rounding=1e-4, max_steps=1))
    assert fit.status is Status.STEP_LIMIT
