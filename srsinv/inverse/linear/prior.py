"""The prior of an unknown as two factors: what spreads coordinates to the unknown, and the root of
the coordinates' precision.

The unknown is x = mean + K z, and the prior's precision of z is w L^T L. A covariance C = K K^T has
L = 1, which also holds where C is singular. A precision L^T L has K = 1, which also holds where the
data alone determine part of x.
"""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Float

from ...errors import refuse
from ...known import Numbers, array_module, is_traced, namespace

Shape = tuple[int, ...]
LEAST_EIGENVALUE = -1e-10  # of the largest: below, a matrix is no covariance and no precision
ASYMMETRY = 1e-10  # of the largest entry


class GaussianPrior(eqx.Module):
    """A Gaussian prior of an unknown x: x ~ N(mean, C).

    One of four states C, in the unit of x:

    - `stderr`: the standard deviation, one number or an array of the unknown's shape; its values
      are independent.
    - `covariance` (m, m): C, of the unknown as a flat array; it may be singular.
    - `precision` (m, m): the inverse of C; it may be singular where the data determine the rest.
    - `root` (k, m): L with the precision L^T L.

    `mean`: one number, or an array of the unknown's shape.

    Raises `BadInput` for none or several of the four, for numbers that are not finite, for standard
    deviations that are not positive, and for a matrix that is not symmetric or has negative
    eigenvalues.
    """

    stderr: Float[Numbers, "..."] | None
    spread: Float[Numbers, "m k"] | None
    root: Float[Numbers, "k m"] | None
    mean: Float[Numbers, "..."]

    def __init__(
        self,
        stderr: Any = None,
        *,
        covariance: Any = None,
        precision: Any = None,
        root: Any = None,
        mean: Any = 0.0,
    ):
        named = {
            "stderr": stderr, "covariance": covariance, "precision": precision, "root": root
        }  # fmt: skip
        given = [name for name, value in named.items() if value is not None]
        refuse(
            len(given) != 1,
            f"The prior has {' and '.join(given) or 'no width'}: give one of stderr, covariance, "
            "precision and root.",
        )
        name = given[0]
        values = _numbers(name, named[name])
        self.mean = _numbers("mean", mean)
        self.stderr = self.spread = self.root = None
        if name == "stderr":
            refuse(
                not is_traced(values) and not np.all(values > 0),
                "stderr of the prior has values that are not positive: give standard deviations "
                "above 0.",
            )
            self.stderr = values
            return
        refuse(
            values.ndim != 2 or (name != "root" and values.shape[0] != values.shape[1]),
            f"{name} of the prior has the shape {values.shape}: give a matrix with a row and a "
            "column for each unknown.",
        )
        if name == "root":
            self.root = values
        elif name == "covariance":
            self.spread = _factor(name, values)
        else:
            self.root = _factor(name, values).T


def _numbers(name: str, value: Any) -> Float[Numbers, "..."]:
    if is_traced(value):
        return jnp.asarray(value, float)
    try:
        values = np.asarray(value, float)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    refuse(
        not np.all(np.isfinite(values)),
        f"{name} of the prior has values that are no finite numbers: give finite numbers.",
    )
    return values


def _factor(name: str, matrix: Float[Numbers, "m m"]) -> Float[Numbers, "m m"]:
    """F with F F^T = matrix: by Cholesky, or by eigenvalues where the matrix is singular."""
    if is_traced(matrix):
        return jnp.linalg.cholesky(matrix)
    size = np.max(np.abs(matrix), initial=0.0)
    refuse(
        not np.all(np.abs(matrix - matrix.T) <= ASYMMETRY * size),
        f"{name} of the prior is not symmetric: give ({name} + {name}.T) / 2.",
    )
    matrix = (matrix + matrix.T) / 2
    try:
        return scipy.linalg.cholesky(matrix, lower=True)
    except scipy.linalg.LinAlgError:
        values, vectors = scipy.linalg.eigh(matrix)
    refuse(
        not values[0] >= LEAST_EIGENVALUE * values[-1],
        f"{name} of the prior has the negative eigenvalue {values[0]:.3g}: give a matrix whose "
        "eigenvalues are 0 or larger.",
    )
    return vectors * np.sqrt(np.maximum(values, 0.0))


