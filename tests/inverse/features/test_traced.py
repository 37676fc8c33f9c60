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
from srsinv.inverse.features import FeatureFit, FeatureModel
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.nonlinear import Optimistix
from srsinv.inverse.problem import Problem
from srsinv.resolution import cell_m
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


def numbers(method, problem):
    """Values and standard errors, one after the other."""
    pairs = method(problem).parameters.values()
    return jnp.array([number for pair in pairs for number in pair])


@pytest.mark.claim
def test_a_strip_by_the_depth_the_angle_and_the_gain():
    """The values' slopes are those of known fits on the same cells, whose standard errors hold the
    misfit of a wrong sensor, too."""
    problem = problem_of("strip")
    signal = problem.data + problem.mean_signal
    method = FeatureFit(
        {"strip": StripFeature()}, Optimistix(tolerance=1e-13), nominal_sensor=SENSOR
    )

    def of(theta):
        films = [Film(theta[0]), Film(theta[0], theta[1], length_m=theta[2])]
        made = srsinv.Sensor(films)
        return numbers(method, LineProblem.of_sensor(LINE, made, SPEED, signal, problem.noise))

    theta = np.array([0.75e-3, np.pi / 2, 8e-3])
    both = jax.jit(lambda theta: (of(theta), jax.jacfwd(of)(theta)))
    made, slopes = both(theta)
    np.testing.assert_allclose(made, of(theta), rtol=1e-8)
    slopes = np.asarray(slopes) * theta
    largest = np.abs(slopes).max(axis=1, keepdims=True)
    for fitted, rows in ((of, slice(0, None, 2)), (lambda theta: both(theta)[0], slice(None))):
        relative = lambda t, fitted=fitted, rows=rows: fitted(theta * (1 + t))[rows]  # noqa: E731
        expected = differences(relative, np.zeros(3), 1e-3)
        off = (slopes[rows] - expected) / largest[rows]
        np.testing.assert_allclose(off, 0.0, atol=1e-6)


EDGE_M, NOMINAL_PA = 1e-4, 2e4
CONTACT = srsinv.Open(48, 2e-4, -4.7e-3)
RIDGE = {"height_m": 3e-5, "width_m": 0.83e-3, "position_m": 0.41e-3, "edge_length_m": EDGE_M}


def ridge_problem(sensor, signal, sigma=1.0):
    """The problem of signals over a ridge."""
    power = np.full(CONTACT.k.shape, sigma**2)
    background_Pa = NOMINAL_PA, None
    return LineProblem.of_sensor(CONTACT, sensor, SPEED, signal, power, background_Pa=background_Pa)


def ridge_signal(sensor, cell_m, **changed):
    """The signal of the ridge on cells of the contact."""
    problem = ridge_problem(sensor, np.zeros((2, CONTACT.n)))
    motion, window = problem.samples().motion, problem.window
    model = FeatureModel.on_window(sensor, motion, window, cell_m, NOMINAL_PA)
    plate = {"base_friction": 0.4, "nominal_pressure_Pa": NOMINAL_PA, "gain": 1.0}
    params = plate | {"ridge": RIDGE | changed}
    model = model.with_features({"ridge": RidgeFeature(EDGE_M)})
    return np.asarray(model(jax.tree.map(jnp.asarray, params))), float(model.line.cell_m)


@pytest.mark.claim
def test_a_ridge_moves_as_its_signal_does_over_whole_cells():
    """Data of the fit's own model: their change as the ridge moves by a cell of the contact is a
    change of its position alone."""
    fine_m = cell_m("contact", float(SENSOR.depth_m))
    signal, cell = ridge_signal(SENSOR, fine_m)
    ends = [
        ridge_signal(SENSOR, fine_m, position_m=RIDGE["position_m"] + step)[0]
        for step in (2 * cell, -2 * cell)
    ]
    along = (ends[0] - ends[1]) / (4 * cell)
    problem = ridge_problem(SENSOR, signal, 0.01 * np.sqrt(np.mean(signal**2)))
    method = FeatureFit({"ridge": RidgeFeature(EDGE_M)}, Optimistix(rounding=1e-9))

    def of(y):
        return {name: pair[0] for name, pair in method(with_data(problem, y)).parameters.items()}

    value, moved = jax.jit(lambda y: jax.jvp(of, (y,), (jnp.asarray(along),)))(problem.data)
    for name, expected in {**RIDGE, "base_friction": 0.4}.items():
        if name in value:
            assert float(value[name]) == pytest.approx(expected, rel=1e-5), name
            size = expected / RIDGE["position_m"]
            assert abs(float(moved[name]) / size - (name == "position_m")) < 1e-5, name


