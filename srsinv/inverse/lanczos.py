"""Lanczos' steps: the few shapes in which an approximate inverse is wrong."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

# Steps at most, and how near to one the eigenvalues are that are left when they end, rooted.
MOST_STEPS, ONE = 60, 0.01

Values = Float[np.ndarray, "..."]
Map = Callable[[np.ndarray], np.ndarray]


class Shapes(NamedTuple):
    """What a map lacks: the sum of f u u^T, `factors` f (shape,) and `vectors` u (shape, ...)."""

    factors: Float[np.ndarray, " shape"]
    vectors: Float[np.ndarray, "shape ..."]

    def times(self, r: Values) -> Values:
        """The sum times r."""
        return np.tensordot(
            self.factors * np.tensordot(self.vectors, r, r.ndim), self.vectors, axes=1
        )

    def diagonal(self) -> Values:
        """The sum's diagonal."""
        return np.einsum("i,i...,i...->...", self.factors, self.vectors, self.vectors)


def missing_shapes(operator: Map, nearly_inverse: Map, project: Map, like: Values) -> Shapes:
    """The shapes that a map M, nearly the inverse of the operator H, lacks.

    M H has few eigenvalues t that are not near one. Lanczos' steps find these with their vectors,
    u^T M^-1 u = 1, and f = 1/t - 1. Every step is orthogonalised to all before, for rounding takes
    their orthogonality where H has a large condition. `like`: an array of zeros; `project` takes
    out of another what M is zero for.
    """
    any_one = project(np.random.default_rng(0).normal(size=like.shape))
    dual = operator(nearly_inverse(any_one)) - any_one  # what is not near one, alone
    vectors, duals, diagonal, beside = [], [], [], []  # duals: M^-1 times the vectors
    for _ in range(MOST_STEPS):
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
