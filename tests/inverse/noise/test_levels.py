"""Noise whose level varies along the line, and the recordings that have it: of cells that hold more
samples or fewer, and were passed quicker or more slowly."""

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.film import Film
from srsinv.forward.noise import Sliding
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open
from srsinv.inverse.gridding.gathered import gathered
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.problem import Problem
from srsinv.inverse.tikhonov import Tikhonov
from tests.inverse.cases import (
    DEPTH_M,
    SLOW,
    N,
    gaps,
    make_case,
    minimiser,
    penalty_rows,
    relative,
    signals_along,
)

WEIGHTS = 3e-8, 2e-8
SPEED_M_PER_S = 0.05


def scale(n=N, kind="smooth"):
    """Factors on the noise (2, n)."""
    if kind == "smooth":
        return np.exp(0.35 * np.sin(2 * np.pi * np.arange(n) / n + np.array([[0.0], [0.5]])))
    return np.random.default_rng(3).choice([0.7, 1.0, 1.5], (2, n))


OFFSET = {"amplifier": SLOW, "free_offset": True}


@pytest.mark.full
@pytest.mark.parametrize(
    ("case", "kind", "path"),
    [
        ({"colour": True}, "smooth", "direct"), ({"colour": True}, "rough", "iterative"),
        (OFFSET, "rough", "direct"), (OFFSET, "smooth", "iterative"),
        (OFFSET | {"colour": True}, "smooth", "direct"),
        (OFFSET | {"colour": True}, "rough", "iterative"),
    ],
)  # fmt: skip
def test_the_estimate_is_that_of_dense_matrices(case, kind, path):
    problem = make_case("open", observed=gaps(), noise_scale=scale(kind=kind), **case).problem
    weights = 2e-5, 8e-5
    estimate = Tikhonov(1, *weights, path=path)(problem)
    dense = minimiser(problem)(penalty_rows(problem, 1, weights))
    assert estimate.status == "converged"
    assert relative(estimate.value, dense.value) < 1e-6
    whitened = np.asarray(estimate.whitened)
    assert np.array_equal(np.isfinite(whitened), gaps())
    if "colour" not in case:
        assert np.nansum(whitened**2) == pytest.approx(dense.residual, rel=1e-6)


@pytest.mark.full
def test_a_factor_that_is_the_same_everywhere_is_louder_noise():
    case = make_case("open", observed=gaps()).problem
    given = {"data": case.data, "observed": case.observed}
    twice = LineProblem(case.line, case.forward, noise=4 * case.noise, **given)
    same = np.full((2, N), 2.0)
    scaled = LineProblem(case.line, case.forward, noise=case.noise, noise_scale=same, **given)
    for path in ("direct", "iterative"):
        one, other = (Tikhonov(1, 2e-5, 8e-5, path=path)(each) for each in (twice, scaled))
        assert relative(one.value, other.value) < 1e-8
        assert relative(one.stderr, other.stderr) < 1e-8


def test_factors_of_gathered_cells_are_the_rms_of_theirs():
    case = make_case("open").problem
    given = Sensor((Film(DEPTH_M), Film(DEPTH_M, np.pi / 2))), ConstantSpeed(SPEED_M_PER_S)
    problem = LineProblem.of_sensor(
        case.line, *given, case.data, case.noise, noise_scale=scale(kind="rough")
    )
    squares = scale(kind="rough") ** 2
    wide = np.asarray(gathered(problem, 2).noise_scale) ** 2
    np.testing.assert_allclose(wide, (squares[:, ::2] + squares[:, 1::2]) / 2)


@pytest.mark.parametrize("wrong", [np.ones((2, N - 1)), np.zeros((2, N)), np.full((2, N), np.nan)])
def test_factors_that_are_none_are_refused(wrong):
    with pytest.raises(BadInput, match="give a positive factor on the noise"):
        make_case("open", noise_scale=wrong)


def speed_of(times, kind):
    if kind == "constant":
        return np.full(times.shape, SPEED_M_PER_S)
    turns = 2 * np.pi * times / times[-1]
    return SPEED_M_PER_S * (1 + 0.3 * np.sin(1.5 * turns))


