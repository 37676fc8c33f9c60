"""The remaining fall of the cost by Newton's method: a check of a search that stopped where the
linearised problem predicts further progress.

The linearised problem is mistaken where the residual's own curvature decides: J can lose rank in a
minimum whose residual is not zero (Freudenstein and Roth, Jennrich and Sampson, chebyquad of 8).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ._lengths import lengths
from ._search import Objective


def newton_fall(objective: Objective, z, jacobian: np.ndarray, held: np.ndarray) -> float:
    """The relative fall of the cost that its whole second derivative predicts; infinite where the
    point (m,) is a saddle or a maximum. `jacobian` (terms, m), `held` (m,) by bounds."""
    columns = np.linalg.norm(jacobian, axis=0)
    moving = ~held & (columns > 0)
    cost, gradient, hessian = (np.asarray(v, float) for v in _derivatives(objective, z))
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        return np.inf
    unit = columns[moving]
    slope = gradient[moving] / unit
    curvature = hessian[np.ix_(moving, moving)] / np.outer(unit, unit)
    values, vectors = np.linalg.eigh((curvature + curvature.T) / 2)
    eps = float(np.finfo(np.asarray(z).dtype).eps)
    if values[0] < -np.sqrt(eps) * np.abs(values).max():
        return np.inf
    curved = np.maximum(values, eps * np.abs(values).max())
    return float(0.5 * np.sum((vectors.T @ slope) ** 2 / curved) / cost)


@compiled
def _derivatives(
    objective: Objective, z: Float[Array, " m"]
) -> tuple[Float[Array, ""], Float[Array, " m"], Float[Array, "m m"]]:
    """The cost, its gradient and its second derivative: central differences of the gradient, which
    ask no more of a model than the search does."""

    def linearised(z):
        terms, push = jax.linearize(objective.terms, z)
        return terms, jax.vmap(push, out_axes=1)(jnp.eye(z.size, dtype=z.dtype))

    def gradient(z):
        terms, jacobian = linearised(z)
        return jacobian.T @ terms

    terms, jacobian = linearised(z)
    # A move that changes the terms by this fraction of their length: it balances the difference's
    # errors by rounding and by the fourth derivative.
    relative_step = float(jnp.finfo(z.dtype).eps) ** (1 / 3)
    columns = lengths(jacobian)
    steps = relative_step * lengths(terms) / jnp.where(columns > 0, columns, 1.0)
    points = z + jnp.concatenate([jnp.diag(steps), -jnp.diag(steps)])
    above, below = jnp.split(jax.lax.map(gradient, points), 2)
    hessian = (above - below) / (2 * steps[:, None])
    return 0.5 * jnp.vdot(terms, terms), jacobian.T @ terms, hessian
