"""Tolerances of stated facts: the defaults, what wins over what, refusals, and that errors of fits
are those of rigs drawn from the tolerances."""

import dataclasses
import math

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.feature import StripFeature
from srsinv.forward.film import CellAverage, Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Open, as_real
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.error import ASSUMED, CALIBRATED, CALIBRATION, STATED, RigError
from srsinv.inverse.rig.setup import Setup
from srsinv.inverse.rig.tolerance import rig_error_of
from srsinv.recording._schema import check_facts
from srsinv.recording._sidecar import merge
from tests.claims import tolerances as study
from tests.refusals import refused

DEPTH_M = 7.5e-4
SENSOR = Sensor([
    Film(DEPTH_M).with_strip_average(), Film(DEPTH_M, np.pi / 2).with_strip_average()
])  # fmt: skip
MOTION = Motion.from_speed(np.arange(240) / 1000, np.full(240, 0.05), -6e-3)
LINE = Open(3000, 1e-5, -1.5e-2)
FIT = FeatureFit({"strip": StripFeature()})
TRUTH = {"position_m": 4e-4, "width_m": 3e-3, "pressure_Pa": 4e3, "friction": 0.4}
CALIBRATION_FACTS = {
    "parameters": ["gain_1", "depth_m"], "values": [2.0, 7.5e-4],
    "covariance": [[1e-4, 1e-8], [1e-8, 1e-10]],
}  # fmt: skip


def error_of(facts, sensor=SENSOR, has_measured_positions=False, nominal_pressure_Pa=2e4):
    return rig_error_of(
        "r.csv",
        facts,
        sensor,
        has_measured_positions=has_measured_positions,
        nominal_pressure_Pa=nominal_pressure_Pa,
    )


def sizes(error: RigError) -> dict[str, float]:
    return dict(zip(error.names, error.stderr, strict=True))


def test_a_rig_made_by_hand_has_the_defaults():
    expected = {
        "depth_m": 0.05 * DEPTH_M, "gain_1": 0.05, "gain_2": 0.05, "angle_2_deg": 2.0,
        "offset_2_m": 5e-5, "strip_width_1_m": 3.5e-5, "strip_width_2_m": 3.5e-5, "speed": 0.01,
        "poisson_ratio": 0.01, "youngs_modulus_Pa": 7e4, "nominal_pressure_Pa": 2e3,
    }  # fmt: skip
    facts = {}
    error = error_of(facts)
    assert sizes(error) == pytest.approx(expected) == sizes(error_of({"tolerance": "default"}))
    assert set(error.origin_of.values()) == {ASSUMED}
    assert "speed" not in error_of(facts, has_measured_positions=True).names
    assert "nominal_pressure_Pa" not in error_of(facts, nominal_pressure_Pa=None).names
    one = error_of(facts, Sensor([Film(DEPTH_M)]))
    assert not {"angle_1_deg", "offset_1_m", "gain_2"} & {*one.names}


def test_what_is_stated_wins_over_a_default_and_a_calibration_over_both():
    facts = {"tolerance": {"depth_m": 1e-5, "speed": 0.002, "edge_length_m": 1e-6}}
    error = error_of(facts, has_measured_positions=True)
    assert sizes(error) | {"depth_m": 1e-5, "speed": 0.002, "edge_length_m": 1e-6} == sizes(error)
    assert error.origin_of["depth_m"] == STATED
    both = error_of(facts | {"rig_error": CALIBRATION_FACTS})
    assert sizes(both)["depth_m"] == pytest.approx(1e-5)
    assert both.origin_of["depth_m"] == both.origin_of["gain_1"] == CALIBRATED
    assert both.origin_of["gain_2"] == ASSUMED
    np.testing.assert_allclose(both.root @ both.root.T, both.covariance, rtol=1e-12)
    assert both.sources(len(both.names)).count(CALIBRATION) == 2


def test_none_takes_all_facts_as_exact_but_what_a_calibration_left():
    assert error_of({"tolerance": "none"}) is None
    for given in ({"tolerance": "none"}, {}):
        left = error_of({**given, "rig_error": CALIBRATION_FACTS})
        assert left.names == ("gain_1", "depth_m")
    # And so does the sidecar's word, beside a command line that gives none of them.
    nothing = {"tolerance": {"depth_m": None, "gain": None}}
    assert merge({"tolerance": "none"}, nothing) == {"tolerance": "none"}


@pytest.mark.parametrize(
    "facts",
    [
        {"depth_m": -1e-5},
        {"depth_m": 0},
        {"depth_m": "5 %"},
        {"gain_1": 0.1},
        {"gain": [0.1]},
        "off",
    ],
)
def test_tolerances_that_are_none_are_refused(facts):
    said = refused(lambda: check_facts("r.csv", {"tolerance": facts}))
    assert "tolerance" in said


def test_a_tolerance_as_large_as_the_fact_is_refused():
    with pytest.raises(BadInput, match=r"tolerance\.depth_m is 0\.05"):
        error_of({"tolerance": {"depth_m": 0.05}})  # per cent in place of metres


