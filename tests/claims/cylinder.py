"""What a fit finds of a cylinder's radius and angle, far below the resolution limit (40 minutes).

A two-element sensor of 0.75 mm depth scans cylinders under 4 N/m, whose contact is 46 um wide for a
radius of 0.1 mm. The simulation solves the contact of the circle on cells of 0.4 micrometres; the
fit has Hertz's pressure. The bound is the Cramer-Rao bound of the simulation.

Coverage over 200 draws scatters by 2.1 %, and over 800 by 1.1 %. One of 200 draws is 83.5 %; the
estimator that is linear in the noise, of this bound exactly, holds the truth in 84 % of these very
draws. So that setting has a second row, of 800 other draws.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from experiments.cylinder.scans import CylinderDraw, CylinderScan, fitted_draws
from srsinv.forward.sensor import Sensor
from srsinv.jobs.trials import Row
from srsinv.numerics import BAND_90
from tests.claims.study import Study

DRAWS, LOAD_N_PER_M = 200, 4.0


@dataclasses.dataclass(frozen=True)
class CylinderCase:
    """Scans of a cylinder; whether its angle and its load are known; the number of draws."""

    radius_mm: float
    angle_deg: float
    snr_dB: float
    knows_angle: bool = False
    knows_load: bool = True
    draws: int = DRAWS

    @property
    def scan(self) -> CylinderScan:
        """The scan."""
        return CylinderScan(
            Sensor(), 1e-3 * self.radius_mm, self.angle_deg, LOAD_N_PER_M, self.snr_dB
        )

    @property
    def named(self) -> str:
        """Its label."""
        known = ", known angle" if self.knows_angle else ""
        free = "" if self.knows_load else ", unknown load"
        more = "" if self.draws == DRAWS else f", {self.draws} draws"
        setting = f"{self.radius_mm:g} mm, {self.angle_deg:g} deg, {self.snr_dB:g} dB"
        return f"{setting}{known}{free}{more}"

    @property
    def facts(self) -> Row:
        """What decides on its row beside its label, which names another number of draws."""
        return {key: each for key, each in dataclasses.asdict(self).items() if key != "draws"}


EVERY = [
    *(CylinderCase(r, 30.0, db) for db in (60.0, 40.0) for r in (0.1, 0.3, 1.0)),
    *(CylinderCase(r, 0.0, 60.0, True) for r in (0.1, 0.3)),
    CylinderCase(0.3, 0.0, 60.0),
    CylinderCase(0.3, 10.0, 60.0),
    CylinderCase(0.3, 30.0, 60.0, knows_load=False),
    CylinderCase(1.0, 30.0, 60.0, draws=800),
]
CASES = {case.named: case for case in EVERY}


Intervals = Mapping[str, tuple[float, float]]


def is_held(draw: CylinderDraw, intervals: Intervals, name: str) -> bool:
    """Whether the truth is in the 90 % interval: that of the profile where there is one."""
    if name in intervals:
        low, high = intervals[name]
        return low <= draw.truth[name] <= high
    return abs(draw.error(name)) <= BAND_90 * draw.stderr(name)


def measured(setting: str) -> Row:
    """Root mean square errors over their bounds, the per cent of 90 % intervals that hold the
    truth, and of draws whose radius and angle the fit says are identified."""
    case, seed = CASES[setting], list(CASES).index(setting)
    scan = case.scan
    also = () if case.knows_load else ("nominal_pressure_Pa",)
    draws = fitted_draws(scan, case.draws, seed, case.knows_angle, also)
    has_bound = case.knows_angle or case.angle_deg > 0
    intervals = [draw.estimate.asymmetric for draw in draws]
    bounds = scan.bounds(case.knows_angle or not has_bound, case.knows_load) if has_bound else {}
    row: Row = {"half_width_um": 1e6 * scan.half_width_m}
    for name in [each for each in ("radius_m", "angle_rad", "position_m", "base_friction")
                 if each in draws[0].estimate.parameters]:  # fmt: skip
        rms = float(np.sqrt(np.mean([draw.error(name) ** 2 for draw in draws])))
        finite = np.mean([np.isfinite(draw.stderr(name)) for draw in draws])
        row[f"{name}_rms"] = rms
        row[f"{name}_bound"] = bounds.get(name)
        row[f"{name}_rms_over_bound"] = rms / bounds[name] if name in bounds else None
        held = [is_held(*each, name) for each in zip(draws, intervals, strict=True)]
        row[f"{name}_held_percent"] = 100 * float(np.mean(held))
        row[f"{name}_identified_percent"] = 100 * float(finite)
    good = [str(draw.estimate.quality) for draw in draws]
    return row | {f"{word}_percent": 100 * good.count(word) / case.draws
                  for word in ("good", "doubtful", "failed")}  # fmt: skip


STUDY = Study(
    "cylinder",
    measured,
    lambda: [{"setting": name} for name in CASES],
    rests_on=lambda setting: CASES[setting].facts,
)
