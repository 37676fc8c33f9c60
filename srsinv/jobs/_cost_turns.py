"""Which trial of accuracy_cost is next, and what is left out for want of time."""

import math
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..progress import stage, steps
from ..report.text import sized
from .trials import Row, Trial, TrialRows

LEAST_GROWTH = 1.0  # power of the size with which a family's time grows, at least

Family = tuple[str, str, str]  # part, line, family


def measure_in_turns(
    trials: Sequence[Trial], rows: TrialRows, budget_s: float = math.inf
) -> tuple[list[Row], list[Trial]]:
    """Rows of the trials in their order, and the trials that are left out for want of time [s].

    The group that has had the least time is next, from few families and small sizes on. A trial
    that would outlast the budget, by what it took its family at smaller sizes, is left out; smaller
    ones may follow.
    """
    started, forecast, spent_s = time.monotonic(), Forecast(), defaultdict(float)
    waiting, done = _by_group(trials), {}
    with steps("accuracy against cost", range(len(trials))) as each:
        for _ in each:
            group = min((name for name, own in waiting.items() if own), key=spent_s.__getitem__)
            at = waiting[group].pop(0)
            row = rows.known(trials[at])
            if row is None:
                left_s = budget_s - (time.monotonic() - started)
                if left_s <= 0 or forecast(trials[at]) > left_s:
                    continue
                labels = trials[at].labels
                with stage(f"{', '.join(family_of(labels))}, size {sized(labels['size'])}"):
                    row = rows.anew(trials[at])
            spent_s[group] += row["trial_s"]
            forecast.learn(row)
            done[at] = row
    return [done[i] for i in sorted(done)], [t for i, t in enumerate(trials) if i not in done]


def _by_group(trials: Sequence[Trial]) -> dict[str, list[int]]:
    """Places of each group's trials in the order in which they are measured: the second size of the
    first family comes with the first size of the second one, and so on, so that little time shows
    some of both."""
    families: dict[tuple[str, str], list[str]] = defaultdict(list)
    sizes: dict[Family, int] = defaultdict(int)
    turns: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for at, trial in enumerate(trials):
        part, line, name = family = family_of(trial.labels)
        own = families[part, line]
        if name not in own:
            own.append(name)
        turns[trial.labels["group"]].append((own.index(name) + sizes[family], at))
        sizes[family] += 1
    return {group: [at for _, at in sorted(own)] for group, own in turns.items()}


class Forecast:
    """What a trial will take [s], by those before it: by two sizes of its family with the power of
    the size between them, by one in proportion, else as its group takes on average for what has
    been prepared."""

    def __init__(self):
        self._families: dict[Family, list[tuple[float, float]]] = defaultdict(list)
        self._groups: dict[str, list[float]] = defaultdict(list)

    def learn(self, row: Row) -> None:
        """Take in what a trial took."""
        self._families[family_of(row)].append((float(row["size"]), row["trial_s"]))
        self._groups[row["group"]].append(row["trial_s"] - row.get("prepare_s", 0.0))

    def __call__(self, trial: Trial) -> float:
        """What it will take; nothing is expected of the first trial of a group."""
        wanted = trial.labels["size"]
        smaller = sorted(
            each for each in self._families[family_of(trial.labels)] if each[0] < wanted
        )
        if not smaller:
            return float(np.mean(self._groups[trial.labels["group"]] or [0.0]))
        size, taken = smaller[-1]
        return taken * (wanted / size) ** _growth(smaller[-2:])


def family_of(labels: Mapping[str, Any]) -> Family:
    """Part, line and family of a trial's labels."""
    return labels["part"], labels["line"], labels["family"]


def _growth(sizes: Sequence[tuple[float, float]]) -> float:
    """The power of the size with which the time grows between two sizes."""
    *before, (size, taken) = sizes
    if not before or not taken > before[0][1] > 0:
        return LEAST_GROWTH
    return max(LEAST_GROWTH, math.log(taken / before[0][1]) / math.log(size / before[0][0]))


def sizes_of(trials: Sequence[Trial]) -> Iterator[Row]:
    """Family by family, which sizes of these trials there are."""
    sizes: dict[Family, list[float]] = defaultdict(list)
    for trial in trials:
        sizes[family_of(trial.labels)].append(trial.labels["size"])
    for (part, line, family), own in sizes.items():
        listed = ", ".join(sized(size) for size in sorted(own))
        yield {"part": part, "line": line, "family": family, "sizes": listed}
