"""The half space and the film in any number of digits (mpmath), derived apart from srsinv and not
importing it.

Airy's function f = (A + B z) exp(-|k| z) exp(ikx) solves the biharmonic equation and decays; the
surface's sigma_z = -p and tau_xz = -q fix A and B. SI units, signs of docs/physics.md.
"""

import mpmath as mp
import numpy as np

mp.mp.dps = 60


def stress(k, depth) -> mp.matrix:
    """sigma_x, sigma_z, tau_xz (3, 2) at the depth under unit p and unit q exp(ikx), any real k."""
    return stress_at(mp.mpf(float(k)), mp.mpf(float(depth)))


def stress_at(k, depth) -> mp.matrix:
    """The same of mpmath's own numbers."""
    size, sign = abs(k), mp.sign(k) if k else mp.mpf(1)
    decay = mp.exp(-size * depth)
    # sigma_x = f'', sigma_z = -k^2 f, tau_xz = -ik f', times k^2 so that k = 0 is a limit. With
    # f = (a + b |k| z) exp(-|k| z)/k^2: sigma_z = -(a + b |k| z), sigma_x = a - 2b + b |k| z and
    # tau_xz = i sign (a - b + b |k| z), all times the decay.
    out = mp.matrix(3, 2)
    for column, (a, b) in enumerate([(1, 1), (0, -1j * sign)]):
        along = a + b * size * depth
        out[0, column] = (along - 2 * b) * decay
        out[1, column] = -along * decay
        out[2, column] = 1j * sign * (along - b) * decay
    if not k:  # what is odd in k jumps there, and has no mean
        out[0, 1] = out[1, 1] = out[2, 0] = 0
    return out


def as_float(values) -> np.ndarray:
    """Nested lists of mpmath's numbers as float64 or complex128."""
    array = np.asarray(values, dtype=object)
    flat = [complex(v) for v in array.ravel()]
    out = np.array(flat).reshape(array.shape)
    return out.real if not np.any(out.imag) else out
