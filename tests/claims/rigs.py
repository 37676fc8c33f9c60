"""What the standard errors of calibrations are worth (an hour).

Random rigs record a ridge of known height and width, and are calibrated on it; then another ridge,
which is fitted with the calibrated sensor, once with the calibration's covariance carried on and
once as if the rig were known exactly. The signals are those of a model of its own, with finer cells
and contact solved at every place (rig_scans.py).

A third of the rigs have one strip, a quarter are passed there and back. A rig's row has its
`pulls`, errors over standard errors, and its standard errors, in the order of `PARAMETERS` (those
of gains and depth relative); of the height fitted `with` and `without` the calibration's covariance
quality, pull and relative standard error.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import norm

from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.quality import Quality
from srsinv.inverse.rig.calibration import Calibration, calibrate
from srsinv.inverse.rig.error import RigError
from srsinv.jobs.trials import Row
from tests.claims.rig_scans import RIDGE, Rig, Rng, random_rig
from tests.claims.study import Study, combinations

RIGS = 1000
BAND = 0.9
LIMIT = float(norm.ppf((1 + BAND) / 2))
SILENT = 3.0  # standard errors: a good answer beyond them is a silent failure
PARAMETERS = (
    "gain_1", "gain_2", "depth_m", "angle_2_deg", "offset_2_m", "base_friction", "position_m"
)  # fmt: skip
OF_SCAN = "position_m", "base_friction"
HEIGHT = "height_m"


def rig_of(index: int) -> tuple[Rig, Rng]:
    """One of the study's rigs, and what its noise is drawn from."""
    rng = np.random.default_rng([index, 2])
    strips = 1 if index % 3 == 2 else 2
    return random_rig(rng, strips, turns=index // 3 % 4 == 3), rng


def calibrated(rig: Rig, rng: Rng) -> Calibration:
    """The calibration on the known ridge."""
    depth = rig.stated.depth_m
    signal = rig.recorded(rig.known, depth, rng)
    problem = rig.problem(signal, depth, rig.sensor(rig.stated))
    return calibrate(problem, RIDGE, {n: rig.known[n] for n in (HEIGHT, "width_m")})


def pulls(rig: Rig, made: Calibration) -> dict[str, float]:
    """Errors over standard errors; NaN where a parameter is not determined."""
    truth = rig.truth
    pulls = {n: (value - truth[n]) / error for n, (value, error) in made.parameters.items()}
    known = {n for n, (_, error) in made.parameters.items() if np.isfinite(error)}
    return {n: pull if n in known else np.nan for n, pull in pulls.items()}


def covered(values: Any) -> float:
    """Which of the pulls lie in the interval, as a fraction."""
    return float(np.mean(np.abs(values) <= LIMIT))


def refitted(rig: Rig, made: Calibration, rng: Rng) -> dict[str, FeatureEstimate]:
    """The fits of the later ridge, `with` the calibration's covariance and `without`."""
    value = {n: float(np.asarray(each)) for n, each in made.fit.value.items()}
    names = [n for n, (_, error) in made.parameters.items()
             if n not in OF_SCAN and np.isfinite(error)]  # fmt: skip
    at = [list(made.parameters).index(name) for name in names]
    best = np.array([made.parameters[name][0] for name in names])
    error = RigError(tuple(names), best, made.covariance[np.ix_(at, at)])
    gains = np.array([value[f"gain_{n}"] for n in range(1, len(rig.gains) + 1)])
    depth, sensor = value["depth_m"], made.model.sensor_of(value)
    signal = rig.recorded(rig.later, depth, rng) / gains[:, None]
    fit = FeatureFit({"ridge": RIDGE})
    return {
        name: fit(rig.problem(signal, depth, sensor, known))
        for name, known in (("with", error), ("without", None))
    }


def measured(rig: int) -> Row:
    """What becomes of one rig."""
    true, rng = rig_of(rig)
    made = calibrated(true, rng)
    found = pulls(true, made)
    row: Row = {
        "strips": len(true.gains), "turns": true.turns, "noise": true.noise,
        "quality": str(made.quality), "reasons": made.reasons,
        "pulls": [found.get(name) for name in PARAMETERS],
        "stderr": [_stderr(made, name) for name in PARAMETERS],
    }  # fmt: skip
    if made.quality is not Quality.FAILED:
        for name, fitted in refitted(true, made, rng).items():
            height, error = fitted.parameters[HEIGHT]
            pull = (height - true.later[HEIGHT]) / error if np.isfinite(error) else np.nan
            row[name] = [str(fitted.quality), pull, error / true.later[HEIGHT]]
    return {key: each for key, each in row.items() if each != ()}


def _stderr(made: Calibration, name: str) -> float | None:
    """A parameter's standard error, that of a gain or a depth relative."""
    if name not in made.parameters:
        return None
    value, error = made.parameters[name]
    return error / abs(value) if name.startswith(("gain", "depth")) else error


# --- what the rows say --------------------------------------------------------------------------


def summary(rows: Sequence[Row]) -> Row:
    """Coverage and scatter, of calibrations and of the later ridge's height, of what did not
    fail."""
    sound = [each for each in rows if each["quality"] != "failed"]
    kinds = {"all": sound} | {
        f"{strips} strips" if strips > 1 else "1 strip": [r for r in sound if r["strips"] == strips]
        for strips in (1, 2)
    }
    return {
        "band": BAND,
        "rigs": len(rows),
        "quality": dict(Counter(each["quality"] for each in rows)),
        "parameters": {kind: _of_parameters(own) for kind, own in kinds.items()},
        HEIGHT: {kind: _of_height(own) for kind, own in kinds.items()},
        "silent_failures": sum(map(_is_silent, sound)),
        "silent_failures_expected": _expected(sound),
    }


def _of_parameters(rows: Sequence[Row]) -> Row:
    return {
        name: _scatter([(each["pulls"][i], each["stderr"][i]) for each in rows])
        for i, name in enumerate(PARAMETERS)
    }


def _of_height(rows: Sequence[Row]) -> Row:
    return {
        name: _scatter([each[name][1:] for each in rows])
        | {"quality": dict(Counter(each[name][0] for each in rows))}
        for name in ("with", "without")
    }


def _scatter(pairs: Sequence[Sequence[Any]]) -> Row:
    """Of pulls and standard errors: how the intervals cover, the pulls' mean and mean square, and
    the standard errors' rms over that of the errors."""
    known = [pair for pair in pairs if None not in pair]
    if not known:
        return {"count": 0}
    pull, stderr = np.array(known, float).T
    return {
        "count": len(known),
        "coverage": covered(pull),
        "mean_pull": float(pull.mean()),
        "mean_square_pull": float(np.mean(pull**2)),
        "stderr_over_scatter": float(np.sqrt(np.mean(stderr**2) / np.mean((pull * stderr) ** 2))),
        "median_stderr": float(np.median(stderr)),
        "stderr_5_to_95_percent": [float(each) for each in np.quantile(stderr, (0.05, 0.95))],
    }


def _is_silent(own: Row) -> bool:
    """Whether a good calibration has a parameter beyond `SILENT` standard errors."""
    beyond = [pull is not None and abs(pull) > SILENT for pull in own["pulls"]]
    return own["quality"] == "good" and any(beyond)


def _expected(rows: Sequence[Row]) -> float:
    """How many silent failures normal errors would make, were those of a rig independent."""
    beyond = 2 * norm.sf(SILENT)
    good = [sum(p is not None for p in r["pulls"]) for r in rows if r["quality"] == "good"]
    return float(sum(1 - (1 - beyond) ** count for count in good))


STUDY = Study("rigs", measured, lambda: combinations(rig=range(RIGS)), summary)
