"""Faulty recordings through the inversions: what rule and noise cost, beside the best weights in
hindsight, and what bands hold (half an hour).

The faults, scenes and scores are those of `experiment=robustness`.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.robustness import TRACTION_SCENES, answer_of, hindsight_of, recorded
from experiments.robustness.faults import faults, suits
from experiments.robustness.scans import SCENES
from srsinv.inverse.line.rule import Evidence
from srsinv.inverse.method import Method
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Wiener
from srsinv.jobs.trials import Row
from tests.claims.study import Study

DRAWS, CELL_M = 2, 2e-4
LOST = 1.5  # times the error of the best weights: beyond it something is lost
METHODS: dict[str, Method] = {
    "tikhonov": Tikhonov(1, rule=Evidence()), "wiener": Wiener(scale="evidence")
}  # fmt: skip


def measured(scene: str, fault: str) -> Row:
    """The scores of one fault."""
    best, answers = [], {name: [] for name in METHODS}
    for draw in range(DRAWS):
        given = recorded(scene, fault, draw, CELL_M)
        best.append(hindsight_of(given))
        for name, method in METHODS.items():
            answers[name].append(answer_of(given, method))
    return scored(best, answers)


def scored(best: Sequence[Row], answers: Mapping[str, Sequence[Row]]) -> Row:
    """The rms error of p and q by the best weights; of each method that over it, what 90 % bands
    hold of the worse of the two, and the quality of each answer."""
    least = _rms(best)
    row: Row = {"best": least}
    for name, each in answers.items():
        row |= {
            f"ratio_{name}": _rms(each) / least,
            f"covered_{name}": float(np.mean([one["coverage"] for one in each], axis=0).min()),
            f"quality_{name}": [one["quality"] for one in each],
        }
    return row


def _rms(rows: Sequence[Row]) -> float:
    return float(np.sqrt(np.mean(np.square([row["error"] for row in rows]))))


def cases() -> list[Row]:
    """Every fault in every scene that it suits and leaves p and q to be found in."""
    return [
        {"scene": scene, "fault": name}
        for scene in TRACTION_SCENES
        for name, fault in faults().items()
        if suits(fault, SCENES[scene]) and fault["does"] != "dead"
    ]


def summary(rows: list[Row]) -> Row:
    """Of each method how many answers fail, how many faults cost more than `LOST`, and which of
    these say nothing."""
    made: Row = {"cases": len(rows)}
    for name in METHODS:
        lost = [row for row in rows if row[f"ratio_{name}"] > LOST]
        made[name] = {
            "failed": sum("failed" in row[f"quality_{name}"] for row in rows),
            "median_ratio": float(np.median([row[f"ratio_{name}"] for row in rows])),
            "lost": len(lost),
            "lost_and_good": sorted(
                f"{row['fault']}, {row['scene']}"
                for row in lost
                if "good" in row[f"quality_{name}"]
            ),
        }
    return made


STUDY = Study("robustness", measured, cases, summary, rests_on=lambda scene, fault: faults()[fault])
