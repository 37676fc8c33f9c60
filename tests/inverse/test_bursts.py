"""Bursts of catch and snap beside a traction: found, located and counted, with their errors."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import srsinv
from experiments.elements.passes import TrueBursts, burst_signals, in_a_row
from srsinv import BurstEstimate, BurstInversion, ConstantSpeed, Film, Periodic, Sensor, Wiener
from srsinv.forward.noise import White
from srsinv.forward.snap_back import SnapBackNoise
from srsinv.inverse.bursts.model import BurstModel, Everything
from srsinv.inverse.bursts.posterior import Burst, OneBurst
from srsinv.inverse.bursts.rate import burst_rate, first_sizes
from srsinv.inverse.line.problem import LineProblem
from srsinv.modules import with_fields
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
    "decay": (lambda: BurstInversion(decay_s=3.0), "method.bursts.decay_s"),
    "method": (lambda: BurstInversion(method=3), "method.bursts.method"),
    "gaps": (lambda: BurstInversion()(scanned().restricted_to(np.arange(N) > 3)), "missing"),
    "still": (
        lambda: BurstInversion()(with_fields(scanned(), scan=ConstantSpeed(0.0))), "slides"
    ),
    "no_sensor": (lambda: BurstInversion()(scanned().to_grid()), "sensor"),
    "traced": (lambda: jax.grad(lambda f: traced(f * scanned().data).sum())(1.0), "jax.jit"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_refusals(name):
    refused(*WRONG[name])


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
