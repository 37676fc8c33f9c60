"""Bonded layers in many digits (mpmath), by one dense system; derived apart from srsinv and not
importing it.

As in layered.py, Airy's function has four free constants in every layer; each of its solutions is
scaled by its value at the face where it is largest, so that no thickness overflows, and mpmath's
exponents hold the rest. Below, k > 0, lengths are in units of 1/k, and tau_xz = iT, u = iU leave a
real system.
"""

from functools import cache

import mpmath as mp
import numpy as np

DIGITS = 120  # a part as thin as k h = 1e-6 under ratios of 1e8 takes about half of them


def solve(layers, depth, k, digits=DIGITS) -> tuple[np.ndarray, np.ndarray]:
    """Stress (3, 2) at the film under unit p and q, rows sigma_x, sigma_z, tau_xz, and the
    surface's displacement (2, 2) times k times the first modulus, rows u, w.

    A layer is (modulus, Poisson's ratio, thickness or None for a half space). The wavenumber may be
    complex, of positive real part: then as it continues from the real ones.
    """
    key = tuple(tuple(None if v is None else float(v) for v in layer) for layer in layers)
    return _solved(key, float(depth), complex(k), digits)


@cache
def _solved(layers, depth, k, digits):
    with mp.workdps(digits):
        k, unit = mp.mpmathify(k), mp.mpf(layers[0][0])
        scaled = [
            (mp.mpf(e) / unit, mp.mpf(nu), None if h is None else k * mp.mpf(h))
            for e, nu, h in layers
        ]
        columns = [4 if h is not None else 2 for _, _, h in scaled]
        start = [sum(columns[:j]) for j in range(len(columns) + 1)]
        rows, at = mp.zeros(start[-1]), 2
        _put(rows, 0, 0, _state(scaled[0], mp.mpf(0))[1:3])
        for j in range(len(scaled) - 1):
            above, below = _state(scaled[j], scaled[j][2]), _state(scaled[j + 1], mp.mpf(0))
            _put(rows, at, start[j], above[1:])
            _put(rows, at, start[j + 1], [[-v for v in row] for row in below[1:]])
            at += 4
        if scaled[-1][2] is not None:
            _put(rows, at, start[-2], _state(scaled[-1], scaled[-1][2])[3:])
        j, below_top = _place(layers, depth)
        film, surface = _state(scaled[j], k * below_top), _state(scaled[0], mp.mpf(0))
        stress, moved = np.zeros((3, 2), complex), np.zeros((2, 2), complex)
        for load, turn in ((0, 1), (1, -1j)):
            # sigma_z = -1, or T = -1, which is q = i.
            right = mp.zeros(start[-1], 1)
            right[load] = -1
            constants = list(mp.lu_solve(rows, right))
            film_state = _times(film, constants[start[j] : start[j + 1]])
            shown = _times(surface, constants[: start[1]])
            stress[:, load] = np.array([film_state[0], film_state[1], 1j * film_state[2]]) * turn
            moved[:, load] = np.array([1j * shown[3], shown[4]]) * turn
        return stress, moved


def across(layers, depth, k) -> np.ndarray:
    """tau_xieta and tau_etaz at the film under unit shear exp(ikx) along the features, k > 0."""
    key = tuple(tuple(None if v is None else float(v) for v in layer) for layer in layers)
    return _across(key, float(depth), float(k))


@cache
def _across(layers, depth, k):
    """By v = A exp(-zeta) + B exp(zeta - eta) in every layer, in units of 1/k."""
    with mp.workdps(DIGITS):
        k = mp.mpf(k)
        unit = mp.mpf(layers[0][0]) / (1 + mp.mpf(layers[0][1]))
        scaled = [
            (mp.mpf(e) / (1 + mp.mpf(nu)) / unit, None if h is None else k * mp.mpf(h))
            for e, nu, h in layers
        ]

        def state(layer, zeta):
            """G dv/dz and v."""
            shear, thick = layer
            down = mp.exp(-zeta)
            if thick is None:
                return [[-shear * down], [down]]
            up = mp.exp(zeta - thick)
            return [[-shear * down, shear * up], [down, up]]

        columns = [2 if h is not None else 1 for _, h in scaled]
        start = [sum(columns[:j]) for j in range(len(columns) + 1)]
        rows, at = mp.zeros(start[-1]), 1
        _put(rows, 0, 0, state(scaled[0], mp.mpf(0))[:1])
        for j in range(len(scaled) - 1):
            _put(rows, at, start[j], state(scaled[j], scaled[j][1]))
            below = state(scaled[j + 1], mp.mpf(0))
            _put(rows, at, start[j + 1], [[-v for v in row] for row in below])
            at += 2
        if scaled[-1][1] is not None:
            _put(rows, at, start[-2], state(scaled[-1], scaled[-1][1])[1:])
        right = mp.zeros(start[-1], 1)
        right[0] = -1
        constants = list(mp.lu_solve(rows, right))
        j, below_top = _place(layers, depth)
        film = state(scaled[j], k * below_top)
        shear, moved = _times(film, constants[start[j] : start[j + 1]])
        return np.array([1j * complex(scaled[j][0] * mp.mpmathify(moved)), shear])


def _place(layers, depth) -> tuple[int, mp.mpf]:
    """The layer that holds the film, and how far below its top the film is."""
    top, j = mp.mpf(0), 0
    while j < len(layers) - 1 and depth > top + mp.mpf(layers[j][2]):
        top, j = top + mp.mpf(layers[j][2]), j + 1
    return j, depth - top


def _state(layer, zeta) -> list:
    """sigma_x, sigma_z, T, U and w (5, constant) at zeta under the layer's top, of Airy functions
    exp(-zeta), zeta exp(-zeta) and their mirror images from the bottom."""
    modulus, nu, thick = layer
    decay = mp.exp(-zeta)
    # Each solution with its first three derivatives.
    solutions = [
        [(-1) ** n * decay for n in range(4)],
        [(-1) ** n * (zeta - n) * decay for n in range(4)],
    ]
    if thick is not None:
        up, growth = thick - zeta, mp.exp(zeta - thick)
        solutions += [[growth] * 4, [(up - n) * growth for n in range(4)]]
    bend = (1 + nu) / modulus
    columns = [
        [
            f2,
            -f0,
            -f1,
            -bend * ((1 - nu) * f2 + nu * f0),
            bend * ((1 - nu) * f3 - (2 - nu) * f1),
        ]
        for f0, f1, f2, f3 in solutions
    ]
    return [list(row) for row in zip(*columns, strict=True)]


def _put(rows, at, column, block) -> None:
    for i, line in enumerate(block):
        for j, value in enumerate(line):
            rows[at + i, column + j] = value


def _times(state, constants) -> list:
    """As complex numbers, with the sum in many digits."""
    return [complex(mp.fsum(a * b for a, b in zip(row, constants, strict=True))) for row in state]
