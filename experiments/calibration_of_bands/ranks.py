"""Ranks of truths among draws of their posterior, and whether these are uniform.

A truth that is drawn from a method's own prior has the same chance of every rank in the posterior,
whatever that is (simulation-based calibration: Cook, Gelman and Rubin 2006; Talts et al. 2018).
Bands that are too narrow give many ranks near 0 and 1; an estimate with a bias gives many near one
of them. The rank of a truth in a normal posterior is Phi((truth - value) / stderr).
"""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from srsinv.numerics import BAND_90

Ranks = Float[np.ndarray, " draw"]
LEAST_EXPECTED = 5.0  # draws in a bin, for the statistic to have a chi-square's distribution
IN_BAND = 0.99


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
    return by_quantity([one() for _ in range(draws)])


def by_quantity(each: Sequence[Mapping[str, float]]) -> dict[str, Ranks]:
    """The ranks of several draws, by quantity."""
    return {name: np.array([ranks[name] for ranks in each]) for name in each[0]}


def noisy(
    clean: Float[np.ndarray, "..."], relative: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "..."], float]:
    """A signal with white noise of a fraction of its rms, and the noise's standard deviation."""
    level = relative * float(np.sqrt(np.mean(clean**2)))
    return clean + level * rng.standard_normal(clean.shape), level


def normal_rank(truth: Any, value: Any, stderr: Any) -> Any:
    """The rank of a truth in a normal posterior."""
    return scipy.special.ndtr((np.asarray(truth) - value) / stderr)


class RankTest(NamedTuple):
    """What the ranks of one quantity say.

    - `density` (bin,): of the ranks in bins of equal width from 0 to 1; its mean is 1.
    - `band`: least and greatest density that uniform ranks keep in all bins with probability
      `IN_BAND`.
    - `p_value`: of a chi-square as large, where ranks are uniform: the sum over bins of
      (count - expected)^2 / expected, with as many degrees of freedom as bins but one.
    - `coverage`: of the band of 90 %.
    """

    density: Float[np.ndarray, " bin"]
    band: tuple[float, float]
    p_value: float
    coverage: float

    @classmethod
    def of(cls, ranks: Ranks, bins: int) -> "RankTest":
        """The test in so many bins. Where these would have too few ranks, neighbours are joined."""
        joined = bins
        while joined % 2 == 0 and joined > 2 and ranks.size / joined < LEAST_EXPECTED:
            joined //= 2
        expected = ranks.size / joined
        counts = np.histogram(ranks, joined, (0.0, 1.0))[0]
        chi2 = float(np.sum((counts - expected) ** 2) / expected)
        outside = (1 - IN_BAND) / joined / 2  # of each bin, so that all are inside (Bonferroni)
        least, most = scipy.stats.binom.ppf([outside, 1 - outside], ranks.size, 1 / joined)
        tail = scipy.special.ndtr(-BAND_90)
        return cls(
            np.repeat(counts / expected, bins // joined),
            (float(least / expected), float(most / expected)),
            float(scipy.special.chdtrc(joined - 1, chi2)),
            float(np.mean((ranks > tail) & (ranks < 1 - tail))),
        )
