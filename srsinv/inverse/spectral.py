"""The spectral path: on a periodic line each wavenumber is a least-squares problem of its own.

The rows [N^(-1/2) G; P^(1/2)] are orthogonalised, for forming G^H N^-1 G + P would square the
condition number of two nearly equal elements.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from ..grid import half_spectrum_weights
from .line_problem import LineProblem
from .prior import Prior, Score, Solution


class OrthogonalFactor(NamedTuple):
    """Orthogonal factor Q of the stacked rows, and R^-1, at every wavenumber.

    A component that neither data nor prior determine has zeros in both.
    """

    q: Complex[Array, "m c k"]
    inverse: Complex[Array, "c c k"]
    determined: Bool[Array, "c k"]
    condition: Float[Array, ""]


@jax.jit
def solve(problem: LineProblem, prior: Prior) -> Solution:
    """Posterior of the traction on a periodic line with every sample valid.

    The condition number is that of the rows, over all wavenumbers, in Frobenius' norm.
    """
    n, elements = problem.line.n, problem.data.shape[0]
    factor = factorise(problem, prior)
    top = factor.q[:elements].conj()
    data = problem.whitener * jnp.fft.rfft(problem.data)
    value = jnp.einsum("ijk,ejk,ek->ik", factor.inverse, top, data)
    resolution = resolution_of(problem, factor)
    covariance = jnp.einsum("ijk,ljk->ilk", factor.inverse, factor.inverse.conj())
    return Solution(
        jnp.fft.irfft(value, n),
        stationary_stderr(factor, n),
        covariance,
        jnp.roll(jnp.fft.irfft(resolution, n), n // 2, axis=-1),
        resolved_degrees_of_freedom(resolution, n),
        factor.condition,
    )


@jax.jit
def score(problem: LineProblem, prior: Prior) -> Score:
    """The prior's score; an open line is taken as the nearest periodic one, gaps as zeros."""
    n, elements = problem.line.n, problem.data.shape[0]
    weights = half_spectrum_weights(n)
    data = problem.whitener * jnp.fft.rfft(problem.data)
    factor = factorise(problem, prior)
    top = factor.q[:elements]
    explained = jnp.einsum("eck,ek->ck", top.conj(), data)
    residual = jnp.sum(weights * jnp.abs(data - jnp.einsum("eck,ck->ek", top, explained)) ** 2)
    freedom = n * jnp.sum(weights * jnp.abs(top) ** 2)
    # log det(G S G^H + N) less its part without G, from the diagonals of R and of P^(1/2); a mode
    # that the prior leaves free has no proper evidence and is left out.
    root = prior.root(problem.line)
    diagonal = jnp.abs(jnp.einsum("cck->ck", factor.inverse))
    proper = factor.determined & (root > 0)
    log_ratio = jnp.where(proper, jnp.log(jnp.where(proper, diagonal * root, 1.0)), 0.0)
    square = jnp.sum(jnp.abs(data) ** 2, axis=0) - jnp.sum(jnp.abs(explained) ** 2, axis=0)
    evidence = n * jnp.sum(weights * jnp.sum(log_ratio, axis=0)) - jnp.sum(weights * square) / 2
    return Score(residual, freedom, evidence)


def factorise(problem: LineProblem, prior: Prior) -> OrthogonalFactor:
    """Orthogonalise [N^(-1/2) G; P^(1/2)] of the nearest periodic problem, column by column."""
    forward = problem.forward.circulant().transfer * problem.whitener
    penalty = jnp.eye(problem.unknowns)[..., None] * prior.root(problem.line)
    rows = jnp.concatenate([forward, penalty.astype(forward.dtype)])
    keep = jnp.ones(rows.shape[1:], bool).at[:, 0].set(~problem.zero_mean)
    return _gram_schmidt(jnp.where(keep, rows, 0.0))


def resolution_of(problem: LineProblem, factor: OrthogonalFactor) -> Complex[Array, "c c k"]:
    """Resolution matrix of the nearest periodic problem, for each wavenumber."""
    forward = problem.forward.circulant().transfer * problem.whitener
    top = factor.q[: forward.shape[0]].conj()
    return jnp.einsum("ijk,ejk,edk->idk", factor.inverse, top, forward)


def resolved_degrees_of_freedom(resolution: Complex[Array, "c c k"], n: int) -> Float[Array, " c"]:
    """Effective degrees of freedom of each component: the resolution's trace over n cells."""
    return n * jnp.einsum("iik,k->i", resolution, half_spectrum_weights(n)).real


def stationary_stderr(factor: OrthogonalFactor, n: int) -> Float[Array, "c n"]:
    """Posterior standard error, the same in every cell of a periodic line."""
    weights = half_spectrum_weights(n)
    variance = jnp.einsum("ick,ick,k->i", factor.inverse, factor.inverse.conj(), weights).real
    return jnp.broadcast_to(jnp.sqrt(variance)[:, None], (variance.size, n))


def _gram_schmidt(rows: Complex[Array, "m c k"]) -> OrthogonalFactor:
    size = rows.shape[1]
    zero = jnp.zeros_like(rows[0, 0])
    r = [[zero] * size for _ in range(size)]
    inverse = [[zero] * size for _ in range(size)]
    columns, determined = [], []
    for j in range(size):
        column = rows[:, j]
        original = jnp.sum(jnp.abs(column) ** 2, axis=0)
        for _ in range(2):  # the second sweep restores the orthogonality that the first one loses
            for i, q in enumerate(columns):
                overlap = jnp.sum(q.conj() * column, axis=0)
                column = column - q * overlap
                r[i][j] = r[i][j] + overlap
        left = jnp.sum(jnp.abs(column) ** 2, axis=0)
        known = left > (8 * jnp.finfo(left.dtype).eps) ** 2 * original
        length = jnp.sqrt(jnp.where(known, left, 1.0))
        columns.append(jnp.where(known, column / length, 0.0))
        determined.append(known)
        # Column j of R^-1 by back-substitution.
        inverse[j][j] = jnp.where(known, 1 / length, 0.0).astype(rows.dtype)
        for i in range(j):
            total = sum((inverse[i][m] * r[m][j] for m in range(i, j)), zero)
            inverse[i][j] = -total * inverse[j][j]
    whole = jnp.stack([jnp.stack(row) for row in inverse])
    return OrthogonalFactor(
        jnp.stack(columns, axis=1), whole, jnp.stack(determined), _size(rows) * _size(whole)
    )


def _size(matrices: Complex[Array, "a b k"]) -> Float[Array, ""]:
    """The largest Frobenius norm over the wavenumbers; without a derivative."""
    return jax.lax.stop_gradient(jnp.max(jnp.linalg.norm(matrices, axis=(0, 1))))
