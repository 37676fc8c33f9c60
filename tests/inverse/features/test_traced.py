"""The fit of features under jit, vmap, grad and jvp: the numbers of known fits, and their
derivatives."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import srsinv
from srsinv.forward.feature import GratingFeature, HertzFeature, StripFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.surface_feature import RidgeFeature
from srsinv.forward.traction import Hertz
from srsinv.inverse.features import FeatureFit
from srsinv.inverse.nonlinear import Optimistix
from srsinv.inverse.problem import Problem
from tests.differences import differences
from tests.refusals import refused

LINE, SPEED = srsinv.Open(160, 2e-4), srsinv.ConstantSpeed(0.05)
SENSOR = srsinv.Sensor([Film(0.75e-3), Film(0.75e-3, np.pi / 2)])
LOADS = {"strip": srsinv.UniformStrip(2e3, 2e-3, 16e-3), "hertz": Hertz(1.5e3, 1.5e-3, 8e-3)}


@cache
def problem_of(*loads):
    """The signals of loads at a signal-to-noise ratio of 40 dB."""
    scene = srsinv.TractionScene(0.0, 0.3, pressures=[LOADS[each] for each in loads])
    noises = [srsinv.SignalToNoise(40.0)]
    return srsinv.simulate(srsinv.Scenario(scene, SENSOR, SPEED, noises=noises), LINE).problem


def with_data(problem, y):
    return eqx.tree_at(lambda p: p.data, problem, y)


def assert_same(traced, known, rel=1e-8):
    for name, (value, stderr) in known.parameters.items():
        assert float(traced.parameters[name][0]) == pytest.approx(value, rel=rel), name
        assert float(traced.parameters[name][1]) == pytest.approx(stderr, rel=rel), name


@pytest.mark.full
def test_numbers_and_derivatives_are_those_of_known_fits():
    """Along a change of the data, forward and reverse; and of many data at once."""
    problem = problem_of("strip")
    method = FeatureFit({"strip": StripFeature()}, Optimistix(tolerance=1e-13))
    sigma = float(jnp.sqrt(problem.noise[0, 1]))
    along = sigma * np.random.default_rng(0).normal(size=problem.data.shape)

    def of(y):
        return method(with_data(problem, y))

    def numbers(y):
        return jnp.array([number for pair in of(y).parameters.values() for number in pair])

    several = problem.data + 0.05 * along * np.arange(3)[:, None, None]
    together = jax.jit(jax.vmap(lambda y: (of(y), jax.jacrev(numbers)(y))))(several)
    for i, y in enumerate(several):
        made, moved = jax.tree.map(lambda leaf, i=i: leaf[i], together)
        known = of(y)
        assert_same(made, known)
    np.testing.assert_allclose(made.value, known.value, atol=1e-8 * np.abs(known.value).max())
    np.testing.assert_allclose(made.stderr, known.stderr, atol=1e-8 * known.stderr.max())
    assert any("JAX traced" in each for each in made.warnings)
    expected = differences(lambda t: numbers(several[-1] + t[0] * along), np.zeros(1), 0.1)[:, 0]
    moved = np.einsum("pen,en->p", moved, along)
    np.testing.assert_allclose(moved, expected, rtol=1e-6)


@pytest.mark.claim
def test_a_sum_of_features_beside_noise_that_is_traced():
    """Two features, one after the other, in noise that jax does not know to be white."""
    problem = problem_of("strip", "hertz")
    method = FeatureFit({"strip": StripFeature(), "hertz": HertzFeature()})

    @jax.jit
    def of(factor):
        return method(eqx.tree_at(lambda p: p.noise, problem, factor * problem.noise))

    assert_same(of(1.0), method(problem), rel=1e-7)


@pytest.mark.full
def test_errors_that_are_not_valid_are_infinite_as_those_of_a_known_fit():
    """Of a feature that is not there, and of one as wide as the scan, which is on its bound."""
    problem, method = problem_of("strip"), FeatureFit({"strip": StripFeature()})
    noise = np.random.default_rng(3).normal(size=problem.data.shape)
    alone = jnp.asarray(noise * np.sqrt(problem.noise[0, 1])) - problem.mean_signal
    wide = alone + problem.mean_signal  # of a pressure on all of the line
    traced = jax.jit(lambda y: method(with_data(problem, y)))
    for y, name in ((alone, "position_m"), (wide, "width_m")):
        known, made = method(with_data(problem, y)), traced(y).parameters
        assert np.isinf(known.parameters[name][1])
        for each, (_, stderr) in known.parameters.items():
            assert np.isinf(made[each][1]) == np.isinf(stderr), each


@pytest.mark.full
def test_bars_that_pull_are_gaps_when_traced_too():
    own = {"pitch_m": 1e-3, "duty": 0.3, "pressure_Pa": -2.0, "phase_rad": 2.0}
    made = jax.jit(GratingFeature().canonical)(own)
    expected = GratingFeature().canonical(own)
    assert {name: float(value) for name, value in made.items()} == pytest.approx(expected)


def test_what_cannot_be_traced_says_so():
    line, strip = problem_of("strip"), {"strip": StripFeature()}
    motion = Motion.from_speed(np.arange(40) / 100, 0.05)
    recorded = Problem(SENSOR, motion, np.zeros((2, 40)), 1e-8)
    for features, problem in (
        (strip, with_data(recorded, recorded.data)),
        ({"ridge": RidgeFeature(1e-4)}, line),
    ):
        method = FeatureFit(features)
        refused(
            lambda p=problem, m=method: jax.jit(lambda y: m(with_data(p, y)))(p.data), "LineProblem"
        )
    refused(lambda: eqx.filter_jit(FeatureFit(strip))(line), "LineProblem")
