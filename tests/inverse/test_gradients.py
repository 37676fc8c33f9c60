"""Gradients of an estimate in its data and in the physics, forward and reverse."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.inverse.line import spectral
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.tikhonov import DerivativePenalty
from srsinv.inverse.wiener import Exponential, SpectralPrior
from tests.inverse.cases import DEPTH_M, RATE, SLOW, N, make_case, make_line, make_operator

CASE = make_case()
PARAMETERS = ("depth", "angle", "noise", "prior", "length")
TURNS = np.random.default_rng(9).normal(size=(2, 2, N))


def number(method, theta):
    """A scalar of value and standard error; theta holds factors on the parameters, then the data.

    Every factor is one at the nominal problem; the data are in units of the noise.
    """
    factor = dict(zip(PARAMETERS, theta[: len(PARAMETERS)], strict=True))
    data = CASE.sigma * theta[len(PARAMETERS) :].reshape(2, N)
    depth_m = DEPTH_M * factor["depth"]
    angle_rad = jnp.array([0.2, 1.6]) * factor["angle"]
    films = (Film(depth_m, angle_rad[0]), Film(depth_m, angle_rad[1]))
    line = make_line()
    noise = jnp.full((1, *line.k.shape), CASE.sigma**2)
    physics = (make_operator(line, films), data, noise * factor["noise"] ** 2)
    problem = eqx.tree_at(lambda p: (p.forward, p.data, p.noise), CASE.problem, physics)
    length_m = 1e-3 * factor["length"]
    if method == "wiener":
        spectra = (Exponential(1.5e3 * factor["prior"], length_m), Exponential(5e2, 2 * length_m))
        prior = SpectralPrior(jnp.stack([spectrum.power(problem) for spectrum in spectra]))
    else:
        weights = jnp.array([2e-5, 8e-5]) * factor["prior"]
        prior = DerivativePenalty(weights, length_m, int(method[-1]))
    solution = spectral.solve(problem, prior)
    value, stderr = solution.value / 1e3, solution.stderr / 1e2
    return jnp.sum(jnp.sin(value) * TURNS[0]) + jnp.sum(jnp.cos(stderr) * TURNS[1] / 10)


THETA = np.concatenate([np.ones(len(PARAMETERS)), np.ravel(CASE.problem.data) / CASE.sigma])
METHODS = ("wiener", "tikhonov_1")


@pytest.mark.full
@pytest.mark.parametrize("method", METHODS)
def test_gradient_is_the_finite_difference(method):
    """Reverse mode in all that theta holds, forward mode along directions, under jit and vmap."""
    of = jax.jit(partial(number, method))
    reverse = np.asarray(jax.jit(jax.grad(of))(THETA))
    assert np.all(np.isfinite(reverse))
    directions = np.eye(len(THETA))[[*range(len(PARAMETERS)), len(PARAMETERS) + 17, -5]]
    directions = np.vstack([directions, np.random.default_rng(0).normal(size=len(THETA))])
    pushed = jax.jit(jax.vmap(lambda d: jax.jvp(of, (THETA,), (d,))[1]))(directions)
    pushed = np.asarray(pushed)
    np.testing.assert_allclose(pushed, directions @ reverse, rtol=1e-9, atol=1e-11)

    def central(step):
        points = np.concatenate([THETA + step * directions, THETA - step * directions])
        ahead, behind = np.split(np.asarray(jax.jit(jax.vmap(of))(points)), 2)
        return (ahead - behind) / (2 * step)

    differences = (4 * central(5e-4) - central(1e-3)) / 3  # the error in step^2 drops out
    np.testing.assert_allclose(pushed, differences, rtol=1e-6)
    assert np.all(np.abs(differences) > 1e-9)


@pytest.mark.full
@pytest.mark.parametrize("amplifier", [RATE, SLOW], ids=["rate", "slow"])
def test_the_noise_may_be_traced(amplifier):
    """A problem can be built inside a differentiated function, from its noise level too; a slow
    readout has a mean of p to tell, and none of q."""
    case = make_case(amplifier=amplifier)

    def spread(level):
        line = make_line()
        noise = level**2 * jnp.ones(line.k.shape)
        problem = LineProblem(line, case.problem.forward, case.problem.data, noise)
        prior = DerivativePenalty(jnp.array([2e-5, 8e-5]), jnp.asarray(DEPTH_M), 1)
        return spectral.solve(problem, prior).stderr[0, 0]

    slope = jax.grad(spread)(case.sigma)
    assert np.isfinite(slope)
    assert slope > 0
