"""What hum and drift cost an inversion: `python -m tests.claims.disturbances` (half an hour).

Hum of 0.1, 1 and 10 times the signal's rms at 50 and 150 Hz, each line a narrow-band Gaussian
process up to 2 Hz wide, is beside white noise of a hundredth of the signal, on one pass and on six
there and back, at a speed at which the skin transmits 50 Hz and at one at which it does not. Drift
is a random walk from zero whose rms at the end is 0.01 to 0.3 of the signal's.

Pressures are drawn from the prior that they are inverted under, friction known: the expected error
of the best estimator is then the exact posterior's floor, by dense algebra on all samples with the
true covariance. Besides, one realistic pressure is inverted under weights chosen by the evidence.
Every draw has noise, hum and walk of its own; an error over that without the disturbance is of the
same draws. Writes results/disturbances.json, case by case, and goes on from what it holds.
"""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from srsinv.false_alarm import DRIFT_WHERE_NAMED
from srsinv.recording.drift import common_level, drift_of
from tests.claims.disturbing import (
    RMS_V,
    WIDTHS_HZ,
    drift_treatments,
    hum,
    hum_covariance,
    hum_treatments,
    recording,
    walk_covariance,
)
from tests.claims.pass_scans import (
    NOISE_V,
    DrawnErrors,
    PassScans,
    Truth,
    motion_of_passes,
    ratio_of,
)

RESULTS = Path(__file__).parent / "results" / "disturbances.json"
# In all, with weights by the evidence, and of other treatments, by the number of passes.
DRAWS = {1: (100, 12, 20), 6: (40, 6, 10)}
LENGTH_M, FRICTION = 0.04, 0.3
MOTIONS = {
    f"{name}, {1e3 * speed:g} mm/s": (passes, speed)
    for speed in (20e-3, 100e-3)
    for name, passes in (("one pass", 1), ("six passes", 6))
}
SIZES, REACHES = (0.1, 1.0, 10.0), (0.01, 0.03, 0.1, 0.3)
CLEAN = "without"


class Tally:
    """The draws of each treatment: errors, and those of the same draws without the disturbance."""

    def __init__(self):
        self._draws: dict[str, list[tuple[float, float, float, float]]] = defaultdict(list)

    def add(self, name: str, answer: DrawnErrors, clean: float, exact: float = np.nan) -> None:
        """A draw's answer beside the squares of the clean and of the exact estimator's errors."""
        row = float(answer.square[0]), float(answer.covered[0]), clean, exact
        self._draws[name].append(row)

    def summary(self, scale_Pa: float, floor_Pa: float | None = None) -> dict[str, Any]:
        """Of each treatment: the relative error, its ratios, with their standard errors, and what
        90 % bands cover."""
        summary = {}
        for name, draws in self._draws.items():
            square, covered, clean, exact = np.array(draws).T
            row = {
                "draws": len(draws),
                "error": round(float(np.sqrt(square.mean())) / scale_Pa, 5),
                "over_clean": ratio_of(square, clean),
                "coverage": round(float(covered.mean()), 4),
            }
            if floor_Pa is not None:
                row["over_floor"] = ratio_of(square, floor_Pa**2)
            if np.isfinite(exact).all():
                row["over_exact_of_same_draws"] = ratio_of(square, exact)
            summary[name] = row
        return summary


def hum_draws(scans: PassScans, draws: tuple[int, int, int]):
    """All sizes of hum on one motion: tallies with weights held, and with chosen ones."""
    held, chosen = defaultdict(Tally), defaultdict(Tally)
    treatments, time_s = hum_treatments(scans), np.asarray(scans.motion.time_s)
    for index in range(draws[0]):
        rng = np.random.default_rng([index, 1])
        truth, noise = scans.drawn(rng), NOISE_V * rng.normal(size=scans.shape)
        waves = RMS_V * hum(rng, time_s, len(noise))
        quiet = scans.signal(truth) + noise
        clean = scans.answer(scans.held(scans.problem(quiet)), truth)
        for size in SIZES:
            held[f"{size:g}"].add(CLEAN, clean, float(clean.square[0]))
            for name, treated in treatments.items():
                if name == "mains" or index < draws[2]:
                    answer = scans.answer(scans.held(treated(quiet + size * waves)), truth)
                    held[f"{size:g}"].add(name, answer, float(clean.square[0]))
        if index < draws[1]:
            quiet = scans.signal(scans.touches) + noise
            _hum_by_evidence(scans, chosen, quiet, waves)
    return held, chosen


def _hum_by_evidence(scans: PassScans, chosen, quiet, waves) -> None:
    truth, named = scans.touches, hum_treatments(scans)["mains"]
    clean = scans.answer(scans.by_evidence(scans.problem(quiet)), truth)
    for size in SIZES:
        answer = scans.answer(scans.by_evidence(named(quiet + size * waves)), truth)
        for name, each in ((CLEAN, clean), ("mains", answer)):
            chosen[f"{size:g}"].add(name, each, float(clean.square[0]))


