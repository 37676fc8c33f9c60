"""The rate of bursts, with those that are too small to be found.

Bursts come at a rate lambda, their sizes are Gaussian of an unknown rms. Those found with a d'
above `SURE` are certain to be found, and the likelihood is that of a thinned Poisson process,

    prod_j lambda f(a_j) exp(-lambda T P(rms)),

f the density of a measured amplitude, P the fraction of bursts of this rms that are found so. Given
the rms, lambda is of a gamma distribution; the rms is of equal odds over logarithms.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import special, stats

from .everything import Everything
from .model import BurstModel
from .posterior import Grid, SizePrior

LOUD = 5.0  # a true d' above which bursts are counted
SURE = 7.0  # a measured d' above which they are certain to be found
DECADES, STEPS = (0.3, 3.3), 31  # of the rms, in units of what has a d' of 1 at the best place
COARSE = 5  # steps of the mixture that sizes have as a prior
PLACES = 81


class BurstRate(NamedTuple):
    """Rate of bursts [1/s] above a d' of `LOUD`: median, standard error and 90 % interval; and the
    prior of sizes that the bursts found imply."""

    value_hz: float
    stderr_hz: float
    low_hz: float
    high_hz: float
    sizes: SizePrior


def squares(
    model: BurstModel, rest: Everything, decay_s: np.ndarray
) -> Float[np.ndarray, "decay place"]:
    """Q over the contact, by the amplitude in the first sample."""
    responses = model.responses(np.linspace(-0.5, 0.5, PLACES) * model.contact_m)
    return rest.squares(model.decaying(decay_s), responses)


def _rms_grid(model: BurstModel, rest: Everything) -> Float[np.ndarray, " s"]:
    typical = np.array([np.sqrt(model.decay_s[0] * model.decay_s[1])])
    best = squares(model, rest, typical).max() * model.left(typical[0]) ** 2
    return np.logspace(*DECADES, STEPS) / np.sqrt(best)


def first_sizes(model: BurstModel, rest: Everything) -> SizePrior:
    """Sizes before any burst is found: an rms of equal odds over logarithms."""
    rms = _rms_grid(model, rest)[COARSE // 2 :: COARSE]
    return SizePrior(rms, np.full(rms.size, 1 / rms.size))


def burst_rate(
    model: BurstModel, rest: Everything, surest: Everything, grids: list[Grid]
) -> BurstRate:
    """The rate by the bursts found.

    - `surest`: everything else at the level of the traction under which fewer bursts are found;
      `grids`: the posterior of each burst under it.
    """
    rms, seconds = _rms_grid(model, rest), model.seconds
    decays = np.array([each.likeliest_decay_s for each in grids]) if grids else model.decays(5)
    left = model.left(decays)[:, None]
    loud, sure = (squares(model, of, decays) * left**2 for of in (rest, surest))
    # d' is normal about 0 with the variance that sizes give it, and that of noise.
    of_loud = np.array([np.mean(_beyond(LOUD, each**2 * loud)) for each in rms])
    of_sure = np.array([np.mean(_beyond(SURE, 1 + each**2 * sure)) for each in rms])
    counted = [each for each in grids if each.d_prime >= SURE]
    log, count = np.zeros(rms.size), len(counted)
    for grid in counted:
        one_rms = (SizePrior(each[None], np.ones(1)) for each in rms)
        left = model.left(np.exp(grid.log_decay))[None, :, None]
        every = [one.log_ratio(grid.along, grid.square, left) for one in one_rms]
        log = log + np.array([special.logsumexp(each) for each in every])
    # With lambda^(-1/2), Jeffreys' prior of a rate, integrated out.
    shape = count + 0.5
    log = log - shape * np.log(np.maximum(of_sure, np.finfo(float).tiny))
    if count == 0:
        log = np.zeros(rms.size)
    odds = np.exp(log - log.max())
    odds = odds / odds.sum()
    scale = of_loud / np.maximum(of_sure, np.finfo(float).tiny) / seconds
    mean = float(odds @ (shape * scale))
    square = float(odds @ (shape * (shape + 1) * scale**2))
    low, middle, high = (_quantile(share, odds, shape, scale) for share in (0.05, 0.5, 0.95))
    sizes = first_sizes(model, rest)
    if count:
        near = np.abs(np.log(rms)[:, None] - np.log(sizes.rms_Pa)).argmin(axis=1)
        of_sizes = np.bincount(near, odds, sizes.rms_Pa.size)
        sizes = SizePrior(sizes.rms_Pa, 0.99 * of_sizes + 0.01 / of_sizes.size)
    return BurstRate(middle, float(np.sqrt(max(square - mean**2, 0.0))), low, high, sizes)


def _beyond(level: float, variance: np.ndarray) -> np.ndarray:
    """Odds that a normal number of mean 0 is beyond a level on either side."""
    return special.erfc(level / np.sqrt(2 * np.maximum(variance, np.finfo(float).tiny)))


def _quantile(share: float, odds: np.ndarray, shape: float, scale: np.ndarray) -> float:
    """The quantile of a mixture of gamma distributions."""
    ends = stats.gamma.ppf(share, shape) * np.array([scale.min(), scale.max()])
    low, high = float(ends[0]), float(ends[1])
    for _ in range(80):
        middle = np.sqrt(max(low, 1e-300) * high)
        below = float(odds @ special.gammainc(shape, middle / np.maximum(scale, 1e-300)))
        low, high = (middle, high) if below < share else (low, middle)
    return float(np.sqrt(max(low, 1e-300) * high))
