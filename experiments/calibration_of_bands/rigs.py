"""Answers about rigs and directions whose intervals are calibrated: a calibration on a known load,
facts that are found with the traction, and a ridge's direction from a circle."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

import srsinv
from srsinv.forward.feature import LineFeature
from srsinv.forward.planar import Circle, ObliqueRidge, PathScan
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, as_real
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.planar.finder import DirectionFinder
from srsinv.inverse.planar.signal import RidgeShape
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.calibration import calibrate
from srsinv.inverse.rig.setup import Setup
from srsinv.inverse.wiener import Exponential

from .fits import Ranges, parameter_ranks, real
from .inversions import DrawnTraction
from .ranks import RankedMethod, Ranks, drawn, noisy

RIG_SAMPLES, RIG_LENGTH_M, RIG_RATE_HZ = 800, 0.016, 2e3
RIG_RANGES = Ranges({"depth_m": (0.95, 1.05), "gain_1": (0.9, 1.1), "gain_2": (0.9, 1.1),
                     "angle_2_deg": (-3.0, 3.0)})  # fmt: skip
RIG_LOAD, RIG_FRICTION, RIG_NOISE = 10.0, 0.4, 3e-3


@dataclass(frozen=True)
class RankedRig(RankedMethod):
    """The calibration of a rig on a known line load: of a sensor whose depth, gains and angle
    differ from the stated ones."""

    sensor: Sensor
    speed_m_per_s: float
    label: str = "Calibration of a rig"
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        start, rate = -RIG_LENGTH_M / 2, self.speed_m_per_s * RIG_SAMPLES / RIG_LENGTH_M
        motion = srsinv.Motion.from_speed(np.arange(RIG_SAMPLES) / rate, self.speed_m_per_s, start)
        stated = {"depth_m": float(self.sensor.depth_m), "gain_1": 1.0, "gain_2": 1.0}
        angle = float(np.rad2deg(self.sensor.elements[1].angle_rad))
        feature, held = LineFeature(), {"load_N_per_m": RIG_LOAD, "position_m": 0.0}
        held |= {"base_friction": RIG_FRICTION}

        def signal(setup: Setup) -> Float[np.ndarray, "e sample"]:
            model = FeatureModel.along(setup.sensor, motion).with_features({"line": feature})
            own = {"load_N_per_m": RIG_LOAD, "shear_N_per_m": RIG_FRICTION * RIG_LOAD}
            return np.asarray(model({"line": {"position_m": as_real(0.0)} | real(own)}))

        level = RIG_NOISE * np.sqrt(np.mean(signal(Setup(self.sensor)) ** 2))

        def one() -> dict[str, float]:
            factors, setup = RIG_RANGES.draw(rng), Setup(self.sensor)
            truth = {name: factors[name] * value for name, value in stated.items()}
            truth["angle_2_deg"] = angle + factors["angle_2_deg"]
            for name in ("depth_m", "angle_2_deg"):
                value = stated.get(name, angle)
                setup = setup.changed(name, value, truth[name] - value)
            gains = np.array([[truth["gain_1"]], [truth["gain_2"]]])
            clean = gains * signal(setup)
            y = clean + level * rng.standard_normal(clean.shape)
            found = calibrate(Problem(self.sensor, motion, y, level), feature, held)
            return parameter_ranks(truth, found.parameters)

        return drawn(one, draws)


FOUND_LENGTH_M, FOUND_CELL_M, FOUND_FRICTION, FOUND_NOISE = 0.04, 1.5e-4, 0.4, 0.01
FOUND_RANGES = Ranges({"depth_m": (0.85, 1.15), "gain_ratio_2": (0.9, 1.1),
                       "angle_2_deg": (-4.0, 4.0)})  # fmt: skip


@dataclass(frozen=True)
class RankedFacts(RankedMethod):
    """Semi-blind inversion: depth, gain ratio and angle of a sensor that differs from the stated
    one, over an unknown surface with q = mu p."""

    sensor: Sensor
    scan: srsinv.ConstantSpeed
    spectrum: Exponential
    label: str = "Semi-blind"
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        cells = int(FOUND_LENGTH_M / FOUND_CELL_M)
        line = Open(2 * cells, FOUND_CELL_M, -cells * FOUND_CELL_M)  # twice as long as the scan
        scanned = np.zeros((2, line.n), bool)
        scanned[:, cells // 2 : cells // 2 + cells] = True
        traction, method = DrawnTraction.by(self.spectrum, line), srsinv.SemiBlind()
        angle = float(np.rad2deg(self.sensor.elements[1].angle_rad))
        stated = {"depth_m": float(self.sensor.depth_m), "gain_2": 1.0, "angle_2_deg": angle}

        def one() -> dict[str, float]:
            by, p = FOUND_RANGES.draw(rng), traction(rng)[0]
            truth = {"depth_m": by["depth_m"] * stated["depth_m"], "gain_2": by["gain_ratio_2"],
                     "angle_2_deg": angle + by["angle_2_deg"]}  # fmt: skip
            setup = Setup(self.sensor)
            for name, value in stated.items():
                setup = setup.changed(name, value, truth[name] - value)
            operator = setup.sensor.operator(line, self.scan)
            clean = np.asarray(operator(as_real(np.stack([p, FOUND_FRICTION * p]))))
            level = FOUND_NOISE * float(np.sqrt(np.mean(clean[scanned] ** 2)))
            y = clean + level * rng.standard_normal(clean.shape)
            known: dict[str, Any] = {"observed": scanned, "friction": FOUND_FRICTION}
            power = np.full(line.n // 2 + 1, level**2)
            of = line, self.sensor, self.scan, np.where(scanned, y, 0.0), power
            truth["gain_ratio_2"] = truth.pop("gain_2")
            return parameter_ranks(truth, method(LineProblem.of_sensor(*of, **known)).parameters)

        return drawn(one, draws)


CIRCLE, CIRCLE_NOISE = {"radius_m": 0.01, "samples": 256}, 0.1
RIDGE_RANGES = Ranges({"angle_deg": (20.0, 160.0), "distance_m": (1e-3, 5e-3),
                       "load_N_per_m": (0.5, 2.0), "width_m": (4e-4, 8e-4),
                       "friction": (-0.6, -0.2)})  # fmt: skip
OF_DIRECTION = "angle_deg", "distance_m", "load_N_per_m", "friction"


@dataclass(frozen=True)
class RankedDirection(RankedMethod):
    """The direction of a ridge from one circle over it."""

    sensor: Sensor
    label: str = "Direction of a ridge"
    is_quick: bool = False

    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        circle = Circle(**CIRCLE)
        circling = PathScan(self.sensor, circle)
        finder = DirectionFinder(circling, RidgeShape())

        def one() -> dict[str, float]:
            truth = RIDGE_RANGES.draw(rng)
            of = {name: value for name, value in truth.items() if name != "angle_deg"}
            clean = np.asarray(circling(ObliqueRidge(np.deg2rad(truth["angle_deg"]), **of)))
            found = finder(*noisy(clean, CIRCLE_NOISE, rng))
            return parameter_ranks({name: truth[name] for name in OF_DIRECTION}, found.parameters)

        return drawn(one, draws)
