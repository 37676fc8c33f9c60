"""Posterior densities to sample: of a fit's objective, or a user's own, on free variables without
bounds.

A parameter x between two bounds is a logistic function of its free variable, one with a single
bound lies an exponential beyond it. The density of the free variables has the slope of this map as
a factor, so that flat priors stay flat in x. The variables are shifted and scaled by Laplace's
approximation, which makes a normal posterior a standard normal one whatever the units.
"""

import abc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._parameters import Layout
from ._search import Objective

Numbers = Float[Array, " m"] | Float[np.ndarray, " m"]
LEAST_CURVATURE = 1e-8  # of the largest: a direction of less is scaled as if it had so much
BESIDE_BOUND = 1 / 3  # of the distance of two bounds: a start is no nearer to either


class Box(eqx.Module):
    """Bounds `lower`, `upper` (m,), infinite for none, and the map from free variables to what lies
    between."""

    lower: Numbers
    upper: Numbers

    def inside(self, t: Numbers) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Parameters (m,) and the log of their slope by the free variables `t` (m,)."""
        below, above = jnp.isfinite(self.lower), jnp.isfinite(self.upper)
        both = below & above
        low, high = jnp.where(below, self.lower, 0.0), jnp.where(above, self.upper, 0.0)
        width = jnp.where(both, high - low, 1.0)
        between = low + width * jax.nn.sigmoid(t)
        outward = jnp.where(below, t, -t)  # of one bound
        away = jnp.exp(jnp.where(below ^ above, outward, 0.0))
        of_one = jnp.where(below, low + away, high - away)
        log_between = jnp.log(width) + jax.nn.log_sigmoid(t) + jax.nn.log_sigmoid(-t)
        value = jnp.where(both, between, jnp.where(below | above, of_one, jnp.asarray(t)))
        log_slope = jnp.where(both, log_between, jnp.where(below | above, outward, 0.0))
        return value, log_slope

    def free(self, z: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """The free variables of parameters `z` (m,) inside the bounds."""
        low, high = np.asarray(self.lower, float), np.asarray(self.upper, float)
        with np.errstate(all="ignore"):
            logit = np.log(z - low) - np.log(high - z)
            of_one = np.where(np.isfinite(low), np.log(z - low), -np.log(high - z))
        both = np.isfinite(low) & np.isfinite(high)
        either = np.isfinite(low) | np.isfinite(high)
        return np.where(both, logit, np.where(either, of_one, z))

    def away(self, z: Float[np.ndarray, " m"], by: Float[np.ndarray, " m"]) -> np.ndarray:
        """Parameters `z` (m,) moved inwards where they are nearer to a bound than `by` (m,)."""
        low, high = np.asarray(self.lower, float), np.asarray(self.upper, float)
        by = np.minimum(by, BESIDE_BOUND * (high - low))
        return np.clip(z, low + by, high - by)


class Density(eqx.Module):
    """An unnormalised log density of parameters z (m,)."""

    @abc.abstractmethod
    def __call__(self, z: Float[Array, " m"]) -> Float[Array, ""]:
        """Its value."""


class FitDensity(Density):
    """The posterior of a fit: its likelihood, its Gaussian priors, and flat ones.

    `count`: number of the data where the level of their noise is not known, else None. With the
    prior 1/sigma of the level its integral over sigma is Student's: the likelihood is S^(-count/2),
    S the sum of squares.
    """

    objective: Objective
    count: Float[np.ndarray, ""] | None

    def __call__(self, z: Float[Array, " m"]) -> Float[Array, ""]:
        of_data = self.objective.loss.root(self.objective.white(z)[0])
        terms = self.objective.with_priors(of_data, z)
        if self.count is None:
            return -0.5 * jnp.vdot(terms, terms)
        priors = terms[of_data.size :]
        log_likelihood = -jnp.asarray(self.count) / 2 * jnp.log(jnp.vdot(of_data, of_data))
        return log_likelihood - 0.5 * jnp.vdot(priors, priors)


class OwnDensity(Density):
    """A user's log density of a tree of parameters."""

    function: Callable[[Any], Any]
    layout: Layout = eqx.field(static=True)
    row: Float[np.ndarray, " all"]

    def __call__(self, z: Float[Array, " m"]) -> Float[Array, ""]:
        return jnp.asarray(self.function(self.layout.filled(jnp.asarray(self.row), z)))


class FreeDensity(eqx.Module):
    """The log density of scaled free variables u (m,): t = `centre` (m,) + `root` (m, m) u.

    `is_forward`: whether its gradient is taken forward, column by column, as the search of a fit
    takes it: a model need not have a derivative the other way, which is faster.
    """

    of: Density
    box: Box
    centre: Numbers
    root: Float[Array, "m m"] | Float[np.ndarray, "m m"]
    is_forward: bool = eqx.field(static=True, default=False)

    def differentiable(self) -> "FreeDensity":
        """The same, with its gradient taken backward where that is possible."""
        try:
            jax.eval_shape(jax.grad(self.value), jnp.asarray(self.centre))
        # For a loop of unknown length or a callback, for a derivative that is not linear in the
        # tangent, and for a linear solve without a transpose.
        except (ValueError, NotImplementedError, TypeError):
            return replace(self, is_forward=True)
        return self

    def parameters(self, u: Float[Array, " m"]) -> Float[Array, " m"]:
        """The parameters within their bounds."""
        return self.box.inside(self.centre + self.root @ u)[0]

    def __call__(self, u: Float[Array, " m"]) -> Float[Array, ""]:
        return _by_columns(u, density=self) if self.is_forward else self.value(u)

    def value(self, u: Float[Array, " m"]) -> Float[Array, ""]:
        """The density itself, -inf where it is not a number."""
        z, log_slope = self.box.inside(self.centre + self.root @ u)
        value = self.of(z) + jnp.sum(log_slope)
        return jnp.where(jnp.isnan(value), -jnp.inf, value)


@eqx.filter_custom_jvp
def _by_columns(u: Float[Array, " m"], density: FreeDensity) -> Float[Array, ""]:
    return density.value(u)


@_by_columns.def_jvp
def _by_columns_jvp(primals, tangents, density: FreeDensity):
    (u,) = primals
    value, push = jax.linearize(density.value, u)
    gradient = jax.vmap(push)(jnp.eye(u.size, dtype=u.dtype))
    return value, jnp.vdot(gradient, tangents[0])


def root_of(precision: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m m"]:
    """A root R with R R^T = precision^-1, of a symmetric matrix whose negative eigenvalues, of no
    maximum, count by their size."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(precision)), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(precision / np.outer(scale, scale))
    sizes = np.maximum(np.abs(values), LEAST_CURVATURE * np.abs(values).max())
    return vectors / np.sqrt(sizes) / scale[:, None]
