"""A calibration's errors carried into a fit: a closed form, and generalised least squares."""

import dataclasses

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.forward.feature import StripFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Open
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.error import RigError
from tests.inverse.cases import signals_along
from tests.tiers import quick

NOISE_V, DEPTH_M = 3e-8, 7.5e-4
MOTION = Motion.from_speed(np.arange(240) / 1000, np.full(240, 0.05), -6e-3)
FIT = FeatureFit({"strip": StripFeature()})


def sensor(depth_m=DEPTH_M, angle_deg=90.0) -> Sensor:
    return Sensor([Film(depth_m), Film(depth_m, np.deg2rad(angle_deg))])


def clean(made=None) -> np.ndarray:
    line = Open(3000, 1e-5, -1.5e-2)
    p = np.asarray(UniformStrip(4e3, 3e-3, 4e-4).cell_average(line))
    return signals_along(made or sensor(), line, MOTION, np.stack([p, 0.4 * p]))


def signal() -> np.ndarray:
    return clean() + NOISE_V * np.random.default_rng(3).normal(size=(2, 240))


def fitted(rig=None, made=None, gain=1.0):
    return FIT(Problem(made or sensor(), MOTION, signal() / gain, NOISE_V, rig=rig))


def error_of(**stderr) -> RigError:
    """Independent errors; gains of one."""
    stated = {"depth_m": DEPTH_M, "angle_2_deg": 90.0}
    values = np.array([stated.get(name, 1.0) for name in stderr])
    return RigError(tuple(stderr), values, np.diag(np.square(list(stderr.values()))))


@pytest.fixture(scope="module")
def exact():
    """The fit of a rig that is known."""
    return fitted()


@pytest.mark.full
def test_the_error_of_a_common_gain_is_that_of_the_pressure(exact):
    """Both gains wrong by the same 2 %: the pressure is, and nothing else."""
    rig = RigError(("gain_1", "gain_2"), np.ones(2), 4e-4 * np.full((2, 2), 1.0))
    carried = fitted(rig)
    own, more = exact.parameters, carried.parameters
    value, stderr = more["pressure_Pa"]
    assert stderr == pytest.approx(np.hypot(own["pressure_Pa"][1], 0.02 * value), rel=0.01)
    for name in ("width_m", "position_m", "friction"):
        assert more[name] == pytest.approx(own[name], rel=0.02)
    # And so is the band of p under the strip.
    top = np.argmax(carried.value[0])
    assert carried.stderr[0, top] > 5 * exact.stderr[0, top]


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "stderr"),
    quick([("depth_m", 1e-5), ("angle_2_deg", 1.0), ("offset_2_m", 2e-5)], ("depth_m", 1e-5)),
)
def test_errors_are_those_of_generalised_least_squares(exact, name, stderr):
    """With the rig's error D in the noise's covariance, (J^T (1 + D D^T)^-1 J)^-1: what the data
    themselves say of the rig is in it."""
    carried = fitted(error_of(**{name: stderr}))
    moved = {
        "depth_m": lambda by: sensor(DEPTH_M + by),
        "angle_2_deg": lambda by: sensor(angle_deg=90.0 + by),
        "offset_2_m": lambda by: _shifted(by),
    }[name]
    change = ((clean(moved(stderr)) - clean(moved(-stderr))) / 2 / NOISE_V).ravel()
    jacobian = exact.fit.jacobian
    whole = np.eye(change.size) + np.outer(change, change)
    covariance = np.linalg.inv(jacobian.T @ np.linalg.solve(whole, jacobian))
    expected = dict(zip(exact.fit.names, np.sqrt(np.diag(covariance)), strict=True))
    growth = 0.0
    for each in ("position_m", "width_m"):
        value, own = exact.parameters[each]
        assert carried.parameters[each][1] == pytest.approx(expected[f"strip.{each}"], rel=0.02)
        assert abs(carried.parameters[each][0] - value) < 4 * expected[f"strip.{each}"]
        growth = max(growth, expected[f"strip.{each}"] / own)
    assert growth > 1.002 or name != "offset_2_m"


def _shifted(by: float) -> Sensor:
    from srsinv.forward.film import Offset

    films = sensor().elements
    return dataclasses.replace(sensor(), elements=(films[0], films[1].with_effect(Offset(by))))


GOOD = {"parameters": ["gain_1", "depth_m"], "values": [2.0, 1e-3],
        "covariance": [[0.01, 1e-6], [1e-6, 1e-9]]}  # fmt: skip
DAMAGED = {
    "no values": GOOD | {"values": None},
    "one row": GOOD | {"covariance": [[1.0, 0.0]]},
    "not symmetric": GOOD | {"covariance": [[0.01, 1e-6], [0.0, 1e-9]]},
    "negative": GOOD | {"covariance": [[0.01, 1e-2], [1e-2, 1e-9]]},
    "twice": GOOD | {"parameters": ["gain_1", "gain_1"]},
    "of another rig": GOOD | {"parameters": ["gain_3", "depth_m"]},
    "of nothing": GOOD | {"parameters": ["gain_1", "mood"]},
    **{
        f"called {each}": GOOD | {"parameters": [each, "depth_m"]}
        for each in (
            "gain_1_deg",
            "gain_1_m",
            "angle_1",
            "angle_1_m",
            "offset_1",
            "offset_1_deg",
            "gain_0",
            "gain_01",
            "gain_\u0661",
            "gain_" + "9" * 5000,
            "depth",
            "gain",
        )
    },
    "of no gain": GOOD | {"values": [0.0, 1e-3]},
    "deeper than known": GOOD | {"covariance": [[0.01, 0.0], [0.0, 1e-6]]},
    "of no finite number": GOOD | {"covariance": [[0.01, np.nan], [np.nan, 1e-9]]},
    "too small for a root": GOOD | {"covariance": [[5e-324, 0.0], [0.0, 1e-9]]},
    "of rows": GOOD | {"covariance": [[0.01, 1e-6, 0.0], [1e-6, 1e-9, 0.0]]},
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_one_is_refused(case):
    with pytest.raises(BadInput, match=r"r\.csv: the sidecar's rig_error"):
        RigError.of_facts("r.csv", DAMAGED[case], 2)


def test_none_is_exact():
    assert RigError.of_facts("r.csv", None, 2) is None
    assert RigError.of_facts("r.csv", {"parameters": []}, 2) is None
    assert RigError.of_facts("r.csv", GOOD, 2).names == ("gain_1", "depth_m")
