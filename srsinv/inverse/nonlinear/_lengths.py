"""Norms that neither overflow nor underflow where their squares do."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def lengths(columns: Float[Array, "n *m"]) -> Float[Array, "*m"]:
    """The norm along the first axis: single precision cannot hold the square of 1e20."""
    largest = jnp.max(jnp.abs(columns), axis=0, initial=0.0)
    # Values that are not finite propagate.
    unit = jnp.where((largest > 0) & jnp.isfinite(largest), largest, 1.0)
    return unit * jnp.linalg.norm(columns / unit, axis=0)
