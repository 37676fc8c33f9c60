"""What calibrations, fits and inversions make of what laboratories have: answers that are good and
wrong.

On files of a known truth (lab_cases.yaml, lab_scans.py), as the jobs read them. A case's row has
its answers by what gave them. Of every answer:

- `z`: of a fit or a calibration each parameter's error over its standard error, null where that is
  infinite or none; of an inversion the rms over the cells that were passed, of p and of q;
- `covers`: which of the 90 % bands hold the truth there;
- `quality`, and the `warnings` that were given.

An answer is beyond where a parameter is by more than four standard errors, where z is above 2 or
where bands cover less than 75 %.
"""

import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from srsinv.errors import BadInput
from srsinv.forward.surface_feature import RidgeFeature, TapeFeature
from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.calibration import Calibration, calibrate
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Wiener
from srsinv.jobs.trials import Row
from srsinv.numerics import BAND_90
from srsinv.recorded import problem_of
from srsinv.recording.even import load_even
from tests.claims.lab_scans import KNOWN, LATER, ZONE_M, Lab, Load, load, recorded, write
from tests.claims.study import Study, combinations

CASES = Path(__file__).with_name("lab_cases.yaml")
MOST_STDERRS, MOST_RMS, LEAST_COVERED = 4.0, 2.0, 0.75
SEED = 0
OF_SCAN = "position_m", "base_friction"
Answers = dict[str, Row]


def _load(lab: Lab, ridge: Mapping[str, float]) -> Load:
    return load(lab, ridge["height_m"], ridge["width_m"], ridge["position_m"])