def hum_case(scans: PassScans, draws: tuple[int, int, int]) -> dict[str, Any]:
    """Of a prior's pressures with weights held, and of the touches by the evidence; and what such
    hum makes of the floor."""
    held, chosen = hum_draws(scans, draws)
    (floor,) = scans.rms_of(scans.floor()[0])
    with_hum = {
        f"{size:g}": [
            scans.rms_of(scans.floor(hum_covariance(scans, size, each))[0])[0] for each in WIDTHS_HZ
        ]
        for size in SIZES
    }
    return {
        level: {
            "floor_over_floor_without": round(_rms(with_hum[level]) / float(floor), 4),
            "weights held": tally.summary(prior_scale(scans), float(floor)),
            "by evidence": chosen[level].summary(scale(scans, scans.touches)),
        }
        for level, tally in held.items()
    }


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def scale(scans: PassScans, truth: Truth) -> float:
    """The rms of a pressure's deviation from its mean over the scan."""
    return float(np.sqrt(scans.square(0 * truth.traction, truth)[0]))


def prior_scale(scans: PassScans) -> float:
    """The same of the prior's pressures."""
    each = [scale(scans, scans.drawn(np.random.default_rng([i, 3]))) for i in range(200)]
    return _rms(each)


def drift_case(scans: PassScans, reach: float, draws: tuple[int, int, int]) -> dict[str, Any]:
    """A walk on one motion that reaches this part of the signal's rms."""
    drift = reach * RMS_V / np.sqrt(scans.duration_s)
    (without,) = scans.rms_of(scans.floor()[0])
    posterior, exact_map = scans.floor(walk_covariance(scans, drift))
    (floor,) = scans.rms_of(posterior)
    held, chosen, treatments = Tally(), Tally(), drift_treatments(scans, drift)
    for index in range(draws[0]):
        rng = np.random.default_rng([index, 2])
        truth, noise = scans.drawn(rng), NOISE_V * rng.normal(size=scans.shape)
        walk = np.cumsum(rng.normal(size=scans.shape), axis=1) * drift / np.sqrt(scans.rate_Hz)
        quiet = scans.signal(truth) + noise
        clean = scans.answer(scans.held(scans.problem(quiet)), truth)
        exact = np.einsum("ies,es->i", exact_map, quiet + walk, optimize=True)
        errors = float(clean.square[0]), float(scans.square(exact[None], truth)[0])
        held.add(CLEAN, clean, *errors)
        for name, treated in treatments.items():
            if name in ("stated", "found") or index < draws[2]:
                answer = scans.answer(scans.held(treated(quiet + walk)), truth)
                held.add(name, answer, *errors)
        if index < draws[1]:
            _drift_by_evidence(scans, chosen, noise, walk, treatments)
    return {
        "floor_over_floor_without": round(float(floor / without), 4),
        "weights held": held.summary(prior_scale(scans), float(floor)),
        "by evidence": chosen.summary(scale(scans, scans.touches)),
    }


def _drift_by_evidence(scans: PassScans, chosen: Tally, noise, walk, treatments) -> None:
    truth = scans.touches
    quiet = scans.signal(truth) + noise
    clean = scans.answer(scans.by_evidence(scans.problem(quiet)), truth)
    chosen.add(CLEAN, clean, float(clean.square[0]))
    for name in ("stated", "found"):
        answer = scans.answer(scans.by_evidence(treatments[name](quiet + walk)), truth)
        chosen.add(name, answer, float(clean.square[0]))


def levels(scans: PassScans, reach: float, draws: int) -> dict[str, Any]:
    """Of the drift that is found in touches and in the prior's pressures, over what it is: its
    median, and how often it is none."""
    drift, ratios = reach * RMS_V / np.sqrt(scans.duration_s), defaultdict(list)
    for index in range(draws):
        rng = np.random.default_rng([index, 2])
        rough, noise = scans.signal(scans.drawn(rng)), NOISE_V * rng.normal(size=scans.shape)
        walk = np.cumsum(rng.normal(size=scans.shape), axis=1) * drift / np.sqrt(scans.rate_Hz)
        for name, signal in (("touches", scans.signal(scans.touches)), ("prior", rough)):
            level = common_level(
                drift_of(recording(scans, signal + noise + walk), DRIFT_WHERE_NAMED)
            )
            ratios[name].append(level / drift)
    return {
        name: {
            "median": round(float(np.median(each)), 4),
            "missed": round(float(np.mean(np.array(each) == 0)), 4),
        }
        for name, each in ratios.items()
    }


def scans_of(motion: str) -> PassScans:
    """The recordings of one of the motions."""
    passes, speed = MOTIONS[motion]
    return PassScans(motion_of_passes(passes, LENGTH_M, speed), friction=FRICTION)


def main() -> None:
    """Measure what is missing."""
    record = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"hum": {}, "drift": {}}
    record.setdefault("levels", {})
    for motion, (passes, _) in MOTIONS.items():
        scans, draws = scans_of(motion), DRAWS[passes]
        if motion not in record["hum"]:
            record["hum"][motion] = hum_case(scans, draws)
            RESULTS.write_text(json.dumps(record, indent=1) + "\n")
        slow = record["drift"].setdefault(motion, {}) if "20 mm/s" in motion else None
        for reach in REACHES if slow is not None else ():
            if f"{reach:g}" not in slow:
                slow[f"{reach:g}"] = drift_case(scans, reach, draws)
            of_motion = record["levels"].setdefault(motion, {})
            if f"{reach:g}" not in of_motion:
                of_motion[f"{reach:g}"] = levels(scans, reach, draws[0])
            RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
