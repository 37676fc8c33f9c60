"""Linear algebra for the missing samples of a line: dense inverses of blocks of them, conjugate
gradients, and Lanczos' steps.

An inverse by blocks, or by the nearest periodic problem, is wrong in a few shapes only. Lanczos'
steps find these.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

# A block has so many samples, from least to usual, and ends at the widest distance between two of
# them, for what lies across it is left to conjugate gradients; a run is cut at the most that a
# dense inverse is quick for.
LEAST, USUAL, MOST = 96, 256, 1024
MOST_STEPS = 300  # of conjugate gradients
# Of a matrix's diagonal, for each of its rows: what rounding leaves of a direction that has no
# information, as an element's offset where all of its samples are missing.
ROUNDED = 4 * float(np.finfo(float).eps)

Values = Float[np.ndarray, " m"]
Lags = Float[np.ndarray, "e f n"]
Some = slice | Int[np.ndarray, " some"]
Map = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Gaps:
    """The m missing samples of a line of n cells: their `element` and `cell`, in the order of cells
    around the line, and `blocks` of neighbours."""

    element: Int[np.ndarray, " m"]
    cell: Int[np.ndarray, " m"]
    blocks: Sequence[slice]
    shape: tuple[int, int]

    @classmethod
    def of(cls, is_observed: Bool[np.ndarray, "e n"]) -> "Gaps":
        """What is not observed."""
        element, cell = np.nonzero(~is_observed)
        n = is_observed.shape[1]
        # The order begins where samples are there, so that no run is cut at the line's ends.
        whole = np.flatnonzero(is_observed.all(axis=0))
        start = whole[whole.size // 2] if whole.size else 0
        position = (cell - start) % n
        order = np.lexsort((element, position))
        ends = _block_ends(position[order])
        blocks = [slice(a, b) for a, b in zip([0, *ends], ends, strict=False)]
        return cls(element[order], cell[order], blocks, is_observed.shape)

    def placed(self, values: Values) -> Float[np.ndarray, "e n"]:
        """Values of the missing samples on the line, zero elsewhere."""
        whole = np.zeros(self.shape)
        whole[self.element, self.cell] = values
        return whole

    def picked(self, y: Float[np.ndarray, "e n"]) -> Values:
        """What stands at the missing samples."""
        return y[self.element, self.cell]

    def matrix(self, lags: Lags, rows: Some, columns: Some) -> Float[np.ndarray, "r s"]:
        """The part of the circular convolution with the kernel `lags` that takes these missing
        samples to those."""
        lag = (self.cell[rows, None] - self.cell[None, columns]) % self.shape[1]
        return lags[self.element[rows, None], self.element[None, columns], lag]

    @cached_property
    def _lags_in_blocks(self) -> Sequence[Int[np.ndarray, "b b"]]:
        """Where in a kernel's numbers those of each block stand."""
        (elements, n), found = self.shape, []
        for block in self.blocks:
            element, cell = self.element[block], self.cell[block].astype(np.int32)
            row = (element * elements * n).astype(np.int32)[:, None] + (element * n)[None]
            found.append((row + (cell[:, None] - cell) % n).astype(np.int32))
        return found

    def block_matrices(self, lags: Lags) -> Iterator[Float[np.ndarray, "b b"]]:
        """The part of a kernel within each block."""
        numbers = lags.ravel()
        return (numbers.take(at) for at in self._lags_in_blocks)

    def whole_inverse(self, lags: Lags) -> Map | None:
        """The inverse over all missing samples of a kernel that is positive definite; None of more
        than a dense inverse is quick for."""
        every = slice(None)
        if self.cell.size > MOST:
            return None
        if not self.cell.size:
            return lambda values: values
        inverse = DenseInverse(self.matrix(lags, every, every)).whole
        return lambda values: inverse @ values

    def inverses(self, lags: Lags) -> "BlockInverse":
        """The inverses of its blocks, of a kernel that is positive definite."""
        return BlockInverse(self.blocks, [DenseInverse(of) for of in self.block_matrices(lags)])


class DenseInverse:
    """The inverse of a symmetric matrix that is positive definite but for rounding. Its diagonal is
    raised by rounding, so that Cholesky's factor is there on any processor; where more than
    rounding is wrong, its eigenvalues are."""

    def __init__(self, matrix: Float[np.ndarray, "b b"]):
        floor = ROUNDED * max(len(matrix), 128)
        matrix = matrix.copy()
        matrix.flat[:: len(matrix) + 1] *= 1 + floor
        self._factor, failed = scipy.linalg.lapack.dpotrf(matrix, lower=1)
        if failed:
            values, axes = np.linalg.eigh(matrix)
            values = np.maximum(values, floor * values[-1])
            self._factor, self.whole = None, (axes / values) @ axes.T
            self.log_determinant = -float(np.sum(np.log(values)))
        else:
            self.log_determinant = -2 * float(np.sum(np.log(np.diag(self._factor))))

    @cached_property
    def whole(self) -> Float[np.ndarray, "b b"]:
        """The inverse itself, which takes twice as long as the factor."""
        whole = self._lower + self._lower.T
        whole.flat[:: len(whole) + 1] /= 2
        return whole

    @cached_property
    def _lower(self) -> Float[np.ndarray, "b b"]:
        """The inverse, zero above its diagonal."""
        if self._factor is None:
            return np.tril(self.whole)
        return scipy.linalg.lapack.dpotri(self._factor, lower=1)[0]

    def trace_with(self, matrix: Float[np.ndarray, "b b"]) -> float:
        """The trace of the inverse times a symmetric matrix."""
        lower = self._lower
        return float(2 * np.vdot(lower.T, matrix) - np.diag(lower) @ np.diag(matrix))

    def solved(self, values: Float[np.ndarray, " b"]) -> Float[np.ndarray, " b"]:
        """The inverse times values, by the factor where the inverse itself is not needed."""
        if self._factor is None or "whole" in vars(self):
            return self.whole @ values
        return scipy.linalg.lapack.dpotrs(self._factor, values, lower=1)[0]


