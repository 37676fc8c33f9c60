"""Speed profiles: departures from a constant speed by ripple, standstill or reversal.

A profile is a factor on the nominal speed, and profiles multiply. How many samples a motion takes
is concrete, and numpy finds it in double precision; at given times the motion is differentiable.
"""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..errors import number, refuse
from ..grid import Scalar
from ..numerics import pairwise_cumsum
from .scan import MIN_SAMPLES, Motion

MOST_SAMPLES = 2**22
NODES = 8  # of Gauss's rule between samples: to round-off for half a period of a ripple
ARRIVED = 1e-12  # of the way: the rest is rounding


class SpeedProfile(eqx.Module):
    """Base of speed profiles: a factor on the nominal speed over time, smooth but for its bends.

    `factor`, `bends_s` [s] and `frequency_limit_hz` [Hz] are to be defined. After the last bend the
    factor is never negative, so that the motion ends at the scan's end.
    """

    @abc.abstractmethod
    def factor(self, time_s, xp: Any = np):
        """(sample,): factor on the nominal speed, by `xp`: numpy or jax.numpy."""

    @property
    @abc.abstractmethod
    def bends_s(self) -> tuple[Scalar, ...]:
        """Times at which the factor is not smooth, increasing."""

    @property
    @abc.abstractmethod
    def frequency_limit_hz(self) -> Scalar:
        """The highest frequency of the factor where it is periodic, else 0."""


class RippleProfile(SpeedProfile):
    """1 + fraction cos(2 pi frequency t + phase): a drive that turns unevenly.

    Raises `BadInput` for a fraction outside [0, 1], which would turn the motion back, and a
    frequency that is not positive.
    """

    fraction: Scalar
    frequency_hz: Scalar
    phase_rad: Scalar

    def __init__(self, fraction, frequency_hz, phase_rad=0.0):
        wanted = "a number between 0 and 1"
        self.fraction = _concrete(number("ripple.fraction", fraction, wanted, least=0, most=1))
        wanted = "a positive frequency in Hz"
        self.frequency_hz = _concrete(number("ripple.frequency_hz", frequency_hz, wanted, above=0))
        self.phase_rad = _concrete(number("ripple.phase_rad", phase_rad, "an angle in radians"))

    def factor(self, time_s, xp: Any = np):
        turn = 2 * np.pi * self.frequency_hz
        return 1 + self.fraction * xp.cos(turn * time_s + self.phase_rad)

    @property
    def bends_s(self) -> tuple[Scalar, ...]:
        return ()

    @property
    def frequency_limit_hz(self) -> Scalar:
        return self.frequency_hz


class Interruption(SpeedProfile):
    """From `at_s` on the motion changes within `ramp_s`, by raised cosines, to 1 - `slowdown` times
    the nominal speed, for `duration_s`, and back again within `ramp_s`.

    Raises `BadInput` for times below 0 and for a ramp that is not positive.
    """

    slowdown: ClassVar[float]
    name: ClassVar[str]
    at_s: Scalar
    duration_s: Scalar
    ramp_s: Scalar

    def __init__(self, at_s, duration_s, ramp_s):
        wanted = "a time in seconds that is at least 0"
        self.at_s = _concrete(number(f"{self.name}.at_s", at_s, wanted, least=0))
        self.duration_s = _concrete(number(f"{self.name}.duration_s", duration_s, wanted, least=0))
        wanted = "a positive time in seconds"
        self.ramp_s = _concrete(number(f"{self.name}.ramp_s", ramp_s, wanted, above=0))

    def factor(self, time_s, xp: Any = np):
        begun = xp.clip((time_s - self.at_s) / self.ramp_s, 0, 1)
        left = xp.clip((self.bends_s[-1] - time_s) / self.ramp_s, 0, 1)
        window = (xp.sin(np.pi / 2 * begun) * xp.sin(np.pi / 2 * left)) ** 2
        return 1 - self.slowdown * window

    @property
    def bends_s(self) -> tuple[Scalar, ...]:
        resting = self.at_s + self.ramp_s
        leaving = resting + self.duration_s
        return self.at_s, resting, leaving, leaving + self.ramp_s

    @property
    def frequency_limit_hz(self) -> float:
        return 0.0


class StandstillProfile(Interruption):
    """The motion slows down, rests for `duration_s` and speeds up again."""

    slowdown = 1.0
    name = "standstill"


class ReversalProfile(Interruption):
    """The motion turns, slides back at the same speed for `duration_s` and turns again."""

    slowdown = 2.0
    name = "reversal"


