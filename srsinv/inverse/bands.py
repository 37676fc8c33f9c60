"""The variance in every cell of a posterior that is known as a map, without its matrix.

With M the posterior covariance of the nearest periodic problem and Z the hats at which the
equations H are solved exactly, E = Z^T H Z, the posterior covariance is
(1 - Z E^-1 Z^T H) M (1 - H Z E^-1 Z^T) + Z E^-1 Z^T but for what conjugate gradients still correct.
M is stationary but for what each missing sample adds to it.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from .coarse import Coarse
from .gaps import inverse_of
from .near_periodic import NearPeriodic
from .transforms import adjoint, from_spectrum, times, to_spectrum

if TYPE_CHECKING:
    from .iterative import PosteriorMap

NEAR = 10  # widths of the response
FAR = 4  # times as far from a missing sample as is computed cell by cell, its variance is traced
# Missing samples before and after a block that are inverted with it, and how few in all are
# inverted at once.
AROUND, FEW = 192, 1024

Variance = Float[np.ndarray, "c n"]


def variance(posterior: "PosteriorMap", mean_weights: Float[np.ndarray, "c n"]) -> Variance:
    """The variance of the traction, less its mean with these weights, in every cell."""
    near = posterior.near
    stationary = near.lags(near.covariance)[..., 0]
    total = np.diagonal(stationary)[:, None] + _of_gaps(near)
    if posterior.coarse is not None:
        total = total + _at_ends(posterior, posterior.coarse)
    if posterior.shapes is not None:
        total = total + posterior.shapes.diagonal()
    for c, weights in enumerate(mean_weights):
        if weights.any():
            r = np.zeros_like(mean_weights)
            r[c] = weights
            shared = posterior.nearly_times(r)[c]
            total[c] += weights @ shared - 2 * shared
    return total


def _at_ends(posterior: "PosteriorMap", coarse: Coarse) -> Variance:
    """What the hats change, one of them after the other."""
    normal, inverse = posterior.normal, coarse.inverse
    total, size = 0.0, len(inverse)
    energy = np.empty((size, size))
    for j in range(size):
        hat = normal.centre(coarse.spread(np.eye(size)[j]))
        moved = posterior.near_times(normal(hat))
        energy[j] = coarse.gathered(normal(moved))
        total = total - 2 * normal.centre(coarse.spread(inverse[j])) * moved
    among = inverse + inverse @ energy @ inverse
    return total + coarse.diagonal((among + among.T) / 2, normal.zero_mean)


def _places(cells: Int[np.ndarray, " b"], n: int, width: float) -> Int[np.ndarray, " place"]:
    """Where the variance that samples missing at these cells make is computed, between the first
    and the last of them and as far outside as it changes, around the line: cell by cell near each,
    and every width of the response elsewhere."""
    offsets = (cells - cells[0]) % n
    reach, outside = int(NEAR * width), int(FAR * NEAR * width)
    span = int(offsets[-1]) + 1 + 2 * outside
    if span >= n:
        outside, span = (n - int(offsets[-1])) // 2, n
    near = np.zeros(span + 1, int)
    np.add.at(near, np.maximum(offsets + outside - reach, 0), 1)
    np.add.at(near, np.minimum(offsets + outside + reach, span), -1)
    is_place = np.cumsum(near)[:span] > 0
    is_place[:: max(1, int(width))] = is_place[-1] = True
    return int(cells[0]) - outside + np.flatnonzero(is_place)


def _of_gaps(near: NearPeriodic) -> Variance:
    """What the missing samples add: the diagonal of B T B^T, T the inverse of Q over them and B the
    response of the traction to them.

    T is taken from each block and what is around it. Far from a block B varies slowly, and T acts
    by the sums of its rows: a convolution. Near it the difference is added.
    """
    gaps, n = near.gaps, near.n
    response = near.lags(adjoint(near.expected))
    elements, unknowns = len(near.model), len(response)
    sums, total = np.zeros((elements, elements, n)), np.zeros((unknowns, n))
    unexpected = near.lags(near.smooth)
    many = gaps.cell.size
    beside = AROUND if many > FEW else many
    for block in gaps.blocks:
        around = slice(max(0, block.start - beside), min(many, block.stop + beside))
        own = slice(block.start - around.start, block.stop - around.start)
        inverse = inverse_of(gaps.matrix(unexpected, around, around))[0][own]
        of_each = gaps.element[around][None] == np.arange(elements)[:, None]
        rows = np.einsum("ab,fb->fa", inverse, of_each)
        sums[gaps.element[block], :, gaps.cell[block]] = rows.T
        places = _places(gaps.cell[around], n, near.width_cells)
        lag = (places[:, None] - gaps.cell[None, around]) % n
        for c in range(unknowns):
            near_b = response[c, gaps.element[around], lag]
            exact = np.sum(near_b[:, own] * (near_b @ inverse.T), axis=1)
            far = sum(rows[f] * response[c, f, lag[:, own]] for f in range(elements))
            more = exact - np.sum(near_b[:, own] * far, axis=1)
            line = np.arange(places[0], places[-1] + 1)
            total[c, line % n] += np.interp(line, places, more)
    spectra = to_spectrum(sums)
    for c in range(unknowns):
        squares = to_spectrum(response[c][:, None] * response[c][None])
        total[c] += from_spectrum(np.einsum("efk,efk->k", spectra, squares), n)
    of_mean, back = near.of_mean(sums), adjoint(near.expected)
    moved = [from_spectrum(times(back, to_spectrum(each)), n) for each in sums.swapaxes(0, 1)]
    return total - np.einsum("fcn,fg,gcn->cn", moved, of_mean, moved)
