"""Many channels in small panels, and long records by their extremes."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .panels import Panel

MOST_POINTS = 6000  # of one curve: more than a page has pixels
_TALL = 4  # panels that each have the full width


def in_columns(parts: Sequence[Panel]) -> list[list[Panel]]:
    """Arrange panels, `parts`, as a grid for [`panels`][]: a few in one column, many in two."""
    columns = 1 if len(parts) <= _TALL else 2
    return [list(parts[i : i + columns]) for i in range(0, len(parts), columns)]


def extremes(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], most: int = MOST_POINTS
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Shorten a long curve to its extremes: peaks stay as high as they are.

    - `x`, `y` (n,): the curve. `most`: points up to which it stays as it is.

    Returns x and y (m,): the least and the greatest finite value in each of many short stretches,
    NaN where a stretch has none.
    """
    block = math.ceil(2 * y.size / most)
    if block <= 2:
        return x, y
    padded = np.concatenate([y, np.full(-y.size % block, np.nan)]).reshape(-1, block)
    finite = np.isfinite(padded)
    low = np.min(padded, axis=1, where=finite, initial=np.inf)
    high = np.max(padded, axis=1, where=finite, initial=-np.inf)
    ends = np.stack([low, high], axis=1).ravel()
    return np.repeat(x[::block], 2), np.where(np.isfinite(ends), ends, np.nan)
