"""The conditions of contact, and how far they are met: for every solver.

Pressure is held as its deviation from the nominal one, heights [m] from the highest crest;
`compliance` [m/Pa] is that of cells, zero at k = 0.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Inexact


def rounding(dtype) -> float:
    """Bound on the gap's rounding error, over the displacement's range."""
    return 40 * float(jnp.finfo(dtype).eps)


def least_error(dtype) -> float:
    """Tolerance on the gap's error, in the measure of `gap_and_error`."""
    return max(1e-10, rounding(dtype))


def times(spectrum: Inexact[Array, " k"], values: Float[Array, " n"]) -> Float[Array, " n"]:
    """`values` (n,) convolved with the kernel of this half spectrum."""
    return jnp.fft.irfft(spectrum * jnp.fft.rfft(values), values.size)


def stiffness(compliance: Float[Array, " k"]) -> Float[Array, " k"]:
    """1/compliance, with a value of the size of the longest wave's at k = 0."""
    inverse = 1 / compliance  # infinite at k = 0; no derivative goes through it
    return jnp.where(compliance > 0, inverse, inverse[1] / 2)


def forceless_stiffness(compliance: Float[Array, " k"]) -> Float[Array, " k"]:
    """1/compliance, nothing at k = 0."""
    return stiffness(compliance).at[0].set(0.0)


def gap_and_error(height, nominal, moved, deviation):
    """The gap, zero on average where the skin touches, and its error: over the displacement's
    range, and with the pressure over the nominal one, over the profile's height."""
    touching = touches(nominal, deviation)
    gap = moved - height
    gap = gap - jnp.sum(jnp.where(touching, gap, 0.0)) / jnp.maximum(jnp.sum(touching), 1)
    off = jnp.where(touching, jnp.abs(gap), jnp.maximum(-gap, 0.0))
    # A slight contact displaces far less than the profile is high.
    span, reach = jnp.ptp(height), jnp.ptp(moved)
    wrong = jnp.max(off) / jnp.where(reach > 0, reach, span)
    # So that p gap is small beside the load times the height too, as far as rounding lets it be
    # under a high peak.
    weight = jnp.where(touching, 1.0 + deviation / nominal, 0.0)
    rounding_ratio = rounding(gap.dtype) / least_error(gap.dtype)
    work = jnp.max(weight * off) / jnp.maximum(span, rounding_ratio * jnp.max(weight) * reach)
    # A flat profile has no size to compare with, and no error.
    return gap, jax.lax.stop_gradient(jnp.where(span > 0, jnp.maximum(wrong, work), 0.0))


def touches(nominal, deviation):
    """Contact mask: cells where the pressure is not zero."""
    return deviation > -nominal


def cut(deviation, active, nominal):
    """The deviation with cells in tension released, and the same load on the rest."""
    pressure = jnp.where(active, jnp.maximum(nominal + deviation, 0.0), 0.0)
    mean = jnp.mean(pressure)
    return nominal / jnp.where(mean > 0, mean, 1.0) * pressure - nominal
