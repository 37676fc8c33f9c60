"""One problem, every method: the contract between what is recorded and what is found."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.robustness.scans import ornstein_uhlenbeck
from srsinv.errors import BadInput
from srsinv.forward.feature import StripFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface_feature import RidgeFeature
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Open
from srsinv.inverse.estimate import deviation, overlap
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.problem import Problem
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Exponential, Wiener
from srsinv.recorded import motion_of, sensor_of
from srsinv.recording import Recording
from tests.inverse.cases import make_case, signals_along

SENSOR = Sensor([Film(angle_rad=angle) for angle in (0.0, np.pi / 2)])
SAMPLES, SPEED = 240, 0.05
TIME = np.arange(SAMPLES) / 1000
P_PA, MU, WIDTH_M, POSITION_M = 4e3, -0.4, 3e-3, 0.4e-3
NOISE = 3e-8
METHODS = {
    "wiener": Wiener(Exponential(2e3, 1.5e-3), Exponential(1e3, 1.5e-3)),
    "tikhonov": Tikhonov(),
    "features": FeatureFit({"strip": StripFeature()}),
}
SPEEDS = {
    "steady": np.full(SAMPLES, SPEED),
    "backwards": np.full(SAMPLES, -SPEED),
    "varying": SPEED * (1 + 0.3 * np.sin(2 * np.pi * TIME / 0.2)),
}


def strip(line) -> np.ndarray:
    """The true p and q on a line while sliding towards +x."""
    p = np.asarray(UniformStrip(P_PA, WIDTH_M, POSITION_M).cell_average(line))
    return np.stack([p, MU * p])


def strip_problem(name="steady", **known) -> Problem:
    """A strip's signal, simulated on fine cells, in white noise, with one sample missing."""
    speed = SPEEDS[name]
    motion = Motion.from_speed(TIME, speed, -np.sign(speed[0]) * 6e-3)
    line = Open(3000, 1e-5, -1.5e-2)
    traction = strip(line) * np.array([[1.0], [np.sign(speed[0])]])
    signal = np.array(signals_along(SENSOR, line, motion, traction))
    signal += NOISE * np.random.default_rng(3).normal(size=signal.shape)
    signal[0, 31] = np.nan
    return Problem(SENSOR, motion, signal, NOISE, **known)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("varying", marks=pytest.mark.full),
        pytest.param("backwards", marks=pytest.mark.claim),
    ],
)
def test_every_method_takes_it_and_says_on_which_line_its_answer_is(name):
    problem, line = strip_problem(name), Open(20, 5e-4, -4.75e-3)
    truth = strip(line) * np.array([[1.0], [np.sign(SPEEDS[name][0])]])
    for method in METHODS.values():
        own = method(problem)
        estimate = own.on(line)
        value, stderr = estimate.deviation(np.ones(line.n, bool))
        error = value - (truth - truth.mean(axis=-1, keepdims=True))
        assert own.value.shape == (2, own.line.n)
        assert np.linalg.norm(error) < 0.2 * np.linalg.norm(truth)
        assert np.all(stderr >= 0)
    assert abs(own.parameters["friction"][0] - MU) < 4 * own.parameters["friction"][1]
    # A feature is averaged exactly on any line.
    found, wide = {k: v for k, (v, _) in own.parameters.items()}, Open(7, 1.7e-3, -6e-3)
    strip_found = UniformStrip(found["pressure_Pa"], found["width_m"], found["position_m"])
    p = strip_found.cell_average(wide)
    np.testing.assert_allclose(own.on(wide).value, np.stack([p, found["friction"] * p]), atol=1e-9)


def test_its_operator_gives_the_signal_and_has_an_adjoint():
    problem, line = strip_problem(), Open(2000, 1e-5, -1e-2)
    operator, rng = problem.operator(line), np.random.default_rng(0)
    white = (
        np.where(problem.observed, np.asarray(problem.data - operator(jnp.asarray(strip(line)))), 0)
        / NOISE
    )
    assert np.sum(white**2) < 1.3 * white.size
    assert problem.nuisance_columns.shape == (2, 0, SAMPLES)
    r, y = (jnp.asarray(rng.normal(size=shape)) for shape in ((2, line.n), problem.data.shape))
    assert float(jnp.vdot(operator(r), y)) == pytest.approx(float(jnp.vdot(r, operator.adjoint(y))))


@pytest.mark.full
def test_errors_over_random_tractions_are_as_large_as_their_bands():
    """Of p less its mean over the scan, as no background is known. Fields correlated as
    exp(-|x|/l)."""
    rng, line = np.random.default_rng(5), Open(3000, 1e-5, -1.5e-2)
    motion, z = Motion.from_speed(TIME, np.full(SAMPLES, SPEED), -6e-3), []
    for _ in range(6):
        p, own = ornstein_uhlenbeck(rng, (2, line.n), float(line.cell_m) / 1e-3)
        truth = 2e3 * p, 800 * p + 300 * own
        signal = signals_along(SENSOR, line, motion, np.stack(truth))
        noise = np.abs(signal).max() / 100
        signal = signal + noise * rng.normal(size=signal.shape)
        problem = Problem(SENSOR, motion, signal, noise, cell_m=1e-4).to_grid()
        estimate, cells = Tikhonov()(problem), problem.observed_cells
        true = np.interp(np.asarray(problem.line.x), np.asarray(line.x), truth[0])
        wrong = deviation(np.asarray(estimate.value[0]) - true, cells)
        z.append(wrong / np.asarray(estimate.stderr)[0, cells])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.25)


