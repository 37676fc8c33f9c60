"""A linear problem in standard form: whitened data = H u + noise, with u of independent coordinates
of the prior precision w.

The prior's precision of z is w L^T L. With a right inverse S of the root L, the unknown is
x = mean + K (S u + N c), where N spans what L maps to zero. The data determine c. With the thin QR
factorisation A N = Q R of the whitened operator A, the part of the data in the range of Q fixes c
for each u, and H = (1 - Q Q^T) A S acts on the rest (Elden 1982; Hansen 1998, section 2.3). So S is
the preconditioner of iterations: prior coordinates of variance 1/w.
"""

import abc
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from ...errors import refuse
from ...known import Numbers, in_jax, namespace
from .modes import UNDETERMINED, inverse_condition_of
from .prior import Differences, PriorFactors
from .problem import LinearProblem, scattered, solve_triangular

LONGEST_AXIS = 8192  # cells of an axis of an array, whose differences are factored as a matrix


class RootInverse(eqx.Module):
    """Base of right inverses S (k, r) of a prior's root L, with range orthogonal to what L maps to
    zero.

    - `null` (k, d): an orthonormal basis of that. `size`: r.
    """

    null: eqx.AbstractVar[Float[Numbers, "k d"]]
    size: eqx.AbstractVar[int]

    @abc.abstractmethod
    def __call__(self, u: Float[Numbers, " r"]) -> Float[Numbers, " k"]:
        """S u."""

    @abc.abstractmethod
    def transpose(self, z: Float[Numbers, " k"]) -> Float[Numbers, " r"]:
        """S^T z."""


class NoRoot(RootInverse):
    """The inverse where L is 1."""

    null: Float[Numbers, "k d"]
    size: int = eqx.field(static=True)

    def __call__(self, u: Float[Numbers, " r"]) -> Float[Numbers, " k"]:
        return u

    def transpose(self, z: Float[Numbers, " k"]) -> Float[Numbers, " r"]:
        return z


class CumulatedSums(RootInverse):
    """The inverse of differences of `order` on a line with ends: sums, less the best polynomial."""

    null: Float[Numbers, "k d"]
    size: int = eqx.field(static=True)
    order: int = eqx.field(static=True)

    def __call__(self, u: Float[Numbers, " r"]) -> Float[Numbers, " k"]:
        xp = namespace(u)
        for _ in range(self.order):
            u = xp.pad(xp.cumsum(u), (1, 0))
        return u - self.null @ (self.null.T @ u)

    def transpose(self, z: Float[Numbers, " k"]) -> Float[Numbers, " r"]:
        xp = namespace(z)
        z = z - self.null @ (self.null.T @ z)
        for _ in range(self.order):
            z = xp.cumsum(z[:0:-1])[::-1]
        return z


class AxisModes(RootInverse):
    """The inverse of differences along the axes of an array of `shape`, of which L^T L is a
    Kronecker sum: the modes of each axis are the columns of `axes`, of which each product of modes
    in `held` (r,) is divided by its own singular value, `values` (r,)."""

    null: Float[Numbers, "k d"]
    size: int = eqx.field(static=True)
    axes: tuple[Float[Numbers, "..."], ...]
    held: Int[Numbers, " r"]
    values: Float[Numbers, " r"]
    shape: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, u: Float[Numbers, " r"]) -> Float[Numbers, " k"]:
        modes = scattered(u / self.values, self.held, math.prod(self.shape))
        return _along_axes(self.axes, modes.reshape(self.shape)).ravel()

    def transpose(self, z: Float[Numbers, " k"]) -> Float[Numbers, " r"]:
        modes = _along_axes([each.T for each in self.axes], z.reshape(self.shape))
        return modes.ravel()[self.held] / self.values


class TriangularInverse(RootInverse):
    """The inverse of a matrix of full column rank with the QR factor `triangle` (k, k)."""

    null: Float[Numbers, "k d"]
    size: int = eqx.field(static=True)
    triangle: Float[Numbers, "k k"]

    def __call__(self, u: Float[Numbers, " r"]) -> Float[Numbers, " k"]:
        return solve_triangular(self.triangle, u)

    def transpose(self, z: Float[Numbers, " k"]) -> Float[Numbers, " r"]:
        return solve_triangular(self.triangle, z, trans=1)


