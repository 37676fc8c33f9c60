"""Lanczos' steps: the few shapes in which an approximate inverse is wrong."""

from collections.abc import Callable

import numpy as np
import scipy
from jaxtyping import Float

# Steps at most, and how near to one the eigenvalues are that are left when they end, rooted.
MOST_STEPS, ONE = 60, 0.01

Values = Float[np.ndarray, "c n"]
Map = Callable[[Values], Values]
Shapes = list[tuple[float, Values]]


def missing_shapes(operator: Map, nearly_inverse: Map, project: Map, first: Values) -> Shapes:
    """Factors f and shapes u whose sum f u u^T a map M lacks that is nearly the inverse of H.

    M H has few eigenvalues t that are not near one. Steps from `first` find these with their
    vectors, u^T M^-1 u = 1, and f = 1/t - 1. Every step is orthogonalised to all before, for M H
    is known to no better than H's condition allows.
    """
    vectors, duals, diagonal, beside = [], [], [], []  # duals: M^-1 times the vectors
    dual = first
    for _ in range(MOST_STEPS):
        for _ in range(2):
            for u, w in zip(vectors, duals, strict=True):
                dual = dual - np.vdot(u, dual) * w
        dual = project(dual)  # where the map is zero, rounding would grow unseen
        vector = nearly_inverse(dual)
        length = float(np.sqrt(max(np.vdot(dual, vector), 0.0)))
        if vectors and not length > ONE:
            break
        vectors.append(vector / length)
        duals.append(dual / length)
        beside.append(length)
        dual = operator(vectors[-1])
        diagonal.append(float(np.vdot(vectors[-1], dual)))
    values, rows = scipy.linalg.eigh_tridiagonal(diagonal, beside[1 : len(diagonal)])
    del duals
    shapes = np.tensordot(rows.T, np.stack(vectors), 1)
    return [(1 / t - 1, shape) for t, shape in zip(values, shapes, strict=True)]
