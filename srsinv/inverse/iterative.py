"""The iterative path: conjugate gradients (lineax) on the normal equations, matrix-free.

It serves lines of any length, with samples missing where the noise is white. The solution of the
nearest periodic problem is its preconditioner, and gives its standard error.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from . import spectral
from .line_problem import LineProblem
from .prior import Prior, Solution


class NormalEquations(eqx.Module):
    """(G^T N^-1 G + P) r = G^T N^-1 m, on traction whose known means are taken out."""

    problem: LineProblem
    prior: Prior
    factor: spectral.OrthogonalFactor

    def __call__(self, r: Float[Array, "c n"]) -> Float[Array, "c n"]:
        r = self.centre(r)
        problem = self.problem
        return self.right_side(problem.forward(r)) + self.centre(self.prior.apply(problem.line, r))

    def right_side(self, y: Float[Array, "e n"]) -> Float[Array, "c n"]:
        """G^T N^-1 y."""
        return self.centre(self.problem.forward.adjoint(self._weigh(y)))

    def precondition(self, r: Float[Array, "c n"]) -> Float[Array, "c n"]:
        """The posterior covariance of the nearest periodic problem, applied to r."""
        inverse = self.factor.inverse
        # A mode that the periodic problem does not determine still has to move: it takes the
        # largest step that any other mode of its component takes.
        largest = jnp.max(jnp.sum(jnp.abs(inverse) ** 2, axis=1), axis=-1)[:, None]
        spectrum = jnp.fft.rfft(r)
        step = jnp.einsum("ijk,ljk,lk->ik", inverse, inverse.conj(), spectrum)
        step = jnp.where(self.factor.determined, step, largest * spectrum)
        return self.centre(jnp.fft.irfft(step, self.problem.line.n))

    def centre(self, r: Array) -> Array:
        """Project out the means that are not solved for."""
        mean = r.mean(axis=-1, keepdims=True)
        return r - jnp.where(self.problem.zero_mean[:, None], mean, 0.0)

    def _weigh(self, y: Array) -> Array:
        problem = self.problem
        if problem.observed is None:
            return jnp.fft.irfft(jnp.fft.rfft(y) * problem.whitener**2, problem.line.n)
        # White noise: the last wavenumber gives its level.
        y = y - problem.free_offset(y)
        return jnp.where(problem.observed, y, 0.0) * problem.whitener[-1] ** 2


@eqx.filter_jit
def solve(problem: LineProblem, prior: Prior, tolerance: Float[Array, ""]):
    """Posterior mean by conjugate gradients to a relative `tolerance`, its standard error from the
    nearest periodic problem: the solution, the steps taken, and whether it converged."""
    factor = spectral.factorise(problem, prior)
    normal = NormalEquations(problem, prior, factor)
    n = problem.line.n
    unknowns = problem.unknowns
    impulses = jnp.eye(unknowns)[:, :, None] * (jnp.arange(n) == n // 2)
    signals = jnp.concatenate([problem.data[None], jax.vmap(problem.forward)(impulses)])
    right = jax.vmap(normal.right_side)(signals)
    solutions, steps, fine = jax.vmap(lambda b: _conjugate_gradients(normal, b, tolerance))(right)
    value, averaging = solutions[0], solutions[1:].swapaxes(0, 1)
    # As of the nearest periodic problem, over the cells that have samples.
    resolved_dof = spectral.resolved_degrees_of_freedom(spectral.resolution_of(problem, factor), n)
    if problem.observed is not None:
        resolved_dof = resolved_dof * jnp.mean(jnp.any(problem.observed, axis=0))
    covariance = jnp.einsum("ijk,ljk->ilk", factor.inverse, factor.inverse.conj())
    if not problem.forward.is_circular:  # of the deviation from the mean, as on the direct path
        factor = factor._replace(inverse=factor.inverse.at[..., 0].set(0.0))
    stderr = spectral.stationary_stderr(factor, n)
    size = _condition(problem, prior)
    return (
        Solution(value, stderr, covariance, averaging, resolved_dof, size),
        steps[0],
        jnp.all(fine),
    )


def _condition(problem: LineProblem, prior: Prior) -> Float[Array, ""]:
    """Estimate of the condition number: the best observed mode over one held by the prior alone.

    Where samples are missing, or an open line ends, some traction is held by the prior alone, with
    its mean precision over wavenumbers.
    """
    information = jnp.max(problem.information)
    held = jnp.mean(prior.root(problem.line) ** 2, axis=-1)
    return (information + jnp.max(held)) / jnp.maximum(jnp.min(held), jnp.finfo(held.dtype).tiny)


def _conjugate_gradients(normal: NormalEquations, right: Array, tolerance):
    # The solver's tolerances are absolute, so the equations are scaled to numbers about one. Scales
    # and preconditioner do not move the solution, which has no derivative by way of them.
    tiny = jnp.finfo(right.dtype).tiny
    fixed = jax.tree.map(jax.lax.stop_gradient, normal)
    size = jnp.maximum(jnp.max(jnp.abs(jax.lax.stop_gradient(right))), tiny)
    unit = jnp.maximum(jnp.max(jnp.abs(fixed.precondition(jax.lax.stop_gradient(right)))), tiny)
    structure = jax.eval_shape(lambda: right)

    def fixed_means(u):
        # Means that are not solved for answer by themselves: the equations are regular for any
        # right side, such as that behind a derivative.
        return u - fixed.centre(u)

    tag = lx.positive_semidefinite_tag
    solution = lx.linear_solve(
        lx.FunctionLinearOperator(
            lambda u: normal(u * unit) / size + fixed_means(u), structure, tag
        ),
        right / size,
        lx.CG(rtol=tolerance, atol=tolerance, max_steps=20 * right.shape[-1]),
        options={
            "preconditioner": lx.FunctionLinearOperator(
                lambda u: fixed.precondition(u * size) / unit + fixed_means(u), structure, tag
            )
        },
        throw=False,
    )
    fine = solution.result == lx.RESULTS.successful
    return solution.value * unit, solution.stats["num_steps"], fine