def paced(
    start_m, length_m, speed_m_per_s, rate_hz, profiles: Sequence[SpeedProfile] = ()
) -> Motion:
    """The motion at `speed_m_per_s` times every profile's factor, sampled `rate_hz` times a second.

    It starts at `start_m`, at a negative speed at `start_m + length_m`, and ends with the first
    sample that is beyond the other end for good. On the way back it may go beyond its start. The
    position is the integral of the speed by Gauss's rule from sample to sample and from bend to
    bend, exact to round-off.

    Raises `BadInput` for values out of range, a speed of 0, which never arrives, a ripple that the
    samples do not resolve, and fewer samples than 3 or more than 2^22.
    """
    number("scan.start_m", start_m, "a finite position in m")
    number("scan.length_m", length_m, "a positive length in metres", above=0)
    number("scan.rate_hz", rate_hz, "a positive rate in samples per second", above=0)
    wanted = "a speed in m/s other than 0"
    number("scan.speed_m_per_s", speed_m_per_s, wanted)
    refuse(speed_m_per_s == 0, f"scan.speed_m_per_s is {speed_m_per_s}: give {wanted}.")
    highest = max((profile.frequency_limit_hz for profile in profiles), default=0.0)
    refuse(
        2 * highest >= rate_hz,
        f"scan.rate_hz is {rate_hz}, too low for a speed ripple of {highest} Hz: give more than "
        f"{2 * highest}.",
    )
    begin = start_m if speed_m_per_s > 0 else start_m + length_m
    time, travelled = _until(length_m / abs(speed_m_per_s), rate_hz, profiles)
    position = begin + speed_m_per_s * travelled
    return Motion(time, position, speed_m_per_s * _factor(time, profiles))


def at_times(
    time_s: Float[Array, " sample"],
    start_m: Scalar,
    speed_m_per_s: Scalar,
    profiles: Sequence[SpeedProfile] = (),
) -> Motion:
    """The motion from `start_m` on, at times from 0 on: that of [`paced`][], to the rounding of the
    working precision, and differentiable in every number but the times.

    Raises `BadInput` for times that do not increase, are fewer than 3, or begin before 0.
    """
    if not isinstance(time_s, Tracer):
        first = float(np.asarray(time_s)[0])
        refuse(first < 0, f"The motion begins at {first:.6g} s: give times from 0 on.")
    travelled = _travelled(time_s, profiles, jnp)
    speed = speed_m_per_s * _factor(time_s, profiles, jnp)
    return Motion(time_s, start_m + speed_m_per_s * travelled, speed)


def denser(
    motion: Motion, times: int, speed_m_per_s: float, profiles: Sequence[SpeedProfile] = ()
) -> Motion:
    """The motion of [`paced`][] at a mean of `speed_m_per_s`, with `times` as many samples."""
    last = motion.time_s.size - 1
    time = np.linspace(0.0, float(motion.time_s[-1]), last * times + 1)
    position = float(motion.position_m[0]) + speed_m_per_s * _travelled(time, profiles)
    return Motion(time, position, speed_m_per_s * _factor(time, profiles))


def _concrete(value: Any) -> Scalar:
    return value if isinstance(value, Tracer) else float(value)


def _factor(time, profiles: Sequence[SpeedProfile], xp: Any = np):
    factor = xp.ones_like(time)
    for profile in profiles:
        factor = factor * profile.factor(time, xp)
    return factor


def _until(
    way_s: float, rate_hz: float, profiles: Sequence[SpeedProfile]
) -> tuple[np.ndarray, np.ndarray]:
    """Times (sample,) and the factor's integral [s] up to them, which ends beyond `way_s`."""
    last_bend = max((bend for profile in profiles for bend in profile.bends_s), default=0.0)
    samples = min(rate_hz * (way_s + last_bend), MOST_SAMPLES - 2)
    while True:
        time = np.arange(int(samples) + 2) / rate_hz
        travelled = _travelled(time, profiles)
        short = travelled < way_s * (1 - ARRIVED)
        if time[-1] >= last_bend and not short[-1]:
            break
        refuse(
            time.size == MOST_SAMPLES,
            f"The motion has not reached its end after {MOST_SAMPLES} samples, at "
            f"{time[-1]:.4g} s: lower scan.rate_hz or scan.length_m, raise the speed, or "
            "let its profiles end sooner.",
        )
        samples = min(2 * samples, MOST_SAMPLES - 2)
    count = int(np.flatnonzero(short)[-1]) + 2
    refuse(
        count < MIN_SAMPLES,
        f"scan.rate_hz is {rate_hz}, which gives {count} samples on the way: raise it until there "
        f"are at least {MIN_SAMPLES}.",
    )
    return time[:count], travelled[:count]


def _travelled(time, profiles: Sequence[SpeedProfile], xp: Any = np):
    """The factor's integral from time 0 [s], of which all panels end at samples and bends."""
    bends = [xp.minimum(bend, time[-1]) for profile in profiles for bend in profile.bends_s]
    zero = xp.zeros(1, time.dtype)
    if bends:  # a sample comes before a bend at its time, whose derivative is not its own
        ends = xp.sort(xp.concatenate([time, zero, xp.asarray(bends, time.dtype)]))
    else:
        ends = xp.concatenate([zero, time])
    middle, half = (ends[1:] + ends[:-1]) / 2, xp.diff(ends) / 2
    mean = xp.zeros_like(middle)
    for node, weight in zip(*np.polynomial.legendre.leggauss(NODES), strict=True):
        mean = mean + weight * _factor(middle + node * half, profiles, xp)
    # jax adds up in pairs of pairs by itself.
    travelled = pairwise_cumsum(half * mean) if xp is np else xp.cumsum(half * mean)
    if not bends:  # every panel ends at a sample: millions need no search
        return travelled
    travelled = xp.concatenate([zero, travelled])
    return travelled[xp.searchsorted(ends, time)]
