"""Kernels over the lag, as prior distributions know them.

A film z deep sees a stress that obeys Laplace's equation above it: its kernel is analytic within z
of the real axis, its spectrum falls as exp(-|k| z), and it decays as 1/x^2 (from p) and 1/x (from
q). The Gaussian process

    K(x) = s E(x) sum_j a_j exp(-k_j l) phi_j(x),    a_j normal of variance one,

has these properties, with phi_j cosines and sines, E an envelope 1/(1 + (x/w)^2) or its root. The
scale s, the length l, the width w, and how much of the envelope is left where the kernel is taken
for the stated one times a factor, are of what the data say (see measure.py).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

SHARPEST = 12.0  # k z of the shortest wave: exp(-12) of the longest one is left of it
PER_DEPTH = 8  # lags in a depth: half the shortest wave has two
REACH = 24.0  # depths to which the kernel is measured, where the scan goes as far
NEAR = (
    10.0,
    0.6,
)  # depths, and of the reach: beyond the lesser of both the mean is the stated kernel
LONGER = 1.1  # of the waves' period over both reaches, so that no end is tied to the other
TAPERED = 0.25  # of the reach, over which a measured kernel goes over to the stated one
LEAST_REACH = 6.0  # depths, below which there is no kernel to speak of


@dataclass(frozen=True)
class Lags:
    """Even lags from -reach to +reach of a film some `depth_m` deep."""

    depth_m: float
    reach_m: float

    @property
    def count(self) -> float:
        """How many lags there are, of whatever size; infinite where it is beyond all numbers."""
        with np.errstate(over="ignore"):
            return float(2 * np.ceil(np.float64(self.reach_m) / self.depth_m * PER_DEPTH) + 1)

    @property
    def x_m(self) -> Float[np.ndarray, " m"]:
        """The lags."""
        half = int(np.ceil(self.reach_m / self.depth_m * PER_DEPTH))
        return np.arange(-half, half + 1) * (self.reach_m / half)

    @property
    def taper(self) -> Float[np.ndarray, " m"]:
        """From one to nothing at both ends, with two smooth derivatives."""
        return _falling(np.abs(self.x_m) / self.reach_m)

    @property
    def near(self) -> Float[np.ndarray, " m"]:
        """The taper of the part near the load, where nothing is taken from the stated kernel."""
        end = min(NEAR[0] * self.depth_m, NEAR[1] * self.reach_m)
        return _falling(np.abs(self.x_m) / end)

    def wavenumbers(self, most: float) -> Float[np.ndarray, " b"]:
        """k_j [rad/m] of the waves, none above `most`."""
        unit = np.pi / (LONGER * self.reach_m)
        count = int(min(SHARPEST / self.depth_m, most) / unit)
        return np.concatenate([[0.0], np.repeat(unit * np.arange(1, count + 1), 2)])

    def waves(self, k: Float[np.ndarray, " b"]) -> Float[np.ndarray, "b m"]:
        """The tapered cosines and sines, in turn."""
        angle = k[:, None] * self.x_m[None]
        is_sine = (np.arange(k.size) % 2 == 0)[:, None] & (k > 0)[:, None]
        return self.taper * np.where(is_sine, np.sin(angle), np.cos(angle))

    def envelope(self, width_m: float, far: float) -> Float[np.ndarray, "2 m"]:
        """E of the kernels of p and q, beyond the near part `far` times as large."""
        fall = 1 / (1 + (self.x_m / width_m) ** 2)
        return np.stack([fall, np.sqrt(fall)]) * (self.near + far * (1 - self.near))

    def spectrum(
        self, values: Float[np.ndarray, "*rows m"], k: Float[np.ndarray, " k"]
    ) -> Complex[np.ndarray, "*rows k"]:
        """The Fourier transform of kernels at k [rad/m]."""
        spacing = self.x_m[1] - self.x_m[0]
        is_resolved = np.abs(k) * spacing < np.pi
        waves = np.exp(-1j * np.outer(self.x_m, np.where(is_resolved, k, 0.0)))
        return spacing * (values @ waves) * is_resolved


def _falling(part: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """From one to nothing as `part` comes to one, with two smooth derivatives."""
    t = np.clip((1 - part) / TAPERED, 0.0, 1.0)
    return t**3 * (10 - 15 * t + 6 * t**2)
