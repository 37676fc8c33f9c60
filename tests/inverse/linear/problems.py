"""Seven discrete ill-posed problems of the literature, from their published formulas.

Hansen (1994, Numerical Algorithms 6, 1) collects them. Each is a Fredholm or Volterra equation of
the first kind: a matrix (n, n) and the solution (n,). The data are the matrix times the solution,
so that noise is their only error. By `Galerkin` a cell's basis function is 1/sqrt(width) over the
cell; the others have the midpoint rule.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

GAUSS = np.polynomial.legendre.leggauss(8)


class IllPosed(NamedTuple):
    """A problem's `matrix` (n, n) and its true `solution` (n,)."""

    matrix: Float[np.ndarray, "n n"]
    solution: Float[np.ndarray, " n"]

    @property
    def data(self) -> Float[np.ndarray, " n"]:
        """The data without noise."""
        return self.matrix @ self.solution


def midpoints(n: int, low: float, high: float) -> tuple[np.ndarray, float]:
    """The middles of n cells, and their width."""
    width = (high - low) / n
    return low + width * (np.arange(n) + 0.5), width


def cell_integrals(
    function: Callable[[np.ndarray], np.ndarray], middles: np.ndarray, width: float
) -> np.ndarray:
    """The integrals of a function over cells, by Gauss's rule with eight points."""
    nodes, weights = GAUSS
    return width / 2 * function(middles[:, None] + width / 2 * nodes) @ weights


def shaw(n: int) -> IllPosed:
    """Light through a slit: Shaw (1972). Midpoint rule on [-pi/2, pi/2]."""
    t, width = midpoints(n, -np.pi / 2, np.pi / 2)
    sines = np.sin(t)[:, None] + np.sin(t)
    cosines = np.cos(t)[:, None] + np.cos(t)
    matrix = width * (cosines * np.sinc(sines)) ** 2
    solution = 2 * np.exp(-6 * (t - 0.8) ** 2) + np.exp(-2 * (t + 0.5) ** 2)
    return IllPosed(matrix, solution)


def phillips(n: int) -> IllPosed:
    """A raised cosine smeared by itself: Phillips (1962). Galerkin on [-6, 6]."""
    middles, width = midpoints(n, -6.0, 6.0)

    def twice(x: np.ndarray) -> np.ndarray:
        """The second integral of 1 + cos(pi x / 3) on |x| < 3, and of 0 beyond."""
        near = np.minimum(np.abs(x), 3.0)
        inside = near**2 / 2 - 9 / np.pi**2 * np.cos(np.pi * near / 3)
        return inside + 3 * (np.abs(x) - near)

    lag = middles[:, None] - middles
    matrix = (twice(lag + width) - 2 * twice(lag) + twice(lag - width)) / width
    ends = np.clip([middles - width / 2, middles + width / 2], -3.0, 3.0)
    once = ends + 3 / np.pi * np.sin(np.pi * ends / 3)
    return IllPosed(matrix, (once[1] - once[0]) / np.sqrt(width))


def deriv2(n: int) -> IllPosed:
    """The second derivative, by Green's function: Delves and Mohamed (1985, p. 310). Galerkin on
    [0, 1], solution t."""
    middles, width = midpoints(n, 0.0, 1.0)
    low = np.minimum(middles[:, None], middles)
    high = np.maximum(middles[:, None], middles)
    matrix = width * low * (high - 1)
    # In a cell the mean of the smaller of two points is a sixth of the width below the middle.
    np.fill_diagonal(matrix, width * (middles**2 - middles + width / 6))
    return IllPosed(matrix, np.sqrt(width) * middles)


def heat(n: int) -> IllPosed:
    """The inverse heat equation: Carasso (1982). Midpoint rule on [0, 1]."""
    t, width = midpoints(n, 0.0, 1.0)
    kernel = t**-1.5 / (2 * np.sqrt(np.pi)) * np.exp(-1 / (4 * t))
    lag = np.arange(n)[:, None] - np.arange(n)
    matrix = np.where(lag >= 0, width * kernel[np.maximum(lag, 0)], 0.0)
    at = 20 * np.arange(1, n + 1) / n
    rise, bend = 0.75 * at**2 / 4, 0.75 + (at - 2) * (3 - at)
    fall = 0.75 * np.exp(-2 * (at - 3))
    solution = np.where(at < 2, rise, np.where(at < 3, bend, fall))
    return IllPosed(matrix, np.where(np.arange(1, n + 1) <= n // 2, solution, 0.0))


def gravity(n: int) -> IllPosed:
    """Mass at a depth of 1/4 from gravity above it: Wing and Zakharov (1991). Midpoint rule on
    [0, 1]."""
    t, width = midpoints(n, 0.0, 1.0)
    depth = 0.25
    matrix = width * depth / (depth**2 + (t[:, None] - t) ** 2) ** 1.5
    return IllPosed(matrix, np.sin(np.pi * t) + 0.5 * np.sin(2 * np.pi * t))


def baart(n: int) -> IllPosed:
    """The kernel exp(s cos t): Baart (1982). Galerkin, s on [0, pi/2] and t on [0, pi]."""
    s, s_width = midpoints(n, 0.0, np.pi / 2)
    t, t_width = midpoints(n, 0.0, np.pi)
    nodes, weights = GAUSS
    cosines = np.cos(t[:, None] + t_width / 2 * nodes)  # (cell, node)
    # Over a cell of s the integral is exact: 2 exp(s c) sinh(c width/2) / c.
    half = s_width / 2 * cosines
    share = s_width * np.where(np.abs(half) > 1e-8, np.sinh(half) / half, 1.0)
    inner = np.exp(s[:, None, None] * cosines) * share
    matrix = t_width / 2 * inner @ weights / np.sqrt(s_width * t_width)
    return IllPosed(matrix, cell_integrals(np.sin, t, t_width) / np.sqrt(t_width))


def foxgood(n: int) -> IllPosed:
    """The kernel sqrt(s^2 + t^2): Fox and Goodwin (1953). Midpoint rule on [0, 1], solution t."""
    t, width = midpoints(n, 0.0, 1.0)
    return IllPosed(width * np.hypot(t[:, None], t), t)


PROBLEMS: dict[str, Callable[[int], IllPosed]] = {
    each.__name__: each for each in (shaw, phillips, deriv2, heat, gravity, baart, foxgood)
}
