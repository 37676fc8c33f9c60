"""Singular triplets of a linear problem's operator by products alone.

The bidiagonalisation of Golub and Kahan (1965) from the data gives the solution of every weight
down to some lowest one, and approximate singular vectors. Where it ends in an invariant space,
further ones from random vectors find the rest, multiple singular values among them, until a random
vector leaves nothing.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import refuse
from ...known import Numbers, in_jax
from .standard import StandardForm

FIRST_ROWS = 16  # that a basis has room for
LEAST_START = 1e-8  # of a random vector: less is left of it where the basis is complete
INVARIANT = 1e-4  # of a singular value: the residual of singular vectors that have converged


class OperatorProducts(NamedTuple):
    """The products H u and H^T y in numpy."""

    forward: Callable[[np.ndarray], np.ndarray]
    adjoint: Callable[[np.ndarray], np.ndarray]


@compiled
def _forward(form: StandardForm, u: Float[Array, " r"]) -> Float[Numbers, " s"]:
    return form.forward(u)


@compiled
def _adjoint(form: StandardForm, y: Float[Array, " s"]) -> Float[Numbers, " r"]:
    return form.adjoint(y)


@compiled
def _unknown(form: StandardForm, u: Float[Array, " r"]) -> Float[Numbers, " m"]:
    return form.unknown(u)


def each_unknown(form: StandardForm, rows: Float[np.ndarray, "j r"]) -> Float[np.ndarray, "j m"]:
    """What each row of u adds to the unknown."""
    if not form.by_jax:
        return np.array([form.unknown(row) for row in rows])
    return np.array([np.asarray(_unknown(form, in_jax(row)), float) for row in rows])


def products(form: StandardForm) -> OperatorProducts:
    """The products of a problem in standard form."""
    if form.by_jax:
        return OperatorProducts(
            lambda u: np.asarray(_forward(form, in_jax(u)), float),
            lambda y: np.asarray(_adjoint(form, in_jax(y)), float),
        )
    return OperatorProducts(
        lambda u: np.asarray(form.forward(u), float), lambda y: np.asarray(form.adjoint(y), float)
    )


class Basis:
    """Orthonormal vectors, as the rows of an array that grows."""

    def __init__(self, length: int):
        self._rows, self.count = np.empty((FIRST_ROWS, length)), 0

    @property
    def rows(self) -> Float[np.ndarray, "k n"]:
        return self._rows[: self.count]

    def add(self, row: Float[np.ndarray, " n"]) -> None:
        if self.count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self.count] = row
        self.count += 1

    def without(self, vector: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The part of a vector that is orthogonal to the basis."""
        size = np.linalg.norm(vector)
        vector = vector - (self.rows @ vector) @ self.rows
        if np.linalg.norm(vector) < size / 2:  # Kahan: twice is enough (Parlett 1998, section 6.9)
            vector = vector - (self.rows @ vector) @ self.rows
        return vector


