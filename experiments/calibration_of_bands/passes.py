"""Conformal bands of a rig whose depth is stated wrong, by passes over known surfaces."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import srsinv
from srsinv import config
from srsinv.errors import mapping, number, whole
from srsinv.forward.sensor import Sensor
from srsinv.grid import Periodic
from srsinv.inverse.conformal import widened
from srsinv.inverse.estimate import TractionEstimate
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.rig.setup import Setup
from srsinv.report.data import scalars

from .inversions import DrawnScan, DrawnTraction, Traction
from .methods import prior_spectrum

CONFIDENCE, SHARE = 0.9, 0.9


@dataclass(frozen=True)
class ConformalStudy:
    """Repeated calibrations on passes of a true sensor, which are inverted as the stated one.

    `passes`: of each calibration; `repeats`: calibrations, each with one further scan.
    """

    stated: Sensor
    on: DrawnScan
    traction: DrawnTraction
    method: srsinv.Wiener
    passes: int
    repeats: int
    depth_error: float
    seed: int

    @classmethod
    def of(cls, cfg: config.Config, given: Mapping[str, Any]) -> "ConformalStudy":
        """The study by the configuration's sensor, whose true depth is another one."""
        key = "calibration_of_bands.conformal"
        given = mapping(key, given)
        wanted = "a whole number from 9"
        passes = whole(f"{key}.passes", given["passes"], wanted, least=9)
        repeats = whole(f"{key}.repeats", given["repeats"], "a whole number from 4", least=4)
        error = number(
            f"{key}.depth_error",
            given["depth_error"],
            "a fraction within 0.5",
            least=-0.5,
            most=0.5,
        )
        line, spectrum = config.line(cfg), prior_spectrum(cfg)
        stated = config.sensor(cfg)
        depth = float(stated.depth_m)
        true = Setup(stated).changed("depth_m", depth, error * depth).sensor
        line = Periodic(line.n, float(line.cell_m), float(line.start_m))
        on = DrawnScan.of(line, true, config.scan(cfg), config.noises(cfg), spectrum)
        traction, method = DrawnTraction.by(spectrum, line), srsinv.Wiener(spectrum, spectrum)
        return cls(stated, on, traction, method, passes, repeats, error, config.seed(cfg))

    def _pass(self, rng: np.random.Generator) -> tuple[LineProblem, Traction]:
        """A scan of the true sensor as a problem of the stated one, and its traction."""
        truth = self.traction(rng)
        truth = truth - truth.mean(axis=-1, keepdims=True)
        true, on = self.on.problem(truth, rng), self.on
        of = on.line, self.stated, on.scan, true.data, on.power
        return LineProblem.of_sensor(*of, known_mean_Pa=(0.0, None)), truth

    def __call__(self) -> dict[str, tuple[Any, ...]]:
        """Coverage of the further scans by the model's bands and by conformal ones."""
        rng, coverage, factors = np.random.default_rng([self.seed, 1000]), [], []
        cells = np.ones(self.on.line.n, bool)
        for _ in range(self.repeats):
            passes = [self._pass(rng) for _ in range(self.passes)]
            made = srsinv.Conformal.of_passes(
                self.method, passes, confidence=CONFIDENCE, share=SHARE
            )
            problem, truth = self._pass(rng)
            own: Any = self.method(problem)
            factors.append((float(made.factor_p), float(made.factor_q)))
            wide: TractionEstimate = widened(own, factors[-1])
            coverage.append([each.coverage(truth, cells) for each in (own, wide)])
        held = np.array(coverage)  # (repeat, model or conformal, component)
        by = ("component",)
        of_scans = np.mean(held >= SHARE, axis=0)
        return {
            "coverage_model": (("repeat", "component"), held[:, 0], "1"),
            "coverage_conformal": (("repeat", "component"), held[:, 1], "1"),
            "scans_held_model": (by, of_scans[0], "1", "scans_held_model_{component}"),
            "scans_held_conformal": (by, of_scans[1], "1", "scans_held_conformal_{component}"),
            "conformal_factor": (
                by,
                np.median(factors, axis=0),
                "1",
                "conformal_factor_{component}",
            ),
            **scalars({
                "conformal_passes": self.passes,
                "conformal_repeats": self.repeats,
                "conformal_depth_error": self.depth_error,
            }),
        }  # fmt: skip
