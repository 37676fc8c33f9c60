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
from .nonlinear import Correlated, Spectrum, WhitePlusOU

EVEN = 0.01  # relative differences of the noise's standard deviation that no band shows
LONG = 100.0  # durations of the recording, over which a walk is taken as correlated
MISSING = 1e8  # of the noise's variance: at missing samples in coloured noise


class Samples(NamedTuple):
    """Signals (e, sample) less their known offset, NaN where they are missing, along a sensor's
    motion; `noise` as [`nonlinear.fit`][] takes it, and whether it is an estimate; `waves`
    (e, m, sample) of mains, which are in the noise too, or None."""

    sensor: Sensor
    motion: Motion
    signal: Float[np.ndarray, "e sample"]
    noise: Any
    is_estimate: bool
    waves: Float[np.ndarray, "e m sample"] | None = None


class SampleNoise(eqx.Module):
    """White noise of `rms` per sample, in the signal's unit, and coloured `causes` by their names.

    `drift`: of a random walk besides, its rms after a second, in the signal's unit.
    `is_estimate`: whether the level was taken from the recording's shortest waves. Where no cause
    is named a fit may then estimate it, and what is correlated along the motion, from its residual.
    """

    rms: Float[Array, ""]
    drift: float = eqx.field(static=True)
    causes: Mapping[str, Noise]
    is_estimate: bool = eqx.field(static=True)

    def __init__(
        self,
        rms,
        causes: Mapping[str, Noise] | None = None,
        is_estimate: bool = False,
        drift: float = 0.0,
    ):
        wanted = "a positive number in the signal's unit"
        self.rms = as_real(number("the noise's rms", rms, wanted, above=0))
        wanted = "a number that is at least 0"
        self.drift = float(number("the noise's drift", drift, wanted, least=0))
        self.causes, self.is_estimate = dict(causes or {}), is_estimate

    def power(
        self, line: Line, scan: ConstantSpeed, signal_rms, samples: float = 1.0
    ) -> Float[Array, " k"]:
        """Power at line.k per cell, a cell being the mean of so many samples."""
        causes = tuple(self.causes.values())
        coloured = total_spectrum(causes, line, scan, signal_rms)
        check_power(causes, coloured)
        return coloured + self._of_drift(line, scan) + (float(self.rms) / np.sqrt(samples)) ** 2

    def _of_drift(self, line: Line, scan: ConstantSpeed) -> Float[np.ndarray, " k"]:
        """The power of a random walk less its trend: that of one around a circle. The mean has the
        variance of that of a walk that begins at zero, the trend's aside."""
        n, k, cell = line.n, np.asarray(line.k), float(line.cell_m)
        step = self._step(line, scan) ** 2
        power = np.full(k.shape, step * n**2 / 12)
        power[1:] = step / (4 * np.sin(k[1:] * cell / 2) ** 2)
        return power

    def trend(self, line: Line, scan: ConstantSpeed, start_m: float) -> Float[np.ndarray, " n"]:
        """A random walk's trend along the line, of one standard deviation, from the scan's start:
        a walk around a circle of n cells, of variogram h (1 - h/n), and this trend, of h^2/n, make
        that of the whole walk, h."""
        cells = (np.asarray(line.x) - start_m) / float(line.cell_m)
        return self._step(line, scan) / np.sqrt(line.n) * cells

    def level(self, motion: Motion) -> float:
        """The rms of a random walk's level at the end of a motion, from zero at its start."""
        time_s = np.asarray(motion.time_s)
        return self.drift * float(np.sqrt(time_s[-1] - time_s[0]))

    def _step(self, line: Line, scan: ConstantSpeed) -> float:
        """The rms of a walk from cell to cell."""
        return self.drift * float(np.sqrt(line.cell_m / abs(float(scan.speed_m_per_s))))

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
        white = np.where(missing, np.inf, rms)
        if not self.causes and self.drift:
            return walk_and_white(motion, white, self.drift)
        if not self.causes:
            return white
        refuse(
            bool(missing.any()) or not is_steady(motion),
            f"{name}: coloured noise ({', '.join(['white', *self.causes])}) is known along x, for "
            "a recording at constant speed without missing samples: name white noise only.",
        )
        speed = float(np.mean(motion.speed_m_per_s))
        line = Periodic(y.shape[-1], abs(speed) / motion.sample_rate_hz)
        signal_rms = jnp.sqrt(jnp.mean(jnp.asarray(y) ** 2))
        return Spectrum(np.asarray(self.power(line, ConstantSpeed(speed), signal_rms)))


def walk_and_white(motion: Motion, white: Float[np.ndarray, "e sample"], drift: float):
    """White noise and a random walk in time from an unknown level."""
    time_s = np.asarray(motion.time_s)
    return WhitePlusOU(time_s, white, *walk_as_correlated(time_s, drift))


def walk_as_correlated(time_s: Float[np.ndarray, " sample"], drift: float) -> tuple[float, float]:
    """The rms and the correlation time [s] of a process so slow that it is a random walk of an
    unknown level over these times; `drift` is the walk's rms after a second."""
    slow_s = LONG * float(time_s[-1] - time_s[0])
    return drift * float(np.sqrt(slow_s / 2)), slow_s


def is_steady(motion: Motion) -> bool:
    """Whether the speed is constant, but for its measurement's noise."""
    speed = np.asarray(motion.speed_m_per_s)
    return bool(np.max(np.abs(speed - speed.mean())) <= STEADY * abs(speed.mean()))


def noise_on_line(
    power: Float[np.ndarray, "#e k"],
    n: int,
    y: Float[np.ndarray, "e sample"],
    scale: Float[np.ndarray, "..."],
) -> Any:
    """The noise of samples that are successive cells of a line of n, by its power there and a
    factor on its standard deviation, as a fit takes it; an offset that is not known is no part of
    it."""
    power = np.where(np.isfinite(power), power, power[:, 1:2])
    observed = np.isfinite(y)
    if (np.ptp(power, axis=1) <= 1e-9 * power.max(axis=1)).all():
        return np.where(observed, scale * np.sqrt(power[:, 1:2]), np.inf)
    lags = np.broadcast_to(np.fft.irfft(power, n)[:, : y.shape[1]], y.shape)
    each = np.broadcast_to(scale, y.shape).ravel()
    blocks = scipy.linalg.block_diag(*map(scipy.linalg.toeplitz, lags))
    covariance = each[:, None] * blocks * each
    missing = np.where(observed, 0.0, MISSING * lags[:, :1])
    return Correlated(covariance + np.diag(missing.ravel()))
