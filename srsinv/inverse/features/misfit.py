"""Whether what a fit leaves is noise that is the same everywhere, or lies where the feature is.

Noise that is estimated from the residual takes up what the model misses. Stationary noise has no
place of its own; a misfit lies where the fitted signal is. With K the inverse of the noise's
covariance and C_a that of the correlated noise under weights a (the fitted signal's local power),
the score of a local excess is (K r)^T C_a (K r). For stationary noise its mean is tr(K C_a) and its
variance 2 tr(K C_a K C_a); it is taken as a multiple of a chi-square with these (Satterthwaite).
The fit takes noise out of the residual where the feature is, so that the test is conservative.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtrc

from ..diagnostics import local_misfit, sliding_noise
from .sliding_noise import Levels, evidence_of_sliding

FALSE_ALARM = 1e-3
MOST_BLOCKS = 256  # of samples, each with its mean: a misfit is as long as the film is deep
PRESENT = 0.1  # of the fitted signal's greatest amplitude: from there on it is at a place


def local_excess(
    residual: Float[np.ndarray, "e sample"],
    fitted: Float[np.ndarray, "e sample"],
    position_m: Float[np.ndarray, " sample"],
    depth_m: float,
    levels: Levels,
) -> float:
    """The residual's power where the fitted signal is, or within a depth of it, over that of
    stationary noise of these levels; 1 where chance makes as much."""
    size = -(-residual.shape[1] // MOST_BLOCKS)
    x = _means(np.asarray(position_m)[None], size)[0][0]
    lag = np.abs(x[:, None] - x)
    power = np.nanmean(_means(fitted**2, size)[0], axis=0)
    amplitude = np.sqrt(power / max(power.max(), np.finfo(float).tiny))
    near = np.max(np.where(lag <= depth_m, amplitude, 0.0), axis=-1)
    correlation = np.exp(-lag / max(levels.longest_m, depth_m / 2))
    # A wrong shape is missed where the signal is large; flanks lie beside it, and may be small.
    weights = amplitude, near, (near >= PRESENT).astype(float)
    whitened = list(_whitened(residual, lag, levels, size))
    excesses = (_excess(whitened, weight[:, None] * correlation * weight) for weight in weights)
    return max((each for each, p in excesses if p < FALSE_ALARM / len(weights)), default=1.0)


class _Whitened(NamedTuple):
    """Of one element's means over blocks: those `present`, the inverse K of their noise's
    covariance, and K r."""

    present: Bool[np.ndarray, " block"]
    precise: Float[np.ndarray, "n n"]
    pulled: Float[np.ndarray, " n"]


def _whitened(
    residual: Float[np.ndarray, "e sample"],
    lag: Float[np.ndarray, "block block"],
    levels: Levels,
    size: int,
) -> Iterator[_Whitened]:
    of_each = levels.white, levels.sliding, levels.correlation_m
    each = (np.broadcast_to(level, len(residual)) for level in of_each)
    for values, white, sliding, correlation_m in zip(residual, *each, strict=True):
        means, number = _means(values[None], size)
        present = number[0] > 0
        noise = sliding**2 * np.exp(-lag / correlation_m)
        noise = noise + np.diag(white**2 / np.maximum(number[0], 1))
        precise = np.linalg.inv(noise[np.ix_(present, present)])
        yield _Whitened(present, precise, precise @ means[0][present])


def _excess(
    whitened: Sequence[_Whitened], local: Float[np.ndarray, "block block"]
) -> tuple[float, float]:
    """The power along `local` over that of stationary noise, and the probability of as much."""
    total, mean, variance = 0.0, 0.0, 0.0
    for present, precise, pulled in whitened:
        own = local[np.ix_(present, present)]
        spread = precise @ own
        total += float(pulled @ own @ pulled)
        mean += float(np.trace(spread))
        variance += 2 * float(np.sum(spread * spread.T))
    if not variance > 0:
        return 1.0, 1.0
    freedom = 2 * mean**2 / variance
    return total / mean, float(chdtrc(freedom, freedom * total / mean))


def _means(
    values: Float[np.ndarray, "row sample"], size: int
) -> tuple[Float[np.ndarray, "row block"], Float[np.ndarray, "row block"]]:
    """Means over blocks of samples, and how many there are in each; NaN is missing."""
    blocks = -(-values.shape[1] // size)
    padded = np.pad(values, ((0, 0), (0, blocks * size - values.shape[1])), constant_values=np.nan)
    cut = padded.reshape(len(values), blocks, size)
    number = np.isfinite(cut).sum(axis=-1)
    return np.nansum(cut, axis=-1) / np.maximum(number, 1), number.astype(float)


def against_levels(
    y: Float[np.ndarray, "e sample"],
    residual: Float[np.ndarray, "e sample"],
    position_m: Any,
    depth_m: float,
    levels: Levels,
    taken: Float[np.ndarray, "e sample m"],
) -> tuple[str, ...]:
    """Warnings on noise that was estimated from the residual of a fit to `y`, the fit's derivatives
    being `taken`; a correlated part that is known, or that chance makes as well, says nothing."""
    x, size = np.asarray(position_m), float(np.sqrt(np.nanmean(y**2)))
    warnings = () if levels.is_stated else sliding_noise(levels.sliding_rms / size)
    if warnings and evidence_of_sliding(residual, x, taken, levels) < -np.log(FALSE_ALARM):
        warnings = ()
    return (*warnings, *local_misfit(local_excess(residual, y - residual, x, depth_m, levels)))
