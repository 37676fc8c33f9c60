"""Analogue-to-digital conversion: pointwise nonlinear effects on each recorded sample."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..compiled import compiled
from ..errors import number, whole
from ..grid import as_real

MOST_BITS = 24  # of which single precision still holds every level


class SampleConversion(eqx.Module):
    """Conversion of the signal at the samples to the recorded numbers, in the signal's unit."""

    @abc.abstractmethod
    def convert(self, signal: Float[Array, "e sample"]) -> Float[Array, "e sample"]:
        """The recorded signal."""

    @abc.abstractmethod
    def valid(self, signal: Float[Array, "e sample"]) -> Bool[Array, "e sample"]:
        """Mask of samples that still give the signal; `signal` is from before conversion or
        after."""

    @abc.abstractmethod
    def variance(self) -> Float[Array, ""]:
        """Variance of the noise added to valid samples, in the signal's unit squared."""


class Saturation(SampleConversion):
    """An amplifier that ends at its rails, |v| <= limit.

    A sample at a rail is a bound only and not valid. The derivative is 1 between the rails and 0
    beyond. Raises `BadInput` for a limit that is not positive.
    """

    limit: Float[Array, ""]

    def __init__(self, limit):
        wanted = "a positive number in the signal's unit"
        self.limit = as_real(number("converter limit", limit, wanted, above=0))

    @compiled
    def convert(self, signal: Float[Array, "e sample"]) -> Float[Array, "e sample"]:
        return _between(signal, -self.limit, self.limit)

    @compiled
    def valid(self, signal: Float[Array, "e sample"]) -> Bool[Array, "e sample"]:
        return jnp.abs(signal) < self.limit

    def variance(self) -> Float[Array, ""]:
        return as_real(0.0)


class Quantiser(SampleConversion):
    """Rounding to the nearest of 2^bits levels, 0 among them, 2 full_scale/2^bits apart.

    The levels go from -full_scale to a step below full_scale, and a sample at one of these two may
    be anything beyond: it is not valid. The error of a signal that covers many steps is uniform, of
    variance step^2/12, and independent of it (Bennett 1948). The derivative is straight through,
    that of the signal before rounding, and 0 beyond the ends. Raises `BadInput` for a full scale
    that is not positive, and for bits outside 2 to 24.
    """

    full_scale: Float[Array, ""]
    bits: int = eqx.field(static=True)

    def __init__(self, bits: Any, full_scale):
        wanted = f"a whole number from 2 to {MOST_BITS}"
        self.bits = whole("converter bits", bits, wanted, least=2, most=MOST_BITS)
        wanted = "a positive number in the signal's unit"
        self.full_scale = as_real(number("converter full_scale", full_scale, wanted, above=0))

    @property
    def step(self) -> Float[Array, ""]:
        """Spacing of the levels."""
        return self.full_scale / self._half

    @property
    def _half(self) -> float:
        """Number of levels below 0."""
        return 2.0 ** (self.bits - 1)

    @compiled
    def convert(self, signal: Float[Array, "e sample"]) -> Float[Array, "e sample"]:
        level = _between(signal / self.step, as_real(-self._half), as_real(self._half - 1))
        return self.step * _rounded(level)

    @compiled
    def valid(self, signal: Float[Array, "e sample"]) -> Bool[Array, "e sample"]:
        level = jnp.round(signal / self.step)
        return (level > -self._half) & (level < self._half - 1)

    def variance(self) -> Float[Array, ""]:
        return self.step**2 / 12


def _between(signal: Float[Array, "e sample"], low, high) -> Float[Array, "e sample"]:
    """As jnp.clip, whose derivative at a bound is halved; NaN where the bounds are."""
    signal = jnp.where(jnp.isnan(high), high, signal)
    return jnp.where(signal < low, low, jnp.where(signal > high, high, signal))


@jax.custom_jvp
def _rounded(level: Float[Array, "e sample"]) -> Float[Array, "e sample"]:
    return jnp.round(level)


@_rounded.defjvp
def _rounded_jvp(given, tangents):
    return _rounded(*given), tangents[0]
