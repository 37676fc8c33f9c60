"""Bursts of catch and snap beside a traction: found, located and counted, with their errors."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import srsinv
from experiments.elements.passes import TrueBursts, burst_signals, in_a_row
from srsinv import (
    BurstEstimate,
    BurstInversion,
    ConstantSpeed,
    Film,
    Motion,
    Open,
    Periodic,
    Problem,
    Sensor,
    Wiener,
)
from srsinv.forward.noise import White
from srsinv.forward.snap_back import SnapBackNoise
from srsinv.inverse.bursts.everything import Columns, Everything
from srsinv.inverse.bursts.model import BurstModel
from srsinv.inverse.bursts.posterior import Burst, OneBurst
from srsinv.inverse.bursts.rate import burst_rate, first_sizes
from srsinv.inverse.line.problem import LineProblem
from srsinv.jobs._inversion import InversionCase, run
from srsinv.jobs._recorded import check_invertible
from srsinv.modules import with_fields
from srsinv.recording import Recording
from tests.refusals import refused

N, CELL_M, RMS_V = 256, 8e-5, 1e-6
LINE = Periodic(N, CELL_M, -N * CELL_M / 2)
PATCH_M = 5e-4
SECONDS = N * CELL_M / 0.02
TRUTH = TrueBursts(
    np.array([0.123, 0.31, 0.337, 0.78]),
    np.array([0.4e-3, -1.7e-3, 1.1e-3, 2.0e-3]),
    np.array([1800.0, -2600.0, 2400.0, 3000.0]),
    np.full(4, 5e-3),
)
SCENE = srsinv.TractionScene(0.0, 0.5, [srsinv.UniformStrip(1e4, 2e-3)])


@cache
def clean(elements=4, speed=0.02):
    sensor = Sensor(in_a_row(Film(), elements, 1e-3))
    scenario = srsinv.Scenario(SCENE, sensor, ConstantSpeed(speed), noises=(White(RMS_V),))
    return srsinv.simulate(scenario, LINE, friction=0.5)


@cache
def scanned(elements=4, speed=0.02, has_bursts=True):
    """The problem of a pass with the bursts, which are at the same times whichever way."""
    made = clean(elements, speed)
    problem = made.problem
    assert problem.sensor is not None
    assert problem.scan is not None
    bursts = burst_signals(TRUTH, PATCH_M, problem.sensor, LINE, problem.scan) * has_bursts
    noise = np.random.default_rng(0).normal(0, RMS_V, bursts.shape)
    data = np.asarray(made.signal - problem.mean_signal) + bursts + noise
    return with_fields(problem, data=jnp.asarray(data))


@cache
def found(elements=4, speed=0.02, scale="given"):
    estimate = BurstInversion(method=Wiener(scale=scale))(scanned(elements, speed))
    assert isinstance(estimate, BurstEstimate)
    return estimate


@pytest.mark.parametrize("speed", [0.02, pytest.param(-0.02, marks=pytest.mark.full)])
def test_bursts_are_found_within_their_errors(speed):
    bursts = found(speed=speed).bursts
    assert len(bursts) == len(TRUTH.time_s)
    true = {"time": TRUTH.time_s, "place": TRUTH.place_m, "size": TRUTH.size_Pa, "decay": 5e-3}
    for name, values in true.items():
        got = getattr(bursts, name)
        assert np.abs((got.value - values) / got.stderr).max() < 3.5, name
    assert bursts.is_located.all()
    assert bursts.time.stderr.max() < CELL_M / 0.02
    assert bursts.rate_hz[2] < 4 / SECONDS < bursts.rate_hz[3]


@pytest.mark.full
def test_one_element_finds_bursts_and_locates_none():
    estimate = found(elements=1, scale="evidence")
    time = estimate.bursts.time
    assert 0 < len(estimate.bursts) <= len(TRUTH.time_s)
    assert np.abs(time.value[:, None] - TRUTH.time_s).min(axis=1).max() < CELL_M / 0.02
    assert not estimate.bursts.is_located.any()
    assert any("not located" in each for each in estimate.warnings)


def test_traction_is_as_without_bursts_and_its_bands_have_them():
    estimate, truth = found(), np.asarray(clean().traction)
    quiet = Wiener()(scanned(has_bursts=False))
    cells = np.ones(N, bool)
    error, without = (np.std((e.deviation(cells)[0] - truth)[0]) for e in (estimate, quiet))
    assert error < 1.1 * without
    assert np.all(np.asarray(estimate.stderr)[0] > np.asarray(quiet.stderr)[0])
    assert "bursts" in estimate.rig_sources
    assert 0.8 < float(estimate.chi2_per_freedom or 0.0) < 1.2
    data = estimate.to_xarray()
    assert data["burst_place"].attrs["units"] == "m"
    assert data.sizes["burst"] == len(TRUTH.time_s)


@pytest.mark.full
def test_pass_without_bursts_has_none():
    estimate = BurstInversion()(scanned(has_bursts=False))
    assert isinstance(estimate, BurstEstimate)
    assert len(estimate.bursts) == 0
    low, high = estimate.bursts.rate_hz[2:]
    assert low < 1e-2 / SECONDS
    assert 0 < high < 20 / SECONDS


def test_missing_samples_and_columns_are_taken_out_of_the_precision():
    """Against the inverse of the whole covariance between samples in time."""
    rng, elements, n = np.random.default_rng(0), 2, 24
    half = rng.normal(size=(elements, elements, n)) * np.exp(-np.arange(n))
    total = np.moveaxis(np.fft.rfft(half), -1, 0)
    total = total @ total.conj().swapaxes(1, 2) + 0.1 * np.eye(elements)
    observed, columns = rng.random((elements, n)) > 0.3, rng.normal(size=(3, elements, n))
    lag = (np.arange(n)[:, None] - np.arange(n)) % n
    lags = np.fft.irfft(np.moveaxis(total, 0, -1), n)
    whole = np.block([[lags[e, f][lag] for f in range(elements)] for e in range(elements)])
    beside = (columns * observed).reshape(3, -1)
    own = (whole + beside.T @ beside)[np.ix_(observed.ravel(), observed.ravel())]
    rest = Everything(np.linalg.inv(total), 0.0, n, np.zeros((1, 1)))
    got, data = rest.over(Columns(observed, columns)), rng.normal(size=(elements, n))
    expected = np.zeros(elements * n)
    expected[observed.ravel()] = np.linalg.solve(own, data[observed])
    weighed = np.fft.irfft(got.weigh(np.fft.rfft(data)), n)
    np.testing.assert_allclose(weighed.ravel(), expected, rtol=0, atol=1e-9)
    log_det = got.log_det + np.linalg.slogdet(whole)[1] / 2
    np.testing.assert_allclose(log_det, np.linalg.slogdet(own)[1] / 2, rtol=1e-9)
    assert got.taken is not None
    shape, responses = np.exp(-1.5 * np.arange(n)), np.array([[1.0], [-0.4]])
    waves = np.fft.rfft(shape)[None]
    every = got.taken.every_square(waves[0], responses)
    some = got.taken.squares(waves, np.arange(-2, 3), responses)[:, 0].T
    np.testing.assert_allclose(some, every[:, np.arange(-2, 3)], rtol=1e-6)
    for m in range(n):
        burst = (responses * np.roll(shape, m))[observed]
        square = got.squares(waves, responses)[0, 0] - every[0, m]
        np.testing.assert_allclose(square, burst @ np.linalg.solve(own, burst), atol=1e-9)


def test_bursts_are_found_beside_missing_samples():
    """One of the four is in the gap, and none is claimed there."""
    cells = np.arange(N)
    problem = scanned().restricted_to((cells > 3) & ((cells < 190) | (cells > 205)))
    estimate = BurstInversion(method=Wiener())(problem)
    assert isinstance(estimate, BurstEstimate)
    bursts, left = estimate.bursts, TRUTH.time_s[:3]
    assert len(bursts) == len(left)
    assert np.abs((bursts.time.value - left) / bursts.time.stderr).max() < 3.5
    assert np.abs((bursts.place.value - TRUTH.place_m[:3]) / bursts.place.stderr).max() < 3.5
    assert estimate.parameters["burst_2_place_m"][0] == bursts.place.value[1]
    assert estimate.intervals["burst_rate_hz"] == bursts.rate_hz[2:]
    assert 0.8 < float(estimate.chi2_per_freedom or 0.0) < 1.2


def recorded(speed=0.02, missing=slice(0, 0)):
    """Signals of an open line with more beyond the scan, four samples a cell, and their bursts."""
    sensor, scan, cell, margin = Sensor(in_a_row(Film(), 4, 1e-3)), ConstantSpeed(speed), 2e-5, 400
    line = Open(4 * N + 2 * margin, cell, -(2 * N + margin) * cell)
    scenario = srsinv.Scenario(SCENE, sensor, scan, noises=(White(RMS_V),))
    inside = slice(margin, margin + 4 * N)
    signal = np.asarray(srsinv.simulate(scenario, line, friction=0.5).signal)[:, inside]
    signal = signal + burst_signals(TRUTH, PATCH_M, sensor, Open(4 * N, cell, 0.0), scan)
    signal = signal + np.random.default_rng(0).normal(0, 2 * RMS_V, signal.shape)
    along = slice(None, None, int(np.sign(speed)))
    x, signal = np.asarray(line.x)[inside][along], signal[:, along].copy()
    signal[:, missing] = np.nan
    motion = Motion(np.arange(4 * N) * cell / abs(speed), x, np.full(4 * N, speed))
    return Problem(sensor, motion, signal, 2 * RMS_V, friction=0.5, cell_m=4 * cell)


@pytest.mark.full
@pytest.mark.parametrize("speed", [pytest.param(0.02, marks=pytest.mark.claim), -0.02])
def test_bursts_are_found_in_a_recording(speed):
    estimate = BurstInversion(method=Wiener())(recorded(speed, slice(500, 530)))
    assert isinstance(estimate, BurstEstimate)
    bursts = estimate.bursts
    true = {"time": TRUTH.time_s, "place": TRUTH.place_m, "size": TRUTH.size_Pa, "decay": 5e-3}
    assert len(bursts) == len(TRUTH.time_s)
    for name, values in true.items():
        got = getattr(bursts, name)
        assert np.abs((got.value - values) / got.stderr).max() < 3.5, name


def with_films_at(angles_rad, scene, friction):
    """A pass of films at these angles without bursts, inverted under another friction."""
    films = [Film(angle_rad=each, offset_m=1e-3 * i) for i, each in enumerate(angles_rad)]
    scenario = srsinv.Scenario(scene, Sensor(films), ConstantSpeed(0.02), noises=(White(RMS_V),))
    made = srsinv.simulate(scenario, LINE, friction=friction)
    signal = np.asarray(made.signal - made.problem.mean_signal)
    noise = np.random.default_rng(0).normal(0, RMS_V, signal.shape)
    return with_fields(made.problem, data=jnp.asarray(signal + noise))


@pytest.mark.full
def test_no_burst_is_claimed_where_the_friction_is_wrong():
    loud = srsinv.TractionScene(0.0, 0.4, [srsinv.UniformStrip(2e5, 3e-3)])
    problem = with_films_at([0.0, np.pi / 2, 0.0, np.pi / 2], loud, friction=0.0)
    estimate = BurstInversion()(problem)
    assert isinstance(estimate, BurstEstimate)
    assert len(estimate.bursts) == 0
    assert np.isnan(estimate.bursts.rate_hz).all()
    assert any("friction" in each for each in estimate.warnings)


def test_decays_out_of_the_range_are_warned_of():
    estimate = BurstInversion(decay_s=(0.5e-3, 2e-3), method=Wiener())(scanned())
    assert any("decay_s" in each for each in estimate.warnings)
    assert not any("decay_s" in each for each in found().warnings)


def test_job_reports_each_burst_with_its_interval():
    problem = scanned()
    assert problem.sensor is not None
    methods = {"Bursts": lambda each: found()}
    data = run(InversionCase(problem, problem.sensor, methods, {}, name="a pass")).dataset
    own, bursts = data.sel(estimator="Bursts"), found().bursts
    for j, place in enumerate(bursts.place.low):
        assert float(own["found_low"].sel(found=f"burst_{j + 1}_place_m")) == place
    assert float(own["found_high"].sel(found="burst_rate_hz")) == bursts.rate_hz[3]


def test_job_refuses_bursts_of_a_recording_that_lacks_what_stands_out():
    facts = {"feedback_resistance_ohm": 1e6}
    recording = Recording(np.zeros((1, 3)), np.arange(3.0), np.ones(3), ("a",), {"sensor": facts})
    check_invertible(recording, "Pa", [Wiener()])
    refused(lambda: check_invertible(recording, "Pa", [BurstInversion()]), "unusable=keep")


def at_varying_speed():
    """A pass whose cells have the noise of a speed that rises by a half."""
    scale = np.broadcast_to(np.linspace(0.9, 1.1, N), (4, N))
    return with_fields(scanned(), noise_scale=jnp.asarray(scale))


def of_two_passes():
    time_s = np.arange(2 * N) * 4e-3
    speed = np.where(time_s < time_s[N], 0.02, -0.02)
    signal = np.random.default_rng(0).normal(0, RMS_V, (4, speed.size))
    sensor = Sensor(in_a_row(Film(), 4, 1e-3))
    return Problem(sensor, Motion.from_speed(time_s, speed), signal, RMS_V, friction=0.5)


def problem_and_model():
    problem = scanned()
    model = BurstModel(problem, 5e-4, 1e-2, (1e-3, 20e-3))
    prior = Wiener().prior_fixed_on(problem)(problem)
    noise = np.broadcast_to(RMS_V**2 * np.eye(4), (N // 2 + 1, 4, 4))
    return problem, model, Everything.of(problem, prior, noise, 1.0)


def test_signals_of_a_burst_are_the_sum_in_time():
    """Of a burst whose first sample has exp(-age/decay) of it, by its spectrum."""
    _, model, _ = problem_and_model()
    interval = CELL_M / 0.02
    one = TrueBursts(
        np.array([50.4 * interval]), np.array([1.3e-3]), np.array([1e3]), np.full(1, 5e-3)
    )
    sensor = Sensor(in_a_row(Film(), 4, 1e-3))
    expected = burst_signals(one, PATCH_M, sensor, LINE, ConstantSpeed(0.02))
    burst = Burst(51, 1.3e-3, 5e-3, 1e3 * np.exp(-0.6 * interval / 5e-3), 0.0)
    got = np.fft.irfft(burst.spectrum(model), N)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_everything_else_has_the_covariance_of_traction_and_noise():
    problem, _, rest = problem_and_model()
    prior = Wiener().spectra(problem)
    transfer = np.asarray(problem.forward.transfer)[:, 0]
    at = 7
    total = np.asarray(prior)[0, at] * np.outer(transfer[:, at], transfer[:, at].conj())
    total = total + RMS_V**2 * np.eye(4)
    np.testing.assert_allclose(rest.inverse[at] @ total, np.eye(4), rtol=0, atol=1e-6)


def test_rate_counts_bursts_that_are_loud():
    """Of many loud bursts the rate is their number over the time, with Poisson's error."""
    _, model, rest = problem_and_model()
    burst = Burst(51, 1.3e-3, 5e-3, 4e4, 0.0)
    one = OneBurst(model, rest, first_sizes(model, rest), burst.spectrum(model))
    rate = burst_rate(model, rest, rest, [one.around(51)] * 12)
    np.testing.assert_allclose(rate.value_hz * SECONDS, 12.5, rtol=0.15)
    expected = stats.gamma.ppf([0.05, 0.95], 12.5)
    np.testing.assert_allclose(np.array([rate.low_hz, rate.high_hz]) * SECONDS, expected, rtol=0.2)