def scan(kind, missing="", noise=0.02, sliding=0.0, seed=0):
    """Sensor, motion, signal (2, sample) and noise of bumps of p and q scanned at 2.3 samples in a
    sixteenth of the depth; 3 % of the samples are missing, at random or in runs of up to three
    depths."""
    rng = np.random.default_rng(seed)
    step = DEPTH_M / 16 / 2.3
    time_s = np.arange(int(160 * DEPTH_M / 16 / step)) * step / SPEED_M_PER_S
    motion = Motion.from_speed(time_s, speed_of(time_s, kind), 0.0)
    x, sensor = np.asarray(motion.position_m), Sensor((Film(DEPTH_M), Film(DEPTH_M, np.pi / 2)))
    cell = DEPTH_M / 48
    line = Open(int((np.ptp(x) + 24 * DEPTH_M) / cell), cell, x.min() - 12 * DEPTH_M)
    clean = signals_along(sensor, line, motion, bumps(line, x.max()))
    rms, level = float(np.sqrt(np.mean(clean**2))), noise * float(clean.std())
    signal = clean + level * rng.normal(size=clean.shape)
    causes = {"sliding": Sliding(sliding, 1e-3)} if sliding else {}
    if sliding:
        decay = np.exp(-np.abs(np.diff(x)) / 1e-3)
        slow = rng.normal(size=clean.shape)
        for i, each in enumerate(decay, 1):
            slow[:, i] = each * slow[:, i - 1] + np.sqrt(1 - each**2) * slow[:, i]
        signal = signal + sliding * rms * slow
    if missing == "scattered":
        signal[rng.random(signal.shape) < 0.03] = np.nan
    while missing == "runs" and np.isnan(signal[0]).mean() < 0.03:
        first = rng.integers(time_s.size)
        signal[:, first : first + int(rng.uniform(0.25, 3) * DEPTH_M / step)] = np.nan
    return sensor, motion, signal, SampleNoise(level, causes)


def bumps(line, end_m):
    """p and q of a bump every ten depths."""
    rng, x = np.random.default_rng(100), np.asarray(line.x)
    rows = np.zeros((2, line.n))
    for row in rows:
        for middle in rng.uniform(0, end_m, max(3, int(end_m / (10 * DEPTH_M)))):
            row += 5e3 * rng.normal() * np.exp(-(((x - middle) / DEPTH_M) ** 2))
    return rows


@pytest.mark.full
@pytest.mark.parametrize(("missing", "sliding"), [("scattered", 0.0), ("runs", 0.03)])
def test_a_recording_by_the_iterative_path_is_the_dense_solution(missing, sliding):
    """At a varying speed, in every cell, gaps and ends included."""
    problem = Problem(*scan("varying", missing, sliding=sliding)).to_grid()
    assert problem.noise_scale is not None
    direct, ours = (Tikhonov(1, *WEIGHTS, path=path)(problem) for path in ("direct", "iterative"))
    assert ours.status == "converged"
    assert relative(ours.value, direct.value) < 1e-6
    np.testing.assert_allclose(ours.stderr, direct.stderr, rtol=0.03)  # as the README has it


@pytest.mark.full
def test_white_noise_in_a_cell_is_that_of_its_samples():
    """A rate signal is as large as the speed, and a cell has samples in inverse proportion to it:
    the noise's variance at the mean speed is as the mean speed over the speed."""
    sensor, motion, signal, noise = scan("varying")
    problem = Problem(sensor, motion, signal, noise).to_grid()
    x, speed = np.asarray(motion.position_m), np.asarray(motion.speed_m_per_s)
    at = np.interp(np.asarray(problem.line.x), x, speed)[problem.observed_cells][2:-2]
    variance = np.asarray(problem.noise_scale)[0, problem.observed_cells][2:-2] ** 2 * at
    np.testing.assert_allclose(variance, variance.mean(), rtol=0.03)


@pytest.mark.full
def test_a_cell_with_half_of_its_samples_has_twice_the_variance():
    sensor, motion, signal, noise = scan("constant")
    signal[0, 101] = np.nan
    problem = Problem(sensor, motion, signal, noise).to_grid()
    squares = np.asarray(problem.noise_scale) ** 2
    assert squares[0].max() == pytest.approx(2.0, rel=1e-6)
    assert squares[1].max() == pytest.approx(1.0, rel=1e-6)
    assert problem.is_observed[:, problem.observed_cells].all()