@pytest.mark.full
def test_on_a_line_it_keeps_what_is_known():
    known = {"friction": MU, "nominal_pressure_Pa": 5e3, "window_m": (-8e-3, 8e-3), "cell_m": 2e-4}
    problem = strip_problem(**known).to_grid()
    assert float(problem.line.cell_m) == pytest.approx(2e-4, rel=1e-6)
    assert -8e-3 <= problem.window.start_m < -6e-3 + 2e-4
    assert problem.unknowns == 1
    estimate = METHODS["wiener"](problem)
    np.testing.assert_allclose(estimate.value[1], MU * estimate.value[0])
    assert float(jnp.median(estimate.value[0])) == pytest.approx(5e3, abs=1e3)


REFUSED = {
    r"has the shape \(1, 240\).* as the sensor and the motion have them: \(2, 240\)": lambda: (
        Problem(SENSOR, strip_problem().motion, np.zeros((1, SAMPLES)), NOISE)
    ),
    "noise's rms is 0": lambda: Problem(
        SENSOR, strip_problem().motion, np.zeros((2, SAMPLES)), 0.0
    ),
    "cell_m is -1": lambda: strip_problem(cell_m=-1),
    "nominal pressure on the surface is not known": lambda: FeatureFit({"it": RidgeFeature(1e-5)})(
        strip_problem()
    ),
    "an operator but no sensor": lambda: METHODS["features"](make_case().problem),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_refused(sentence):
    with pytest.raises(BadInput, match=sentence):
        REFUSED[sentence]()


# --- an estimate on another line ---------------------------------------------------------------


@pytest.mark.parametrize(("kind", "shape"), [("periodic", "ccK"), ("open", "mm")])
def test_an_average_has_the_error_that_the_covariance_gives(kind, shape):
    """By draws from the posterior, of an estimate whose errors are correlated over cells."""
    case = make_case(kind, amplifier=None)
    estimate = METHODS["wiener"](case.problem)
    line = case.problem.line
    wide = Open(10, 4 * float(line.cell_m), float(line.x[4]) + 1.5 * float(line.cell_m))
    n, weights = line.n, overlap(line, wide)
    covariance = np.asarray(estimate.covariance)
    if shape == "ccK":
        first = np.fft.irfft(covariance[0, 0].real, n)
        dense = first[(np.arange(n)[:, None] - np.arange(n)) % n]
    else:
        dense = covariance[:n, :n]
    hidden = np.asarray(estimate.mean_weights)[0]
    off = weights - weights.sum(axis=1, keepdims=True) * hidden
    moved = estimate.on(wide)
    np.testing.assert_allclose(moved.stderr[0], np.sqrt(np.sum(off @ dense * off, axis=1)))
    np.testing.assert_allclose(moved.value, estimate.value @ weights.T)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert np.all(moved.stderr[0] < 1.05 * np.max(estimate.stderr[0]))


def test_on_its_own_line_an_estimate_is_itself():
    estimate = METHODS["tikhonov"](make_case("open").problem)
    same = estimate.on(estimate.line)
    np.testing.assert_allclose(same.value, estimate.value)
    np.testing.assert_allclose(same.stderr, estimate.stderr, rtol=1e-6)


def test_beyond_its_line_an_estimate_knows_nothing():
    estimate = METHODS["wiener"](make_case("open").problem)
    line = dataclasses.replace(estimate.line, start_m=estimate.line.start_m + 1e-3)
    assert np.isnan(estimate.on(line).value[:, -1]).all()
    assert np.isfinite(estimate.on(line).value[:, 0]).all()


# --- a method of one's own ---------------------------------------------------------------------


def test_a_solution_becomes_an_estimate():
    """Of the true traction: the residual is the noise, and with no error stated none is shown."""
    case = make_case("open", free_offset=True)
    problem = case.problem
    truth = jnp.asarray(case.truth - np.asarray(problem.zero_mean)[:, None] * case.truth.mean())
    estimate = problem.estimate(truth, resolved_dof=3.0, steps=7)
    assert estimate.quality == "no bands"
    assert estimate.stats["degrees_of_freedom"] == problem.sample_count - 2 - 3
    assert estimate.chi2_per_freedom == pytest.approx(1.0, abs=0.4)
    assert estimate.stats["steps"] == 7
    assert jnp.isnan(estimate.stderr).all()
    assert estimate.with_warnings(["Something."]).quality == "doubtful"
    assert problem.estimate(0 * truth).quality == "failed"
    assert problem.estimate(np.nan * truth).status == "not finite"


def test_what_is_compiled_for_one_sensor_serves_all():
    """On a line only the operator is left of the sensor."""
    gridded = strip_problem().to_grid()
    leaves = jax.tree.leaves(gridded.to_grid())
    assert len(leaves) < len(jax.tree.leaves(gridded))
    assert gridded.to_grid().sensor is None


@pytest.mark.full
def test_a_sidecars_elements_are_where_it_says():
    """The films' offsets are in the sensor that a sidecar describes, and shift its signals."""
    element = {"angle_deg": 20.0, "strip_width_m": 7e-4, "active_length_m": 8e-3}
    sidecar = {
        "sensor": {
            "depth_m": 7.5e-4, "feedback_resistance_ohm": 1e6,
            "elements": [element, element | {"offset_m": 1.5e-3}],
        }
    }  # fmt: skip
    time_s = np.arange(400) / 1000
    given = Recording(np.zeros((2, 400)), time_s, 0.03 + 0 * time_s, ("a", "b"), sidecar)
    sensor, line = sensor_of(given), Open(400, 5e-5, -4e-3)
    signals = signals_along(sensor, line, motion_of(given), strip(line))
    shifted = np.interp(0.03 * time_s + 1.5e-3, 0.03 * time_s, signals[0])
    inside = 0.03 * time_s < 0.03 * time_s[-1] - 1.5e-3
    np.testing.assert_allclose(
        signals[1][inside], shifted[inside], atol=1e-2 * np.abs(signals[0]).max()
    )
