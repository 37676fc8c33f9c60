"""A motion that turns: its passes parted, aligned and averaged, and both ways inverted together."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.feature import LineFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open
from srsinv.inverse.features import FeatureFit
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.gridding.directions import pressure_by_direction
from srsinv.inverse.gridding.pass_statistics import PassesOnCells, PassOnCells
from srsinv.inverse.line.rule import Evidence
from srsinv.inverse.line.solve import solve
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.problem import Problem
from srsinv.inverse.tikhonov import DerivativePenalty, Tikhonov
from srsinv.modules import with_fields
from srsinv.recording.mains import mains_lines
from srsinv.recording.passes import passes_of, with_backlash
from tests.inverse.cases import signals_along
from tests.refusals import refused

RATE_HZ, SPEED, DEPTH, LENGTH = 1000.0, 0.02, 1.2e-3, 0.02
CELL = 2e-4
LINE = Open(2048, 0.04 / 2048, -0.02)
X = np.asarray(LINE.x)
P = 6e3 * np.exp(-((X / 1.2e-3) ** 2)) + 3e3 * np.exp(-(((X - 5e-3) / 8e-4) ** 2))
Q = 0.35 * P * (1 + 0.3 * np.tanh(X / 2e-3))


def motion(passes, ramp_s=0.1):
    """There and back so often, turning within `ramp_s`."""
    steady = np.full(int(LENGTH / SPEED * RATE_HZ), SPEED)
    turn = -SPEED * np.sin(np.linspace(-np.pi / 2, np.pi / 2, int(ramp_s * RATE_HZ)))
    parts = [(-1) ** i * part for i in range(passes) for part in (steady, turn)][:-1]
    speed = np.concatenate(parts)
    return Motion.from_speed(np.arange(speed.size) / RATE_HZ, speed, -LENGTH / 2)


def sensor(angles=(0.0, np.pi / 4)):
    films = [Film(DEPTH, angle).with_strip_average() for angle in angles]
    return Sensor(films, HalfSpace(0.5, 7e5), CurrentAmplifier(1e8))


def signals(moved, sensed, back=1.0, ahead_m=0.0):
    """The signals, the traction times `back` on the way back, the stage `ahead_m` of where it is
    said to be."""
    true = Motion(moved.time_s, np.asarray(moved.position_m) - ahead_m, moved.speed_m_per_s)
    traction = np.stack([np.stack([P, Q]), back * np.stack([P, -Q])])
    return signals_along(sensed, LINE, true, traction, moved.directions)


def fixed(problem):
    """The posterior under a prior that resolves what the signal has."""
    line = problem.to_grid()
    return solve(line, DerivativePenalty(jnp.array([3e-8, 1e-7]), jnp.array(DEPTH), 1), "direct")


def error(estimate, component=0):
    """Relative, of the deviation from the mean along the scan; and by how much bands cover."""
    x = np.asarray(estimate.line.x)
    cells = np.abs(x) < LENGTH / 2 - DEPTH
    truth = np.interp(x, X, (P, Q)[component])[cells]
    off = np.asarray(estimate.value)[component, cells] - truth
    off, truth = off - off.mean(), truth - truth.mean()
    inside = np.abs(off) < 1.645 * np.asarray(estimate.stderr)[component, cells]
    return np.linalg.norm(off) / np.linalg.norm(truth), np.mean(inside)


def noisy(clean, seed, level=0.01):
    rms = level * np.abs(clean).max()
    return clean + rms * np.random.default_rng(seed).normal(size=clean.shape), rms


def test_passes_are_parted_where_the_motion_turns():
    moved = motion(5)
    passes = passes_of(np.asarray(moved.position_m))
    assert [each.is_onwards for each in passes] == [True, False, True, False, True]
    x = np.asarray(moved.position_m)
    for each in passes:
        assert np.ptp(x[each.samples]) > 0.95 * np.ptp(x)
    # A standstill parts nothing, and a short way back at the end is no pass.
    speed = np.concatenate([np.full(300, SPEED), np.zeros(50), np.full(300, SPEED),
                            np.full(20, -SPEED)])  # fmt: skip
    moved = Motion.from_speed(np.arange(speed.size) / RATE_HZ, speed)
    (only,) = passes_of(np.asarray(moved.position_m))
    assert only.is_onwards
    assert only.samples.start == 0
    assert only.samples.stop >= 650


@pytest.mark.full
def test_one_element_both_ways_tells_p_from_q():
    moved, sensed = motion(2), sensor((0.0,))
    signal, rms = noisy(signals(moved, sensed), 1)
    estimate = Tikhonov(rule=Evidence())(Problem(sensed, moved, signal, rms, cell_m=CELL))
    assert estimate.quality == "good"
    (p, covered), (q, q_covered) = error(estimate), error(estimate, 1)
    assert p < 0.1
    assert q < 0.4
    assert min(covered, q_covered) > 0.8
    # One way alone it does not.
    one = Problem(sensed, moved, signal, rms, cell_m=CELL).of_direction(True)
    refused(one.to_grid, "friction")


@pytest.mark.full
def test_averaged_passes_are_the_posterior_of_all_of_them():
    """The mean over passes with the noise of one over the root of their number: the dense posterior
    of one pass each way at that noise, whatever the draw."""
    many, one, sensed = motion(6), motion(2), sensor()
    rms = noisy(signals(one, sensed), 0)[1]
    of_many = Problem(sensed, many, np.zeros((2, many.time_s.size)), rms, cell_m=CELL)
    fewer = np.zeros((2, one.time_s.size))
    of_one = Problem(sensed, one, fewer, rms / np.sqrt(3), cell_m=CELL)
    ours, floor = (np.asarray(fixed(each).stderr) for each in (of_many, of_one))
    x, other = (np.asarray(each.to_grid().line.x) for each in (of_many, of_one))
    middle = np.abs(x) < LENGTH / 4
    floor = np.stack([np.interp(x, other, row) for row in floor])
    np.testing.assert_allclose(ours[:, middle], floor[:, middle], rtol=0.02)


@pytest.mark.full
def test_shifts_of_the_stage_are_found_and_taken_out():
    moved, sensed = motion(6), sensor()
    ahead = np.array([20e-6, -30e-6, 15e-6, 45e-6, -35e-6, -15e-6])
    along = np.zeros(moved.time_s.size)
    for each, own in zip(passes_of(np.asarray(moved.position_m)), ahead, strict=True):
        along[each.samples] = own
    signal, rms = noisy(signals(moved, sensed, ahead_m=along), 2)
    problem = Problem(sensed, moved, signal, rms, cell_m=CELL)
    found = problem.to_grid().passes
    assert (found.onwards, found.back) == (3, 3)
    np.testing.assert_allclose(found.shifts_m, ahead, atol=5 * found.shift_stderr_m)
    assert found.scatter == pytest.approx(1.0, abs=0.1)
    size, covered = error(fixed(problem))
    assert size < 0.1
    assert covered > 0.8
    quiet = Problem(sensed, moved, noisy(signals(moved, sensed), 2)[0], rms, cell_m=CELL)
    assert not quiet.to_grid().passes.shifts_m.any()


def over_a_line_load():
    """A line load on six passes whose stage is up to 60 um off, which noise does not make."""
    moved, sensed = motion(6), sensor()
    ahead, every = np.zeros(moved.time_s.size), passes_of(np.asarray(moved.position_m))
    for each, own in zip(every, (0, 1, 6, -2, -5, 3), strict=True):
        ahead[each.samples] = own * 1e-5
    true = Motion(moved.time_s, np.asarray(moved.position_m) - ahead, moved.speed_m_per_s)
    load = {"position_m": 1e-3, "load_N_per_m": 8.0, "shear_N_per_m": 2.4}
    model = FeatureModel.along(sensed, true).with_features({"line": LineFeature()})
    signal, rms = noisy(np.asarray(model({"line": load})), 3)
    return Problem(sensed, moved, signal, rms)


@pytest.mark.full
def test_a_fit_takes_shifts_of_the_stage_out():
    reported = {"position_m": 1e-3, "load_N_per_m": 8.0, "friction": 0.3}
    fitted = FeatureFit({"line": LineFeature()})(over_a_line_load())
    assert fitted.quality == "good"
    for name, expected in reported.items():
        value, stderr = fitted.parameters[name]
        # The ways' mean places are 3 and 7 um off, which is in the standard errors.
        assert abs(value - expected) < 4 * stderr


@pytest.mark.claim
def test_a_fit_of_passes_as_they_are_said_to_be_fails(monkeypatch):
    monkeypatch.setattr(Problem, "aligned", lambda self: self)
    assert FeatureFit({"line": LineFeature()})(over_a_line_load()).quality != "good"


@pytest.mark.full
def test_a_fit_has_the_samples_of_its_own_way():
    moved, sensed = motion(2), sensor()
    given = Problem(sensed, moved, signals(moved, sensed), 1e-6)
    samples = given.of_direction(True).samples().signal
    onwards, back = (each.samples for each in passes_of(np.asarray(moved.position_m)))
    assert np.isfinite(samples[:, onwards]).all()
    assert np.isnan(samples[:, back]).all()


@pytest.mark.full
def test_what_passes_differ_by_is_said():
    moved, sensed = motion(6), sensor()
    signal, rms = noisy(signals(moved, sensed), 3)
    signal = signal + 0.3 * np.std(signal) * np.sin(3 * np.asarray(moved.time_s))
    line = Problem(sensed, moved, signal, rms, cell_m=CELL).to_grid()
    assert line.passes.scatter > 1.5
    assert any(each.startswith("Passes of one direction differ") for each in line.warnings)


@pytest.mark.parametrize("spread", [0.0, 0.03, 0.1])
def test_means_of_passes_have_gains_within_their_bands(spread):
    """Gains that both elements have in common, of two directions with three passes each and noise
    that makes 1 % of a gain: 90 % bands of the mean's gain, over 400 draws (three standard
    deviations of a binomial, 4 %; wider at no spread, where a variance cannot be below zero)."""
    rng, x = np.random.default_rng(7), np.linspace(-4, 4, 60)
    clean = np.stack([x * np.exp(-(x**2)), np.exp(-(x**2)) * (1 - 2 * x**2)])
    rms = 0.01 * np.sqrt(np.sum(clean**2, axis=1, keepdims=True))
    information, none = np.ones(clean.shape), np.zeros((2, 0, 60))
    inside, squares = [], []
    for _ in range(400):
        gains = 1 + spread * rng.normal(size=(6, 1, 1))
        every = [
            PassOnCells(g * clean + rms * rng.normal(size=clean.shape), none, information,
                        information, 1.0)
            for g in gains
        ]  # fmt: skip
        passes = PassesOnCells(every, [0, 1] * 3, rms**2, np.zeros((2, 1)), 1.0)
        off = np.stack([np.mean(gains[direction::2]) - 1 for direction in (0, 1)])
        noise = 0.01 / np.sqrt(3) * rng.normal(size=(2, 2))
        variance = np.sum(passes.gains.of_means**2, axis=-1) + 0.01**2 / 3
        inside.append(np.abs(off[:, None] + noise) < 1.645 * np.sqrt(variance))
        squares.append(passes.gains.covariance)
        assert passes.less_gains().scatter()[0] < 1.3
    assert 0.86 < np.mean(inside) < (0.97 if spread < 0.02 else 0.94)
    np.testing.assert_allclose(np.mean(squares, axis=0), spread**2, atol=0.2 * spread**2 + 1e-4)


def test_passes_that_end_elsewhere_leave_no_step_where_they_drift():
    """Of a walk each pass is at a level of its own: where the last of them begins or ends, the
    mean over fewer of them goes on as it was."""
    moved, sensed = motion(6), sensor()
    rng, level, rms = np.random.default_rng(11), np.zeros(moved.time_s.size), 1e-6
    observed = np.ones(moved.time_s.size, bool)
    x = np.asarray(moved.position_m)
    for j, each in enumerate(passes_of(x)):
        level[each.samples] = 300 * rms * rng.normal()
        observed[each.samples] = np.abs(x[each.samples]) < LENGTH / 2 - j * 4e-4
    noise = rms * rng.normal(size=(2, x.size))
    signal = np.where(observed, level + noise, np.nan)
    walks = SampleNoise(rms, drift=300 * rms)
    line = Problem(sensed, moved, signal, walks, cell_m=CELL).to_grid()
    for row, seen in zip(np.asarray(line.data), np.asarray(line.is_observed), strict=True):
        assert np.max(np.abs(np.diff(row[seen]))) < 10 * rms


@pytest.mark.full
def test_hum_on_passes():
    """Of ten times the signal: the error is that without hum, within a tenth, under the same
    prior."""
    moved, sensed = motion(6), sensor()
    clean = signals(moved, sensed)
    signal, rms = noisy(clean, 4)
    waves = np.sin(2 * np.pi * 50.1 * np.asarray(moved.time_s) + np.array([[0.3], [1.0]]))
    loud = signal + 10 * np.std(clean) * np.sqrt(2) * waves
    lines = mains_lines(loud, RATE_HZ)
    quiet = fixed(Problem(sensed, moved, signal, rms, cell_m=CELL))
    hummed = fixed(Problem(sensed, moved, loud, rms, cell_m=CELL, mains=lines))
    assert error(hummed)[0] < 1.1 * error(quiet)[0]
    assert error(hummed)[1] > 0.8


@pytest.mark.full
def test_a_pressure_that_changes_with_the_direction_is_said():
    moved, sensed = motion(4), sensor()
    same, rms = noisy(signals(moved, sensed), 5)
    other = noisy(signals(moved, sensed, back=1.15), 5)[0]
    problems = [Problem(sensed, moved, each, rms, cell_m=CELL) for each in (same, other)]
    assert pressure_by_direction(fixed, problems[0], fixed(problems[0])) == ()
    (said,) = pressure_by_direction(fixed, problems[1], fixed(problems[1]))
    assert "recording.ways=onwards" in said
    # The estimate of each way goes with the pressure of that way alone, whatever its prior pulls.
    for is_onwards, factor in ((True, 1.0), (False, 1.15)):
        before, after = (np.ptp(fixed(each.of_direction(is_onwards)).value[0]) for each in problems)
        assert after / before == pytest.approx(factor, abs=0.02)


@pytest.mark.full
def test_backlash_is_measured_and_taken_out_by_what_is_said():
    """A stage that is 80 um further on on the way back than it says: what the warning gives makes
    the answer that of a stage without backlash."""
    moved, sensed = motion(2), sensor()
    off = np.zeros(moved.time_s.size)
    off[passes_of(np.asarray(moved.position_m))[1].samples] = 80e-6
    signal, rms = noisy(signals(moved, sensed, ahead_m=-off), 7, 0.003)
    given = Problem(sensed, moved, signal, rms, cell_m=CELL)
    (said,) = pressure_by_direction(fixed, given, fixed(given))
    value = float(re.search(r"recording.backlash_m=([-+.e\d]+)", said)[1])
    stderr = float(re.search(r"± ([-+.e\d]+) m", said)[1])
    assert abs(value - 80e-6) < 4 * stderr
    assert stderr < 5e-6
    position = with_backlash(np.asarray(moved.position_m), value)
    mended = with_fields(given, motion=Motion(moved.time_s, position, moved.speed_m_per_s))
    assert pressure_by_direction(fixed, mended, fixed(mended)) == ()
    clean = noisy(signals(moved, sensed), 7, 0.003)[0]
    without = Problem(sensed, moved, clean, rms, cell_m=CELL)
    assert error(fixed(mended))[0] < 1.1 * error(fixed(without))[0]


def test_a_way_that_is_not_there_is_refused():
    moved, sensed = motion(1), sensor()
    problem = Problem(sensed, moved, np.zeros((2, moved.time_s.size)), 1.0, cell_m=CELL)
    refused(problem.of_direction(False).to_grid, "recording.ways=both")
