"""Statistics of many fits of one truth: errors, Cramer-Rao bounds, coverage."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from ..grid import half_spectrum_weights
from .simulated_features import SyntheticScan

LEVELS = (0.68, 0.90, 0.95)
STEP = 1e-3  # of the depth, of the amplitude, of one: for the bound's differences


@dataclass(frozen=True)
class Quantity:
    """One parameter of one feature over all draws, in its SI unit."""

    feature: str
    name: str
    truth: float
    bound: float
    value: Float[np.ndarray, " draw"]
    stderr: Float[np.ndarray, " draw"]

    @property
    def label(self) -> str:
        """Feature and parameter."""
        return f"{self.feature}_{self.name}"

    @property
    def error(self) -> Float[np.ndarray, " draw"]:
        """Deviation from the truth, of a phase within half a turn."""
        error = self.value - self.truth
        return np.angle(np.exp(1j * error)) if self.name.endswith("_rad") else error

    @property
    def bias(self) -> float:
        """The mean error."""
        return float(self.error.mean())

    @property
    def rmse(self) -> float:
        """The root mean squared error."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def normalised(self) -> Float[np.ndarray, " draw"]:
        """Errors in units of the standard error that came with them."""
        return self.error / self.stderr

    def coverage(self, level: float) -> float:
        """The fraction of draws whose central interval of this level holds the truth."""
        return float(np.mean(np.abs(self.normalised) <= ndtri((1 + level) / 2)))


@dataclass(frozen=True)
class FitStatistics:
    """One feature's quantities, and the number of its fits that converged."""

    quantities: tuple[Quantity, ...]
    converged: int
    snr_dB: float


def bounds_of(
    on: SyntheticScan,
    signal: Callable[[Mapping[str, float]], np.ndarray],
    truth: Mapping[str, float],
    sizes: Mapping[str, float],
    power: np.ndarray,
) -> dict[str, float]:
    """The Cramer-Rao bound of each parameter of `sizes`, which holds the scales of the steps.

    From central differences of the simulation at the truth and the noise's spectrum `power` (k,),
    apart from the fit, its cells and its derivatives.
    """

    def slope(part: str) -> np.ndarray:
        step = STEP * sizes[part]
        above, below = (signal({**truth, part: truth[part] + s * step}) for s in (1, -1))
        change = np.fft.rfft((above - below) / (2 * step))
        return np.fft.irfft(change / np.sqrt(power), on.shape[1]).ravel()

    columns = [slope(part) for part in sizes]
    if on.free_offset:
        columns += list(np.repeat(np.eye(on.shape[0]), on.shape[1], axis=1) / np.sqrt(power[0]))
    jacobian = np.array(columns)
    length = np.linalg.norm(jacobian, axis=1)
    covariance = np.linalg.inv(jacobian @ jacobian.T / np.outer(length, length))
    bounds = np.sqrt(np.diagonal(covariance)) / length
    return {part: float(bound) for part, bound in zip(sizes, bounds, strict=False)}


def ratio_dB(rms: float, power: np.ndarray, samples: int) -> float:
    """Signal to noise, of an rms and a noise's spectrum."""
    return float(20 * np.log10(rms / np.sqrt(half_spectrum_weights(samples) @ power)))
