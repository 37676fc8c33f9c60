"""The posterior as a function of arrays: under jit, vmap, grad and jvp, without checks.

`jax.grad` of an inversion learns a prior, its weights or the sensor from the error of a task. A
method called so gives the same value and bands as one called with known numbers. What its checks
would say is not known then, and a warning says that they were left out.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...modules import with_fields
from ...status import Status
from .. import diagnostics
from ..estimate import COMPONENTS, Numbers, TractionEstimate
from . import direct, implicit, spectral
from .model import CHI2, FREEDOM, EstimateParts
from .prior import Prior, Solution
from .problem import LineProblem
from .rig_bands import with_rig_errors

# Condition numbers up to which a solution is accepted: beyond these, errors of 1 % and more occur,
# some 70 times the condition's round-off.
TRUSTED = {"float64": 6e11, "float32": 1.7e4}


class Posterior(NamedTuple):
    """A solution, what the estimate shows of it, the errors by the rig (None: it is exact), and the
    degrees of freedom that went to the problem's nuisance."""

    solution: Solution
    parts: EstimateParts
    rig_errors: Float[Numbers, "k c n"] | None
    nuisance_dof: Float[Array, ""]


def posterior(problem: LineProblem, prior: Prior, path: str, tolerance: float) -> Posterior:
    """The posterior by this path, to a relative tolerance on the iterative one; NaN where the
    system is too ill-conditioned for its precision."""
    if path == "direct":
        return _direct(problem, prior)
    if path == "iterative":
        solution = implicit.solve((problem, prior), tolerance)
        return _iterative(problem, solution)
    solution = spectral.solve(problem, prior)
    parts = problem.estimate_parts(solution.value, solution.stderr)
    return Posterior(solution, parts, _rig_errors(problem, solution, None), jnp.zeros(()))


def _iterative(problem: LineProblem, solution: Solution) -> Posterior:
    left = problem.data - problem.forward(solution.value)
    residual = implicit.Residual.of(problem, left)
    cleaned = with_fields(problem, data=problem.data - residual.signal, nuisance=None)
    parts = cleaned.estimate_parts(solution.value, solution.stderr)
    fitted, squares = parts.fitted + residual.signal, residual.squares(left)
    parts = parts._replace(fitted=fitted, squares=squares)
    return Posterior(solution, parts, solution.rig_errors, residual.dof)


def _direct(problem: LineProblem, prior: Prior) -> Posterior:
    white = direct.whiten(problem)
    solution = direct.solve(problem, prior, white)
    is_trusted = solution.condition < TRUSTED[problem.data.dtype.name]
    factor = jnp.where(is_trusted, 1.0, jnp.nan)
    solution = solution._replace(value=factor * solution.value, stderr=factor * solution.stderr)
    moved = _rig_errors(problem, solution, white)
    left = white.data - white.model @ solution.value.ravel()
    squares, dof = left @ left, jnp.zeros(())
    if problem.nuisance is None:
        parts = problem.estimate_parts(solution.value, solution.stderr)
        return Posterior(solution, parts._replace(squares=squares), moved, dof)
    # The residual is weighed by the noise with the columns in it, of the covariance R + C C^T. The
    # expected sizes are s = C^T (R + C C^T)^-1 y, and what they leave has the square
    # y^T (R + C C^T)^-1 y - s^T s under R alone.
    sizes = jnp.einsum("eni,en->ei", white.nuisance, left.reshape(problem.data.shape))
    signal = jnp.einsum("ein,ei->en", jnp.asarray(problem.nuisance), sizes)
    signal = signal if problem.observed is None else jnp.where(problem.observed, signal, 0.0)
    cleaned = with_fields(problem, data=problem.data - signal, nuisance=None)
    parts = cleaned.estimate_parts(solution.value, solution.stderr)
    squares = squares - jnp.sum(sizes**2)
    parts = parts._replace(fitted=parts.fitted + signal, squares=squares)
    return Posterior(solution, parts, moved, jnp.sum(white.nuisance**2))


def _rig_errors(
    problem: LineProblem, solution: Solution, white: direct.Whitened | None
) -> Float[Array, "k c n"] | None:
    """The changes of the solution by one standard deviation of the rig."""
    if problem.rig_changes is None:
        return None
    changes = jnp.asarray(problem.rig_signals(solution.value))
    if white is not None:
        columns = direct.whiten(problem, changes).changes
        moved = solution.covariance @ (white.model.T @ columns)
        return moved.T.reshape(-1, *solution.value.shape)
    n, weights = problem.line.n, jnp.asarray(problem.whitener) ** 2
    right = jax.vmap(problem.forward.adjoint)(jnp.fft.irfft(jnp.fft.rfft(changes) * weights, n))
    spectra = jnp.einsum("cdk,jdk->jck", solution.covariance, jnp.fft.rfft(right))
    return jnp.fft.irfft(spectra, n)


def pure_estimate(
    problem: LineProblem,
    prior: Prior,
    how: tuple[str, float],
    stats: Mapping[str, Any],
    warnings: Sequence[str],
) -> TractionEstimate:
    """The estimate of a problem or a prior that jax traces; `how`: the path and its tolerance."""
    found = posterior(problem, prior, *how)
    solution, parts = found.solution, found.parts
    stderr = parts.stderr
    if found.rig_errors is not None:
        stderr = with_rig_errors(problem, stderr, found.rig_errors)
    names = COMPONENTS[: problem.unknowns]
    resolved = {f"resolved_dof_{name}": solution.resolved_dof[c] for c, name in enumerate(names)}
    taken = jnp.sum(solution.resolved_dof) + found.nuisance_dof
    is_free = ~jnp.all(jnp.isfinite(jnp.asarray(problem.noise)[:, 0]))
    freedom = problem.sample_count - jnp.where(is_free, problem.data.shape[0], 0) - taken
    chi2 = jnp.where(freedom >= 1, parts.squares / jnp.maximum(freedom, 1.0), jnp.nan)
    further = {"condition": solution.condition, **resolved, CHI2: chi2, FREEDOM: freedom}
    return TractionEstimate(
        line=problem.line,
        value=parts.value,
        stderr=stderr,
        fitted=parts.fitted,
        whitened=parts.whitened,
        covariance=solution.covariance,
        mean_weights=jnp.asarray(problem.mean_weights),
        averaging=solution.averaging,
        friction=problem.friction,
        rig_errors=found.rig_errors,
        mean_unobserved=problem.mean_unobserved,
        signal_unit=problem.signal_unit,
        status=Status.CONVERGED,
        warnings=(*warnings, *diagnostics.unchecked()),
        stats={**stats, "path": how[0], **further},
    )