class PseudoInverse(RootInverse):
    """The inverse `matrix` (k, r) of a matrix of lower rank."""

    null: Float[Numbers, "k d"]
    size: int = eqx.field(static=True)
    matrix: Float[Numbers, "k r"]

    def __call__(self, u: Float[Numbers, " r"]) -> Float[Numbers, " k"]:
        return self.matrix @ u

    def transpose(self, z: Float[Numbers, " k"]) -> Float[Numbers, " r"]:
        return self.matrix.T @ z


def _along_axes(matrices: Any, values: Any) -> Any:
    for axis, matrix in enumerate(matrices):
        moved = namespace(values).tensordot(matrix, values, axes=(1, axis))
        values = namespace(values).moveaxis(moved, 0, axis)
    return values


def root_inverse(factors: PriorFactors) -> RootInverse:
    """The right inverse of the root of a prior.

    Raises `BadInput` for differences along an axis that is too long to be factored.
    """
    root, k = factors.root, factors.coordinates
    if root is None:
        return NoRoot(np.zeros((k, 0)), k)
    if not isinstance(root, Differences):
        return _of_matrix(root)
    if len(root.shape) == 1 and not root.wraps:
        powers = np.vander(np.linspace(-1.0, 1.0, k), root.order)
        return CumulatedSums(np.linalg.qr(powers)[0], k - root.order, root.order)
    return _of_axes(root)


def _of_matrix(root: Any) -> RootInverse:
    rows, k = root.shape
    root = np.asarray(root)
    if rows >= k:
        is_factor = rows == k and not np.any(np.tril(root, -1))
        triangle = root if is_factor else np.linalg.qr(root)[1]
        if inverse_condition_of(triangle) > k * np.finfo(float).eps:
            return TriangularInverse(np.zeros((k, 0)), k, triangle)
    _, values, right = scipy.linalg.svd(root)
    count = int(np.sum(values > max(rows, k) * np.finfo(float).eps * values[0]))
    return PseudoInverse(right[count:].T, count, right[:count].T / values[:count])


def _of_axes(root: Differences) -> AxisModes:
    longest = max(root.shape)
    refuse(
        longest > LONGEST_AXIS,
        f"The unknown has an axis of {longest} cells, and its differences are factored up to "
        f"{LONGEST_AXIS}: give order=0, or a GaussianPrior.",
    )
    axes, total = [], np.zeros(root.shape)
    for axis, n in enumerate(root.shape):
        along = Differences((n,), root.order, root.wraps)
        vectors, squares = np.eye(n), np.zeros(n)
        if along.is_defined:
            _, values, right = scipy.linalg.svd(along.matrix(), full_matrices=True)
            vectors = right.T
            squares[: along.rank] = values[: along.rank] ** 2
        axes.append(vectors)
        total += squares.reshape([-1 if i == axis else 1 for i in range(total.ndim)])
    held, lost = np.flatnonzero(total), np.flatnonzero(total == 0)
    units = np.zeros((len(lost), *root.shape))
    units.reshape(len(lost), -1)[np.arange(len(lost)), lost] = 1.0
    null = [_along_axes(axes, unit).ravel() for unit in units]
    values = np.sqrt(total.ravel()[held])
    return AxisModes(np.array(null).T, len(held), tuple(axes), held, values, root.shape)


