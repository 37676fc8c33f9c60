"""Stress under a strip of traction on bonded layers, by an integral over complex wavenumbers of the
exact layers; without srsinv.

exp(ikx) decays and no longer oscillates along k = r exp(i theta). The layers' transfer has no
singularity up to there: its poles have arguments of 30 degrees (a plate on a thin incompressible
layer, k^6 = -c), 45 (on a thin compressible one, k^4 = -c), 60 (on a half space, k^3 = -c) or more.
"""

from collections.abc import Sequence

import numpy as np

from tests.reference import exact_layers

THETA = 0.3
# Stress that is even in x, and has a real transfer; rows sigma_x, sigma_z, tau_xz, columns p, q.
EVEN = np.array([[True, False], [True, False], [False, True]])


class LayersOnLine:
    """The transfer at wavenumbers of argument `THETA`, even in their logarithms.

    A layer is (modulus, Poisson's ratio, thickness or None for a half space). The error is about
    exp(-2 pi 0.2/step).
    """

    def __init__(self, layers: Sequence, depth: float, step=0.05, digits=60):
        longest = np.log(1e-10 / depth)
        r = np.exp(np.arange(longest, np.log(45 / np.cos(THETA) / depth), step))
        self.k = r * np.exp(1j * THETA)
        solved = [exact_layers.solve(layers, depth, k, digits)[0] for k in self.k]
        # Along the real axis `EVEN` ones are real and the others imaginary; so made all real there.
        self._weights = step / np.pi * np.where(EVEN, 1, -1j) * np.array(solved)
        # Below the first one the integrand falls as k: a geometric series.
        self._weights[0] /= -np.expm1(-step)

    def strip(self, x, width: float, slope=False) -> np.ndarray:
        """Stress (3, 2, x) under 1 Pa on |x'| < width/2, or its slope along x [1/m]."""
        x = np.asarray(x, float)
        part = self._slope if slope else self._integral
        return part(x + width / 2) - part(x - width / 2)

    def _integral(self, x) -> np.ndarray:
        """From 0 to x, of the stress under a line load."""
        wave = np.expm1(1j * self.k[:, None] * np.abs(x))
        total = np.einsum("kij,kx->ijx", self._weights, wave)
        return np.where(EVEN[..., None], np.sign(x) * total.imag, total.real)

    def _slope(self, x) -> np.ndarray:
        """The stress under a line load."""
        wave = self.k[:, None] * np.exp(1j * self.k[:, None] * np.abs(x))
        total = np.einsum("kij,kx->ijx", self._weights, wave)
        return np.where(EVEN[..., None], total.real, -np.sign(x) * total.imag)
