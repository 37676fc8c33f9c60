"""Statistics of many draws: coverage of intervals, proportions, ranks, differences of methods."""

from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from ..numerics import BAND_90

CONFIDENCE = 0.95  # confidence at which two methods differ


def coverage(z: Float[np.ndarray, "*row draw"], level: float) -> Float[np.ndarray, "*row"]:
    """Fraction of the draws whose central interval of this level holds the truth, from their errors
    `z` over their own standard errors."""
    return np.mean(np.abs(z) <= scipy.special.ndtri((1 + level) / 2), axis=-1)


def wilson(count: int, total: int) -> tuple[float, float]:
    """Wilson's central 90 % interval of a proportion (1927)."""
    z2 = BAND_90**2
    middle = (count + z2 / 2) / (total + z2)
    half = np.sqrt(z2 * (count * (total - count) / total + z2 / 4)) / (total + z2)
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def ranks(score: Float[np.ndarray, "method *draw"]) -> Float[np.ndarray, "method *draw"]:
    """1 for the least score of each draw, and so on; equal scores get the mean of their ranks."""
    less = np.sum(score[None] < score[:, None], axis=1)
    equal = np.sum(score[None] == score[:, None], axis=1)
    return np.where(np.isnan(score).any(axis=0), np.nan, less + (equal + 1) / 2)


def differences(
    score: Float[np.ndarray, "method draw"], names: list[str], by: tuple[str, ...] = ("pair",)
) -> dict[str, tuple[Any, ...]]:
    """Variables of all pairs of methods on the same draws, the best first.

    The mean difference of their scores, its standard deviation over the draws (NaN of one draw),
    the number of draws in which the better one is better, and whether the mean exceeds 0 by
    Student's t at `CONFIDENCE`, which one draw never says.
    """
    order = np.argsort(score.mean(axis=1), kind="stable")
    first, second = (order[at] for at in np.triu_indices(len(order), 1))
    more, draws = score[second] - score[first], score.shape[1]
    spread = more.std(axis=1, ddof=1) if draws > 1 else np.full(len(more), np.nan)
    reach = scipy.special.stdtrit(max(draws - 1, 1), (1 + CONFIDENCE) / 2) * spread / np.sqrt(draws)
    return {
        "better": (by, np.array(names)[first], "1"),
        "worse": (by, np.array(names)[second], "1"),
        "difference": (by, more.mean(axis=1), "1"),
        "difference_spread": (by, spread, "1"),
        "draws_better": (by, np.sum(more > 0, axis=1), "1"),
        "differs": (by, more.mean(axis=1) > reach, "1"),
    }
