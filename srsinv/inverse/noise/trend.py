"""A drift's trend: polynomials on each element's signal, among its nuisance columns."""

import numpy as np
from jaxtyping import Float

STRAIGHT, SMOOTH = 1, 3  # degrees of a trend that has no bend, and of one that has
FLEXIBLE = 5  # of one beside features, whose few shapes it does not take up
WIDE = 10.0  # times the largest sample: the size of a straight one before anything is known of it


def trend_columns(
    y: Float[np.ndarray, "e n"],
    along: Float[np.ndarray, " n"],
    degree: int,
    has_free_offset: bool,
) -> Float[np.ndarray, "e column n"]:
    """Legendre polynomials of places from -1 to 1 on each element's samples, zero where one is
    missing (NaN); the constant is left out where it is free.

    A constant and a slope may be of any size. What is bent further may be as large as it is in the
    signal, and no larger.
    """
    shapes = np.polynomial.legendre.legvander(along, degree).T
    is_there = np.isfinite(y)
    data = np.where(is_there, y, 0.0)
    size = np.full((len(y), degree + 1), np.nan)
    for row, own, mask in zip(size, data, is_there, strict=True):
        row[:] = np.abs(np.linalg.lstsq(np.where(mask, shapes, 0.0).T, own)[0])
        row[: STRAIGHT + 1] = WIDE * np.max(np.abs(data))
    columns = size[..., None] * shapes * is_there[:, None]
    return columns[:, int(has_free_offset) :]
