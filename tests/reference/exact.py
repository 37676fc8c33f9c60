"""The half space and the film in any number of digits (mpmath), derived apart from srsinv and not
importing it.

Airy's function f = (A + B z) exp(-|k| z) exp(ikx) solves the biharmonic equation and decays; the
surface's sigma_z = -p and tau_xz = -q fix A and B. SI units, signs of
docs/explanation/physics/signs.md.
"""

import mpmath as mp
import numpy as np

mp.mp.dps = 60


# sigma_x, sigma_z and tau_xz are (c + d |k| z) exp(-|k| z): (c, d) under unit p and q, k > 0.
# With f = (a + b |k| z) exp(-|k| z)/k^2, so that k = 0 is a limit, sigma_x = f'' is
# a - 2b + b |k| z, sigma_z = -k^2 f is -(a + b |k| z), and tau_xz = -ik f' is i (a - b + b |k| z).
_WAVE = [
    [[(a - 2 * b, b), (-a, -b), (1j * (a - b), 1j * b)][row] for a, b in ((1, 1), (0, -1j))]
    for row in range(3)
]


def stress(k, depth) -> mp.matrix:
    """sigma_x, sigma_z, tau_xz (3, 2) at the depth under unit p and unit q exp(ikx), any real k."""
    k, depth = _many(k), _many(depth)
    decay = mp.exp(-abs(k) * depth)
    out = mp.matrix(3, 2)
    for row in range(3):
        for column in range(2):
            c, d = _WAVE[row][column]
            wave = mp.mpc(c + d * abs(k) * depth) * decay
            out[row, column] = wave if k > 0 else mp.conj(wave)
    if not k:  # what is odd in k jumps there, and has no mean
        out[0, 1] = out[1, 1] = out[2, 0] = 0
    return out


def strip(x, depth, width, slope=False, over=0.0) -> list:
    """sigma_x, sigma_z, tau_xz (3, 2) at (x, depth) under 1 Pa on |x| < width/2; d/dx of it [1/m];
    either as the mean over the length `over` about x.

    The waves k > 0 of a traction p add up to F(zeta) = i/pi W(zeta), W = integral of
    p(x')/(zeta - x') dx' and zeta = x + iz; a factor of k is -i d/d zeta, and the waves k < 0 are
    the conjugates.
    """
    depth = _many(depth)
    integrals = _cauchy(x, depth, width, over)[1 if slope else 0 :]
    wave, derived = (1j / mp.pi * part for part in integrals[:2])
    return [[mp.re(c * wave - 1j * d * depth * derived) for c, d in row] for row in _WAVE]


def antiplane(k, depth) -> list:
    """tau_xieta, tau_etaz at the depth under unit shear exp(ikx) along the features.

    G v = q exp(-|k| z)/|k| is harmonic with tau_etaz = G dv/dz = -q on the surface.
    """
    k, depth = _many(k), _many(depth)
    decay = mp.exp(-abs(k) * depth)
    return [1j * mp.sign(k) * decay, -decay + 0j]


def antiplane_strip(x, depth, width, slope=False) -> list:
    """tau_xieta, tau_etaz at (x, depth) under 1 Pa on |x| < width/2, or d/dx of it [1/m]."""
    wave = _cauchy(x, depth, width)[1 if slope else 0] * 1j / mp.pi
    return [mp.re(1j * wave), mp.re(-wave)]


def _cauchy(x, depth, width, over=0.0) -> list:
    """W of 1 Pa on |x| < width/2, and its first two derivatives; means over `over`."""
    zeta, half, over = mp.mpc(_many(x), _many(depth)), _many(width) / 2, _many(over)
    # Each is the derivative of the one ahead.
    parts = (
        lambda at: at * mp.log(at) - at,
        mp.log,
        lambda at: 1 / at,
        lambda at: -1 / at**2,
    )

    def loaded(part, at):
        return part(at + half) - part(at - half)

    if not over:
        return [loaded(part, zeta) for part in parts[1:]]
    ahead, behind = zeta + over / 2, zeta - over / 2
    return [(loaded(part, ahead) - loaded(part, behind)) / over for part in parts[:3]]


def _many(number) -> mp.mpf:
    return number if isinstance(number, mp.mpf) else mp.mpf(float(number))


def as_float(values) -> np.ndarray:
    """Nested lists of mpmath's numbers as float64 or complex128."""
    array = np.asarray(values, dtype=object)
    flat = [complex(v) for v in array.ravel()]
    out = np.array(flat).reshape(array.shape)
    return out.real if not np.any(out.imag) else out
