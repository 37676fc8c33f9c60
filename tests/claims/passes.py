"""What passes there and back gain an inversion: `python -m tests.claims.passes` (minutes).

One to 32 passes of two elements in white noise of a hundredth of the signal, p and q apart, drawn
from the prior that they are inverted under: the expected error of the best estimator is the exact
posterior's floor for the noise of all samples. By how much the stage is ahead, 10 to 45 um either
way in each pass, is fitted besides: once with a mean of zero over the passes of each way, and once
as drawn, when nothing tells the mean. One realistic traction is inverted under weights chosen by
the evidence. Then one element both ways stands beside two elements one way and both. Writes
results/passes.json, case by case, and goes on from what it holds.
"""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from srsinv.recording.passes import passes_of
from tests.claims.pass_scans import (
    CELL_M,
    NOISE_V,
    SPACING_M,
    DrawnErrors,
    PassScans,
    Rng,
    motion_of_passes,
    ratio_of,
)

RESULTS = Path(__file__).parent / "results" / "passes.json"
DRAWS, BY_EVIDENCE, DRAWS_OF_NOISE = 100, 10, 20
LENGTH_M, SPEED_M_PER_S = 0.02, 20e-3
COUNTS = (1, 2, 4, 8, 16, 32)
SHIFTS_M = (10e-6, 45e-6)
SENSORS = {
    "one element, both ways": ((0.0,), 2),
    "two elements, one way": ((0.0, 45.0), 1),
    "two elements, both ways": ((0.0, 45.0), 2),
}


def scans_of(passes: int, angles_deg=(0.0, 45.0), step_Pa=None) -> PassScans:
    """So many passes; `step_Pa`: the prior's, or that of a signal of 100 times the noise."""
    made = PassScans(motion_of_passes(passes, LENGTH_M, SPEED_M_PER_S), angles_deg)
    made.step_Pa = made.step_Pa if step_Pa is None else step_Pa
    return made


def stage_ahead(scans: PassScans, rng: Rng, is_centred: bool):
    """By how much the stage is ahead at each sample, one number for each pass."""
    passes = passes_of(np.asarray(scans.motion.position_m))
    ahead = rng.choice([-1, 1], size=len(passes)) * rng.uniform(*SHIFTS_M, size=len(passes))
    direction = np.array([each.is_onwards for each in passes])
    if is_centred:
        for each in (True, False):
            ahead[direction == each] -= ahead[direction == each].mean()
    along = np.zeros(scans.position.size)
    for one, shift in zip(passes, ahead, strict=True):
        along[one.samples] = shift
    return along


def noise_of_mean(scans: PassScans, draws: int) -> float:
    """The rms of the noise on the cells that every pass crosses at full speed, over that of one
    pass over the root of the passes of its way."""
    squares, steady = [], np.abs(np.asarray(scans.line.line.x)) < LENGTH_M / 2 - CELL_M
    for index in range(draws):
        noise = NOISE_V * np.random.default_rng([index, 5]).normal(size=scans.shape)
        data = np.asarray(scans.problem(noise).to_grid().data)[:, steady]
        squares.append(np.mean(data**2))
    count = len(passes_of(np.asarray(scans.motion.position_m))) * scans.shape[0] / len(data)
    one = NOISE_V / np.sqrt(CELL_M / SPACING_M)
    return round(float(np.sqrt(np.mean(squares) * count) / one), 4)


def summary(answers: list[DrawnErrors], floor) -> dict[str, Any]:
    """Of p and of q: the error over the floor, with its standard error, and what bands cover."""
    square, covered = (np.array(each) for each in zip(*answers, strict=True))
    return {
        name: {
            "over_floor": ratio_of(square[:, c], floor[c] ** 2),
            "coverage": round(float(covered[:, c].mean()), 4),
        }
        for c, name in enumerate("pq")
    }


def measured(scans: PassScans, draws: tuple[int, int], is_shifted: bool) -> dict[str, Any]:
    """All draws on one motion."""
    floor = scans.rms_of(scans.floor()[0])
    answers: dict[str, list[DrawnErrors]] = defaultdict(list)
    for index in range(draws[0]):
        rng = np.random.default_rng([index, 4])
        truth, noise = scans.drawn(rng), NOISE_V * rng.normal(size=scans.shape)
        ahead = {"weights held": 0.0}
        if is_shifted:
            ahead["shifts"] = stage_ahead(scans, rng, True)
            ahead["shifts, mean too"] = stage_ahead(scans, rng, False)
        for name, shift in ahead.items():
            signal = scans.signal(truth, shift) + noise
            answers[name].append(scans.answer(scans.held(scans.problem(signal)), truth))
        if index < draws[1]:
            estimate = scans.by_evidence(scans.problem(scans.signal(scans.touches) + noise))
            answers["by evidence"].append(scans.answer(estimate, scans.touches))
    chosen = answers.pop("by evidence", [])
    return {
        "draws": draws,
        "floor_Pa": [round(float(each), 2) for each in floor],
        **{name: summary(each, floor) for name, each in answers.items()},
        "by evidence": of_touches(scans, chosen) if chosen else {},
    }


def of_touches(scans: PassScans, answers: list[DrawnErrors]) -> dict[str, Any]:
    """Of p and of q: the relative error, and what bands cover."""
    square, covered = (np.mean(each, axis=0) for each in zip(*answers, strict=True))
    size = np.sqrt(scans.square(0 * scans.touches.traction, scans.touches))
    return {
        name: {
            "error": round(float(np.sqrt(square[c]) / size[c]), 5),
            "coverage": round(float(covered[c]), 4),
        }
        for c, name in enumerate("pq")
    }


def main() -> None:
    """Measure what is missing."""
    record = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"passes": {}, "sensors": {}}
    of_noise = record.setdefault("noise_times_root_of_passes", {})
    step_Pa, draws = scans_of(1).step_Pa, (DRAWS, BY_EVIDENCE)
    for name, (angles_deg, passes) in SENSORS.items():
        if name not in record["sensors"]:
            scans = scans_of(passes, angles_deg, step_Pa)
            record["sensors"][name] = measured(scans, draws, False)
            RESULTS.write_text(json.dumps(record, indent=1) + "\n")
    for passes in COUNTS:
        if f"{passes}" not in record["passes"]:
            scans = scans_of(passes, step_Pa=step_Pa)
            record["passes"][f"{passes}"] = measured(scans, draws, passes > 2)
            of_noise[f"{passes}"] = noise_of_mean(scans, DRAWS_OF_NOISE)
            RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
