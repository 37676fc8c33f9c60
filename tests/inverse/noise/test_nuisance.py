"""Drift and mains beside the noise: against dense linear algebra, and against the exact floor."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from srsinv.forward.amplifier import ChargeReadout, CurrentAmplifier
from srsinv.forward.feature import LineFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open
from srsinv.inverse.features import FeatureFit
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.line.rule import Evidence
from srsinv.inverse.line.solve import solve
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.calibration import calibrate
from srsinv.inverse.tikhonov import DerivativePenalty, Tikhonov
from srsinv.modules import with_fields
from srsinv.recording.mains import mains_lines
from tests.inverse.rig import test_calibration as rig

RATE_HZ, SPEED, DEPTH, COUNT = 500.0, 20e-3, 1.2e-3, 1000
TIME_S = np.arange(COUNT) / RATE_HZ
NOISE = 1e-6


def sensor(offset=0.0):
    films = [Film(depth_m=DEPTH, angle_rad=angle) for angle in (0.0, np.pi / 4)]
    readout = CurrentAmplifier(1e8) if offset is not None else ChargeReadout(1e8 * SPEED / DEPTH)
    return Sensor(films, HalfSpace(0.5, 7e5), readout)


def problem(signal, drift=0.0, offset=0.0, lines=(), observed=None, speed=SPEED):
    x = speed * TIME_S
    signal = signal if observed is None else np.where(observed, signal, np.nan)
    return Problem(
        sensor(offset),
        Motion(TIME_S, x, np.full(COUNT, speed)),
        signal,
        SampleNoise(NOISE, drift=drift),
        friction=0.3,
        mains=lines,
    )


def model_of(line_problem):
    """G (e, sample, cell) over the cells that have samples."""
    units = jnp.eye(line_problem.line.n)[:, None]
    columns = np.moveaxis(np.asarray(jax.vmap(line_problem.forward)(units)), 0, -1)
    return columns[:, line_problem.observed_cells]


def covariance_of(line_problem, e):
    """That of an element's noise, drift and mains as the problem states them."""
    power, n = np.asarray(line_problem.noise), line_problem.line.n
    power = power[min(e, len(power) - 1)].copy()
    free = not np.isfinite(power[0])
    power[0] = power[1] if free else power[0]
    has_data = line_problem.observed_cells
    covariance = scipy.linalg.toeplitz(np.fft.irfft(power, n))[np.ix_(has_data, has_data)]
    if line_problem.nuisance is not None:
        columns = np.asarray(line_problem.nuisance)[e][:, has_data]
        covariance = covariance + columns.T @ columns
    return covariance + free * 1e6 * np.trace(covariance)


def penalty(line):
    prior = DerivativePenalty(jnp.asarray([3e-9]), jnp.asarray(DEPTH), 1)
    rows = np.asarray(jax.vmap(lambda row: prior.apply(line, row[None])[0])(jnp.eye(line.n)))
    return prior, rows + 1e4 * np.trace(rows) / line.n**2  # the mean is known


def estimator(model, covariances, precision):
    """The posterior's map from signals, and its covariance."""
    weighed = [g.T @ np.linalg.inv(c) for g, c in zip(model, covariances, strict=True)]
    information = sum(w @ g for w, g in zip(weighed, model, strict=True))
    covariance = np.linalg.inv(information + precision)
    return [covariance @ w for w in weighed], covariance


def hum(rng, sizes=(1.0, 0.4)):
    frequencies = 50.1 * np.arange(1, 2 * len(sizes), 2)
    phases = rng.uniform(0, 6, size=(2, len(sizes)))
    waves = np.sin(2 * np.pi * frequencies[:, None] * TIME_S + phases[..., None])
    return np.einsum("f,eft->et", sizes, waves)