class Bidiagonalisation:
    """H V = U B by the recursion of Golub and Kahan from a start: B has the `diagonal` and, `below`
    it, as many entries again.

    - `left`, `right`: bases to which U and V are kept orthogonal and are added. None: neither.
    - `largest`: an entry of an earlier B, in whose rounding a new entry is zero. The space is then
      invariant, and `is_exhausted`.
    """

    def __init__(
        self,
        of: OperatorProducts,
        start: Float[np.ndarray, " s"],
        bases: tuple[Basis, Basis] | None = None,
        largest: float = 0.0,
    ):
        self._of, self.largest = of, largest
        self._left, self._right = bases or (None, None)
        self._first = (0, 0) if bases is None else (bases[0].count, bases[1].count)
        self.diagonal: list[float] = []
        self.below: list[float] = []
        self.is_exhausted = False
        size = float(np.linalg.norm(start))
        start = start if self._left is None else self._left.without(start)
        norm = float(np.linalg.norm(start))
        self.norm = norm if norm > LEAST_START * size else 0.0
        self._u = start / self.norm if self.norm > 0 else np.zeros_like(start)
        self._v = np.zeros(0)
        if self._left is not None:
            self._left.add(self._u)
        self._advance(of.adjoint(self._u))

    def extend(self, steps: int) -> None:
        """So many steps in all, or fewer where the space is invariant."""
        while len(self.below) < steps and not self.is_exhausted:
            ahead = self._of.forward(self._v) - self.diagonal[-1] * self._u
            ahead, norm = self._next(ahead, self._left)
            self.below.append(norm)
            self._u = ahead
            if self._left is not None:
                self._left.add(ahead)
            if norm == 0:
                self.diagonal.append(0.0)
                self.is_exhausted = True
                return
            self._advance(self._of.adjoint(ahead) - norm * self._v)

    def _advance(self, back: np.ndarray) -> None:
        self._v, norm = self._next(back, self._right)
        self.diagonal.append(norm)
        self.is_exhausted = norm == 0
        if not self.is_exhausted and self._right is not None:
            self._right.add(self._v)

    def _next(self, vector: np.ndarray, basis: Basis | None) -> tuple[np.ndarray, float]:
        """The next vector of a basis and its norm, both 0 where it is rounding."""
        vector = vector if basis is None else basis.without(vector)
        norm = float(np.linalg.norm(vector))
        if norm <= np.finfo(float).eps * max(self._u.size, vector.size) * self.largest:
            return np.zeros_like(vector), 0.0
        self.largest = max(self.largest, norm)
        return vector / norm, norm

    @property
    def matrix(self) -> Float[np.ndarray, "j k"]:
        """B (k + 1, k)."""
        k = len(self.below)
        made = np.zeros((k + 1, k))
        made[np.arange(k), np.arange(k)] = self.diagonal[:k]
        made[np.arange(1, k + 1), np.arange(k)] = self.below
        return made

    def tridiagonal(self, whole: bool) -> tuple[np.ndarray, np.ndarray]:
        """The diagonal of B B^T and the entries beside it, of all rows of B or all but the last."""
        k = len(self.below)
        diagonal, below = np.array(self.diagonal[:k]), np.array(self.below)
        squares = np.append(diagonal**2, 0.0) + np.insert(below**2, 0, 0.0)
        beside = diagonal * below
        return (squares, beside) if whole else (squares[:-1], beside[:-1])

    def triplets(self) -> "Triplets":
        """The singular values and vectors of H in the space."""
        assert self._left is not None
        assert self._right is not None
        outer, values, inner = np.linalg.svd(self.matrix, full_matrices=False)
        k, (left, right) = len(values), self._first
        return Triplets(
            values,
            outer.T @ self._left.rows[left : left + k + 1],
            inner @ self._right.rows[right : right + k],
            self.diagonal[k] * np.abs(outer[k]),
        )

    def lowest(self, logs: Float[np.ndarray, " w"], tolerance: float) -> float:
        """The lowest of falling log10 weights down to which the mean has a relative residual of the
        normal equations within the tolerance."""
        if self.is_exhausted:
            return float(logs[-1])
        outer, values, inner = np.linalg.svd(self.matrix, full_matrices=False)
        filters = values / (values**2 + 10.0 ** logs[:, None])
        last = np.abs((filters * outer[0]) @ inner[:, -1])
        residual = self.diagonal[-1] * self.below[-1] * last / self.diagonal[0]
        return last_before(logs, residual <= tolerance)


class Triplets(NamedTuple):
    """Approximate singular `values` (k,) with `left` (k, s) and `right` (k, r) vectors, and the
    `residual` |H^T left - value right| of each."""

    values: Float[np.ndarray, " k"]
    left: Float[np.ndarray, "k s"]
    right: Float[np.ndarray, "k r"]
    residual: Float[np.ndarray, " k"]

    def converged(self) -> "Triplets":
        """Those of small residual."""
        some = self.residual <= INVARIANT * self.values
        return Triplets(*(each[some] for each in self))


def last_before(logs: np.ndarray, holds: np.ndarray) -> float:
    """The last of the weights before the condition fails a first time; the first in any case."""
    failed = np.flatnonzero(~holds)
    return float(logs[max(failed[0] - 1, 0)] if failed.size else logs[-1])


class SingularSpace:
    """The singular triplets of H that are found from the data, and from random vectors where those
    have found an invariant space. `is_exact`: whether these are all."""

    def __init__(self, of: OperatorProducts, data: Float[np.ndarray, " s"], size: int):
        self._of = of
        self._bases = Basis(data.size), Basis(size)
        self._rng = np.random.default_rng(0)
        self._parts = [Bidiagonalisation(of, data, self._bases)]
        self.is_exact = False
        if self.first.diagonal[0] == 0:  # the data are zero, or orthogonal to the range of H
            self._parts = [Bidiagonalisation(of, self._signs(), self._bases)]

    @property
    def first(self) -> Bidiagonalisation:
        return self._parts[0]

    def _signs(self) -> np.ndarray:
        return self._rng.choice([-1.0, 1.0], self._bases[0].rows.shape[1])

    def extend(self, steps: int, most: int) -> None:
        """So many steps from the data; where that ends it, up to `most` from random vectors."""
        self.first.extend(steps)
        left, right = self._bases
        whole = min(left.rows.shape[1], right.rows.shape[1])
        self.is_exact = right.count >= whole
        while self.first.is_exhausted and not self.is_exact and right.count < most:
            largest, room = self._parts[-1].largest, most - right.count
            part = Bidiagonalisation(self._of, self._signs(), self._bases, largest)
            part.extend(room)
            self.is_exact = part.diagonal[0] == 0 or right.count >= whole
            if not part.is_exhausted and not self.is_exact:
                return
            if part.below:
                self._parts.append(part)

    def triplets(self) -> Triplets:
        """All that are found. Raises `BadInput` where H is zero."""
        refuse(
            not self.first.below,
            "operator is zero for all that the prior weighs: give one that maps unknowns to data.",
        )
        parts = [part.triplets() for part in self._parts if part.below]
        return Triplets(*(np.concatenate(each) for each in zip(*parts, strict=True)))
