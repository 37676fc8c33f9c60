"""The iterative path: conjugate gradients on the normal equations, matrix-free, on a line of any
length, with any samples missing.

Its preconditioner is the nearest periodic problem with the same samples missing, M. That is wrong
at the line's ends only, in a few smooth shapes: hats, for which the equations H are solved exactly
before and after M (balancing, Mandel 1993), and those that Lanczos' steps find besides. Under a
weak prior rounding takes the directions' orthogonality, and each shape left would cost many steps.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..grid import as_real
from ..modules import with_fields
from .bands import variance
from .coarse import Coarse, hats_of
from .gaps import Gaps, Solved, conjugate_gradients
from .lanczos import Shapes, missing_shapes
from .line_problem import LineProblem
from .near_periodic import MOST_STEPS, NearPeriodic
from .noise_levels import at_one_level, change_of_variance
from .noise_precision import NoisePrecision
from .nuisance import Beside, Nuisance
from .prior import Prior, Solution
from .rig_bands import fewer_directions
from .transforms import adjoint, from_spectrum, times, to_spectrum

DRAWS = 3  # of noise, that the map is tried with
LEFT_TO_ROUNDING = 1 / float(np.finfo(float).eps)  # a condition number

Traction = Float[np.ndarray, "c n"]
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
        apply = jax.jit(lambda r: prior.apply(problem.line, r))
        return lambda r: np.asarray(apply(r), float)
    order, weights = squares[0], np.asarray(squares[1], float)[:, None]
    wraps = problem.forward.is_circular

    def differences(r: np.ndarray) -> np.ndarray:
        return np.roll(r, -1, axis=-1) - r if wraps else r[:, 1:] - r[:, :-1]

    def transpose(d: np.ndarray) -> np.ndarray:
        if wraps:
            return np.roll(d, 1, axis=-1) - d
        zero = np.zeros((len(d), 1))
        return np.concatenate([zero, d], axis=-1) - np.concatenate([d, zero], axis=-1)

    def penalty(r: Traction) -> Traction:
        for _ in range(order):
            r = differences(r)
        for _ in range(order):
            r = transpose(r)
        return weights * r

    return penalty


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
        self.near = NearPeriodic(with_fields(problem, **fixed), prior, gaps)
        self.filler = self.near.filler()
        hats = hats_of(self.near, problem.observed_cells) if is_open else None
        self.coarse = None if hats is None else Coarse.of(self.normal, hats, problem.unknowns)
        self.shapes: Shapes | None = None

    def find_shapes(self) -> None:
        """Find the shapes in which the map differs from the covariance, and correct it by them."""
        normal, like = self.normal, np.zeros(self.normal.shape)
        self.shapes = missing_shapes(normal, self.nearly_times, normal.centre, like)

    def near_times(self, r: Traction) -> Traction:
        """The covariance of the nearest periodic problem times r."""
        return self.normal.centre(self.near.covariance_times(self.normal.centre(r), self.filler))

    def nearly_times(self, r: Traction) -> Traction:
        """The covariance times r, but for what conjugate gradients still correct: exact for hats,
        and for the shapes found."""
        if self.coarse is None:
            z = self.near_times(r)
        else:
            r = self.normal.centre(r)
            among = self.coarse.times(r)
            z = self.near_times(r - self.normal(among))
            z = self.normal.centre(z - self.coarse.times(self.normal(z)) + among)
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
            self._beside = Beside.of(
                nuisance, equations.adjoint, lambda r: posterior.times(r, tolerance).value
            )

    def mean(self, y: Signal) -> Solved:
        """The posterior mean of the traction of a signal."""
        right = self._posterior.equations.adjoint(self._weigh(y))
        solved = self._posterior.times(right, self._tolerance)
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
    near = NearPeriodic(at_one_level(problem), prior, normal.gaps)
    data = np.asarray(problem.data, float)
    posterior.find_shapes()
    marginal = Marginal(problem, posterior, tolerance)
    solved = [marginal.mean(data)]
    for c in range(problem.unknowns):
        impulse = np.zeros((problem.unknowns, n))
        impulse[c, n // 2] = 1.0
        solved.append(marginal.mean(normal.forward(normal.centre(impulse))))
    mean, *averaging = (jnp.asarray(each.value) for each in solved)
    changes = fewer_directions(problem.rig_signals(mean))
    moved = [marginal.mean(each).value for each in changes]
    spread = marginal.variance(np.asarray(problem.mean_weights))
    spread = spread + change_of_variance(problem, posterior.near)
    stderr = np.sqrt(np.maximum(spread, 0.0))
    solution = Solution(
        as_real(mean),
        as_real(stderr),
        jnp.asarray(near.covariance),
        as_real(jnp.stack(averaging, axis=1)),
        as_real(near.resolved_dof(near.blocks())),
        # A sum of variances that ends at or below zero is rounding.
        _condition(problem, prior) if spread.min() > 0 else jnp.asarray(LEFT_TO_ROUNDING),
        np.stack(moved) if moved else None,
    )
    converged = all(each.converged for each in solved)
    return IterativeSolution(solution, solved[0].steps, converged, posterior.defect())


@jax.jit
def _condition(problem: LineProblem, prior: Prior) -> Float[Array, ""]:
    """Estimate of the condition number: the best observed mode over one held by the prior alone.

    Where samples are missing, or an open line ends, some traction is held by the prior alone, with
    its mean precision over wavenumbers.
    """
    information = jnp.max(problem.information)
    held = jnp.mean(prior.root(problem.line) ** 2, axis=-1)
    return (information + jnp.max(held)) / jnp.maximum(jnp.min(held), jnp.finfo(held.dtype).tiny)
