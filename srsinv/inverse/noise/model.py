"""The noise of recorded samples, as inversions on a line and as fits along a motion take it."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float

from ...errors import number, refuse
from ...forward.noise import Noise, check_power, total_spectrum
from ...forward.scan import ConstantSpeed, Motion
from ...forward.sensor import Sensor
from ...grid import Line, Periodic, as_real
from ...known import Numbers, array_module, is_traced
from ...modules import with_fields
from ...numerics import is_flat
from ...recording.even import STEADY
from ..nonlinear import LEVEL_STDERR, Correlated, Independent, Spectrum, WhitePlusOU

EVEN = 0.01  # relative differences of the noise's standard deviation that no band shows
LONG = 100.0  # durations of the recording, over which a walk is taken as correlated
FORGOTTEN = 1 / 3  # of a line's duration: what is remembered longer is taken as a walk along it
LEAST_DRIFT = 1e-6  # of the white noise, after a second: less is none
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
    """White noise per sample, a drift beside it, and coloured `causes` by their names.

    - `white` (#e,): its rms, one for all elements or one for each, in the signal's unit.
    - `drift` (#e,): of a process whose rms is `drift` after a second, where it is a random walk;
      `drift_time_s` (#e,): after which it forgets itself (an Ornstein-Uhlenbeck process), infinite
      of a random walk. Zero: there is none.
    - `is_estimate`: whether the level was taken from the recording's shortest waves. Where no cause
      is named a fit may then estimate it, and what is correlated along the motion, from its
      residual.
    - `level_stderr`: relative standard error of the white levels.
    - `is_drift_found`: whether the drift was looked for in the recording; on cells its level is
      then estimated anew, with the traction.
    - `jumps_s`: seconds from the first sample after which the signals have jumped.

    Raises `BadInput` for levels that are not above zero, and other numbers below it.
    """

    white: Float[Array, "#e"]
    drift: tuple[float, ...] = eqx.field(static=True)
    drift_time_s: tuple[float, ...] = eqx.field(static=True)
    causes: Mapping[str, Noise]
    is_estimate: bool = eqx.field(static=True)
    level_stderr: float = eqx.field(static=True)
    is_drift_found: bool = eqx.field(static=True)
    jumps_s: tuple[float, ...] = eqx.field(static=True)

    def __init__(
        self,
        rms,
        causes: Mapping[str, Noise] | None = None,
        is_estimate: bool = False,
        drift: Any = 0.0,
        drift_time_s: Any = np.inf,
        level_stderr: float = LEVEL_STDERR,
        is_drift_found: bool = False,
        jumps_s: Sequence[float] = (),
    ):
        self.level_stderr, self.is_drift_found = float(level_stderr), bool(is_drift_found)
        self.jumps_s = tuple(jumps_s)
        wanted = "a positive number in the signal's unit"
        self.white = as_real(
            [number("the noise's rms", each, wanted, above=0) for each in _each(rms)]
        )
        wanted = "a number that is at least 0"
        self.drift = tuple(
            float(number("the noise's drift", each, wanted, least=0)) for each in _each(drift)
        )
        times = np.broadcast_to(np.asarray(drift_time_s, float), len(self.drift))
        refuse(not bool((times > 0).all()), "drift_time_s: give seconds above 0.")
        self.drift_time_s = tuple(times.tolist())
        self.causes, self.is_estimate = dict(causes or {}), is_estimate

    @property
    def rms(self) -> float:
        """The white noise's rms over all elements."""
        return float(np.sqrt(np.mean(np.asarray(self.white) ** 2)))

    @property
    def without_drift(self) -> "SampleNoise":
        """The same noise without what drifts."""
        return with_fields(self, drift=(0.0,), drift_time_s=(np.inf,))

    @property
    def has_drift(self) -> bool:
        """Whether any element drifts."""
        return any(self.drift)

    def of_directions(self, count: int) -> "SampleNoise":
        """The noise of as many rows of signals, of all elements each."""
        if len(self.white) == len(self.drift) == 1:
            return self
        elements = max(len(self.white), len(self.drift))
        white = jnp.tile(jnp.broadcast_to(self.white, elements), count)
        drift, time_s = (
            tuple(np.tile(np.broadcast_to(each, elements), count).tolist())
            for each in (self.drift, self.drift_time_s)
        )
        return with_fields(self, white=white, drift=drift, drift_time_s=time_s)

    def check_elements(self, name: str, elements: int) -> None:
        """Refuse levels that are not as many as the elements, nor one for all."""
        for what, values in (("noise levels", self.white), ("drifts", self.drift)):
            refuse(
                len(values) not in (1, elements),
                f"{name}: {len(values)} {what} are given, and there are {elements} elements: give "
                "one for all or one for each.",
            )

    def power(
        self, line: Line, scan: ConstantSpeed, signal_rms, samples: float = 1.0
    ) -> Float[Array, "#e k"]:
        """Power at line.k per cell, a cell being the mean of so many samples, one row for all
        elements or one for each."""
        causes = tuple(self.causes.values())
        coloured = total_spectrum(causes, line, scan, signal_rms)
        check_power(causes, coloured)
        white = np.asarray(self.white, float)[:, None] ** 2 / samples
        return as_real(np.asarray(coloured) + self._of_drift(line, scan, samples) + white)

    def _of_drift(
        self, line: Line, scan: ConstantSpeed, samples: float
    ) -> Float[np.ndarray, "#e k"]:
        is_walk = self._is_walk(line, scan)
        step_s = float(line.cell_m) / abs(float(scan.speed_m_per_s))
        rows = [
            of_walk(line.n, rate * np.sqrt(step_s)) if walks
            else _of_forgetful(line.n, rate, time_s, step_s, max(round(samples), 1))
            for rate, time_s, walks in zip(self.drift, self.drift_time_s, is_walk, strict=True)
        ]  # fmt: skip
        return np.stack(rows)

    def _is_walk(self, line: Line, scan: ConstantSpeed) -> Bool[np.ndarray, "#e"]:
        """Whether what drifts remembers itself all along the line, and is as good as a walk."""
        duration_s = line.n * float(line.cell_m) / abs(float(scan.speed_m_per_s))
        return np.asarray(self.drift_time_s) > FORGOTTEN * duration_s

    def trend(self, line: Line, scan: ConstantSpeed, start_m: float) -> Float[np.ndarray, "#e n"]:
        """A random walk's trend along the line, of one standard deviation, from the scan's start:
        a walk around a circle of n cells, of variogram h (1 - h/n), and this trend, of h^2/n, make
        that of the whole walk, h."""
        cells = (np.asarray(line.x) - start_m) / float(line.cell_m)
        step_s = float(line.cell_m) / abs(float(scan.speed_m_per_s))
        rates = np.where(self._is_walk(line, scan), self.drift, 0.0)[:, None]
        return rates * np.sqrt(step_s / line.n) * cells

    def level(self, motion: Motion) -> Float[np.ndarray, "#e"]:
        """The rms of what drifts at the end of a motion: a random walk is zero at its start."""
        duration_s = float(motion.time_s[-1] - motion.time_s[0])
        times = np.minimum(duration_s, np.array(self.drift_time_s) / 2)
        return np.array(self.drift) * np.sqrt(times)

    def scale(
        self,
        power: Float[Array, "#e k"],
        samples: float,
        white: Float[np.ndarray, "e n"],
        slow: Float[np.ndarray, "e n"],
    ) -> Float[np.ndarray, "e n"] | None:
        """The factor on the standard deviation of all noise in each cell, from those of its white
        and of its coloured part; None where it is one but for `EVEN`."""
        level = np.asarray(self.white, float)[:, None] ** 2 / samples
        from_white = level / np.mean(np.asarray(power)[:, 1:], axis=1, keepdims=True)
        scale = np.sqrt(from_white * white**2 + np.maximum(1 - from_white, 0.0) * slow**2)
        return None if np.all(np.abs(scale - 1) < EVEN) else scale

    def of_fit(
        self,
        name: str,
        motion: Motion,
        y: Float[np.ndarray, "e sample"],
        beside: Float[np.ndarray, "e sample"] | None = None,
    ) -> Any:
        """The noise of samples along a motion, as [`nonlinear.fit`][] takes it; `beside`: rms of
        what else is on each sample of white noise. Raises `BadInput` for coloured noise where the
        speed varies or samples are missing."""
        missing, levels = ~np.isfinite(y), np.asarray(self.white, float)[:, None]
        levels = levels if beside is None or self.causes else np.hypot(levels, beside)
        white = np.where(missing, np.inf, levels)
        if not self.causes and self.has_drift:
            time_s = np.asarray(motion.time_s)
            drift = self.drift_as_correlated(time_s)
            return WhitePlusOU(time_s, white, *drift, relative_stderr=self.level_stderr)
        if not self.causes:
            return Independent(white, self.level_stderr)
        refuse(
            bool(missing.any()) or not is_steady(motion) or levels.size > 1 or self.has_drift,
            f"{name}: noise=[{','.join(['white', *self.causes])}] needs a constant speed, the same "
            "noise in all elements, no drift and no missing samples: give noise=[white].",
        )
        speed = float(np.mean(motion.speed_m_per_s))
        line = Periodic(y.shape[-1], abs(speed) / motion.sample_rate_hz)
        signal_rms = jnp.sqrt(jnp.mean(jnp.asarray(y) ** 2))
        (power,) = np.asarray(self.power(line, ConstantSpeed(speed), signal_rms))
        return Spectrum(power)

    def drift_as_correlated(
        self, time_s: Float[np.ndarray, " sample"]
    ) -> tuple[Float[np.ndarray, "#e"], Float[np.ndarray, "#e"]]:
        """The rms and the correlation time [s] of what drifts; a random walk of an unknown level is
        a process that is very slow over these times."""
        slow_s = np.minimum(self.drift_time_s, LONG * float(time_s[-1] - time_s[0]))
        rates = np.maximum(self.drift, LEAST_DRIFT * self.rms)
        return rates * np.sqrt(slow_s / 2), slow_s


def _each(values: Any) -> Any:
    """One number, or several, as several."""
    return values if isinstance(values, list | tuple) or np.ndim(values) else [values]


def of_walk(n: int, step: float) -> Float[np.ndarray, " k"]:
    """The power of a random walk of so much from cell to cell, less its trend: that of one around a
    circle. The mean has the variance of that of a walk that begins at zero, the trend's aside."""
    power = np.full(n // 2 + 1, step**2 * n**2 / 12)
    power[1:] = step**2 / (4 * np.sin(np.pi * np.arange(1, power.size) / n) ** 2)
    return power


def _of_forgetful(
    n: int, rate: float, time_s: float, step_s: float, samples: int
) -> Float[np.ndarray, " k"]:
    """The power of means over `samples` of an Ornstein-Uhlenbeck process, around a circle of n
    cells: with r the correlation of successive samples, m of them in a cell, means that are h cells
    apart have the covariance r^(h m - m + 1) ((1 - r^m) / (1 - r) / m)^2."""
    variance, per_sample = rate**2 * time_s / 2, step_s / samples / time_s
    lags = np.minimum(np.arange(n), n - np.arange(n))
    ratio = np.expm1(-samples * per_sample) / np.expm1(-per_sample) / samples
    covariance = np.exp(-per_sample * (lags * samples - samples + 1)) * ratio**2
    lag = np.arange(1, samples)
    covariance[0] = (1 + 2 * np.sum((1 - lag / samples) * np.exp(-per_sample * lag))) / samples
    return variance * np.fft.rfft(covariance).real


def is_steady(motion: Motion) -> bool:
    """Whether the speed is constant, but for its measurement's noise."""
    speed = np.asarray(motion.speed_m_per_s)
    return bool(np.max(np.abs(speed - speed.mean())) <= STEADY * abs(speed.mean()))


def noise_on_line(
    power: Float[Numbers, "#e k"],
    n: int,
    observed: Bool[np.ndarray, "e sample"],
    scale: Float[Numbers, "..."],
) -> Any:
    """The noise of samples that are successive cells of a line of n, by its power there and a
    factor on its standard deviation, as a fit takes it; an offset that is not known is no part of
    it."""
    xp, shape = array_module(power, scale), observed.shape
    power, scale = xp.asarray(power), xp.asarray(scale)
    power = xp.where(xp.isfinite(power), power, power[:, 1:2])
    if not is_traced(power) and is_flat(np.asarray(power)):
        return xp.where(observed, scale * xp.sqrt(power[:, 1:2]), xp.inf)
    lags = xp.broadcast_to(xp.fft.irfft(power, n)[:, : shape[1]], shape)
    each = xp.broadcast_to(scale, shape).ravel()
    apart = np.abs(np.subtract.outer(np.arange(shape[1]), np.arange(shape[1])))
    blocks = (scipy if xp is np else jax.scipy).linalg.block_diag(*lags[:, apart])
    covariance = each[:, None] * blocks * each
    missing = xp.where(observed, 0.0, MISSING * lags[:, :1])
    return Correlated(covariance + xp.diag(missing.ravel()))
