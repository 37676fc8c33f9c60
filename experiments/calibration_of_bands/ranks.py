"""Ranks of truths among draws of their posterior, and whether these are uniform.

A truth that is drawn from a method's own prior has the same chance of every rank in the posterior,
whatever that is (simulation-based calibration: Cook, Gelman and Rubin 2006; Talts et al. 2018).
Bands that are too narrow give many ranks near 0 and 1; an estimate with a bias gives many near one
of them. The rank of a truth in a normal posterior is Phi((truth - value) / stderr).
"""

import abc
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from srsinv.numerics import BAND_90

Ranks = Float[np.ndarray, " draw"]
LEAST_EXPECTED = 5.0  # draws in a bin, for the statistic to have a chi-square's distribution


class RankedMethod(abc.ABC):
    """A method with the draws that calibrate its bands.

    `label`: its name on the page; `is_quick`: whether a draw takes milliseconds.
    """

    label: str
    is_quick: bool = True

    @abc.abstractmethod
    def ranks(self, rng: np.random.Generator, draws: int) -> Mapping[str, Ranks]:
        """The ranks, between 0 and 1, of the truths of so many draws, by quantity."""


def drawn(one: Callable[[], Mapping[str, float]], draws: int) -> dict[str, Ranks]:
    """The ranks of draws that are made one by one."""
    each = [one() for _ in range(draws)]
    return {name: np.array([ranks[name] for ranks in each]) for name in each[0]}


def normal_rank(truth: Any, value: Any, stderr: Any) -> Any:
    """The rank of a truth in a normal posterior."""
    return scipy.special.ndtr((np.asarray(truth) - value) / stderr)


class RankTest(NamedTuple):
    """What the ranks of one quantity say.

    - `counts` (bin,): ranks in each of the bins of equal width from 0 to 1.
    - `chi2`: the sum of (count - expected)^2 / expected; `p_value`: the probability of one as large
      where ranks are uniform, by as many degrees of freedom as there are bins but one.
    - `coverage`: of the band of 90 %.
    """

    counts: Float[np.ndarray, " bin"]
    chi2: float
    p_value: float
    coverage: float

    @classmethod
    def of(cls, ranks: Ranks, bins: int) -> "RankTest":
        """The test in so many bins, or fewer where these would have too few ranks: the counts of
        neighbours are then added up."""
        counts = np.histogram(ranks, bins, (0.0, 1.0))[0].astype(float)
        tested = counts
        while (
            tested.size > 2 and tested.size % 2 == 0 and ranks.size / tested.size < LEAST_EXPECTED
        ):
            tested = tested.reshape(-1, 2).sum(axis=1)
        expected = ranks.size / tested.size
        chi2 = float(np.sum((tested - expected) ** 2) / expected)
        tail = scipy.special.ndtr(-BAND_90)
        covered = float(np.mean((ranks > tail) & (ranks < 1 - tail)))
        return cls(counts, chi2, float(scipy.special.chdtrc(tested.size - 1, chi2)), covered)


def count_band(draws: int, bins: int, level: float) -> tuple[float, float]:
    """Least and greatest count of a bin, which uniform ranks keep in all bins with probability
    `level` at least (Bonferroni)."""
    outside = (1 - level) / bins / 2
    least, most = scipy.stats.binom.ppf([outside, 1 - outside], draws, 1 / bins)
    return float(least), float(most)