@pytest.mark.claim
def test_a_ridge_in_noise_has_the_numbers_of_a_known_fit_and_their_slope_by_the_depth():
    """By the depth they move over cells, within a hundredth of what known fits do."""
    signal, _ = ridge_signal(SENSOR, EDGE_M / 13)
    sigma = 0.01 * np.sqrt(np.mean(signal**2))
    signal = signal + sigma * np.random.default_rng(0).normal(size=signal.shape)
    method = FeatureFit({"ridge": RidgeFeature(EDGE_M)}, nominal_sensor=SENSOR)

    def of(depth_m):
        sensor = srsinv.Sensor([Film(depth_m), Film(depth_m, np.pi / 2)])
        return method(ridge_problem(sensor, signal, sigma))

    def arrays(depth_m):
        made = of(depth_m)
        return made.parameters, made.value, made.stderr

    def values(depth_m):
        return jnp.stack([value for value, _ in of(depth_m).parameters.values()])

    known, (made, value, stderr) = of(0.75e-3), jax.jit(arrays)(0.75e-3)
    for name, (expected, error) in known.parameters.items():
        assert abs(float(made[name][0]) - expected) < 1e-3 * error, name
        assert float(made[name][1]) == pytest.approx(error, rel=1e-5), name
    np.testing.assert_allclose(value, known.value, atol=1e-5 * np.abs(known.value).max())
    np.testing.assert_allclose(stderr, known.stderr, atol=1e-4 * known.stderr.max())
    slopes = jax.jit(jax.grad(lambda depth_m: values(depth_m)[1]))(0.75e-3)
    expected = (values(0.76e-3) - values(0.74e-3))[1] / 2e-5
    assert float(slopes) == pytest.approx(float(expected), rel=1e-2)


@pytest.mark.claim
def test_a_ridge_that_is_not_there_has_infinite_errors():
    problem = ridge_problem(SENSOR, np.zeros((2, CONTACT.n)))
    noise = np.random.default_rng(1).normal(size=problem.data.shape)
    method = FeatureFit({"ridge": RidgeFeature(EDGE_M)})
    made = jax.jit(lambda y: method(with_data(problem, y)).parameters)(jnp.asarray(noise))
    assert all(np.isinf(stderr) for _, stderr in made.values())


@pytest.mark.claim
def test_a_recording_is_fitted_on_its_grid():
    method = FeatureFit({"strip": StripFeature()})
    motion = Motion.from_speed(np.arange(600) / 1000, 0.05, 1e-3)
    fine = srsinv.Open(3200, 1e-5)
    operator = SENSOR.operator_along(fine, motion)
    pressure = LOADS["strip"].cell_average(fine)
    signal = np.asarray(operator(jnp.stack([pressure, 0.3 * pressure])))
    sigma = 0.01 * np.sqrt(np.mean(signal**2))
    signal = signal + sigma * np.random.default_rng(2).normal(size=signal.shape)
    grid = Problem(SENSOR, motion, signal, sigma).to_grid()
    assert_same(jax.jit(lambda y: method(with_data(grid, y)))(grid.data), method(grid))


def of_depth(depth_m, nominal_sensor=None):
    """A fit of nothing by a sensor of this depth."""
    method = FeatureFit({"strip": StripFeature()}, nominal_sensor=nominal_sensor)
    sensor = srsinv.Sensor([Film(depth_m), Film(depth_m, np.pi / 2)])
    nothing, power = np.zeros((2, LINE.n)), np.ones(LINE.k.shape)
    return method(LineProblem.of_sensor(LINE, sensor, SPEED, nothing, power)).value


def test_what_cannot_be_traced_says_so():
    line, strip = problem_of("strip"), {"strip": StripFeature()}
    motion = Motion.from_speed(np.arange(40) / 100, 0.05)
    recorded = Problem(SENSOR, motion, np.zeros((2, 40)), 1e-8)
    method = FeatureFit(strip)
    of_data = jax.jit(lambda y: method(with_data(recorded, y)))
    refused(lambda: of_data(recorded.data), "problem.to_grid()")
    refused(lambda: eqx.filter_jit(method)(line), "LineProblem")
    refused(lambda: jax.jit(of_depth)(1e-3), "nominal_sensor=")
    refused(
        lambda: jax.jit(lambda d: of_depth(d, srsinv.Sensor([Film(d)])))(1e-3), "nominal_sensor="
    )
    one = srsinv.Sensor([Film(1e-3)])
    refused(lambda: jax.jit(lambda d: of_depth(d, one))(1e-3), "1 films", "2")
