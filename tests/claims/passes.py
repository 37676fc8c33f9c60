"""What passes there and back gain an inversion (minutes).

One to 32 passes of two elements in white noise of a hundredth of the signal, p and q apart, drawn
from the prior that they are inverted under: the expected error of the best estimator is the exact
posterior's floor for the noise of all samples. By how much the stage is ahead, 10 to 45 um either
way in each pass, is fitted besides: once with a mean of zero over the passes of each way, and once
as drawn, when nothing tells the mean. One realistic traction is inverted under weights chosen by
the evidence. One element both ways stands beside two elements one way and both.
"""

from functools import cache, lru_cache

import numpy as np

from srsinv.jobs.trials import Row
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
from tests.claims.study import Study

LENGTH_M, SPEED_M_PER_S = 0.02, 20e-3
COUNTS = (1, 2, 4, 8, 16, 32)
SHIFTS_M = (10e-6, 45e-6)
ANGLES_DEG = (0.0, 45.0)  # of the elements
NOISE, HELD, BY_EVIDENCE = "noise alone", "weights held", "by evidence"
SHIFTED = {"shifts": True, "shifts, mean too": False}  # whether their mean is zero
DRAWS = {NOISE: 20, HELD: 100, BY_EVIDENCE: 10, **dict.fromkeys(SHIFTED, 100)}


@lru_cache(maxsize=1)
def scans_of(elements: int, passes: int) -> PassScans:
    """So many passes of so many elements, over traction of the same prior."""
    motion = motion_of_passes(passes, LENGTH_M, SPEED_M_PER_S)
    made = PassScans(motion, ANGLES_DEG[:elements])
    made.step_Pa = step_Pa()
    return made


@cache
def step_Pa() -> np.ndarray:
    """The prior's: that of a signal of one pass of 100 times the noise."""
    return PassScans(motion_of_passes(1, LENGTH_M, SPEED_M_PER_S), ANGLES_DEG).step_Pa


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
    return float(np.sqrt(np.mean(squares) * count) / one)


def answer(scans: PassScans, treatment: str, index: int) -> DrawnErrors:
    """The errors of one draw."""
    rng = np.random.default_rng([index, 4])
    truth, noise = scans.drawn(rng), NOISE_V * rng.normal(size=scans.shape)
    if treatment == BY_EVIDENCE:
        signal = scans.signal(scans.touches) + noise
        return scans.answer(scans.by_evidence(scans.problem(signal)), scans.touches)
    ahead = {name: stage_ahead(scans, rng, is_centred) for name, is_centred in SHIFTED.items()}
    signal = scans.signal(truth, ahead.get(treatment, 0.0)) + noise
    return scans.answer(scans.held(scans.problem(signal)), truth)


def measured(elements: int, passes: int, treatment: str, draws: int) -> Row:
    """Of p and of q what bands cover, and the error over the floor, with its standard error; of
    the touches the relative error."""
    scans = scans_of(elements, passes)
    if treatment == NOISE:
        return {"times_root_of_passes": noise_of_mean(scans, draws)}
    answers = [answer(scans, treatment, index) for index in range(draws)]
    square, covered = (np.array(each) for each in zip(*answers, strict=True))
    row = {name: {"coverage": float(covered[:, c].mean())} for c, name in enumerate("pq")}
    size = scans.square(0 * scans.touches.traction, scans.touches)
    for c, own in enumerate(row.values()):
        if treatment == BY_EVIDENCE:
            own["error"] = float(np.sqrt(square[:, c].mean() / size[c]))
        else:
            floor = float(scans.floor_Pa[c])
            own |= {"over_floor": ratio_of(square[:, c], floor**2), "floor_Pa": floor}
    return row


def cases() -> list[Row]:
    """One element both ways, and two elements over all numbers of passes."""
    return [
        {"elements": elements, "passes": passes, "treatment": treatment, "draws": draws}
        for elements, passes in ((1, 2), *((2, count) for count in COUNTS))
        for treatment, draws in DRAWS.items()
        if passes > 2 or treatment not in SHIFTED
    ]


STUDY = Study("passes", measured, cases)
