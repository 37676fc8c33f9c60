"""Trials of accuracy_cost: what is measured, and its row of the table.

A trial has a place (part, line, family, size), a work that is prepared beforehand, and a score of
what the work gives. Every part makes trials of its own; all are measured alike.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np

from ..errors import BadInput
from ..memory import weighed
from ..report.data import key_of
from ..report.text import sized
from ..status import Status
from ..timing import timed

MOST_S = 2.0  # a trial's further calls, after which no more of them begin
# What a work may end with: the trial has failed then, and the next one follows.
FAILURES = (BadInput, ArithmeticError, MemoryError, RuntimeError, np.linalg.LinAlgError)

Row = dict[str, Any]
Work = Callable[[], Any]


class CostScore(NamedTuple):
    """How good a value is: its measures by name, and why it is no answer, empty where it is one."""

    measures: Mapping[str, float]
    failure: str = ""


@dataclass(frozen=True)
class CostTrial:
    """One thing to measure.

    - `group`: of the parts that take turns. `part`, `line`, `family`, `size`: the trial's place.
    - `prepare`: gives the work, whose time is measured; `score` takes what the work gives.
    - `peer`: the family of the same part, line and size whose time is compared with; `is_peer`
      whether this is one of those.
    - `count`: answers of one call, each of which has its part of the time.
    - `rests_on`: what else of the settings decides on its row.
    """

    group: str
    part: str
    line: str
    family: str
    size: int | float
    prepare: Callable[[], Work]
    score: Callable[[Any], CostScore]
    peer: str = ""
    is_peer: bool = False
    count: int = 1
    rests_on: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """The beginning of its metrics' names."""
        return f"{self.part}_{self.line}_{name_of(self.family)}_{sized(self.size)}"

    @property
    def place(self) -> Row:
        """What a row of the trial begins with."""
        names = ("group", "part", "line", "family", "size", "peer", "is_peer", "key")
        return {name: getattr(self, name) for name in names}


def failure_of(status: Status) -> str:
    """Why an estimate of this status is no answer, "" where it is one."""
    return "" if status.is_answer else f"{status}. {status.advice}"


def name_of(family: str) -> str:
    """A family as a part of a metric's name: `optax_l_bfgs`, `iterative_1e-08`."""
    words = key_of(family).split("-")
    return words[0] + "".join(f"-{w}" if w[:1].isdigit() else f"_{w}" for w in words[1:])


def measured(trial: CostTrial, repeats: int, is_fresh: bool) -> Row:
    """The row of a trial: first call, memory, further calls, score; or why it has failed.

    `is_fresh`: nothing that was compiled before serves the first call. `trial_s` is what all of it
    took, `prepare_s` what came before the first call.
    """
    start = time.perf_counter()
    try:
        row = _measured(trial, repeats, is_fresh)
    except FAILURES as error:
        row = {"failure": " ".join(f"{type(error).__name__}: {error}".split())[:300]}
        if isinstance(error, BadInput):
            row = {"failure": str(error)}
    return {**trial.place, **row, "trial_s": time.perf_counter() - start}


def _measured(trial: CostTrial, repeats: int, is_fresh: bool) -> Row:
    start = time.perf_counter()
    work = trial.prepare()
    prepare_s = time.perf_counter() - start
    if is_fresh and not trial.is_peer:
        jax.clear_caches()
    first = timed(work, 0)
    second, memory = weighed(lambda: timed(work, 0).first_s)
    times = (second,)
    if second < MOST_S:  # the call that was weighed is slower, and counts where it is the only one
        more = timed(work, repeats - 1, MOST_S)
        times = more.first_s, *more.further_s
    score = trial.score(first.value)
    return {
        **score.measures,
        "failure": score.failure,
        "first_call_s": first.first_s / trial.count,
        "steady_call_s": float(np.median(times)) / trial.count,
        "lower_call_s": float(np.quantile(times, 0.25)) / trial.count,
        "upper_call_s": float(np.quantile(times, 0.75)) / trial.count,
        "memory_bytes": memory,
        "prepare_s": prepare_s,
    }


def relative(value: Any, reference: Any) -> float:
    """The norm of the difference over that of the reference."""
    value, reference = np.asarray(value, float), np.asarray(reference, float)
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))
