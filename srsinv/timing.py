"""Times of calls."""

import time
from collections.abc import Callable
from typing import Any

import jax


def timed(work: Callable[[], Any], repeats: int) -> tuple[Any, float, float | None]:
    """The result, the first call's time [s] and the least of `repeats` further ones; None without
    any."""

    def once():
        start = time.perf_counter()
        result = jax.block_until_ready(work())
        return result, time.perf_counter() - start

    result, first = once()
    return result, first, min((once()[1] for _ in range(repeats)), default=None)
