"""Contact by dense matrices and an active set in long double, apart from srsinv and not importing
it: periodic, without friction, the mean pressure given. SI units.

The pressure is held as its deviation from the nominal one, in units of nothing: no transform, no
preconditioner, no tolerance.
"""

import numpy as np

MOST_SETS = 400
Real = np.longdouble


def kernel(n, cell, compliance) -> np.ndarray:
    """Displacement (n,) at the centres by unit pressure on the first of n cells, its mean left out:
    `compliance(k)` of a point of the skin, over the Fourier transform of a cell."""
    wave = np.arange(1, n // 2 + 1)
    k = 2 * np.pi * wave.astype(Real) / (n * Real(cell))
    factor = compliance(k) * (k * Real(cell) / 2) / np.sin(k * Real(cell) / 2)
    factor = factor * np.where(2 * wave == n, 1, 2) / n
    turn = 2 * np.arccos(Real(-1)) * (np.outer(np.arange(n), wave) % n) / n
    parts = np.cos(turn) * factor.real
    if np.iscomplexobj(factor):
        parts = parts - np.where(2 * wave == n, 0, np.sin(turn) * factor.imag)
    return np.sum(parts, axis=1)


def half_space(modulus):
    """2/(E* k)."""
    return lambda k: 2 / (Real(modulus) * k)


def solve_contact(column, height, nominal) -> tuple[np.ndarray, np.ndarray]:
    """The pressure's deviation (n,) and where it touches, from a column of displacements."""
    matrix, height = _circulant(column), np.asarray(height, Real) - np.max(height)
    nominal, n = Real(nominal), height.size
    touching, visited = np.ones(n, bool), set()
    for _ in range(MOST_SETS):
        resting = np.where(touching, 0, -nominal)
        d = _on(matrix, touching, height - matrix @ resting, -np.sum(resting)) + resting
        gap = matrix @ d - height
        gap = gap - np.mean(gap[touching])
        lifted, entering = touching & (d < -nominal), ~touching & (gap < 0)
        if not lifted.any() and not entering.any():
            return d, touching
        once = touching.tobytes() not in visited
        visited.add(touching.tobytes())
        if once:  # all at once; where that goes round in circles, one at a time
            touching = (touching & ~lifted) | entering
        else:
            first = int(np.flatnonzero(lifted | entering)[-1])
            touching = touching.copy()
            touching[first] = not touching[first]
    raise ArithmeticError("the active set goes round in circles")


def slope(column, touching, d_wanted, d_nominal) -> np.ndarray:
    """The change (n,) of pressure where displacements on the contact set have to change by
    `d_wanted`, up to a constant, and the nominal pressure by `d_nominal`."""
    matrix = _circulant(column)
    return _on(matrix, touching, np.asarray(d_wanted, Real), Real(d_nominal) * touching.size)


def moved(column, pressure) -> np.ndarray:
    """The displacement (n,) under a pressure, without its mean."""
    return _circulant(column) @ pressure


def _circulant(column):
    n = np.arange(column.size)
    return column[(n[:, None] - n[None]) % column.size]


def _on(matrix, active, wanted, load):
    """The pressure on the `active` cells with this sum that displaces them by `wanted` + const."""
    at = np.flatnonzero(active)
    border = np.max(np.abs(matrix))
    system = np.zeros((at.size + 1, at.size + 1), Real)
    system[:-1, :-1] = matrix[np.ix_(at, at)]
    system[-1, :-1] = system[:-1, -1] = border
    solution = _solved(system, np.append(wanted[at], border * load))
    out = np.zeros(active.size, Real)
    out[at] = solution[:-1]
    return out


def _solved(a, b):
    """Gauss's elimination with partial pivots: LAPACK has no long double."""
    a, b = a.copy(), b.copy()
    for i in range(b.size):
        pivot = i + int(np.argmax(np.abs(a[i:, i])))
        a[[i, pivot]], b[[i, pivot]] = a[[pivot, i]], b[[pivot, i]]
        factor = a[i + 1 :, i] / a[i, i]
        a[i + 1 :, i:] -= factor[:, None] * a[i, i:]
        b[i + 1 :] -= factor * b[i]
    for i in reversed(range(b.size)):
        b[i] = (b[i] - a[i, i + 1 :] @ b[i + 1 :]) / a[i, i]
    return b