class Differences(eqx.Module):
    """Differences of an array of `shape` of this `order` along each axis, one axis after the other;
    order 0 is the array itself. `wraps`: whether the last neighbours the first."""

    shape: Shape = eqx.field(static=True)
    order: int = eqx.field(static=True)
    wraps: bool = eqx.field(static=True)

    def __call__(self, z: Float[Numbers, " m"]) -> Float[Numbers, " k"]:
        if self.order == 0:
            return z
        xp = namespace(z)
        values = z.reshape(self.shape)
        return xp.concatenate([self._along(values, axis).ravel() for axis in self._axes])

    def transpose(self, y: Float[Numbers, " k"]) -> Float[Numbers, " m"]:
        """The transposed map."""
        if self.order == 0:
            return y
        xp = namespace(y)
        total, at = xp.zeros(self.shape, y.dtype), 0
        for axis in self._axes:
            shape = list(self.shape)
            shape[axis] -= 0 if self.wraps else self.order
            size = math.prod(shape)
            total = total + self._back(y[at : at + size].reshape(shape), axis)
            at += size
        return total.ravel()

    @property
    def is_defined(self) -> bool:
        """Whether there is any difference."""
        return bool(self._axes)

    @property
    def rank(self) -> int:
        """The rank of the map, which loses polynomials of lower degree along each axis."""
        lost = [self.shape[axis] for axis in range(len(self.shape)) if axis not in self._axes]
        lost += [1 if self.wraps else self.order for _ in self._axes]
        return math.prod(self.shape) - math.prod(lost) if self.order else math.prod(self.shape)

    @property
    def _axes(self) -> list[int]:
        """Those along which there are differences."""
        least = 1 if self.wraps else self.order
        return [axis for axis, n in enumerate(self.shape) if n > least]

    def _along(self, values: Any, axis: int) -> Any:
        xp = namespace(values)
        if not self.wraps:
            return xp.diff(values, self.order, axis)
        for _ in range(self.order):
            values = xp.roll(values, -1, axis) - values
        return values

    def _back(self, values: Any, axis: int) -> Any:
        xp = namespace(values)
        for _ in range(self.order):
            if self.wraps:
                values = xp.roll(values, 1, axis) - values
                continue
            ends = [(int(i == axis), int(i == axis)) for i in range(values.ndim)]
            values = -xp.diff(xp.pad(values, ends), 1, axis)
        return values

    def matrix(self) -> Float[np.ndarray, "k m"]:
        """The map as a matrix."""
        basis = np.eye(math.prod(self.shape))
        if self.order == 0:
            return basis
        columns = basis.reshape(-1, *self.shape)
        rows = [self._along(columns, axis + 1).reshape(len(basis), -1) for axis in self._axes]
        return np.concatenate(rows, axis=1).T


class PriorFactors(eqx.Module):
    """The factors of a prior of `size` unknowns: x = mean + K z with the precision L^T L of z.

    - `mean` (m,). `spread`: K, (m,) for a diagonal, or (m, k); None: 1.
    - `root`: L, a matrix (j, k) or [`Differences`][]; None: 1.
    """

    mean: Float[Numbers, " m"]
    spread: Float[Numbers, "..."] | None
    root: Float[Numbers, "j k"] | Differences | None
    size: int = eqx.field(static=True)

    @property
    def coordinates(self) -> int:
        """How many z there are."""
        is_matrix = self.spread is not None and self.spread.ndim == 2
        return self.spread.shape[1] if is_matrix else self.size  # pyright: ignore

    def apply_spread(self, z: Any) -> Any:
        """K z, also of columns (k, j)."""
        if self.spread is None:
            return z
        if self.spread.ndim == 2:
            return self.spread @ z
        return (self.spread * z.T).T

    def transpose_spread(self, x: Any) -> Any:
        """K^T x."""
        if self.spread is not None and self.spread.ndim == 2:
            return self.spread.T @ x
        return self.apply_spread(x)

    def apply_root(self, z: Any) -> Any:
        """L z."""
        if self.root is None:
            return z
        return self.root(z) if isinstance(self.root, Differences) else self.root @ z

    def transpose_root(self, y: Any) -> Any:
        """L^T y."""
        if self.root is None:
            return y
        if isinstance(self.root, Differences):
            return self.root.transpose(y)
        return self.root.T @ y

    def root_matrix(self) -> Float[Numbers, "j k"] | None:
        """L as a matrix; None: 1."""
        return self.root.matrix() if isinstance(self.root, Differences) else self.root

    @property
    def rank(self) -> int:
        """The rank of L; that of a matrix which jax traces is taken as full."""
        root = self.root
        if root is None:
            return self.coordinates
        if isinstance(root, Differences):
            return root.rank
        if is_traced(root):
            return min(root.shape)
        return int(np.linalg.matrix_rank(np.asarray(root)))


def prior_factors(prior: GaussianPrior, shape: Shape) -> PriorFactors:
    """The factors of a prior of an unknown of this shape, refused where shapes disagree."""
    m = math.prod(shape)
    xp = array_module(prior)
    refuse(
        prior.mean.shape not in ((), shape),
        f"mean of the prior has the shape {prior.mean.shape}: give one number or the shape "
        f"{shape} of the unknown.",
    )
    mean = xp.broadcast_to(prior.mean, shape).reshape(m)
    if prior.root is not None:
        _check_count(prior.root.shape[1], m)
        return PriorFactors(mean, None, prior.root, m)
    if prior.stderr is not None:
        refuse(
            prior.stderr.shape not in ((), shape),
            f"stderr of the prior has the shape {prior.stderr.shape}: give one number or the shape "
            f"{shape} of the unknown.",
        )
        return PriorFactors(mean, xp.broadcast_to(prior.stderr, shape).reshape(m), None, m)
    assert prior.spread is not None
    _check_count(prior.spread.shape[0], m)
    return PriorFactors(mean, prior.spread, None, m)


def _check_count(of_prior: int, m: int) -> None:
    refuse(
        of_prior != m,
        f"The prior is of {of_prior} unknowns and the operator of {m}: give a prior of as many.",
    )
