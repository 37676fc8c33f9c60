"""Signals of films that slide over a ridge, by line loads and a contact of their own, without
srsinv: signs and formulas of PHYSICS.md, SI units.

The contact has cells of uniform pressure, fine at the ridge's edges and wide beyond, whose
displacement is known in closed form (Clausen's function); each is then some line loads.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import bernoulli, factorial

D1, D2, D3 = 23e-12, 3e-12, -33e-12
FINEST = 1 / 40  # cells at an edge, of its length
FINE_OVER = 6.0  # lengths on both sides of an edge
GROWTH, WIDEST = 1.08, 1.5e-4  # of neighbouring cells; of any [m]
MOST_SETS = 400
TERMS = 26  # of a series that falls by at least four a term
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)


class Strip(NamedTuple):
    """A film: depth and angle, offset, width averaged over, electrode area times strips."""

    depth_m: float
    angle_rad: float
    offset_m: float
    width_m: float
    area_m2: float


def ridge_pressure(height, width, place, edge, window, modulus, nominal):
    """Edges (n + 1,) of cells and the pressure (n,) on them, of a ridge in a `window` that is
    pressed on with `nominal` in the mean."""
    left, right = place - width / 2, place + width / 2
    edges = _cells(window, [left, right], edge)
    x = (edges[1:] + edges[:-1]) / 2
    rise = np.tanh((x - left) / edge) - np.tanh((x - right) / edge)
    return edges, _pressure(edges, height / 2 * rise, modulus, nominal)


def ridge_loads(height, width, place, edge, window, modulus, nominal):
    """Places (m,) and line loads [N/m] beyond those of `nominal`, of the same."""
    edges, pressure = ridge_pressure(height, width, place, edge, window, modulus, nominal)
    x, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    loads = (pressure - nominal)[:, None] * half[:, None] * WEIGHTS
    return (x[:, None] + half[:, None] * NODES).ravel(), loads.ravel()


def rate(strip: Strip, x, direction, places, loads, friction, nu=0.5):
    """d charge/dx (sample,) [C/m] with the sensor at `x`, over `loads` at `places`."""
    signal = np.empty(len(x))
    for some in np.array_split(np.arange(len(x)), max(len(x) * len(places) // 10**6, 1)):
        from_load = x[some, None] + strip.offset_m - places
        from_p, from_q = _responses(strip, from_load, nu)
        signal[some] = (from_p + friction * direction[some, None] * from_q) @ loads
    return strip.area_m2 * signal


def _responses(strip: Strip, x, nu):
    """d/dx of the charge per area under a line load of pressure and one of shear."""
    if strip.width_m:
        ends = (charges(strip, x + sign * strip.width_m / 2, nu) for sign in (1, -1))
        ahead, behind = ends
        return [(a - b) / strip.width_m for a, b in zip(ahead, behind, strict=True)]
    return charges(strip, x, nu, slope=True)


def charges(strip: Strip, x, nu, slope=False):
    """The charge per area under a line load of pressure and one of shear, or its slope along x."""
    t, c, s = x / strip.depth_m, np.cos(strip.angle_rad), np.sin(strip.angle_rad)
    factor = -2 / (np.pi * strip.depth_m)

    def power(m):
        if slope:
            own = m * t ** max(m - 1, 0) / (1 + t**2) ** 2 - 4 * t ** (m + 1) / (1 + t**2) ** 3
            return factor / strip.depth_m * own
        return factor * t**m / (1 + t**2) ** 2

    each = []
    for sz, sx, txz in ((power(0), power(2), power(1)), (power(1), power(3), power(2))):
        along = sx * c**2 + sz * s**2 + 2 * txz * s * c
        across = sx * s**2 + sz * c**2 - 2 * txz * s * c
        each.append(D1 * along + D2 * nu * (sx + sz) + D3 * across)
    return each


# --- contact -----------------------------------------------------------------------------------


def _cells(window, corners, edge):
    """Edges of the cells."""
    start, end = window
    edges = [start]
    while edges[-1] < end:
        away = min(abs(edges[-1] - corner) for corner in corners)
        own = max(away - FINE_OVER * edge, 0.0) * (GROWTH - 1) + FINEST * edge
        ahead = [corner - edges[-1] for corner in corners if corner > edges[-1]]
        # Not over the fine cells of the next corner.
        own = min(own, max((min(ahead, default=np.inf) - FINE_OVER * edge) / 2, FINEST * edge))
        edges.append(edges[-1] + min(own, WIDEST))
    edges[-1] = end
    if edges[-1] - edges[-2] < FINEST * edge / 4:
        del edges[-2]
    return np.array(edges)


def _clausen(angle):
    """Cl_2, the integral of -ln|2 sin(t/2)| from 0, at |angle| < 2 pi, by its series about 0."""
    angle = angle - 2 * np.pi * np.round(angle / (2 * np.pi))
    order = 2 * np.arange(1, TERMS + 1)
    terms = np.abs(bernoulli(2 * TERMS)[2::2]) / (order * factorial(order + 1))
    size = np.where(angle == 0, 1.0, np.abs(angle))
    series = np.polynomial.Polynomial(np.append(0.0, terms))(angle**2)
    return angle * (1 - np.log(size) + series)


def _pressure(edges, height, modulus, nominal):
    """The pressure (n,) on cells that repeat with the window, by an active set."""
    length, width = edges[-1] - edges[0], np.diff(edges)
    x = (edges[1:] + edges[:-1]) / 2
    turn = 2 * np.pi / length
    clausen = _clausen(turn * (x[:, None] - edges[None]))
    # -2/(pi E*) ln|2 sin(pi x/L)| is the displacement by a line load, its mean left out.
    matrix = -np.diff(clausen, axis=1) / turn * 2 / (np.pi * modulus)
    touching = np.ones(x.size, bool)
    for _ in range(MOST_SETS):
        at = np.flatnonzero(touching)
        system = np.zeros((at.size + 1, at.size + 1))
        system[:-1, :-1], system[-1, :-1] = matrix[np.ix_(at, at)], width[at]
        scale = np.abs(matrix).max()
        system[:-1, -1] = -scale
        *own, level = np.linalg.solve(system, np.append(height[at], nominal * length))
        pressure = np.zeros(x.size)
        pressure[at] = own
        gap = matrix @ pressure - scale * level - height
        lifted, entering = pressure < 0, ~touching & (gap < -1e-12 * np.ptp(height))
        if not (lifted | entering).any():
            return pressure
        touching = (touching & ~lifted) | entering
    raise ArithmeticError("the active set goes round in circles")
