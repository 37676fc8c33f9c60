"""A calibration's errors carried into the bands of inversions: closed forms, and rigs drawn."""

import numpy as np
import pytest

from srsinv.forward.feature import StripFeature
from srsinv.forward.film import Film, Offset
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Open
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.line.rig_bands import MOST_DIRECTIONS, solved_directions
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.error import STATED, RigError
from srsinv.inverse.rig.setup import Setup
from srsinv.inverse.wiener import Exponential, Wiener
from tests.claims.rig_bands import drawn
from tests.inverse.cases import signals_along

NOISE_V, DEPTH_M, FRICTION, CELL_M = 3e-8, 7.5e-4, 0.4, 2e-4
LINE = Open(2000, 1e-5, -1e-2)
SCAN = Motion.from_speed(np.arange(240) / 1000, np.full(240, 0.05), -6e-3)
TURN = np.clip((1 - np.arange(480) / 240) / 0.1, -1, 1)
THERE_AND_BACK = Motion.from_speed(np.arange(480) / 1000, 0.05 * TURN, -6e-3)
WIENER = Wiener(Exponential(4e3, 1e-3), Exponential(2e3, 1e-3))
STRIP = np.asarray(UniformStrip(4e3, 3e-3, 4e-4).cell_average(LINE))


def sensor(depth_m=DEPTH_M, angle_deg=90.0, offset_m=0.0, count=2) -> Sensor:
    second = Film(depth_m, np.deg2rad(angle_deg)).with_effect(Offset(offset_m))
    return Sensor([Film(depth_m), second][:count])


def signal(made: Sensor, motion=SCAN, p=STRIP) -> np.ndarray:
    directions = [np.stack([p, sign * FRICTION * p]) for sign in (1, -1)]
    traction = np.stack(directions) if len(motion.directions) > 1 else directions[0]
    return signals_along(made, LINE, motion, traction)


def problem(y, rig=None, motion=SCAN, friction=None, count=2) -> Problem:
    own = sensor(count=count)
    return Problem(own, motion, y, NOISE_V, rig=rig, friction=friction, cell_m=CELL_M)


def common_gain(stderr: float) -> RigError:
    """Both gains wrong by the same."""
    return RigError(("gain_1", "gain_2"), np.ones(2), stderr**2 * np.ones((2, 2)))


@pytest.mark.full
def test_a_gain_adds_its_error_times_the_traction():
    """s |x| where the signal resolves it, x less its mean over the scan; what it adds is the
    estimate from the fitted signal."""
    y = signal(sensor())
    exact, carried = WIENER(problem(y)), WIENER(problem(y, common_gain(0.03)))
    np.testing.assert_array_equal(carried.value, exact.value)
    added = np.sqrt(np.asarray(carried.stderr) ** 2 - np.asarray(exact.stderr) ** 2)
    again = problem(y, common_gain(0.03)).to_grid()
    cells = again.observed_cells
    again = WIENER(type(again).of_sensor(
        again.line, again.sensor, again.scan, exact.fitted, again.noise, observed=again.observed,
        noise_scale=again.noise_scale, known_mean_Pa=again.known_mean_Pa,
    ))  # fmt: skip
    expected = 0.03 * np.abs(again.deviation(cells)[0][0])
    np.testing.assert_allclose(added[0], expected, atol=1e-6 * expected.max())
    p = np.abs(exact.deviation(cells)[0][0])
    strong = p > 0.7 * p.max()
    np.testing.assert_allclose(added[0, strong], 0.03 * p[strong], rtol=0.05)


MOVES = {"gain_1": 0.02, "depth_m": 1e-5, "angle_2_deg": 1.0, "offset_2_m": 2e-5}


def moved(name: str, by: float, motion) -> np.ndarray:
    """The signals of a rig that is off by so much in one parameter."""
    if name == "gain_1":
        return signal(sensor(), motion) * np.array([[1 + by], [1.0]])
    own = {"depth_m": DEPTH_M, "angle_2_deg": 90.0, "offset_2_m": 0.0}[name] + by
    return signal(sensor(**{name.replace("_2", ""): own}), motion)


@pytest.mark.full
@pytest.mark.parametrize(("name", "motion"), [*zip(MOVES, 2 * (THERE_AND_BACK, SCAN), strict=True)])
def test_errors_are_what_a_rig_that_is_off_makes(name, motion):
    value = {"gain_1": 1.0, "depth_m": DEPTH_M, "angle_2_deg": 90.0, "offset_2_m": 0.0}[name]
    rig = RigError((name,), np.array([value]), np.array([[MOVES[name] ** 2]]))
    estimate = WIENER(problem(moved(name, 0.0, motion), rig, motion))
    by = MOVES[name]
    of = [WIENER(problem(moved(name, off, motion), None, motion)) for off in (by, -by)]
    change = (np.asarray(of[0].value) - np.asarray(of[1].value)) / 2
    (error,) = estimate.rig_errors
    # To the regularised traction, of which the signals change, from the true one.
    np.testing.assert_allclose(error, change, atol=0.1 * np.abs(change).max())


