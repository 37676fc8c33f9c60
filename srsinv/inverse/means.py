"""The means of p and q over the window: whether the signal shows them, and what it would be."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..grid import Convolution

FAINT = 1e-3  # a gain at k = 0 below this fraction of the largest leaves a mean unobservable


@eqx.filter_jit
def are_observable(
    forward: Convolution, noise: Float[Array, "#e k"], known: tuple[bool, ...]
) -> Bool[Array, " c"]:
    """For each unknown, whether its gain at k = 0 is neither zero nor proportional to another's."""
    gain = forward.transfer[..., 0]
    largest = jnp.max(jnp.abs(forward.transfer))
    size = jnp.linalg.norm(jnp.abs(gain), axis=0)
    observable = forward.has_dc_gain & (size > FAINT * largest) & jnp.all(jnp.isfinite(noise[:, 0]))
    unit = jnp.where(observable, gain / jnp.where(observable, size, 1.0), 0.0)
    overlap = jnp.abs(unit.conj().T @ unit) - jnp.eye(len(known))
    alike = jnp.any((overlap > 1 - FAINT**2) & ~np.array(known)[:, None], axis=0)
    return observable & ~alike


@eqx.filter_jit
def have_zero_mean(
    forward: Convolution, noise: Float[Array, "#e k"], known: tuple[bool, ...]
) -> Bool[Array, " c"]:
    """For each unknown, whether only its deviation from the mean is solved for."""
    # On an open line the window's ends respond weakly to every mean.
    return jnp.asarray(known) | (~are_observable(forward, noise, known) & forward.is_circular)


@eqx.filter_jit
def less_means(forward: Convolution, data, observed, means):
    """The signal of the known means, and the data without it, zero where they are missing."""
    each = jnp.stack([jnp.zeros(()) if mean is None else mean for mean in means])
    level = forward(jnp.tile(each[:, None], (1, data.shape[-1])))
    data = data - level
    return level, data if observed is None else jnp.where(observed, data, 0.0)
