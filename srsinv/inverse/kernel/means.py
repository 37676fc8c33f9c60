"""Means of the prior of kernels: what is taken as known of them, with linear parameters."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from .physics import Physics

if TYPE_CHECKING:
    from .signals import KernelSignals

STEP = 1e-3  # of a parameter's standard deviation, for differences


class Mean(NamedTuple):
    """The prior's mean of the kernels (e, 2, m), its factor `far` (e, 2) on the stated kernels far
    away, its signals (row, n), and the derivatives of all by the parameters t."""

    kernel: Float[np.ndarray, "e 2 m"]
    far: Float[np.ndarray, "e 2"]
    signal: Float[np.ndarray, "row n"]
    kernel_slope: Float[np.ndarray, "c e 2 m"]
    far_slope: Float[np.ndarray, "c e 2"]
    signal_slope: Float[np.ndarray, "c row n"]

    def of(self, parameters: slice) -> "Mean":
        """The same with these of its parameters."""
        return Mean(*self[:3], *(each[parameters] for each in self[3:]))

    def scaled(self, factors: Float[np.ndarray, " c"]) -> "Mean":
        """The same with parameters in units of these factors."""
        return Mean(*self[:3], *((each.T * factors).T for each in self[3:]))

    def beside(self, other: "Mean") -> "Mean":
        """The same with the parameters of another as well."""
        both = [np.concatenate([a, b]) for a, b in zip(self[3:], other[3:], strict=True)]
        return Mean(*self[:3], *both)


def far_field(signals: "KernelSignals") -> Mean:
    """What the stated kernels are beyond the lags, as the mean of a kernel that is not known
    within, and its derivatives by a factor on that of each."""
    count, outside = len(signals.stated.elements), 1 - signals.lags.near
    kernel = np.zeros((count, 2, count, 2, signals.lags.taper.size))
    far = np.zeros(kernel.shape[:-1])
    signal = np.zeros((count, 2, *signals.data.shape))
    ones = np.ones(count)
    for c in range(2):
        whole = signals.of_sensor(signals.stated, ones, only=c)
        within = signals.at_lags(signals.lags.near * signals.stated_kernel, only=c)
        for e in signals.elements:
            kernel[e, c, e, c] = outside * signals.stated_kernel[e, c]
            far[e, c, e, c] = 1.0
            rows = signals.known.rows_of(e)
            signal[e, c, rows] = (whole - within)[rows]
    slopes = [each.reshape(2 * count, *each.shape[2:]) for each in (kernel, far, signal)]
    return Mean(*(each.sum(axis=0) for each in slopes), *slopes)


def theory(signals: "KernelSignals", physics: Physics, values: Float[np.ndarray, " c"]) -> Mean:
    """The kernels of a sensor of these physical parameters, and their derivatives by each over its
    standard deviation."""
    step = STEP * physics.deviations

    def at(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sensor, gains = physics.sensor_of(v)
        own = gains[:, None, None] * signals.kernels_of(sensor)
        return own, signals.of_sensor(sensor, gains)

    kernel, signal = at(values)
    slopes = []
    for i, size in enumerate(step):
        ahead, behind = (at(values + sign * size * np.eye(step.size)[i]) for sign in (1, -1))
        slopes.append([(a - b) / (2 * STEP) for a, b in zip(ahead, behind, strict=True)])
    kernel_slope, signal_slope = (np.stack(each) for each in zip(*slopes, strict=True))
    far, far_slope = _factor(signals, kernel), _factor(signals, kernel_slope)
    return Mean(kernel, far, signal, kernel_slope, far_slope, signal_slope)


def _factor(
    signals: "KernelSignals", kernel: Float[np.ndarray, "*c e 2 m"]
) -> Float[np.ndarray, "*c e 2"]:
    """The factor that makes kernels of the stated ones where they are tapered."""
    weights = (1 - signals.lags.taper) * signals.stated_kernel
    size = np.sum(weights * signals.stated_kernel, axis=-1)
    return np.sum(weights * kernel, axis=-1) / np.where(size > 0, size, 1.0)