@pytest.mark.parametrize(
    ("path", "offset"),
    [
        pytest.param("direct", None, marks=pytest.mark.claim),
        pytest.param("iterative", 0.0, marks=pytest.mark.full),
        pytest.param("direct", 0.0, marks=pytest.mark.claim),
        pytest.param("iterative", None, marks=pytest.mark.claim),
    ],
)
def test_paths_are_the_dense_posterior(path, offset):
    rng = np.random.default_rng(1)
    signal = NOISE * (rng.normal(size=(2, COUNT)) + 30 * hum(rng))
    signal = signal + NOISE * np.cumsum(rng.normal(size=(2, COUNT)), axis=1)
    line_problem = problem(signal, NOISE * 20, offset, mains_lines(signal, RATE_HZ)).to_grid()
    prior, precision = penalty(line_problem.line)
    estimate = solve(line_problem, prior, path)
    maps, covariance = estimator(
        model_of(line_problem), [covariance_of(line_problem, e) for e in range(2)], precision
    )
    data = np.asarray(line_problem.data)[:, line_problem.observed_cells]
    expected = sum(m @ d for m, d in zip(maps, data, strict=True))
    stderr = np.sqrt(np.diag(covariance))
    cells = line_problem.observed_cells
    off = (np.asarray(estimate.value)[0] - expected)[cells] / stderr[cells]
    assert np.ptp(off) < 0.01
    weights = np.asarray(line_problem.mean_weights)[0]
    less_mean = np.eye(expected.size) - weights
    own = np.sqrt(np.sum(less_mean @ covariance * less_mean, axis=1))
    assert np.asarray(estimate.stderr)[0, cells] == pytest.approx(own[cells], rel=0.02)


@pytest.mark.claim
@pytest.mark.parametrize("reach", [0.03, 0.3])
@pytest.mark.parametrize("offset", [0.0, None])
def test_drift_costs_no_more_than_the_exact_floor(reach, offset):
    """The expected square of the error of a walk from zero, or from an unknown level, whose rms at
    the end is `reach` of a signal of 100 times the noise."""
    drift = reach * 100 * NOISE / np.sqrt(TIME_S[-1])
    line_problem = problem(np.zeros((2, COUNT)), drift, offset).to_grid()
    model, (_, precision) = model_of(line_problem), penalty(line_problem.line)
    stated = [covariance_of(line_problem, e) for e in range(2)]
    block = COUNT // model.shape[1]
    means = np.kron(np.eye(model.shape[1]), np.full(block, 1 / block))
    time = TIME_S[: means.shape[1]]
    walk = drift**2 * np.minimum(time[:, None], time)
    true = means @ (walk + NOISE**2 * np.eye(time.size)) @ means.T
    true = true + (offset is None) * 1e6 * np.trace(true)
    _, floor = estimator(model, [true, true], precision)
    maps, _ = estimator(model, stated, precision)
    left = np.eye(len(floor)) - sum(m @ g for m, g in zip(maps, model, strict=True))
    proper = precision + 1e-9 * np.trace(precision) / len(precision) * np.eye(len(precision))
    error = left @ np.linalg.solve(proper, left.T) + sum(m @ true @ m.T for m in maps)
    centre = np.eye(len(floor))[line_problem.observed_cells]
    centre = centre - centre.mean(axis=0)
    ratio = np.sqrt(np.trace(centre @ error @ centre.T) / np.trace(centre @ floor @ centre.T))
    print(f"reach {reach}, offset {offset}: {ratio:.4f} of the exact floor")
    assert 0.999 < ratio < 1.05


@pytest.mark.claim
@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_hum_costs_hardly_any_information(size):
    """The floor with the waves that hum is taken for, beside that without, and the error of what
    the waves do not span."""
    rng, rms = np.random.default_rng(2), 100 * NOISE
    wave = size * rms * hum(rng)
    lines = mains_lines(NOISE * rng.normal(size=(2, COUNT)) + wave, RATE_HZ)
    with_hum, clean = (problem(wave, lines=each).to_grid() for each in (lines, ()))
    model, (_, precision) = model_of(clean), penalty(clean.line)
    maps, floor = estimator(model, [covariance_of(with_hum, e) for e in range(2)], precision)
    _, without = estimator(model, [covariance_of(clean, e) for e in range(2)], precision)
    cells = clean.observed_cells
    data = np.asarray(clean.data)[:, cells]
    bias = sum(m @ d for m, d in zip(maps, data, strict=True))[cells]
    centre = np.eye(len(floor))[cells]
    centre = centre - centre.mean(axis=0)
    square, least = (np.trace(centre @ each @ centre.T) for each in (floor, without))
    ratio = np.sqrt((square + np.sum((bias - bias.mean()) ** 2)) / least)
    assert ratio < 1.1