@pytest.mark.full
@pytest.mark.parametrize("motion", [SCAN, THERE_AND_BACK])
@pytest.mark.parametrize("name", ["speed", "poisson_ratio", "strip_width_2_m"])
def test_errors_are_what_wrong_facts_make(name, motion):
    """The speed stretches the traction about the scan's start, and wrongs its kernel's length."""
    value = {"speed": 1.0, "poisson_ratio": 0.5, "strip_width_2_m": 7e-4}[name]
    step = {"speed": 0.01, "poisson_ratio": 0.02, "strip_width_2_m": 7e-5}[name]
    rig = RigError((name,), np.array([value]), np.array([[step**2]]), (STATED,))
    stated = Setup(sensor().with_films(Film.with_strip_average))
    # Without edges, which the regularised traction, of which the signals change, does not have.
    smooth = 4e3 * np.exp(-(((np.asarray(LINE.x) - 4e-4) / 1e-3) ** 2))

    def of(setup: Setup, error=None):
        y = signal(setup.sensor, setup.motion(motion), smooth)
        return WIENER(Problem(stated.sensor, motion, y, NOISE_V, rig=error, cell_m=CELL_M))

    above, below = (of(stated.changed(name, value, sign * step)) for sign in (1, -1))
    change = (np.asarray(above.value) - np.asarray(below.value)) / 2
    (error,) = of(stated, rig).rig_errors
    np.testing.assert_allclose(error, change, atol=0.1 * np.abs(change).max())


@pytest.mark.full
def test_paths_and_other_lines_agree():
    rig = RigError(("gain_1", "depth_m"), np.array([1.0, DEPTH_M]), np.diag([4e-4, 1e-10]))
    y = signal(sensor()) + NOISE_V * np.random.default_rng(1).normal(size=(2, 240))
    y[:, 100:103] = np.nan
    each = [
        Wiener(WIENER.p, WIENER.q, path=path, tolerance=1e-12)(problem(y, rig))
        for path in ("direct", "iterative")
    ]
    first, second = (np.asarray(one.rig_errors) for one in each)
    # The iterative path ends earlier, as its bands are within 3 %.
    np.testing.assert_allclose(first, second, rtol=0, atol=1e-4 * np.abs(first).max())
    # Its own line gives its own band, and cells twice as wide the joint errors of their halves.
    direct, line = each[0], each[0].line
    np.testing.assert_allclose(direct.on(line).stderr, direct.stderr, rtol=1e-6)
    wide = Open(line.n // 2, 2 * line.cell_m, line.start_m + line.cell_m / 2)
    off = first[:, 0] - first[:, 0] @ np.asarray(direct.mean_weights)[0][:, None]
    pairs = off[:, : 2 * wide.n].reshape(2, -1, 2).mean(axis=-1)
    without = WIENER(problem(y)).on(wide).stderr[0]
    expected = np.sqrt(np.asarray(without) ** 2 + np.sum(pairs**2, axis=0))
    np.testing.assert_allclose(direct.on(wide).stderr[0], expected, rtol=1e-6)


@pytest.mark.full
def test_features_on_a_line_carry_them_too():
    y = signal(sensor()) + NOISE_V * np.random.default_rng(1).normal(size=(2, 240))
    fit = FeatureFit({"strip": StripFeature()})
    value, stderr = fit(problem(y, common_gain(0.02)).to_grid()).parameters["pressure_Pa"]
    assert stderr == pytest.approx(0.02 * value, rel=0.2)


@pytest.mark.claim
def test_bands_cover_where_the_rig_dominates():
    """At 60 dB, over draws of the traction, the rig and the noise."""
    of = drawn("two elements, 60 dB", "wiener", draws=60)
    assert 0.85 < of["coverage_p_with"] < 0.95
    assert of["coverage_p_without"] < of["coverage_p_with"] - 0.2


def test_many_directions_are_combined_into_fewer_with_the_same_spread():
    """The variance in each place scatters by sqrt(2/m) about that of all directions."""
    rng = np.random.default_rng(1)
    few, rows = rng.normal(size=(20, 2, 7)), rng.normal(size=(30, 20))
    np.testing.assert_array_equal(solved_directions(list, few, None), few)
    np.testing.assert_allclose(
        solved_directions(list, few, rows), np.einsum("kj,jen->ken", rows, few)
    )
    many = rng.normal(size=(500, 3, 400))
    combined = solved_directions(list, many, None)
    assert len(combined) == MOST_DIRECTIONS
    ratio = np.sum(combined**2, axis=0) / np.sum(many**2, axis=0)
    assert abs(ratio.mean() - 1) < 0.02
    assert 0.7 < ratio.std() / np.sqrt(2 / MOST_DIRECTIONS) < 1.3
