"""The direct path: Cholesky factors of the whole problem, for any line and any missing samples."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...grid import half_spectrum_weights
from .prior import Prior, Score, Solution
from .problem import LineProblem


class Whitened(NamedTuple):
    """Model and data over the valid samples, in units of the noise.

    Rows of missing samples are zero. An unknown offset has been projected out.
    """

    model: Float[Array, "s m"]
    data: Float[Array, "e n"]


@jax.jit
def whiten(problem: LineProblem) -> Whitened:
    """Whiten every element by the Cholesky factor of its noise covariance."""
    n, unknowns = problem.line.n, problem.unknowns
    basis = jnp.eye(unknowns * n).reshape(-1, unknowns, n)
    columns = jnp.moveaxis(jax.vmap(problem.forward)(basis), 0, -1)  # (element, sample, unknown)
    observed = jnp.ones(problem.data.shape, bool) if problem.observed is None else problem.observed
    free_offset = ~jnp.all(jnp.isfinite(problem.noise[:, 0]))
    at_zero = jnp.where(free_offset, problem.noise[:, 1], problem.noise[:, 0])
    lag = np.arange(n)[:, None] - np.arange(n)
    lags = jnp.fft.irfft(problem.noise.at[:, 0].set(at_zero), n)

    def one(model, data, observed, scale, columns, lags):
        toeplitz = lags[lag]
        both = observed[:, None] & observed[None, :]
        covariance = scale[:, None] * toeplitz * scale + columns.T @ columns
        root = jnp.linalg.cholesky(jnp.where(both, covariance, jnp.eye(n)))
        rows = jnp.concatenate([model, data[:, None], jnp.ones((n, 1))], axis=-1)
        rows = jnp.where(observed[:, None], rows, 0.0)
        rows = jax.scipy.linalg.solve_triangular(root, rows, lower=True)
        one = rows[:, -1]
        coefficients = (one @ rows) / jnp.maximum(one @ one, jnp.finfo(one.dtype).tiny)
        rows = rows - jnp.where(free_offset, one[:, None] * coefficients[None, :], 0.0)
        return rows[:, :-2], rows[:, -2]

    # Not batched: batched LAPACK on a CPU can deadlock (see `nonlinear`).
    scale = jnp.ones(problem.data.shape) if problem.noise_scale is None else problem.noise_scale
    nothing = jnp.zeros((len(problem.data), 0, n))
    nuisance = nothing if problem.nuisance is None else problem.nuisance
    of_each = jnp.broadcast_to(lags, (len(problem.data), n))
    each = columns, problem.data, observed, scale, nuisance, of_each
    model, data = jax.lax.map(lambda rows: one(*rows), each)
    return Whitened(model.reshape(-1, unknowns * n), data)


class PosteriorFactor(NamedTuple):
    """Cholesky factor of the posterior precision.

    Where only the deviation from the mean is solved for, the mean has the precision `scale`, which
    keeps the factor regular, and is taken out of the covariance again.
    """

    root: Float[Array, "m m"]
    zero_mean: Bool[Array, " c"]
    scale: Float[Array, ""]
    norm: Float[Array, ""]  # the precision's 1-norm

    def covariance(self) -> Float[Array, "m m"]:
        """The posterior covariance, zero along a fixed mean."""
        covariance = jax.scipy.linalg.cho_solve((self.root, True), jnp.eye(self.root.shape[0]))
        return covariance - _means(self.root, self.zero_mean) / self.scale


def _means(like: Float[Array, "m m"], zero_mean: Bool[Array, " c"]) -> Float[Array, "m m"]:
    """The projection on the means of the components that are zero_mean."""
    n = like.shape[0] // zero_mean.size
    return jnp.kron(jnp.diag(zero_mean.astype(like.dtype)), jnp.full((n, n), 1 / n, like.dtype))


def _centre(matrix: Float[Array, "m j"], zero_mean: Bool[Array, " c"]) -> Float[Array, "m j"]:
    """Remove rows' means from the components that are zero_mean."""
    blocks = matrix.reshape(zero_mean.size, -1, matrix.shape[-1])
    means = jnp.where(zero_mean[:, None, None], blocks.mean(axis=1, keepdims=True), 0.0)
    return (blocks - means).reshape(matrix.shape)


@jax.jit
def solve(problem: LineProblem, prior: Prior, white: Whitened) -> Solution:
    """Posterior of the traction, its covariance (c n, c n) whole.

    The condition number is that of the precision, in the 1-norm.
    """
    n, unknowns = problem.line.n, problem.unknowns
    information = white.model.T @ white.model
    posterior = _posterior(problem.zero_mean, information + _penalty(problem, prior))
    covariance = posterior.covariance()
    value = covariance @ (white.model.T @ white.data.ravel())
    variance = jnp.maximum(_variance(problem, covariance), 0.0)
    middle = jnp.arange(unknowns) * n + n // 2
    averaging = covariance @ information[:, middle]
    return Solution(
        value.reshape(unknowns, n),
        jnp.sqrt(variance).reshape(unknowns, n),
        covariance,
        averaging.reshape(unknowns, n, unknowns).swapaxes(1, 2),
        jnp.sum((covariance * information).reshape(unknowns, -1), axis=-1),
        posterior.norm * jnp.max(jnp.sum(jnp.abs(covariance), axis=0)),
    )


