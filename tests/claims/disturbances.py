"""What hum and drift cost an inversion (half an hour).

Hum of 0.1, 1 and 10 times the signal's rms at 50 and 150 Hz, each line a narrow-band Gaussian
process up to 2 Hz wide, is beside white noise of a hundredth of the signal, on one pass and on six
there and back, at a speed at which the skin transmits 50 Hz and at one at which it does not. Drift
is a random walk from zero whose rms at the end is 0.01 to 0.3 of the signal's.

Pressures are drawn from the prior that they are inverted under, friction known: the expected error
of the best estimator is then the exact posterior's floor, by dense algebra on all samples with the
true covariance. Besides, one realistic pressure is inverted under weights chosen by the evidence.
Every draw has noise, hum and walk of its own; an error over that without the disturbance is of the
same draws.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

import numpy as np

from srsinv.jobs.trials import Row
from tests.claims.disturbing import Disturbance, Drift, Hum
from tests.claims.pass_scans import (
    NOISE_V,
    DrawnErrors,
    PassScans,
    Truth,
    motion_of_passes,
    ratio_of,
)
from tests.claims.study import Study

KINDS: dict[str, type[Disturbance]] = {"hum": Hum, "drift": Drift}
# In all, with weights by the evidence, and of other treatments, by the number of passes.
DRAWS = {1: (100, 12, 20), 6: (40, 6, 10)}
LENGTH_M, FRICTION = 0.04, 0.3
MOTIONS = {
    f"{name}, {1e3 * speed:g} mm/s": (passes, speed)
    for speed in (20e-3, 100e-3)
    for name, passes in (("one pass", 1), ("six passes", 6))
}
SIZES = {"hum": (0.1, 1.0, 10.0), "drift": (0.01, 0.03, 0.1, 0.3)}  # over the signal
CLEAN = "without"


class Tally:
    """The draws of each treatment: errors, and those of the same draws without the disturbance."""

    def __init__(self):
        self._draws: dict[str, list[tuple[float, float, float, float]]] = defaultdict(list)

    def add(self, name: str, answer: DrawnErrors, clean: float, exact: float = np.nan) -> None:
        """A draw's answer beside the squares of the clean and of the exact estimator's errors."""
        row = float(answer.square[0]), float(answer.covered[0]), clean, exact
        self._draws[name].append(row)

    def summary(self, scale_Pa: float, floor_Pa: float | None = None) -> Row:
        """Of each treatment: the relative error, its ratios, with their standard errors, and what
        90 % bands cover."""
        summary = {}
        for name, draws in self._draws.items():
            square, covered, clean, exact = np.array(draws).T
            row = {
                "draws": len(draws),
                "error": float(np.sqrt(square.mean())) / scale_Pa,
                "over_clean": ratio_of(square, clean),
                "coverage": float(covered.mean()),
            }
            if floor_Pa is not None:
                row["over_floor"] = ratio_of(square, floor_Pa**2)
            if np.isfinite(exact).all():
                row["over_exact_of_same_draws"] = ratio_of(square, exact)
            summary[name] = row
        return summary


def tallies(own: Disturbance, draws: tuple[int, int, int], exact_map=None) -> tuple[Tally, Tally]:
    """Of a prior's pressures with weights held, and of the touches by the evidence; `exact_map`:
    of the exact posterior, from the signals."""
    held, chosen, scans = Tally(), Tally(), own.scans
    for index in range(draws[0]):
        rng = np.random.default_rng([index, own.seed])
        truth, noise = scans.drawn(rng), NOISE_V * rng.normal(size=scans.shape)
        added = own.drawn(rng)
        names = own.treatments if index < draws[2] else own.proper
        _add(held, own, names, scans.held, truth, noise, added, exact_map)
        if index < draws[1]:
            _add(chosen, own, own.proper, scans.by_evidence, scans.touches, noise, added)
    return held, chosen


def _add(
    tally: Tally,
    own: Disturbance,
    names: Iterable[str],
    invert: Callable,
    truth: Truth,
    noise,
    added,
    exact_map=None,
) -> None:
    """The draw without the disturbance, and with it by each of the treatments."""
    scans, quiet, exact = own.scans, own.scans.signal(truth) + noise, np.nan
    if exact_map is not None:
        mean = np.einsum("ies,es->i", exact_map, quiet + added, optimize=True)
        exact = float(scans.square(mean[None], truth)[0])
    clean = scans.answer(invert(scans.problem(quiet)), truth)
    tally.add(CLEAN, clean, float(clean.square[0]), exact)
    for name in names:
        answer = scans.answer(invert(own.treatments[name](quiet + added)), truth)
        tally.add(name, answer, float(clean.square[0]), exact)


def measured(
    disturbance: str, motion: str, size: float, draws: tuple[int, int, int] | None = None
) -> Row:
    """What it makes of the floor and of errors; of drift what is found of it, too."""
    scans = scans_of(motion)
    own, draws = KINDS[disturbance](scans, size), draws or draws_of(motion)
    floors, exact_map = [], None
    for covariance in own.covariances():
        posterior, exact_map = scans.floor(covariance)
        floors.append(scans.rms_of(posterior)[0])
    floor = float(scans.floor_Pa[0])
    is_drift = isinstance(own, Drift)
    held, chosen = tallies(own, draws, exact_map if is_drift else None)
    row = {
        "floor_over_floor_without": _rms(floors) / floor,
        "weights held": held.summary(prior_scale(scans), float(floors[0]) if is_drift else floor),
        "by evidence": chosen.summary(scale(scans, scans.touches)),
    }
    return row | ({"levels": levels(own, draws[0])} if is_drift else {})


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def scale(scans: PassScans, truth: Truth) -> float:
    """The rms of a pressure's deviation from its mean over the scan."""
    return float(np.sqrt(scans.square(0 * truth.traction, truth)[0]))


