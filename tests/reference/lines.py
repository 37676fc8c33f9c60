"""Signals of a film on a line by plain sums over kernels in many digits, without srsinv.

SI units, signs of docs/explanation/physics/signs.md. An element is (depth, angle, strip width,
offset), its charge that of a strip of 1 m^2; a strip width of 0 is a thin strip.
"""

import numpy as np

from tests.reference import exact

D1, D2, D3 = 23e-12, 3e-12, -33e-12
mp = exact.mp


def kernels(periodic, n, cell, elements, nu, gain, order) -> np.ndarray:
    """gain d^order/dx^order of charge, (e, c, sample, cell)."""
    kernel = periodic_kernel if periodic else open_kernel
    h = np.array([kernel(n, cell, element, nu, order) for element in elements])
    lag = np.arange(n)[:, None] - np.arange(n)
    return h[..., lag % n if periodic else lag].astype(np.longdouble) * np.longdouble(gain)


def signals(h, r) -> np.ndarray:
    """(e, n) under the traction r (2, n)."""
    return np.einsum("ecij,cj->ei", h, np.asarray(r, np.longdouble))


def transposed(h, y) -> np.ndarray:
    """What the transpose makes (2, n) of signals y (e, n)."""
    return np.einsum("ecij,ei->cj", h, np.asarray(y, np.longdouble))


def periodic_kernel(n, cell, element, nu, order) -> np.ndarray:
    """(c, lag): the band-limited function of one cell's average, wave by wave."""
    depth, angle, width, offset = element
    h = np.zeros((2, n), np.longdouble)
    turn = 8 * np.arctan(np.longdouble(1)) / n
    for m in range(n // 2 + 1):
        k = 2 * mp.pi * m / (n * mp.mpf(float(cell)))
        stress = exact.stress(k, depth).tolist()
        factor = mp.expj(k * mp.mpf(float(offset))) * (1j * k) ** order / n
        factor *= _sinc(k * mp.mpf(float(width)) / 2) / _sinc(k * mp.mpf(float(cell)) / 2)
        both = exact.as_float([factor * each for each in _charge(stress, angle, nu)])
        both = np.asarray(both, np.clongdouble)[:, None]
        if 0 < 2 * m < n:
            h += 2 * (both * np.exp(1j * (m * np.arange(n) % n * turn))).real
        else:  # of the shortest wave of an even line only the real part can act
            h += both.real * np.cos(m * np.arange(n) % n * turn)
    return h


def open_kernel(n, cell, element, nu, order) -> np.ndarray:
    """(c, lag), lags 0 to n - 1 and then those from -(n - 1) on: of uniform traction on a cell."""
    depth, angle, width, offset = element
    lags = [*range(n), *range(1 - n, 0)]
    at = [mp.mpf(lag) * mp.mpf(float(cell)) + mp.mpf(float(offset)) for lag in lags]
    stress = [exact.strip(x, depth, cell, bool(order), width) for x in at]
    return exact.as_float([_charge(one, angle, nu) for one in stress]).T


def _charge(stress, angle, nu) -> list:
    """Charge per area from p and from q, of stresses (3, 2) turned into the film's axes."""
    c, s = mp.cos(mp.mpf(float(angle))), mp.sin(mp.mpf(float(angle)))
    nu = mp.mpf(float(nu))
    charges = []
    for sx, sz, txz in zip(*stress, strict=True):
        along = c * c * sx + s * s * sz + 2 * s * c * txz
        across = s * s * sx + c * c * sz - 2 * s * c * txz
        charges.append(D1 * along + D2 * nu * (sx + sz) + D3 * across)
    return charges


def _sinc(a):
    return mp.sin(a) / a if a else mp.mpf(1)
