"""A drift's trend: polynomials and jumps on each element's signal, among its nuisance columns."""

from collections.abc import Sequence

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
    jumps: Sequence[float] = (),
) -> Float[np.ndarray, "e column n"]:
    """Legendre polynomials of places from -1 to 1 on each element's samples, and a step after each
    place of `jumps`, zero where a sample is missing (NaN); the constant is left out where it is
    free.

    A constant, a slope and a step may be of any size. What is bent further may be as large as it is
    in the signal, and no larger.
    """
    steps = along > np.array(jumps)[:, None]
    shapes = np.concatenate([np.polynomial.legendre.legvander(along, degree).T, steps])
    is_there = np.isfinite(y)
    data = np.where(is_there, y, 0.0)
    size = np.full((len(y), len(shapes)), np.nan)
    for row, own, mask in zip(size, data, is_there, strict=True):
        row[:] = np.abs(np.linalg.lstsq(np.where(mask, shapes, 0.0).T, own)[0])
        row[: STRAIGHT + 1] = row[degree + 1 :] = WIDE * np.max(np.abs(data))
    columns = size[..., None] * shapes * is_there[:, None]
    return columns[:, int(has_free_offset) :]