@pytest.mark.claim
def test_a_rule_chooses_as_without_hum_or_drift():
    rng = np.random.default_rng(5)
    x = SPEED * TIME_S
    load = 5e3 * np.exp(-(((np.linspace(-0.02, 0.06, 1024)) - 0.02) ** 2) / 2e-6)
    clean = problem(np.zeros((2, COUNT)))
    line = Open(1024, 0.08 / 1023, -0.02)
    signal = np.asarray(clean.operator(line)(jnp.stack([load, 0.3 * load])))
    assert signal.shape == (2, x.size)
    noisy = signal + 0.01 * np.std(signal) * rng.normal(size=signal.shape)
    loud = noisy + 3 * np.std(signal) * hum(rng)
    level = SampleNoise(0.01 * np.std(signal))
    estimates = []
    for data, lines in ((noisy, ()), (loud, mains_lines(loud, RATE_HZ))):
        given = Problem(
            sensor(), Motion(TIME_S, x, np.full(COUNT, SPEED)), data, level, friction=0.3,
            mains=lines,
        )  # fmt: skip
        estimates.append(Tikhonov(rule=Evidence(), path="iterative")(given))
    quiet, hummed = estimates
    weights = [each.stats["weight_p_per_Pa2"] for each in estimates]
    assert weights[1] == pytest.approx(weights[0], rel=1.0)
    gap = np.asarray(hummed.value - quiet.value)[0]
    scale = np.asarray(quiet.stderr)[0]
    inside = (np.asarray(quiet.line.x) > 0) & (np.asarray(quiet.line.x) < x[-1])
    assert np.sqrt(np.mean((gap - gap[inside].mean())[inside] ** 2 / scale[inside] ** 2)) < 1.0
    assert hummed.chi2_per_freedom == pytest.approx(1.0, abs=0.1)


@pytest.mark.full
def test_a_fit_of_features_takes_hum_out():
    """A line load beside hum of ten times its signal, as well as without."""
    rng, x = np.random.default_rng(6), SPEED * TIME_S
    load = {"position_m": 0.02, "load_N_per_m": 1.0, "shear_N_per_m": 0.3}
    model = FeatureModel.along(sensor(), Motion(TIME_S, x, np.full(COUNT, SPEED)))
    signal = np.asarray(model.with_features({"line": LineFeature()})({"line": load}))
    noise = 0.01 * np.std(signal)
    noisy = signal + noise * rng.normal(size=signal.shape)
    loud = noisy + 10 * np.std(signal) * hum(rng)
    both = []
    for data, lines in ((noisy, ()), (loud, mains_lines(loud, RATE_HZ))):
        motion = Motion(TIME_S, x, np.full(COUNT, SPEED))
        given = Problem(sensor(), motion, data, SampleNoise(noise), mains=lines)
        both.append(FeatureFit({"line": LineFeature()})(given))
    quiet, hummed = both
    for name, (value, stderr) in hummed.parameters.items():
        expected, alone = quiet.parameters[name]
        assert stderr == pytest.approx(alone, rel=0.02)
        assert abs(value - expected) < 0.5 * stderr
    assert hummed.quality == "good"
    assert hummed.chi2_per_freedom == pytest.approx(1.0, abs=0.1)


@pytest.mark.claim
def test_a_ridge_is_fitted_and_a_rig_calibrated_beside_hum_and_drift():
    """In noise that both estimate from what they leave: as without, but for what drift costs."""
    rng, clean = np.random.default_rng(7), rig.clean(rig.FEATURES["ridge"][0])
    rms, time_s = np.std(clean), np.asarray(rig.motion().time_s)
    noisy = clean + rig.NOISE_V * rng.normal(size=clean.shape)
    waves = np.sin(2 * np.pi * 50.2 * time_s + np.array([[0.3], [1.0]]))
    drift = 0.03 * rms / np.sqrt(time_s[-1])
    walk = drift * np.sqrt(time_s[1]) * np.cumsum(rng.normal(size=clean.shape), axis=1)
    loud = noisy + 3 * rms * waves + walk
    stated = SampleNoise(rig.NOISE_V, is_estimate=True, drift=drift)
    lines = mains_lines(loud, rig.RATE_HZ)
    feature, held = rig.FEATURES["ridge"]
    given = with_fields(rig.problem(loud), noise=stated, mains=lines)
    calibration = calibrate(given, feature, held)
    gain = {"gain_1": 1.0, "gain_2": 1.0}
    assert calibration.quality == "good"
    for name, (value, stderr) in calibration.parameters.items():
        assert abs(value - (rig.TRUE | gain)[name]) < 3.5 * stderr
    exact = rig.sensor(rig.TRUE["depth_m"], rig.TRUE["angle_2_deg"], rig.TRUE["offset_2_m"])
    fitted = FeatureFit({"ridge": feature})(with_fields(given, sensor=exact))
    assert fitted.quality == "good"
    for name, expected in held.items():
        value, stderr = fitted.parameters[name]
        assert abs(value - expected) < 3.5 * stderr
        assert stderr < 0.02 * expected