class BlockInverse(NamedTuple):
    """The inverse of a matrix over the missing samples, one block at a time."""

    blocks: Sequence[slice]
    inverses: Sequence[DenseInverse] = ()

    def __call__(self, values: Values) -> Values:
        """By each block's own inverse, for many values."""
        return self._by_block(values, lambda inverse, own: inverse.whole @ own)

    def solved(self, values: Values) -> Values:
        """The same, for a few."""
        return self._by_block(values, DenseInverse.solved)

    def _by_block(self, values: Values, times: Callable[[DenseInverse, Values], Values]) -> Values:
        out = np.empty_like(values)
        for block, inverse in zip(self.blocks, self.inverses, strict=True):
            out[block] = times(inverse, values[block])
        return out

    def log_determinant(self) -> float:
        """The logarithm of its determinant."""
        return sum(each.log_determinant for each in self.inverses)


def _block_ends(position: Int[np.ndarray, " m"]) -> list[int]:
    """Where the blocks of the missing samples at these positions end."""
    ends: list[int] = []
    begun, m, step = 0, position.size, np.diff(position)
    while m - begun > USUAL:
        ahead = step[begun + LEAST - 1 : begun + MOST]
        usual = ahead[: USUAL - LEAST + 1]
        if usual.max() > 1:
            size = LEAST + int(usual.argmax())
        else:  # a run, to its end
            size = LEAST + int((ahead > 1).argmax()) if ahead.max() > 1 else MOST
        begun = min(begun + size, m)
        ends.append(begun)
    return [*ends, m] if begun < m else ends


class Solved(NamedTuple):
    """What conjugate gradients end with: the solution, the steps, and whether they converged."""

    value: np.ndarray
    steps: int
    converged: bool


def conjugate_gradients(
    operator: Callable[[np.ndarray], np.ndarray],
    preconditioner: Callable[[np.ndarray], np.ndarray],
    right: np.ndarray,
    tolerance: float,
    most_steps: int,
    first: float = 0.0,
) -> Solved:
    """Solve operator(x) = right, both maps symmetric and positive definite.

    It ends when the residual r, measured as r^T M r with M the preconditioner, has fallen to
    `tolerance`^2 of its first, or of the energy `first` that is given and larger: where M is near
    the inverse, that is the error's energy.
    """
    x, residual = np.zeros_like(right), right.copy()
    ahead = preconditioner(residual)
    direction = ahead.copy()
    energy = float(np.vdot(residual, ahead))
    first = max(first, energy)
    for step in range(most_steps):
        if not energy > tolerance**2 * first:
            return Solved(x, step, bool(np.isfinite(energy)))
        image = operator(direction)
        length = energy / float(np.vdot(direction, image))
        x += length * direction
        residual -= length * image
        ahead = preconditioner(residual)
        before, energy = energy, float(np.vdot(residual, ahead))
        direction = ahead + energy / before * direction
    return Solved(x, most_steps, energy <= tolerance**2 * first)


# Most steps of Lanczos' method; they end where the next direction is shorter than `ONE`.
LANCZOS_STEPS, ONE = 60, 0.01

Field = Float[np.ndarray, "..."]


class Shapes(NamedTuple):
    """What a map lacks: the sum of f u u^T, `factors` f (shape,) and `vectors` u (shape, ...)."""

    factors: Float[np.ndarray, " shape"]
    vectors: Float[np.ndarray, "shape ..."]

    def times(self, r: Field) -> Field:
        """The sum times r."""
        return np.tensordot(
            self.factors * np.tensordot(self.vectors, r, r.ndim), self.vectors, axes=1
        )

    def diagonal(self) -> Field:
        """The sum's diagonal."""
        return np.einsum("i,i...,i...->...", self.factors, self.vectors, self.vectors)


def missing_shapes(operator: Map, nearly_inverse: Map, project: Map, like: Field) -> Shapes:
    """The shapes that a map M, nearly the inverse of the operator H, lacks.

    M H has few eigenvalues t that are not near one. Lanczos' steps find these with their vectors,
    u^T M^-1 u = 1, and f = 1/t - 1. Every step is orthogonalised to all before, for rounding takes
    their orthogonality where H has a large condition. `like`: an array of zeros; `project` takes
    out of another what M is zero for.
    """
    any_one = project(np.random.default_rng(0).normal(size=like.shape))
    dual = operator(nearly_inverse(any_one)) - any_one  # what is not near one, alone
    vectors, duals, diagonal, beside = [], [], [], []  # duals: M^-1 times the vectors
    for _ in range(LANCZOS_STEPS):
        for _ in range(2):
            for u, w in zip(vectors, duals, strict=True):
                dual = dual - np.vdot(u, dual) * w
        dual = project(dual)  # there rounding would grow unseen
        vector = nearly_inverse(dual)
        length = float(np.sqrt(max(np.vdot(dual, vector), 0.0)))
        if not length > (ONE if vectors else 0.0):
            break
        vectors.append(vector / length)
        duals.append(dual / length)
        beside.append(length)
        dual = operator(vectors[-1])
        diagonal.append(float(np.vdot(vectors[-1], dual)))
    if not vectors:
        return Shapes(np.zeros(0), np.zeros((0, *like.shape)))
    values, rows = scipy.linalg.eigh_tridiagonal(diagonal, beside[1 : len(diagonal)])
    del duals  # as large as what is made next
    return Shapes(1 / values - 1, np.tensordot(rows.T, np.stack(vectors), 1))
