"""The variance in every cell of a posterior that is known as a map, without its matrix.

With M the posterior covariance of the nearest periodic problem and Z the hats at which the
equations H are solved exactly, E = Z^T H Z, the posterior covariance is
(1 - Z E^-1 Z^T H) M (1 - H Z E^-1 Z^T) + Z E^-1 Z^T but for what conjugate gradients still correct.
M is stationary but for what each missing sample adds to it.
"""

from typing import TYPE_CHECKING

import numpy as np
import scipy
from jaxtyping import Float, Int

from .coarse import Coarse
from .gaps import inverse_of
from .near_periodic import NearPeriodic
from .transforms import adjoint, from_spectrum, times, to_spectrum

if TYPE_CHECKING:
    from .iterative import PosteriorMap

# What missing samples add is computed cell by cell up to so many widths of the response from each,
# every width up to FAR times that, and beyond at distances that grow by e in so many steps.
NEAR, FAR, RUNGS = 5, 8, 10
TOGETHER = 16  # hats
AROUND = 192  # missing samples before and after a block that are inverted with it

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
    """What the hats change."""
    normal, inverse, images = posterior.normal, coarse.inverse, coarse.images
    energy, total = [], 0.0
    for first in range(0, len(images), TOGETHER):
        moved = np.stack([posterior.near_times(each) for each in images[first : first + TOGETHER]])
        energy.append(moved.reshape(len(moved), -1) @ images.reshape(len(images), -1).T)
        for row, each in zip(inverse[first:], moved, strict=False):
            total = total - 2 * normal.centre(coarse.spread(row)) * each
    among = inverse + inverse @ np.concatenate(energy) @ inverse
    return total + coarse.diagonal((among + among.T) / 2, normal.zero_mean)


def _of_gaps(near: NearPeriodic) -> Variance:
    """What the missing samples add: the diagonal of B T B^T, T the inverse of Q over them and B the
    response of the traction to them.

    The rows of T are taken from each block and what is around it, and what they add is computed at
    a few places alone: T may be so large that sums of its rows would say nothing.
    """
    gaps, n = near.gaps, near.n
    response, unexpected = near.lags(adjoint(near.expected)), near.lags(near.smooth)
    elements, unknowns = len(near.model), len(response)
    sums, total = np.zeros((elements, elements, n)), np.zeros((unknowns, n))
    grid = np.arange(0, n, max(1, int(near.width_cells)))
    on_grid = np.zeros((unknowns, grid.size))
    for block in gaps.blocks:
        around, own = _around(block, gaps.cell.size)
        inverse = inverse_of(gaps.matrix(unexpected, around, around))[0][own]
        of_each = gaps.element[around, None] == np.arange(elements)
        sums[gaps.element[block], :, gaps.cell[block]] = inverse @ of_each
        line, places = _places(gaps.cell[around], grid, n, near.width_cells)
        lag = (places[:, None] - gaps.cell[around]) % n
        added = []
        for c in range(unknowns):
            shown = response[c, gaps.element[around], lag]
            added.append(np.sum(shown[:, own] * (shown @ inverse.T), axis=1))
        along = _around_line(places, np.stack(added), n)
        far = along(grid)
        on_grid += far
        total[:, line % n] += along(line) - _around_line(grid, far, n)(line)
    total += _around_line(grid, on_grid, n)(np.arange(n))
    of_mean, back = near.of_mean(sums), adjoint(near.expected)
    moved = [from_spectrum(times(back, to_spectrum(each)), n) for each in sums.swapaxes(0, 1)]
    return total - np.einsum("fcn,fg,gcn->cn", moved, of_mean, moved)


def _around_line(places: Int[np.ndarray, " place"], values: Float[np.ndarray, "c place"], n: int):
    """Values on a circle of n cells as a function of the cell: parabolas, which nearly cancel with
    those of the mean, would be seen between places that are joined by straight lines."""
    ends = np.append(places, places[0] + n), np.concatenate([values, values[:, :1]], axis=1)
    return scipy.interpolate.CubicSpline(*ends, axis=1, bc_type="periodic")


def _around(block: slice, many: int) -> tuple[Int[np.ndarray, " around"], slice]:
    """Which of so many missing samples around the line are inverted with a block's, and where the
    block's own are among these."""
    size = block.stop - block.start
    if many <= size + 2 * AROUND:
        return np.arange(many), block
    return np.arange(block.start - AROUND, block.stop + AROUND) % many, slice(AROUND, AROUND + size)


def _places(
    cells: Int[np.ndarray, " b"], grid: Int[np.ndarray, " g"], n: int, width: float
) -> tuple[Int[np.ndarray, " near"], Int[np.ndarray, " place"]]:
    """Where on a line of n cells the variance that samples missing at these cells make is computed:
    the cells near them, and these with those of the `grid`, ever fewer far away."""
    reach, start = int(NEAR * width), int(cells[0])
    offsets = (cells - start) % n
    within = start - reach + np.arange(int(offsets[-1]) + 2 * reach + 1)
    near = np.zeros(within.size + 1, int)
    np.add.at(near, offsets, 1)
    np.add.at(near, offsets + 2 * reach + 1, -1)
    dense = within[np.cumsum(near)[:-1] > 0] % n
    after = (grid - start) % n - int(offsets[-1])
    away = np.minimum(after, n - int(offsets[-1]) - after) / (FAR * reach)
    rung = np.floor(RUNGS * np.log(np.maximum(away, 1.0)))
    is_place = (away <= 1) | (rung != np.roll(rung, 1))
    return within[:n], np.unique(np.concatenate([dense, grid[is_place]]))
