"""Trials in turn, until all are measured or the time is over."""

import math
import time
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..progress import stage, steps
from ..report.text import sized
from ._cost_rows import RowFile
from ._cost_trials import CostTrial, Row, measured

LEAST_GROWTH = 1.0  # power of the size with which a family's time grows, at least


class MeasuredTrials(NamedTuple):
    """Rows in the order of the trials, and the trials that were left out for want of time."""

    rows: list[Row]
    left_out: list[CostTrial]


def run(
    trials: Sequence[CostTrial],
    repeats: int,
    known: RowFile,
    budget_s: float | None = None,
    is_fresh: bool = False,
) -> MeasuredTrials:
    """Measure the trials that `known` has no row of, while the budget [s] lasts.

    The group that has had the least time is next, from few families and small sizes on. A trial
    that would outlast the budget, by what it took its family at smaller sizes, is left out; smaller
    ones may follow. `is_fresh`: whether each first call compiles all of its programs anew.
    """
    started, forecast, rows = time.monotonic(), Forecast(), {}
    queue = Queue(trials)
    with steps("accuracy against cost", range(len(trials))) as each:
        for _ in each:
            trial = queue.next()
            row = known.row(trial)
            if row is None:
                left = math.inf if budget_s is None else budget_s - (time.monotonic() - started)
                if left <= 0 or forecast(trial) > left:
                    continue
                with stage(f"{trial.part}, {trial.line}, {trial.family}, {sized(trial.size)}"):
                    row = measured(trial, repeats, is_fresh)
                known.add(trial, row)
            queue.spend(trial, row["trial_s"])
            forecast.learn(trial, row)
            rows[trial.key] = row
    return MeasuredTrials(
        [rows[trial.key] for trial in trials if trial.key in rows],
        [trial for trial in trials if trial.key not in rows],
    )


class Queue:
    """Trials in the order of their groups' time: next is the first one left of that group which has
    had the least. Within a group the second size of the first family comes with the first size of
    the second one, and so on, so that little time shows some of both."""

    def __init__(self, trials: Iterable[CostTrial]):
        families: dict[tuple[str, str], list[str]] = defaultdict(list)
        sizes: dict[tuple[str, str, str], int] = defaultdict(int)
        waiting: dict[str, list[tuple[int, CostTrial]]] = defaultdict(list)
        for trial in trials:
            own, family = families[trial.part, trial.line], _family(trial)
            if trial.family not in own:
                own.append(trial.family)
            waiting[trial.group].append((own.index(trial.family) + sizes[family], trial))
            sizes[family] += 1
        ordered = {group: sorted(own, key=lambda each: each[0]) for group, own in waiting.items()}
        self._waiting = {group: deque(t for _, t in own) for group, own in ordered.items()}
        self._spent_s = dict.fromkeys(waiting, 0.0)

    def next(self) -> CostTrial:
        """Take one out."""
        group = min((g for g, own in self._waiting.items() if own), key=self._spent_s.__getitem__)
        return self._waiting[group].popleft()

    def spend(self, trial: CostTrial, seconds: float) -> None:
        """Its group has had so much more time."""
        self._spent_s[trial.group] += seconds


class Forecast:
    """What a trial will take [s], by those before it: by two sizes of its family with the power of
    the size between them, by one in proportion, else as its group takes on average for what has
    been prepared."""

    def __init__(self):
        self._families: dict[tuple[str, str, str], list[tuple[float, float]]] = defaultdict(list)
        self._groups: dict[str, list[float]] = defaultdict(list)

    def learn(self, trial: CostTrial, row: Row) -> None:
        """Take in what a trial took."""
        self._families[_family(trial)].append((float(trial.size), row["trial_s"]))
        self._groups[trial.group].append(row["trial_s"] - row.get("prepare_s", 0.0))

    def __call__(self, trial: CostTrial) -> float:
        """What it will take; nothing is expected of the first trial of a group."""
        smaller = sorted(each for each in self._families[_family(trial)] if each[0] < trial.size)
        if not smaller:
            return float(np.mean(self._groups[trial.group] or [0.0]))
        size, taken = smaller[-1]
        return taken * (trial.size / size) ** _growth(smaller[-2:])


def _family(trial: CostTrial) -> tuple[str, str, str]:
    return trial.part, trial.line, trial.family


def _growth(sizes: Sequence[tuple[float, float]]) -> float:
    """The power of the size with which the time grows between two sizes."""
    *before, (size, taken) = sizes
    if not before or not taken > before[0][1] > 0:
        return LEAST_GROWTH
    return max(LEAST_GROWTH, math.log(taken / before[0][1]) / math.log(size / before[0][0]))


def places(trials: Iterable[CostTrial]) -> Iterator[Row]:
    """Family by family, which sizes of these trials there are."""
    sizes: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for trial in trials:
        sizes[_family(trial)].append(trial.size)
    for (part, line, family), own in sizes.items():
        listed = ", ".join(sized(size) for size in sorted(own))
        yield {"part": part, "line": line, "family": family, "sizes": listed}