def test_rate_has_bursts_that_are_too_small_to_be_found():
    """Where those found are faint, more of them are above a d' of 5 than were found."""
    _, model, rest = problem_and_model()
    unit = Burst(51, 1.3e-3, 5e-3, 1.0, 0.0)
    square = rest.dot(unit.spectrum(model)[None], rest.weigh(unit.spectrum(model))[None])[0, 0]
    faint = unit._replace(amplitude_Pa=8 / np.sqrt(square))
    one = OneBurst(model, rest, first_sizes(model, rest), faint.spectrum(model))
    rate = burst_rate(model, rest, rest, [one.around(51)] * 12)
    assert rate.low_hz * SECONDS > 10
    assert rate.value_hz * SECONDS > 18


def traced(data):
    return BurstInversion()(with_fields(scanned(), data=data)).value


WRONG = {
    "patch": (lambda: BurstInversion(patch_m=0.0), "method.bursts.patch_m"),
    "contact": (lambda: BurstInversion(contact_m=-1.0), "method.bursts.contact_m"),
    "decays": (lambda: BurstInversion(decay_s=(2e-3, 1e-3)), "method.bursts.decay_s"),
    "short": (lambda: BurstInversion(decay_s=(1e-6, 1e-5))(scanned()), "method.bursts.decay_s"),
    "decay": (lambda: BurstInversion(decay_s=3.0), "method.bursts.decay_s"),
    "method": (lambda: BurstInversion(method=3), "method.bursts.method"),
    "speed": (lambda: BurstInversion()(at_varying_speed()), "constant speed"),
    "still": (
        lambda: BurstInversion()(with_fields(scanned(), scan=ConstantSpeed(0.0))), "slides"
    ),
    "no_sensor": (lambda: BurstInversion()(scanned().to_grid()), "sensor"),
    "traced": (lambda: jax.grad(lambda f: traced(f * scanned().data).sum())(1.0), "jax.jit"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_refusals(name):
    refused(*WRONG[name])


@pytest.mark.full
def test_several_passes_are_refused():
    refused(lambda: BurstInversion()(of_two_passes()), "single pass")


@pytest.mark.claim
def test_stated_bursts_are_no_noise_of_the_elements():
    """A simulation that states bursts as noise is searched for them under the noise without."""
    sensor, scan = Sensor(in_a_row(Film(), 4, 1e-3)), ConstantSpeed(0.02)
    bursts = SnapBackNoise.recorded_by(sensor, 3.0, 2000.0, 5e-4, 5e-3, 1e-2)
    scenario = srsinv.Scenario(SCENE, sensor, scan, noises=(White(RMS_V), bursts))
    simulated = srsinv.simulate(scenario, LINE, friction=0.5, seed=3).problem
    assert isinstance(simulated, LineProblem)
    estimate = BurstInversion()(simulated)
    assert isinstance(estimate, BurstEstimate)
    assert len(estimate.bursts) > 0
    assert 0.8 < float(estimate.chi2_per_freedom or 0.0) < 1.2
