"""Convergence of Markov chains: R-hat and effective sample sizes (Vehtari et al. 2021).

In numpy, as these are computed once: compiled they take two seconds for each shape.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

TAILS = (0.05, 0.95)  # the quantiles that are reported
Chains = Float[np.ndarray, "chain draw"]


class Convergence(NamedTuple):
    """How well chains sample one parameter: rank-normalised split `r_hat`, and effective sample
    sizes of the mean (`ess_bulk`) and of the 5 and 95 % quantiles (`ess_tail`)."""

    r_hat: float
    ess_bulk: float
    ess_tail: float


def convergence(chains: Chains) -> Convergence:
    """The convergence of `chains` (chain, draw)."""
    halves = _halves(chains)
    folded = np.abs(halves - np.median(halves))
    r_hat = max(_r_hat(_normal_scores(halves)), _r_hat(_normal_scores(folded)))
    below = (_halves(chains <= np.quantile(chains, level)).astype(float) for level in TAILS)
    return Convergence(r_hat, ess(_normal_scores(halves)), min(map(ess, below)))


def ess(chains: Chains) -> float:
    """Effective sample size of the mean of `chains` (chain, draw), by Geyer's initial monotone
    sequence."""
    n = chains.shape[1]
    if np.ptp(chains) == 0:
        return float(chains.size)
    covariance = _autocovariance(chains).mean(axis=0)
    within = covariance[0] * n / (n - 1)
    total = covariance[0] + (chains.mean(axis=1).var(ddof=1) if len(chains) > 1 else 0.0)
    correlation = 1 - (within - covariance) / total
    correlation[0] = 1.0
    count = (n - 1) // 2
    pairs = correlation[: 2 * count].reshape(count, 2).sum(axis=1)  # of neighbouring lags
    (ends,) = np.nonzero(pairs <= 0)
    last = int(ends[0]) if ends.size else count - 1
    # Of the pair that ends the sequence its first counts where it is positive.
    rest = max(correlation[2 * last], 0.0)
    positive = np.minimum.accumulate(pairs[:last])
    time = max(2 * positive.sum() - 1 + rest, 1 / np.log10(chains.size))
    return float(chains.size / time)


def _halves(chains: np.ndarray) -> np.ndarray:
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, -half:]])


def _normal_scores(chains: Chains) -> Chains:
    """The normal quantiles of the values' ranks among all."""
    ranks = scipy.stats.rankdata(chains.ravel()).reshape(chains.shape)
    return scipy.special.ndtri((ranks - 0.375) / (chains.size + 0.25))


def _r_hat(chains: Chains) -> float:
    n, within = chains.shape[1], chains.var(axis=1, ddof=1).mean()
    between = chains.mean(axis=1).var(ddof=1)
    return float(np.sqrt((n - 1) / n + between / within)) if within > 0 else np.inf


def _autocovariance(chains: Chains) -> Chains:
    n = chains.shape[1]
    size = scipy.fft.next_fast_len(2 * n)
    spectrum = np.fft.rfft(chains - chains.mean(axis=1, keepdims=True), size)
    return np.fft.irfft(np.abs(spectrum) ** 2, size)[:, :n] / n