class StandardForm(eqx.Module):
    """A problem in standard form.

    - `data` (s,): the whitened data, less those of the prior's mean and of what the prior leaves to
      them. `size`: how many u there are.
    - `range` (s, d): Q, and the data `along` (d,) it. `free` (k, d): N R^-1, with R c of unit
      covariance. `pulled` (r, d): (A S)^T Q, what u takes of R c.
    """

    problem: LinearProblem
    factors: PriorFactors
    inverse: RootInverse
    data: Float[Numbers, " s"]
    range: Float[Numbers, "s d"]
    along: Float[Numbers, " d"]
    free: Float[Numbers, "k d"]
    pulled: Float[Numbers, "r d"]

    @property
    def size(self) -> int:
        return self.inverse.size

    @property
    def free_count(self) -> int:
        """How many combinations of unknowns the data alone determine."""
        return self.range.shape[1]

    @property
    def by_jax(self) -> bool:
        """Whether its products are those of jax."""
        return self.problem.operator.by_jax

    def forward(self, u: Float[Numbers, " r"]) -> Float[Numbers, " s"]:
        """H u."""
        return self._outside(whitened_forward(self.problem, self.factors, self.inverse(u)))

    def adjoint(self, y: Float[Numbers, " s"]) -> Float[Numbers, " r"]:
        """H^T y."""
        z = whitened_adjoint(self.problem, self.factors, self._outside(y))
        return self.inverse.transpose(z)

    def unknown(self, u: Float[Numbers, " r"]) -> Float[Numbers, " m"]:
        """What u adds to the unknown."""
        return self.factors.apply_spread(self.inverse(u) - self.free @ (self.pulled.T @ u))

    def coordinates(self, u: Float[Numbers, " r"]) -> Float[Numbers, " k"]:
        """The best prior coordinates z of u: S u + N c."""
        return self.inverse(u) + self.free @ (self.along - self.pulled.T @ u)

    def _outside(self, y: Any) -> Any:
        return y - self.range @ (self.range.T @ y) if self.free_count else y


def whitened_forward(problem: LinearProblem, factors: PriorFactors, z: Any) -> Any:
    """The whitened data of prior coordinates z, less those of the prior's mean."""
    x = factors.apply_spread(z).reshape(problem.operator.unknown_shape)
    return problem.whiten(problem.operator.forward(x).reshape(-1))


def whitened_adjoint(problem: LinearProblem, factors: PriorFactors, y: Any) -> Any:
    """The transposed map of [`whitened_forward`][]."""
    samples = problem.transpose_white(y).reshape(problem.data.shape)
    return factors.transpose_spread(problem.operator.adjoint(samples).reshape(-1))


def centred_data(problem: LinearProblem, factors: PriorFactors) -> Float[Numbers, " s"]:
    """The whitened data, less those of the prior's mean."""
    mean = factors.mean.reshape(problem.operator.unknown_shape)
    return problem.whiten((problem.data - problem.operator.forward(mean)).reshape(-1))


def standard_form(problem: LinearProblem, factors: PriorFactors) -> StandardForm:
    """The problem under a prior in standard form, of a problem that is known.

    Raises `BadInput` where data and prior leave a combination of unknowns undetermined.
    """
    inverse = root_inverse(factors)
    if problem.operator.by_jax:
        problem, factors, inverse = in_jax((problem, factors, inverse))
    xp = jnp if problem.operator.by_jax else np
    data = centred_data(problem, factors)
    null, d = inverse.null, inverse.null.shape[1]
    if d == 0:
        outer, free, pulled = (
            xp.zeros((rows, 0)) for rows in (data.size, factors.coordinates, inverse.size)
        )
        return StandardForm(problem, factors, inverse, data, outer, xp.zeros(0), free, pulled)
    columns = xp.stack([whitened_forward(problem, factors, null[:, i]) for i in range(d)], axis=1)
    outer, triangle = xp.linalg.qr(columns)
    signs = xp.asarray(np.random.default_rng(0).choice([-1.0, 1.0], factors.coordinates))
    # About Frobenius's norm of the operator.
    norm = xp.linalg.norm(whitened_forward(problem, factors, signs))
    least = max(columns.shape) * np.finfo(float).eps * norm
    refuse(
        columns.shape[0] < d or bool(np.any(np.abs(np.diag(np.asarray(triangle))) <= least)),
        UNDETERMINED,
    )
    free = solve_triangular(triangle, null.T, trans=1).T
    back = [inverse.transpose(whitened_adjoint(problem, factors, outer[:, i])) for i in range(d)]
    along = outer.T @ data
    pulled = xp.stack(back, axis=1)
    left = data - outer @ along
    left = left - outer @ (outer.T @ left)  # once more, as rounding leaves a part
    return StandardForm(problem, factors, inverse, left, outer, along, free, pulled)
