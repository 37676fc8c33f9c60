"""A few smooth shapes along an open line, in which its equations are solved exactly."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from .near_periodic import NearPeriodic

# The hats are this part of the resolved wave's half length wide at the ends of the data, `FLAT` of
# them inwards; further ones grow, into the data and into the margins beyond.
WIDTH, FLAT, GROWTH = 2.0, 14, 2.0
NEGLIGIBLE = 1e-14  # of the largest eigenvalue, the hats scaled to the same energy

Traction = Float[np.ndarray, "c n"]


def _ladder(length: float, step: float, flat: int) -> list[float]:
    """Distances from zero to `length`: `flat` of these steps, and further ones ever wider."""
    rungs = [0.0]
    while rungs[-1] + 1.5 * step < length:
        rungs.append(rungs[-1] + step)
        step *= GROWTH if len(rungs) > flat else 1.0
    return rungs


def knots_of(n: int, first: int, last: int, narrowest: float) -> Float[np.ndarray, " knot"]:
    """The hats' tips, in cells, dense at the first and the last cell with data."""
    inwards = _ladder((last - first) / 2, narrowest, FLAT)
    before = _ladder(float(first), narrowest, 0)
    after = _ladder(float(n - 1 - last), narrowest, 0)
    left = [0.0, *(first - d for d in before), *(first + d for d in inwards)]
    right = [n - 1.0, *(last + d for d in after), *(last - d for d in inwards)]
    return np.unique(np.round(left + right))


def hats_of(near: NearPeriodic, has_data: Bool[np.ndarray, " n"]) -> Any:
    """The hats for this model, a sparse matrix (n, hat): each cell lies between two tips."""
    first, *_, last = np.flatnonzero(has_data).tolist()
    knots = knots_of(near.n, first, last, WIDTH * near.half_wave_cells)
    cells = np.arange(near.n)
    right = np.clip(np.searchsorted(knots, cells, "right"), 1, knots.size - 1)
    part = (cells - knots[right - 1]) / (knots[right] - knots[right - 1])
    at = np.concatenate([right - 1, right])
    weights = np.concatenate([1 - part, part])
    return scipy.sparse.csr_array((weights, (np.tile(cells, 2), at)), shape=(near.n, knots.size))


class Coarse(NamedTuple):
    """The equations restricted to `hats` (n, hat) of each component: `inverse` (c hat, c hat) is
    theirs, and `images` (c hat, c, n) are the equations times each hat."""

    hats: Any
    inverse: Float[np.ndarray, "m m"]
    images: Float[np.ndarray, "m c n"]

    @classmethod
    def of(cls, equations: Callable[[Traction], Traction], hats: Any, unknowns: int) -> "Coarse":
        """These equations on the hats."""
        n, size = hats.shape
        images = np.empty((unknowns * size, unknowns, n))
        for c in range(unknowns):
            for hat in range(size):
                r = np.zeros((unknowns, n))
                r[c] = hats[:, [hat]].toarray()[:, 0]
                images[c * size + hat] = equations(r)
        matrix = np.array([(hats.T @ image.T).T.ravel() for image in images])
        return cls(hats, _inverse((matrix + matrix.T) / 2), images)

    def spread(self, values: Float[np.ndarray, " m"]) -> Traction:
        """The traction that is so much of each hat."""
        return (self.hats @ values.reshape(-1, self.hats.shape[1]).T).T

    def gathered(self, r: Traction) -> Float[np.ndarray, " m"]:
        """The product with each hat."""
        return (self.hats.T @ r.T).T.ravel()

    def diagonal(
        self, matrix: Float[np.ndarray, "m m"], zero_mean: Bool[np.ndarray, " c"]
    ) -> Traction:
        """The diagonal of Z matrix Z^T for each component, Z the hats, less their means where it is
        zero_mean."""
        size, means = self.hats.shape[1], np.asarray(self.hats.mean(axis=0))
        rows = []
        for c, is_centred in enumerate(zero_mean):
            part = matrix[c * size : (c + 1) * size, c * size : (c + 1) * size]
            among = self.hats @ part
            less = is_centred * means
            rows.append((among * self.hats).sum(axis=1) - 2 * among @ less + less @ part @ less)
        return np.stack(rows)

    def times(self, r: Traction) -> Traction:
        """The solution among hats for the right side r."""
        return self.spread(self.inverse @ self.gathered(r))


def _inverse(matrix: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m m"]:
    """The inverse but for the directions, such as a fixed mean, that have no energy."""
    diagonal = np.diag(matrix)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale)
    has_energy = values > NEGLIGIBLE * max(values[-1], 0.0)
    vectors = scale[:, None] * vectors[:, has_energy]
    return (vectors / values[has_energy]) @ vectors.T
