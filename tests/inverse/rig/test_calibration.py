"""Calibration on a known feature: the rig that made the signals, with honest standard errors.

The signals are those of the feature model, whose operator has every parameter of its own: it has
fine cells, contact at every place, and films at their offsets.
"""

from functools import lru_cache

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.feature import LineFeature, StepFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface_feature import RidgeFeature, StepUpFeature
from srsinv.grid import as_real
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.gridding.cells import Window
from srsinv.inverse.problem import Problem
from srsinv.inverse.quality import Quality
from srsinv.inverse.rig.calibration import calibrate

EDGE_M, PRESSURE_PA, SPEED, RATE_HZ = 5e-5, 3e4, 0.02, 1000.0
WINDOW_M = (-0.015, 0.015)
HELD = {"height_m": 2e-5, "width_m": 2e-3}
TRUE = {"gain_1": 95.0, "gain_2": -110.0, "depth_m": 1.2e-3, "angle_2_deg": 45.0,
        "offset_2_m": 1.5e-3, "base_friction": 0.35, "position_m": 8e-4}  # fmt: skip
NOISE_V = 2e-6


def sensor(depth_m, angle_deg, offset_m, elements=2) -> Sensor:
    """Two strips."""
    films = [Film(depth_m, strips=2), Film(depth_m, np.deg2rad(angle_deg), strips=2,
                                           offset_m=offset_m)]  # fmt: skip
    averaged = [film.with_strip_average() for film in films[:elements]]
    return Sensor(averaged, HalfSpace(0.5, 7e5), CurrentAmplifier(1e6))


def motion(turning=False) -> Motion:
    samples = int(0.02 / SPEED * RATE_HZ)
    speed = np.full(samples, SPEED)
    if turning:
        speed = np.concatenate([speed, -speed])
    return Motion.from_speed(np.arange(speed.size) / RATE_HZ, speed, -0.01)


@lru_cache
def clean(feature, turning=False) -> np.ndarray:
    """The signals (e, sample) of the true rig, without noise."""
    true = sensor(TRUE["depth_m"], TRUE["angle_2_deg"], TRUE["offset_2_m"])
    own = {"position_m": TRUE["position_m"]}
    if feature.is_of_surface:
        model = FeatureModel.on_window(true, motion(turning), Window(*WINDOW_M), 3e-6, PRESSURE_PA)
        own |= {"height_m": HELD["height_m"], "edge_length_m": EDGE_M}
        own |= {"width_m": HELD["width_m"]} if "width_m" in feature.axes else {}
        own |= {"friction_zone_length_m": 5e-4} if feature.frictions else {}
        own |= dict.fromkeys(feature.frictions, TRUE["base_friction"])
    else:
        model = FeatureModel.along(true, motion(turning))
        load = 10.0
        own |= {"load_N_per_m": load, "shear_N_per_m": TRUE["base_friction"] * load}
    model = model.with_features({"one": feature})
    common = model.loading.common() | {"base_friction": TRUE["base_friction"]}
    params = {"one": {key: as_real(value) for key, value in own.items()}}
    params |= {key: as_real(value) for key, value in common.items()}
    return np.asarray(model(params))


def problem(signal, stated=(1.1e-3, 40.0, 1.2e-3), turning=False, elements=2) -> Problem:
    return Problem(
        sensor(*stated, elements), motion(turning), signal[:elements],
        NOISE_V, nominal_pressure_Pa=PRESSURE_PA, window_m=WINDOW_M,
    )  # fmt: skip


def recorded(feature, rng, turning=False) -> np.ndarray:
    signal = clean(feature, turning)
    gain = np.array([[TRUE["gain_1"]], [TRUE["gain_2"]]])
    return gain * (signal + rng.normal(scale=NOISE_V, size=signal.shape))


def pulls(calibration) -> dict[str, float]:
    return {
        name: (value - TRUE[name]) / stderr
        for name, (value, stderr) in calibration.parameters.items()
    }


FEATURES = {
    "ridge": (RidgeFeature(EDGE_M), HELD),
    "step": (StepUpFeature(EDGE_M), {"height_m": 2e-5, "friction_zone_length_m": 5e-4}),
    "line": (LineFeature(), {"load_N_per_m": 10.0}),
}


CASES = {
    "ridge": ("ridge", False), "step": ("step", False),
    "line, there and back": ("line", True),
}  # fmt: skip


