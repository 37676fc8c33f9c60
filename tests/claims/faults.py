"""What fits make of faulty measurements, and whether they say so.

On simulated scans of a known truth (the faults of experiments/robustness, where inversions are:
robustness.py; an hour and a half). Of every fault and fit:

- `z`: the error over the standard error of the worst parameter, 0 where that is infinite;
- `off`: the largest error over the true value, of parameters that are no place;
- `quality`, and the `warnings` that were given;
- `rejected`: whether a chi-square test at `LEVEL` rejects the residual as the noise that was put
  in, its true level and colour given: a test that the estimate itself has no part in.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from experiments.robustness.faults import faults, faulty, suits
from experiments.robustness.scans import SCENES, Scan, ScannedScene
from srsinv.errors import BadInput
from srsinv.grid import as_real
from srsinv.inverse.estimate import Estimate, deviation
from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.line.rule import Evidence
from srsinv.inverse.method import Method
from srsinv.inverse.problem import Problem
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Wiener
from srsinv.jobs.trials import Row
from srsinv.recorded import problem_of, ready
from tests.claims.study import Study

LEVEL = 1e-3
MOST_STDERRS = 3.0  # standard errors
CELL_M = 2e-4
SEED = 0
STRIP, ONE, RIDGE = SCENES


class MethodOnScene(NamedTuple):
    """A method on a scene; `known_friction`: whether q = mu p is taken as known."""

    scene: str
    method: Callable[[ScannedScene], Method]
    known_friction: bool = False


METHODS = {
    "wiener": MethodOnScene(STRIP, lambda _: Wiener(scale="evidence")),
    "gcv": MethodOnScene(STRIP, lambda _: Tikhonov(1)),
    "evidence": MethodOnScene(STRIP, lambda _: Tikhonov(1, rule=Evidence())),
    "wiener, friction known": MethodOnScene(STRIP, lambda _: Wiener(scale="evidence"), True),
    "wiener, one element": MethodOnScene(ONE, lambda _: Wiener(scale="evidence"), True),
    "gcv, one element": MethodOnScene(ONE, lambda _: Tikhonov(1), True),
    "fit of a strip": MethodOnScene(STRIP, lambda scene: FeatureFit({"one": scene.feature})),
    "fit of a strip, one element": MethodOnScene(
        ONE, lambda scene: FeatureFit({"one": scene.feature})
    ),
    "fit of a ridge": MethodOnScene(RIDGE, lambda scene: FeatureFit({"one": scene.feature})),
}
FITS = [name for name in METHODS if name.startswith("fit")]


def problem(made: Scan, known_friction: bool, cell_m: float = CELL_M) -> Problem:
    """The problem of a scan, as a user states it: the noise is that of the recording."""
    friction = made.scene.friction if known_friction else None
    return problem_of(ready(made.recording), friction=friction, cell_m=cell_m)


def measured(fault: str, method: str) -> Row:
    """One fault and method."""
    tried = METHODS[method]
    scene = SCENES[tried.scene]
    made = faulty(faults()[fault], scene, SEED)
    try:
        stated = problem(made, tried.known_friction)
        estimate = tried.method(scene)(stated)
    except BadInput as refusal:
        return {"z": 0.0, "quality": "refused", "warnings": [str(refusal)]}
    if isinstance(estimate, FeatureEstimate):
        off = [abs(estimate.parameters[k][0] / true - 1) for k, true in _sizes(scene).items()]
        of_fit = {"off": max(off), "rejected": bool(_fit_p_value(made, estimate) < LEVEL)}
        z = float(np.abs(fit_ratios(scene, estimate)).max())
    else:
        of_fit = {}
        z = float(np.sqrt(np.mean(ratios(made, stated, estimate) ** 2, axis=-1)).max())
    warnings = list(estimate.reasons)
    return {"z": z, **of_fit, "quality": str(estimate.quality), "warnings": warnings}


def _sizes(scene: ScannedScene) -> dict[str, float]:
    """The true values of parameters that are no place."""
    return {k: true for k, true in scene.parameters.items() if k != "position_m"}


def ratios(made: Scan, stated: Problem, estimate: Estimate) -> np.ndarray:
    """Errors of p and q (2, cell) over their standard errors, where the scan passed."""
    observed = stated.to_grid().observed_cells
    return errors(made, stated, estimate)[0] / np.asarray(estimate.stderr)[:, observed]


def errors(made: Scan, stated: Problem, estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Errors of p and q (2, cell), and their true values, less the means, where the scan passed."""
    observed, p = stated.to_grid().observed_cells, made.pressure(estimate.line)
    truth = np.stack([p, made.scene.friction * p])
    wrong = np.asarray(estimate.value) - truth
    return deviation(wrong, observed), deviation(truth, observed)


def fit_ratios(scene: ScannedScene, estimate: FeatureEstimate) -> np.ndarray:
    """Errors of the parameters over their standard errors."""
    read = estimate.parameters
    return np.array([(read[k][0] - true) / read[k][1] for k, true in scene.parameters.items()])


def _fit_p_value(made: Scan, estimate: FeatureEstimate) -> float:
    white = np.asarray(made.whitener()(as_real(estimate.data - estimate.fitted)))
    return float(chi2.sf(white @ white, white.size - len(estimate.parameters)))


def cases() -> list[Row]:
    """Every fault by every fit on a scene that it suits."""
    return [
        {"fault": name, "method": method}
        for name, fault in faults().items()
        for method in FITS
        if suits(fault, SCENES[METHODS[method].scene])
    ]


def summary(rows: list[Row]) -> Row:
    """Counts by quality, and which good answers are wrong by more than `MOST_STDERRS`."""
    made: Row = {"cases": len(rows)}
    for quality in ("good", "doubtful", "failed", "refused"):
        own = [row for row in rows if row["quality"] == quality]
        made[quality] = len(own)
    wrong = [row for row in rows if row["quality"] == "good" and row["z"] > MOST_STDERRS]
    made["good_and_rejected"] = sum(row["rejected"] for row in rows if row["quality"] == "good")
    made["wrong_and_good"] = [f"{row['fault']}: {row['method']}, {row['z']:.3g}" for row in wrong]
    made["no_answer"] = [
        f"{row['fault']}: {row['method']}"
        for row in rows
        if row["quality"] in ("failed", "refused")
    ]
    return made


STUDY = Study("faults", measured, cases, summary, rests_on=lambda fault, method: faults()[fault])
