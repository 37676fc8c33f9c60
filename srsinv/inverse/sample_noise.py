"""The noise of recorded samples, as inversions on a line and as fits along a motion take it."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from ..errors import number, refuse
from ..forward.noise import Noise, check_power, total_spectrum
from ..forward.scan import ConstantSpeed, Motion
from ..forward.sensor import Sensor
from ..grid import Line, Periodic, as_real
from ..recording.even import STEADY
from .nonlinear import Correlated, Spectrum

EVEN = 0.01  # relative differences of the noise's standard deviation that no band shows
MISSING = 1e8  # of the noise's variance: at missing samples in coloured noise


class Samples(NamedTuple):
    """Signals (e, sample) less their known offset, NaN where they are missing, along a sensor's
    motion; `noise` as [`nonlinear.fit`][] takes it, and whether it is an estimate."""

    sensor: Sensor
    motion: Motion
    signal: Float[np.ndarray, "e sample"]
    noise: Any
    is_estimate: bool


class SampleNoise(eqx.Module):
    """White noise of `rms` per sample, in the signal's unit, and coloured `causes` by their names.

    `is_estimate`: whether the level was taken from the recording's shortest waves. Where no cause
    is named a fit may then estimate it, and what is correlated along the motion, from its residual.
    """

    rms: Float[Array, ""]
    causes: Mapping[str, Noise]
    is_estimate: bool = eqx.field(static=True)

    def __init__(self, rms, causes: Mapping[str, Noise] | None = None, is_estimate: bool = False):
        wanted = "a positive number in the signal's unit"
        self.rms = as_real(number("the noise's rms", rms, wanted, above=0))
        self.causes, self.is_estimate = dict(causes or {}), is_estimate

    def power(
        self, line: Line, scan: ConstantSpeed, signal_rms, samples: float = 1.0
    ) -> Float[Array, " k"]:
        """Power at line.k per cell, a cell being the mean of so many samples."""
        causes = tuple(self.causes.values())
        coloured = total_spectrum(causes, line, scan, signal_rms)
        check_power(causes, coloured)
        return coloured + (float(self.rms) / np.sqrt(samples)) ** 2

    def scale(
        self,
        power: Float[Array, " k"],
        samples: float,
        white: Float[np.ndarray, "e n"],
        slow: Float[np.ndarray, "e n"],
    ) -> Float[np.ndarray, "e n"] | None:
        """The factor on the standard deviation of all noise in each cell, from those of its white
        and of its coloured part; None where it is one but for `EVEN`."""
        from_white = (float(self.rms) ** 2 / samples) / float(jnp.mean(power[1:]))
        scale = np.sqrt(from_white * white**2 + max(1 - from_white, 0.0) * slow**2)
        return None if np.all(np.abs(scale - 1) < EVEN) else scale

    def of_fit(self, name: str, motion: Motion, y: Float[np.ndarray, "e sample"]) -> Any:
        """The noise of samples along a motion, as [`nonlinear.fit`][] takes it. Raises `BadInput`
        for coloured noise where the speed varies or samples are missing."""
        missing, rms = ~np.isfinite(y), float(self.rms)
        if not self.causes:
            return np.where(missing, np.inf, rms)
        refuse(
            bool(missing.any()) or not is_steady(motion),
            f"{name}: coloured noise ({', '.join(['white', *self.causes])}) is known along x, for "
            "a recording at constant speed without missing samples: name white noise only.",
        )
        speed = float(np.mean(motion.speed_m_per_s))
        line = Periodic(y.shape[-1], abs(speed) / motion.sample_rate_hz)
        signal_rms = jnp.sqrt(jnp.mean(jnp.asarray(y) ** 2))
        return Spectrum(np.asarray(self.power(line, ConstantSpeed(speed), signal_rms)))


def is_steady(motion: Motion) -> bool:
    """Whether the speed is constant, but for its measurement's noise."""
    speed = np.asarray(motion.speed_m_per_s)
    return bool(np.max(np.abs(speed - speed.mean())) <= STEADY * abs(speed.mean()))


def noise_on_line(
    power: Float[np.ndarray, " k"],
    n: int,
    y: Float[np.ndarray, "e sample"],
    scale: Float[np.ndarray, "..."],
) -> Any:
    """The noise of samples that are successive cells of a line of n, by its power there and a
    factor on its standard deviation, as a fit takes it; an offset that is not known is no part of
    it."""
    power = np.where(np.isfinite(power), power, power[1])
    observed = np.isfinite(y)
    if np.ptp(power) <= 1e-9 * power.max():
        return np.where(observed, scale * np.sqrt(power[1]), np.inf)
    toeplitz = scipy.linalg.toeplitz(np.fft.irfft(power, n)[: y.shape[1]])
    each = np.broadcast_to(scale, y.shape).ravel()
    covariance = each[:, None] * np.kron(np.eye(len(y)), toeplitz) * each
    missing = np.where(observed, 0.0, MISSING * toeplitz[0, 0])
    return Correlated(covariance + np.diag(missing.ravel()))