@pytest.mark.parametrize(
    "case",
    [
        *(pytest.param(each, marks=pytest.mark.full) for each in ("ridge", "step")),
        pytest.param("line, there and back", marks=pytest.mark.claim),
    ],
)
def test_the_rig_that_made_the_signals(case):
    """Gains of either sign, from a sensor stated 8 % too shallow, 5 degrees and 0.3 mm off."""
    name, back = CASES[case]
    feature, held = FEATURES[name]
    signal = recorded(feature, np.random.default_rng(1), back)
    made = calibrate(problem(signal, turning=back), feature, held)
    assert made.quality is not Quality.FAILED
    assert set(made.parameters) == set(TRUE)
    assert max(map(abs, pulls(made).values())) < 3.5
    # What is known to a per cent or so is known to be so.
    for key in ("gain_1", "gain_2", "depth_m"):
        value, stderr = made.parameters[key]
        assert 1e-4 * abs(value) < stderr < 0.03 * abs(value)


@pytest.mark.claim
def test_standard_errors_are_those_of_many_draws():
    feature, held = FEATURES["ridge"]
    rng = np.random.default_rng(2)
    every = [calibrate(problem(recorded(feature, rng)), feature, held) for _ in range(8)]
    for name in TRUE:
        squares = np.mean([pulls(each)[name] ** 2 for each in every])
        # The mean of eight chi-squares of one is outside once in 150 draws.
        assert 0.17 < squares < 2.7, name


@pytest.mark.full
def test_one_strip_of_a_depth_that_is_held():
    feature, held = FEATURES["ridge"]
    given = problem(recorded(feature, np.random.default_rng(3)), elements=1)
    made = calibrate(given, feature, held | {"depth_m": TRUE["depth_m"]})
    assert set(made.parameters) == {"gain_1", "position_m", "base_friction"}
    assert max(map(abs, pulls(made).values())) < 3.5


@pytest.mark.claim
def test_one_strip_of_unknown_depth():
    feature, held = FEATURES["ridge"]
    signal = recorded(feature, np.random.default_rng(3))
    made = calibrate(problem(signal, elements=1), feature, held)
    assert set(made.parameters) == {"gain_1", "depth_m", "position_m", "base_friction"}
    assert max(map(abs, pulls(made).values())) < 3.5


@pytest.mark.claim
def test_what_is_held_stays_and_the_rest_is_surer():
    feature, held = FEATURES["ridge"]
    signal = recorded(feature, np.random.default_rng(4))
    loose = calibrate(problem(signal), feature, held)
    known = {"depth_m": TRUE["depth_m"], "angle_2_deg": TRUE["angle_2_deg"]}
    tight = calibrate(problem(signal), feature, held | known)
    assert not known.keys() & tight.parameters.keys()
    for name, factor in (("gain_1", 0.9), ("offset_2_m", 0.6)):
        assert tight.parameters[name][1] < factor * loose.parameters[name][1]


@pytest.mark.claim
def test_what_is_named_alone_is_free():
    feature, held = FEATURES["ridge"]
    signal = recorded(feature, np.random.default_rng(4))
    some = calibrate(problem(signal), feature, held, free=["gain_1", "gain_2"])
    assert set(some.parameters) == {"gain_1", "gain_2", "position_m", "base_friction"}


@pytest.mark.claim
def test_missing_samples_and_an_offset():
    feature, held = FEATURES["ridge"]
    signal = recorded(feature, np.random.default_rng(5))
    signal[0, 300:330] = np.nan
    signal[1, ::7] = np.nan
    made = calibrate(problem(signal), feature, held)
    assert max(map(abs, pulls(made).values())) < 3.5


REFUSED = {
    "not held": ({"width_m": 2e-3}, None, "height_m of the feature must be known"),
    "unknown": (HELD | {"hight_m": 1.0}, None, "'hight_m'"),
    "without its unit": (HELD | {"height": 2e-5}, None, "nearest is height_m"),
    "free without its unit": (HELD, ["angle_2"], "nearest is angle_2_deg"),
    "in both": (HELD | {"depth_m": 1e-3}, ["depth_m"], "both in fit.free and in fit.hold"),
    "unknown free": (HELD, ["angle_1_deg"], "fit.free names 'angle_1_deg'"),
    "no number": (HELD | {"gain_1": "high"}, None, "fit.hold.gain_1"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    held, free, words = REFUSED[case]
    signal = np.zeros((2, motion().time_s.size)) + np.random.default_rng(0).normal(size=(2, 1000))
    with pytest.raises(BadInput, match=words):
        calibrate(problem(signal), RidgeFeature(EDGE_M), held, free)


def test_what_has_no_place_or_no_pressure_is_refused():
    signal = np.random.default_rng(0).normal(size=(2, 1000))
    with pytest.raises(BadInput, match="StepFeature has no position"):
        calibrate(problem(signal), StepFeature(), {"pressure_Pa": 1e3})
    unknown = Problem(sensor(1.2e-3, 45.0, 0.0), motion(), signal, NOISE_V)
    with pytest.raises(BadInput, match=r"recording\.nominal_pressure_Pa"):
        calibrate(unknown, RidgeFeature(EDGE_M), HELD)
