"""Times of calls."""

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np


class Timed(NamedTuple):
    """What a work gives, and the seconds of its first call and of each further one."""

    value: Any
    first_s: float
    further_s: tuple[float, ...]

    @property
    def least_s(self) -> float:
        """The quickest further call; NaN without any."""
        return min(self.further_s, default=np.nan)

    @property
    def median_s(self) -> float:
        """The median of the further calls; NaN without any."""
        return float(np.median(self.further_s)) if self.further_s else np.nan


def timed(work: Callable[[], Any], repeats: int, most_s: float = math.inf) -> Timed:
    """Call `work` once and `repeats` times more, each result waited for; after the second call no
    more of them once `most_s` [s] have passed."""

    def once():
        start = time.perf_counter()
        result = jax.block_until_ready(work())
        return result, time.perf_counter() - start

    result, first = once()
    further: list[float] = []
    while len(further) < repeats and (not further or first + sum(further) < most_s):
        further.append(once()[1])
    return Timed(result, first, tuple(further))