def _variance(problem: LineProblem, covariance: Float[Array, "m m"]) -> Float[Array, " m"]:
    """Variance of the deviation from the mean over the sampled cells where the mean is weakly
    observed: the mean's error would mask the others."""
    variance = jnp.diagonal(covariance)
    if problem.forward.is_circular:
        return variance
    n, unknowns = problem.line.n, problem.unknowns
    of_each = jnp.eye(unknowns)[:, :, None] * problem.mean_weights[None]
    weights = of_each.reshape(unknowns, unknowns * n)
    shared = covariance @ weights.T
    of_mean = jnp.diagonal(weights @ shared)
    along = jnp.repeat(jnp.eye(unknowns), n, axis=0)
    return variance - 2 * jnp.sum(shared * along, axis=1) + along @ of_mean


class Scored(NamedTuple):
    """What the scores of a family's priors share: the whitened model and data, the data's
    information on the traction, the penalty of the prior with weights of 1, of each component the
    `rank` of its penalty, the penalty's log pseudo-determinant `log_root`, halved, and which means
    are not solved for. `basis`: what makes cells of the unknowns; None: they are the cells, whose
    mean moves without being counted."""

    white: Whitened
    information: Float[Array, "m m"]
    penalty: Float[Array, "m m"]
    rank: Float[Array, " c"]
    log_root: Float[Array, ""]
    zero_mean: Bool[Array, " c"]
    basis: Float[Array, "cell m"] | None = None


@jax.jit
def scored(problem: LineProblem, unweighted: Prior) -> Scored:
    """The problem as scores take it, exact but for the prior's determinant.

    That one is the periodic line's: its weights enter alike, up to the two cells at the ends.
    """
    white = whiten(problem)
    return scored_under(problem, unweighted, white, white.model.T @ white.model)


def scored_under(
    problem: LineProblem, prior: Prior, white: Whitened, information: Float[Array, "m m"]
) -> Scored:
    """What scores take, of the whitened problem and the data's `information` on the traction."""
    n = problem.line.n
    root = jnp.asarray(prior.root(problem.line))
    root = root.at[:, 0].set(jnp.where(problem.zero_mean, 0.0, root[:, 0]))
    weights, is_held = n * half_spectrum_weights(n), root > 0
    log_root = jnp.sum(weights * jnp.log(jnp.where(is_held, root, 1.0)))
    penalty = _penalty(problem, prior)
    return Scored(white, information, penalty, is_held @ weights, log_root, problem.zero_mean)


def score(factor: Float[Array, " c"], of: Scored) -> Score:
    """The score, over the valid samples, of the prior whose root is `factor` times that of weights
    of 1."""
    white, each = of.white, jnp.repeat(factor**2, len(of.penalty) // factor.size)
    data = white.data.ravel()
    penalty = each[:, None] * of.penalty
    posterior = _posterior(of.zero_mean, of.information + penalty)

    def solved(right: Array) -> Array:
        return jax.scipy.linalg.solve_triangular(posterior.root, right, lower=True)

    # Apart, as a criterion may need some terms alone, which are far quicker.
    model, right = solved(white.model.T), solved(white.model.T @ data)
    residual = data - model.T @ right
    value = jax.scipy.linalg.solve_triangular(posterior.root, right, trans=1, lower=True)
    pulling = penalty @ value
    pull = solved(_centre(pulling[:, None], of.zero_mean)[:, 0])
    moved = jax.scipy.linalg.solve_triangular(posterior.root, pull, trans=1, lower=True)
    if of.basis is None:
        moved = _centre(moved[:, None], jnp.ones(factor.shape, bool))
    else:
        moved = of.basis @ moved
    log_prior = of.rank @ jnp.log(factor) + of.log_root
    log_posterior = jnp.sum(jnp.log(jnp.diagonal(posterior.root)))
    log_posterior -= jnp.sum(of.zero_mean) * jnp.log(posterior.scale) / 2
    square = data @ data - right @ right
    rows = residual.reshape(white.data.shape)
    return Score(
        residual @ residual,
        jnp.sum(model**2),
        log_prior - log_posterior - square / 2,
        value @ pulling,
        pull @ pull,
        jnp.sum(moved**2),
        jnp.sum(jnp.abs(jnp.fft.rfft(rows)) ** 2, axis=0),
    )


def _penalty(problem: LineProblem, prior: Prior) -> Float[Array, "m m"]:
    """The prior's precision."""
    n, unknowns = problem.line.n, problem.unknowns
    size = unknowns * n
    basis = jnp.eye(size).reshape(size, unknowns, n)
    rows = jax.vmap(lambda r: jnp.asarray(prior.apply(problem.line, r)))(basis)
    return rows.reshape(size, size)


def _posterior(zero_mean: Bool[Array, " c"], precision: Float[Array, "m m"]) -> PosteriorFactor:
    centred = _centre(_centre(precision, zero_mean).T, zero_mean)
    scale = jnp.mean(jnp.diagonal(precision))
    root = jnp.linalg.cholesky(centred + scale * _means(precision, zero_mean))
    return PosteriorFactor(root, zero_mean, scale, jnp.max(jnp.sum(jnp.abs(centred), axis=0)))
