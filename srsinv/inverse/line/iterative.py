"""The iterative path: conjugate gradients on the normal equations, matrix-free, on a line of any
length, with any samples missing.

Its preconditioner is the nearest periodic problem with the same samples missing, M. That is wrong
at the line's ends only, in a few smooth shapes: hats, for which the equations H are solved exactly
before and after M (balancing, Mandel 1993), and those that Lanczos' steps find besides. Under a
weak prior rounding takes the directions' orthogonality, and each shape left would cost many steps.

With Z the hats and E = Z^T H Z, the posterior covariance is
(1 - Z E^-1 Z^T H) M (1 - H Z E^-1 Z^T) + Z E^-1 Z^T but for what conjugate gradients still correct.
M is stationary but for what each missing sample adds to it, so that the variance in every cell
needs no matrix.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from ...grid import as_real
from ...known import by_numpy, in_jax, in_numpy
from ...modules import with_fields
from ..noise.levels import at_one_level, change_of_variance
from ..noise.nuisance import Nuisance, NuisanceCorrection
from ..noise.whitener import NoisePrecision
from .gaps import (
    MOST_STEPS,
    DenseInverse,
    Gaps,
    Shapes,
    Solved,
    conjugate_gradients,
    missing_shapes,
)
from .near_periodic import NearPeriodic, PeriodicModel
from .prior import Prior, Solution, squared_differences
from .problem import LineProblem
from .rig_bands import solved_directions
from .transforms import adjoint, each_on_a_core, from_spectrum, times, to_spectrum

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

        def put(at: int) -> None:
            r = np.zeros((unknowns, n))
            r[at // size] = hats[:, [at % size]].toarray()[:, 0]
            images[at] = equations(r)

        each_on_a_core(put, range(len(images)), n)
        matrix = np.array([(hats.T @ image.T).T.ravel() for image in images])
        return cls(hats, _inverse((matrix + matrix.T) / 2), images)

    def spread(self, values: Float[np.ndarray, " m"]) -> Traction:
        """The traction that is so much of each hat."""
        return (self.hats @ values.reshape(-1, self.hats.shape[1]).T).T

    def gathered(self, r: Traction) -> Float[np.ndarray, " m"]:
        """The product with each hat."""
        return (self.hats.T @ r.T).T.ravel()

    def image(self, values: Float[np.ndarray, " m"]) -> Traction:
        """The equations times so much of each hat."""
        return np.tensordot(values, self.images, 1)

    def image_products(self, r: Traction) -> Float[np.ndarray, " m"]:
        """The product of each hat with the equations times r."""
        return np.tensordot(self.images, r, 2)

    def diagonal(
        self, matrix: Float[np.ndarray, "m m"], zero_mean: Bool[np.ndarray, " c"]
    ) -> Traction:
        """The diagonal of Z matrix Z^T for each component, Z the hats, less their means where it is
        zero_mean."""
        size, means = self.hats.shape[1], np.asarray(self.hats.mean(axis=0))
        # Each cell lies between two hats.
        beside, parts = self.hats.indices.reshape(-1, 2), self.hats.data.reshape(-1, 2)
        rows = []
        for c, is_centred in enumerate(zero_mean):
            part = matrix[c * size : (c + 1) * size, c * size : (c + 1) * size]
            less = is_centred * means
            own = np.einsum("na,nab,nb->n", parts, part[beside[:, :, None], beside[:, None]], parts)
            rows.append(own - 2 * self.hats @ (part @ less) + less @ part @ less)
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


RIG = 1e-6  # of what an error of the rig makes of the estimate: bands are within 3 %
DRAWS = 3  # of noise, that the map is tried with
# In double precision; beyond this condition number the weakest traction is less than the tolerance
# of the whole.
TRUSTED = 1e11
LEFT_TO_ROUNDING = 1 / float(np.finfo(float).eps)  # a condition number

Signal = Float[np.ndarray, "e n"]


class NormalEquations:
    """(G^T R^-1 G + P) r = G^T R^-1 m over the samples that are there, R their noise's covariance;
    on traction whose known means are taken out."""

    def __init__(self, problem: LineProblem, prior: Prior, gaps: Gaps):
        self.gaps = gaps
        self.transfer = np.asarray(problem.forward.transfer, complex)
        self.length, self.n = problem.forward.length, problem.line.n
        self.shape = problem.unknowns, self.n
        self.zero_mean = np.asarray(problem.zero_mean)
        self.penalty = _penalty(problem, prior)
        self.weighed = NoisePrecision(problem, gaps)

    def __call__(self, r: Traction) -> Traction:
        r = self.centre(r)
        return self.right_side(self.forward(r)) + self.centre(self.penalty(r))

    def forward(self, r: Traction) -> Signal:
        """G r."""
        return self._convolved(self.transfer, r)

    def right_side(self, y: Signal) -> Traction:
        """G^T R^-1 y."""
        return self.adjoint(self.weighed(y))

    def adjoint(self, y: Signal) -> Traction:
        """G^T y."""
        return self.centre(self._convolved(adjoint(self.transfer), y))

    def centre(self, r: Traction) -> Traction:
        """Project out the means that are not solved for."""
        return r - np.where(self.zero_mean[:, None], r.mean(axis=-1, keepdims=True), 0.0)

    def _convolved(self, matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
        spectrum = times(matrices, to_spectrum(values, self.length))
        return from_spectrum(spectrum, self.length)[:, : self.n]


def _penalty(problem: LineProblem, prior: Prior) -> Callable[[Traction], Traction]:
    """P, in double precision where it is a sum of squared differences."""
    squares = prior.differences(problem.line)
    if squares is None:
        line, own = in_numpy((problem.line, prior))
        if isinstance(own.apply(line, np.zeros((problem.unknowns, line.n))), np.ndarray):
            return lambda r: np.asarray(own.apply(line, r), float)
        apply = jax.jit(lambda r: prior.apply(problem.line, r))
        return lambda r: np.asarray(apply(r), float)
    order, weights = squares[0], np.asarray(squares[1], float)[:, None]
    wraps = problem.forward.is_circular
    return lambda r: weights * squared_differences(r, order, wraps)


class PosteriorMap:
    """The posterior covariance under the normal equations, as a map and its diagonal.

    Where the noise has a scale, the map is that of noise at one level, and `equations` have their
    own.
    """

    def __init__(self, problem: LineProblem, prior: Prior):
        gaps = Gaps.of(problem.is_observed)
        is_open, own = not problem.forward.is_circular, problem
        problem = at_one_level(own)
        self.normal = NormalEquations(problem, prior, gaps)
        self.equations = self.normal if own is problem else NormalEquations(own, prior, gaps)
        # The hats have the means, and the nearest problem none: its own are next to undetermined.
        fixed = {"zero_mean": np.ones(problem.unknowns, bool)} if is_open else {}
        self.near = NearPeriodic(PeriodicModel(with_fields(problem, **fixed), gaps), prior)
        self.over_gaps_inverse = self.near.over_gaps_inverse()
        hats = hats_of(self.near, problem.observed_cells) if is_open else None
        self.coarse = None if hats is None else Coarse.of(self.normal, hats, problem.unknowns)
        self.shapes: Shapes | None = None

    def find_shapes(self) -> None:
        """Find the shapes in which the map differs from the covariance, and correct it by them."""
        normal, like = self.normal, np.zeros(self.normal.shape)
        self.shapes = missing_shapes(normal, self.nearly_times, normal.centre, like)

    def near_times(self, r: Traction) -> Traction:
        """The covariance of the nearest periodic problem times r."""
        moved = self.near.covariance_times(self.normal.centre(r), self.over_gaps_inverse)
        return self.normal.centre(moved)

    def nearly_times(self, r: Traction) -> Traction:
        """The covariance times r, but for what conjugate gradients still correct: exact for hats,
        and for the shapes found."""
        if self.coarse is None:
            z = self.near_times(r)
        else:
            r, coarse = self.normal.centre(r), self.coarse
            among = coarse.inverse @ coarse.gathered(r)
            z = self.near_times(r - coarse.image(among))
            z = self.normal.centre(
                z + coarse.spread(among - coarse.inverse @ coarse.image_products(z))
            )
        return z if self.shapes is None else z + self.shapes.times(r)

    def defect(self) -> float:
        """How far the map M is from the covariance: |H M w - w| over |w| as M weighs their squares,
        the worst of a few draws w of noise."""
        rng, worst = np.random.default_rng(1), 0.0
        for _ in range(DRAWS):
            w = self.normal.centre(rng.normal(size=self.normal.shape))
            nearly = self.nearly_times(w)
            left = self.normal(nearly) - w
            part = np.vdot(left, self.nearly_times(left)) / np.vdot(w, nearly)
            worst = max(worst, float(np.sqrt(abs(part))))
        return worst

    def times(self, right: Traction, tolerance: float) -> Solved:
        """The covariance times `right`, to a relative tolerance."""
        if self.coarse is None or self.equations is not self.normal:
            of = self.equations, self.nearly_times, right, tolerance, MOST_STEPS
            return conjugate_gradients(*of)
        start = self.coarse.times(right)
        energy = float(np.vdot(right, start))
        left = right - self.normal(start)
        solved = conjugate_gradients(
            self.normal, self.nearly_times, left, tolerance, MOST_STEPS, energy
        )
        return solved._replace(value=self.normal.centre(start + solved.value))


class Marginal:
    """The posterior of a problem from the map without its nuisance."""

    def __init__(self, problem: LineProblem, posterior: PosteriorMap, tolerance: float):
        self._posterior, self._tolerance = posterior, tolerance
        equations, self._beside = posterior.equations, None
        self._weigh = equations.weighed
        if problem.nuisance is not None:
            nuisance = Nuisance(problem, equations.weighed)
            self._weigh = nuisance.weigh
            self._beside = NuisanceCorrection.of(
                nuisance, equations.adjoint, lambda r: posterior.times(r, tolerance).value
            )

    def mean(self, y: Signal, least: float = 0.0) -> Solved:
        """The posterior mean of the traction of a signal, to this tolerance at `least`."""
        return self.times(self._posterior.equations.adjoint(self._weigh(y)), least)

    def times(self, right: Traction, least: float = 0.0) -> Solved:
        """The covariance times `right`, to this tolerance at `least`."""
        solved = self._posterior.times(right, max(self._tolerance, least))
        if self._beside is None:
            return solved
        return solved._replace(value=self._beside.corrected(solved.value))

    def variance(self, mean_weights: Float[np.ndarray, "c n"]) -> Traction:
        """The variance of the traction, less its mean with these weights, in every cell."""
        without = variance(self._posterior, mean_weights)
        return without if self._beside is None else without + self._beside.variance(mean_weights)


def value(problem: LineProblem, prior: Prior, tolerance: float) -> Solved:
    """Posterior mean to a relative `tolerance`, without its standard error."""
    posterior = PosteriorMap(with_fields(problem, nuisance=None), prior)
    return Marginal(problem, posterior, tolerance).mean(np.asarray(problem.data, float))


def times_covariance(
    problem: LineProblem, prior: Prior, right: Traction, tolerance: float
) -> Traction:
    """The posterior covariance times a right side, to a relative `tolerance`."""
    posterior = PosteriorMap(with_fields(problem, nuisance=None), prior)
    return Marginal(problem, posterior, tolerance).times(posterior.normal.centre(right)).value


class IterativeSolution(NamedTuple):
    """A solution, the steps taken, whether they converged, and the defect of the map that its bands
    are of (see `PosteriorMap`)."""

    solution: Solution
    steps: int
    converged: bool
    defect: float


def solve(problem: LineProblem, prior: Prior, tolerance: float) -> IterativeSolution:
    """Posterior mean to a relative `tolerance`, and its standard error."""
    posterior = PosteriorMap(with_fields(problem, nuisance=None), prior)
    normal, n = posterior.equations, problem.line.n
    near = NearPeriodic(PeriodicModel(at_one_level(problem), normal.gaps), prior)
    data = np.asarray(problem.data, float)
    posterior.find_shapes()
    marginal = Marginal(problem, posterior, tolerance)
    signals = [data]
    for c in range(problem.unknowns):
        impulse = np.zeros((problem.unknowns, n))
        impulse[c, n // 2] = 1.0
        signals.append(normal.forward(normal.centre(impulse)))
    solved = each_on_a_core(marginal.mean, signals, n)
    mean, *averaging = (each.value for each in solved)
    moved = solved_directions(
        lambda changes: each_on_a_core(lambda y: marginal.mean(y, RIG).value, changes, n),
        np.asarray(problem.changed_signals(mean)),
        problem.rig_rows,
    )
    spread = marginal.variance(np.asarray(problem.mean_weights))
    spread = spread + change_of_variance(problem, posterior.near)
    stderr = np.sqrt(np.maximum(spread, 0.0))
    solution = Solution(
        as_real(mean),
        as_real(stderr),
        in_jax(near.covariance),
        as_real(np.stack(averaging, axis=1)),
        as_real(near.resolved_dof(near.blocks())),
        # A sum of variances that ends at or below zero is rounding.
        _condition(problem, prior) if spread.min() > 0 else np.asarray(LEFT_TO_ROUNDING),
        moved,
    )
    converged = all(each.converged for each in solved)
    return IterativeSolution(solution, solved[0].steps, converged, posterior.defect())


@by_numpy
def _condition(problem: LineProblem, prior: Prior, xp: Any = jnp) -> Float[Any, ""]:
    """Estimate of the condition number: the best observed mode over one held by the prior alone.

    Where samples are missing, or an open line ends, some traction is held by the prior alone, with
    its mean precision over wavenumbers.
    """
    information = xp.max(problem.information)
    held = xp.mean(xp.asarray(prior.root(problem.line)) ** 2, axis=-1)
    return (information + xp.max(held)) / xp.maximum(xp.min(held), np.finfo(held.dtype).tiny)


# What missing samples add is computed cell by cell up to so many widths of the response from each,
# every width up to FAR times that, and beyond at distances that grow by e in so many steps.
NEAR, FAR, RUNGS = 5, 8, 10
TOGETHER = 8  # hats
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
    """Correction of the variance for piecewise-linear interpolation at the ends of the grid."""
    normal, inverse, images = posterior.normal, coarse.inverse, coarse.images
    energy, total = [], 0.0
    for first in range(0, len(images), TOGETHER):
        some = images[first : first + TOGETHER]
        moved = np.stack(each_on_a_core(posterior.near_times, some, some.shape[-1]))
        energy.append(moved.reshape(len(moved), -1) @ images.reshape(len(images), -1).T)
        for row, each in zip(inverse[first:], moved, strict=False):
            total = total - 2 * normal.centre(coarse.spread(row)) * each
    among = inverse + inverse @ np.concatenate(energy) @ inverse
    return total + coarse.diagonal((among + among.T) / 2, normal.zero_mean)


def _of_gaps(near: NearPeriodic) -> Variance:
    """The variance that missing samples add: the diagonal of B T B^T, T the inverse of Q over
    them and B the response of the traction to them.

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
        inverse = DenseInverse(gaps.matrix(unexpected, around, around)).whole[own]
        of_each = gaps.element[around, None] == np.arange(elements)
        sums[gaps.element[block], :, gaps.cell[block]] = inverse @ of_each
        line, places = _places(gaps.cell[around], grid, n, near.width_cells)
        lag = (places[:, None] - gaps.cell[around]) % n
        added = []
        for c in range(unknowns):
            responses = response[c, gaps.element[around], lag]
            added.append(np.sum(responses[:, own] * (responses @ inverse.T), axis=1))
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