def prior_scale(scans: PassScans) -> float:
    """The same of the prior's pressures."""
    each = [scale(scans, scans.drawn(np.random.default_rng([i, 3]))) for i in range(200)]
    return _rms(each)


def levels(drift: Drift, draws: int) -> Row:
    """Of the drift that is found in touches and in the prior's pressures, over what it is: its
    median, and how often it is none."""
    scans, ratios = drift.scans, defaultdict(list)
    for index in range(draws):
        rng = np.random.default_rng([index, drift.seed])
        rough, noise = scans.signal(scans.drawn(rng)), NOISE_V * rng.normal(size=scans.shape)
        added = noise + drift.drawn(rng)
        for name, signal in (("touches", scans.signal(scans.touches)), ("prior", rough)):
            ratios[name].append(drift.found(signal + added) / drift.rate)
    return {
        name: {
            "median": float(np.median(each)),
            "missed": float(np.mean(np.array(each) == 0)),
        }
        for name, each in ratios.items()
    }


@lru_cache(maxsize=1)
def scans_of(motion: str) -> PassScans:
    """The recordings of one of the motions."""
    passes, speed = MOTIONS[motion]
    return PassScans(motion_of_passes(passes, LENGTH_M, speed), friction=FRICTION)


def draws_of(motion: str) -> tuple[int, int, int]:
    """How many draws are made of recordings of a motion."""
    return DRAWS[MOTIONS[motion][0]]


def cases() -> list[dict[str, Any]]:
    """Hum on all motions, drift on the slow ones."""
    return [
        {"disturbance": kind, "motion": motion, "size": size}
        for kind, sizes in SIZES.items()
        for motion in MOTIONS
        if kind == "hum" or "20 mm/s" in motion
        for size in sizes
    ]


STUDY = Study(
    "disturbances",
    measured,
    cases,
    rests_on=lambda disturbance, motion, size: {"draws": draws_of(motion)},
)