def test_a_width_whose_gain_is_calibrated_changes_the_mean_over_the_strip_alone():
    off = np.array([0.0, 0.0, 1.0])
    for origin, area in ((CALIBRATED, 1.0), (ASSUMED, 1.05)):
        rig = RigError(
            ("gain_1", "gain_2", "strip_width_1_m"),
            np.array([1.0, 1.0, 7e-4]),
            np.diag([1e-4, 1e-4, 3.5e-5**2]),
            (origin, ASSUMED, ASSUMED),
        )
        off = np.zeros(3)
        off[rig.sources(3).index("strip_width_1_m")] = 1.0
        film = rig.uncertain(SENSOR, MOTION)(off).sensor.elements[0]
        own = SENSOR.elements[0]
        assert film.width_m * film.length_m == pytest.approx(area * own.width_m * own.length_m)
        assert film.effects[0].width_m == pytest.approx(1.05 * own.width_m)


def test_a_strip_leaves_the_cell_that_it_is_recorded_in():
    """10 % on the strip: the samples are still the means over the same cell."""
    film = SENSOR.elements[0].with_effect(CellAverage.at_depth(1e-4, DEPTH_M))
    made = Setup(Sensor([film])).changed("strip_width_1_m", film.width_m, 0.1 * film.width_m)
    strip, cell = made.sensor.elements[0].effects
    assert float(strip.width_m) == pytest.approx(1.1 * float(film.width_m))
    assert float(cell.width_m) == pytest.approx(1e-4)
    assert [each.scaled(2.0).acts_on_signal for each in (strip, cell)] == [False, True]


def signal(setup: Setup) -> np.ndarray:
    p = np.asarray(UniformStrip(4e3, 3e-3, 4e-4).cell_average(LINE))
    operator = setup.sensor.operator_along(LINE, setup.motion(MOTION))
    return np.asarray(operator(as_real(np.stack([p, 0.4 * p]))))


@pytest.mark.claim
def test_standard_errors_are_the_spread_over_rigs_drawn_from_the_tolerances():
    """Each of the rig's errors at a time, of one size either way: the sum of squares of what they
    move is the variance that noise does not make."""
    rig = error_of({"tolerance": "default"}, nominal_pressure_Pa=None)
    known = rig.uncertain(SENSOR, MOTION)
    level = 0.01 * np.abs(signal(Setup(SENSOR))).max()
    rng, draws = np.random.default_rng(2), 12
    scores = []
    for _ in range(draws):
        y = signal(known(rng.normal(size=len(rig.names)))) + level * rng.normal(size=(2, 240))
        estimate = FIT(Problem(SENSOR, MOTION, y, level, rig=rig))
        assert estimate.quality == "good"
        scores.append([(estimate.parameters[k][0] - v) / estimate.parameters[k][1]
                       for k, v in TRUTH.items()])  # fmt: skip
        for name, parts in estimate.budget.parts.items():
            whole = math.sqrt(sum(part**2 for part in parts.values()))
            assert whole == pytest.approx(estimate.parameters[name][1], rel=1e-6)
    # 48 scores, of which four of one fit are correlated.
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.3
    assert np.abs(scores).max() < 4
    largest = {
        name: max(parts, key=lambda k, p=parts: p[k])
        for name, parts in estimate.budget.parts.items()
    }
    assert largest["position_m"] == "speed"
    assert largest["pressure_Pa"].startswith("gain")


@pytest.mark.full
def test_what_contradicts_the_tolerances_is_said():
    """A depth that is wrong by seven of its standard deviations."""
    rig = error_of({"tolerance": {"depth_m": 1e-5}}, nominal_pressure_Pa=None)
    made = dataclasses.replace(SENSOR, elements=tuple(
        Film(DEPTH_M + 7e-5, film.angle_rad).with_strip_average() for film in SENSOR.elements
    ))  # fmt: skip
    y = signal(Setup(made))
    level = 0.01 * np.abs(y).max()
    y = y + level * np.random.default_rng(1).normal(size=y.shape)
    estimate = FIT(Problem(SENSOR, MOTION, y, level, rig=rig))
    assert estimate.quality == "doubtful"
    assert any("depth" in each for each in estimate.warnings)


@pytest.mark.claim
def test_a_ridge_and_a_strip_do_not_change_places():
    """Widths of a ridge and of the strips explain the signals in two ways, 8 standard errors apart:
    the answer is the more probable one."""
    off = np.array([0.81, 1.63, -0.13, -1.34, -0.94, 0.69, 0.23, -1.47, 1.31, 0.22, 1.6])
    rig = study.tolerances(study.NOMINAL_PA)
    known = rig.uncertain(study.SENSOR, study.RIDGE_SCAN)
    assert known is not None
    clean = study.ridge_signal(known(off))
    noise = study.level(clean, 60.0)
    y = clean + noise * np.random.default_rng(1).normal(size=clean.shape)
    estimate = study.RIDGE_FIT(study.ridge_problem(y, noise, rig))
    for name, true in study.RIDGE.items():
        value, stderr = estimate.parameters[name]
        assert abs(value - true) < 4 * stderr < np.inf
