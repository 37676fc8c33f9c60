"""Trials of accuracy_cost: their places in the table, and measures that several parts share."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..errors import BadInput
from ..report.data import key_of
from ..report.text import sized
from ..status import Status
from .trials import Trial, Work

# What a work may end with: the trial has failed then, and the next one follows.
FAILURES = (BadInput, ArithmeticError, MemoryError, RuntimeError, np.linalg.LinAlgError)


def cost_trial(
    group: str, part: str, line: str, family: str, size: int | float,
    prepare: Callable[[], Work], score: Callable[[Any], Mapping[str, Any]], *,
    peer: str = "", is_peer: bool = False, count: int = 1,
    rests_on: Mapping[str, Any] | None = None,
) -> Trial:  # fmt: skip
    """A trial of a `group` of the parts that take turns, with its place in the table.

    `peer`: the family of the same part, line and size whose time is compared with; `is_peer`:
    whether this is one of those. Its key begins its metrics' names. A score has measures by their
    names, and as `failure` why the value is no answer, where it is none.
    """
    labels = {
        "group": group, "part": part, "line": line, "family": family, "size": size, "peer": peer,
        "is_peer": is_peer, "key": f"{part}_{line}_{name_of(family)}_{sized(size)}",
    }  # fmt: skip
    return Trial(labels, prepare, score, count, rests_on or {})


def failure_of(status: Status) -> str:
    """Why an estimate of this status is no answer, "" where it is one."""
    return "" if status.is_answer else f"{status}. {status.advice}"


def name_of(family: str) -> str:
    """A family as a part of a metric's name: `optax_l_bfgs`, `iterative_1e-08`."""
    words = key_of(family).split("-")
    return words[0] + "".join(f"-{w}" if w[:1].isdigit() else f"_{w}" for w in words[1:])


def relative(value: Any, reference: Any) -> float:
    """The norm of the difference over that of the reference."""
    value, reference = np.asarray(value, float), np.asarray(reference, float)
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))