def _problem(lab: Lab, made: Load, facts: Mapping[str, Any], seed: int) -> Problem:
    """The problem of the file that the logger writes."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), recorded(lab, made, rng), lab.facts | facts)
        return problem_of(load_even({"path": str(path)}, {}))


# --- what is made of a recording ----------------------------------------------------------------


def _calibrated(
    lab: Lab, facts: Mapping[str, Any], how: Mapping[str, Any], seed: int
) -> Calibration:
    stated, held = lab.facts | facts, {n: KNOWN[n] for n in ("height_m", "width_m")}
    depth = how.get("stated_depth_m")
    if depth is not None:
        stated["sensor"] = stated["sensor"] | {"depth_m": depth}
    held |= {name: stated["sensor"][name] for name in how.get("hold", ())}
    problem = _problem(lab, _load(lab, KNOWN), stated, seed)
    return calibrate(problem, RidgeFeature(stated["feature"]["edge_length_m"]), held)


def _calibrate(lab: Lab, facts: Mapping[str, Any], how: Mapping[str, Any], seed: int) -> Answers:
    made = _calibrated(lab, facts, how, seed)
    return {"calibration": _row(made, lab.rig | {"position_m": KNOWN["position_m"]})}


def _calibrate_and_fit(
    lab: Lab, facts: Mapping[str, Any], how: Mapping[str, Any], seed: int
) -> Answers:
    """A calibration, and a later ridge that is fitted with it."""
    made = _calibrated(lab, facts, how, seed)
    rows = {"calibration": _row(made, lab.rig | {"position_m": KNOWN["position_m"]})}
    names = [n for n, (_, error) in made.parameters.items()
             if n not in OF_SCAN and np.isfinite(error)]  # fmt: skip
    at = [list(made.parameters).index(name) for name in names]
    found = {n: value for n, (value, _) in made.parameters.items()}
    first, second = lab.facts["sensor"]["elements"]
    second |= {"angle_deg": found["angle_2_deg"], "offset_m": found["offset_2_m"]}
    sensor = {"depth_m": found["depth_m"], "elements": [first, second]}
    error = {"parameters": names, "values": [found[n] for n in names],
             "covariance": made.covariance[np.ix_(at, at)].tolist(),
             "warnings": " ".join(made.warnings) or None}  # fmt: skip
    calibrated = {"sensor": lab.facts["sensor"] | sensor, "rig_error": error,
                  "gain": [found["gain_1"], found["gain_2"]]}  # fmt: skip
    return rows | _fit_ridge(lab, dict(facts) | calibrated, how, seed + 1)


def _fit_ridge(lab: Lab, facts: Mapping[str, Any], how: Mapping[str, Any], seed: int) -> Answers:
    stated = lab.facts | facts
    problem = _problem(lab, _load(lab, LATER), stated, seed)
    ridge = RidgeFeature(stated["feature"]["edge_length_m"])
    fitted = FeatureFit({"it": ridge})(problem)
    return {"fit": _row(fitted, LATER | {"base_friction": lab.friction})}


def _fit_tape(lab: Lab, facts: Mapping[str, Any], how: Mapping[str, Any], seed: int) -> Answers:
    problem = _problem(lab, _load(lab, LATER), facts, seed)
    edge = lab.facts["feature"]["edge_length_m"]
    tape = TapeFeature(edge, friction_follows=how.get("follows", "motion"))
    fitted = FeatureFit({"it": tape})(problem)
    assert lab.edges is not None
    names = "leading_edge_friction", "trailing_edge_friction"
    own = dict(zip(names, lab.edges, strict=True)) | {"friction_zone_length_m": ZONE_M}
    return {"fit": _row(fitted, LATER | own | {"base_friction": lab.friction})}


def _invert(lab: Lab, facts: Mapping[str, Any], how: Mapping[str, Any], seed: int) -> Answers:
    load = _load(lab, LATER)
    problem = _problem(lab, load, facts, seed)
    rows = {}
    for name, method in (("gcv", Tikhonov(1)), ("wiener", Wiener(scale="evidence"))):
        estimate = method(problem)
        x, cell = np.asarray(estimate.line.x), float(estimate.line.cell_m)
        p, q = load.excess, load.frictions[0] * load.pressure
        truth = np.stack([load.cell_means(each, x, cell) for each in (p, q)])
        passed = problem.to_grid().observed_cells
        value, stderr = estimate.deviation(passed)
        wrong = (value - truth)[:, passed]
        wrong -= wrong.mean(axis=-1, keepdims=True)
        with np.errstate(divide="ignore"):  # where there is no answer
            z = wrong / stderr[:, passed]
        rows[name] = {
            "z": dict(zip("pq", np.sqrt(np.mean(z**2, axis=-1)).tolist(), strict=True)),
            "covers": float(np.mean(np.abs(z) < BAND_90)),
            "quality": str(estimate.quality),
            "warnings": list(estimate.reasons),
        }
    return rows


def _row(made: Calibration | FeatureEstimate, truth: Mapping[str, float]) -> Row:
    found = {n: pair for n, pair in made.parameters.items() if n in truth}
    z = {n: (value - truth[n]) / error if np.isfinite(error) else None
         for n, (value, error) in found.items()}  # fmt: skip
    return {"z": z, "quality": str(made.quality), "warnings": list(made.reasons)}


DOES: Mapping[str, Callable[[Lab, Mapping[str, Any], Mapping[str, Any], int], Answers]] = {
    "calibrate": _calibrate, "calibrate_and_fit": _calibrate_and_fit, "fit_ridge": _fit_ridge,
    "fit_tape": _fit_tape, "invert": _invert,
}  # fmt: skip


# --- the study ----------------------------------------------------------------------------------


@cache
def cases() -> dict[str, dict[str, Any]]:
    """The cases by their names."""
    return yaml.safe_load(CASES.read_text(encoding="utf-8"))


def answers(case: str) -> Answers:
    """The answers in a case, by what gave them."""
    given = cases()[case]
    own = dict(given.get("lab", {}))
    if "edges" in own:
        own["edges"] = tuple(own["edges"])
    try:
        return DOES[given["does"]](Lab(**own), given.get("facts", {}), given.get("how", {}), SEED)
    except BadInput as refusal:
        return {"refusal": {"z": {}, "quality": "refused", "warnings": [str(refusal)]}}


def is_beyond(row: Mapping[str, Any]) -> bool:
    """Whether an answer is off by more than it says."""
    worst = max((abs(z) for z in row["z"].values() if z is not None), default=0.0)
    is_inversion = "covers" in row
    return worst > (MOST_RMS if is_inversion else MOST_STDERRS) or (
        is_inversion and row["covers"] < LEAST_COVERED
    )


def summary(rows: list[Row]) -> Row:
    """How many answers are beyond, and which of these are good by their own word."""
    every = {
        f"{row['case']}: {by}": answer
        for row in rows
        for by, answer in row.items()
        if isinstance(answer, dict)
    }
    beyond = {name: answer for name, answer in every.items() if is_beyond(answer)}
    good = [name for name, answer in beyond.items() if answer["quality"] == "good"]
    return {"answers": len(every), "beyond": len(beyond), "good_and_beyond": good}


STUDY = Study(
    "lab_cases",
    answers,
    lambda: combinations(case=cases()),
    summary,
    rests_on=lambda case: cases()[case],
)
