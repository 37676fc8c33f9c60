"""Scans: the motion of the finger over the surface."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.core import Tracer
from jaxtyping import Array, Float

from ..errors import number, refuse
from ..grid import Line, Scalar, as_real
from ..known import by_numpy

MIN_SAMPLES = 3
MAX_INTERVAL_ROUNDING = 1e-3  # of the shortest interval: what rounding the times may take off one


class ConstantSpeed(eqx.Module):
    """A scan at constant speed: x(t) = x0 + u t, so that d/dt = u d/dx (Howe 1993, (3)).

    - `speed_m_per_s` [m/s]: u.

    A negative speed slides towards -x, and friction turns with it. Zero is a static touch: the rate
    signal is then zero. Raises `BadInput` for a speed that is not finite.
    """

    speed_m_per_s: Float[Array, ""]

    def __init__(self, speed_m_per_s=0.05):
        self.speed_m_per_s = as_real(
            number("scan.speed_m_per_s", speed_m_per_s, "a finite speed in m/s")
        )

    @property
    def direction(self) -> Float[Array, ""]:
        """sign(u): the sign with which Coulomb friction enters q = sign(u) mu p."""
        return jnp.sign(self.speed_m_per_s)

    def require_onwards(self) -> None:
        """Raises `BadInput` unless the finger slides towards +x."""
        speed = float(self.speed_m_per_s)
        refuse(speed <= 0, f"scan.speed_m_per_s is {speed}: give a positive speed in m/s.")

    def scaled(self, factor: Scalar) -> "ConstantSpeed":
        """The scan at a speed times `factor`."""
        return eqx.tree_at(lambda scan: scan.speed_m_per_s, self, factor * self.speed_m_per_s)

    def time_s(self, line: Line) -> Float[Array, " n"]:
        """Time at which the sensor is at each x, from zero at the first one met.

        NaN for a static touch, which stays at one x.
        """
        time = (line.x - line.start_m) / self.speed_m_per_s
        return time - time.min()

    def sample_rate_hz(self, line: Line) -> Float[Array, ""]:
        """Samples per second, one for each cell."""
        return jnp.abs(self.speed_m_per_s) / line.cell_m


class Motion(eqx.Module):
    """A measured motion: position x(t) and speed u(t) = dx/dt of the sensor at every sample.

    - `time_s` (sample,) [s]: strictly increasing, from any origin, evenly spaced or not. Stored
      from the first sample on where the origin is so far off that the working precision would round
      the intervals.
    - `position_m` [m], `speed_m_per_s` [m/s] (sample,): both as measured. [`Motion.from_speed`][]
      and [`Motion.from_position`][] make one from the other.

    The motion may stop and turn back. Raises `BadInput` for columns of different lengths, fewer
    than 3 samples, values that are not finite, and times that do not increase; only the lengths of
    traced columns can be checked.
    """

    time_s: Float[Array, " sample"]
    position_m: Float[Array, " sample"]
    speed_m_per_s: Float[Array, " sample"]

    def __init__(self, time_s, position_m, speed_m_per_s):
        _check_columns(time_s=time_s, position_m=position_m, speed_m_per_s=speed_m_per_s)
        self.time_s, self.position_m = _distinct_times(time_s), as_real(position_m)
        self.speed_m_per_s = as_real(speed_m_per_s)

    @classmethod
    def from_speed(cls, time_s, speed_m_per_s, start_m=0.0) -> "Motion":
        """The motion that starts at `start_m` with a speed column (sample,), or with one number.

        The position is the integral of the cubic spline through the speeds: its error is of fourth
        order in the sampling interval. Columns are concrete, not traced. Raises `BadInput` as the
        class does.
        """
        speed = np.broadcast_to(speed_m_per_s, np.shape(speed_m_per_s) or np.shape(time_s))
        _check_columns(time_s=time_s, speed_m_per_s=speed)
        number("scan.start_m", start_m, "a finite position in m")
        if np.ptp(speed) == 0:
            travelled_m = speed[0] * (np.asarray(time_s, dtype=float) - time_s[0])
        else:
            travelled_m = _at_samples(_spline(time_s, speed, 3).antiderivative(), time_s)
        return cls(time_s, start_m + travelled_m, speed)

    @classmethod
    def from_position(cls, time_s, position_m) -> "Motion":
        """The motion through a position column (sample,).

        The speed is the derivative of the quintic spline through the positions: its error is of
        fifth order in the sampling interval. The positions are interpolated exactly, and their
        noise or rounding comes out divided by the interval: smooth them first. Columns are
        concrete, not traced. Raises `BadInput` as the class does.
        """
        _check_columns(time_s=time_s, position_m=position_m)
        speed = _at_samples(_spline(time_s, position_m, 5).derivative(), time_s)
        return cls(time_s, position_m, speed)

    @property
    def direction(self) -> Float[Array, " sample"]:
        """sign(u), with which Coulomb friction enters q = sign(u) mu p.

        At a standstill the sign is that of the motion before it, ahead of the first motion that of
        the first motion. It is zero where nothing ever moves.
        """
        return as_real(_last_sign(self.speed_m_per_s))

    def of_samples(self, samples: slice) -> "Motion":
        """The motion over these of its samples. Not for traced motions."""
        columns = self.time_s, self.position_m, self.speed_m_per_s
        return Motion(*(np.asarray(each)[samples] for each in columns))

    def scaled(self, factor: Scalar) -> "Motion":
        """The motion with speeds and positions times `factor`."""
        return Motion(self.time_s, factor * self.position_m, factor * self.speed_m_per_s)

    def held(self, count: int) -> "Motion":
        """The motion, followed by a standstill until it has `count` samples. Not for traced
        motions."""
        time_s, x, speed = (
            np.asarray(each) for each in (self.time_s, self.position_m, self.speed_m_per_s)
        )
        after = np.arange(1, count - time_s.size + 1)
        return Motion(
            np.append(time_s, time_s[-1] + after / self.sample_rate_hz),
            np.append(x, np.full(after.size, x[-1])),
            np.append(speed, np.zeros(after.size)),
        )

    @property
    def sample_rate_hz(self) -> float:
        """The mean rate of its samples [Hz]. Not for traced motions."""
        first, last = np.asarray(self.time_s)[[0, -1]]
        return (self.time_s.size - 1) / float(last - first)

    @property
    def directions(self) -> tuple[bool, ...]:
        """Whether the sensor slides towards +x, and towards -x: True and False, in this order. Not
        for traced motions."""
        onwards = np.asarray(self.direction) >= 0
        return tuple(direction for direction in (True, False) if np.any(onwards == direction))


@by_numpy
def _last_sign(speed: Float[Any, " sample"], xp: Any = jnp) -> Float[Any, " sample"]:
    sign = xp.sign(speed)
    place = xp.where(sign != 0, xp.arange(sign.size), -1)
    moved = np.maximum.accumulate(place) if xp is np else jax.lax.cummax(place)
    return sign[xp.where(moved < 0, xp.argmax(sign != 0), moved)]


def _check_columns(**columns) -> None:
    shapes = {name: np.shape(column) for name, column in columns.items()}
    samples = shapes["time_s"]
    for name, shape in shapes.items():
        refuse(
            len(shape) != 1 or shape != samples,
            f"scan.{name} has the shape {shape} and scan.time_s {samples}: give one value for each "
            "sample, (sample,).",
        )
    refuse(
        samples[0] < MIN_SAMPLES,
        f"The motion has {samples[0]} samples: give at least {MIN_SAMPLES}.",
    )
    known = {
        name: np.asarray(column)
        for name, column in columns.items()
        if not isinstance(column, Tracer)
    }
    for name, values in known.items():
        bad = ~np.isfinite(values)
        refuse(
            bool(bad.any()),
            f"scan.{name} is {values[bad.argmax()]} at sample {bad.argmax() + 1}: correct the "
            "value or leave the sample out.",
        )
    if "time_s" in known:
        time = known["time_s"]
        stuck = np.diff(time) <= 0
        at = int(stuck.argmax())
        refuse(
            bool(stuck.any()),
            f"scan.time_s must increase strictly, but sample {at + 2} ({time[at + 1]} s) does not "
            f"come after sample {at + 1} ({time[at]} s): drop or reorder the samples.",
        )


def _distinct_times(time_s) -> Float[Array, " sample"]:
    """The times in the working precision, in which a clock's 1e9 s would hide every interval."""
    if isinstance(time_s, Tracer):
        return as_real(time_s)
    time = np.asarray(time_s, dtype=float)
    interval, rounded = np.diff(time), time.astype(jnp.result_type(float)).astype(float)
    off = np.max(np.abs(np.diff(rounded) - interval))
    return as_real(time - time[0] if off > MAX_INTERVAL_ROUNDING * np.min(interval) else time_s)


def _spline(time_s, values, degree: int) -> Any:
    """The interpolating spline over the time since the first sample, of lower degree where the
    samples are too few."""
    since = np.asarray(time_s, dtype=float) - time_s[0]
    degree = min(degree, since.size - 1)
    return scipy.interpolate.make_interp_spline(since, np.asarray(values, dtype=float), degree)


def _at_samples(spline: Any, time_s) -> np.ndarray:
    return spline(np.asarray(time_s, dtype=float) - time_s[0])
