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
from .rig_bands import times_covariance, with_rig_errors

# Condition numbers up to which a solution is accepted: beyond these, errors of 1 % and more occur,
# some 70 times the condition's round-off.
TRUSTED = {"float64": 6e11, "float32": 1.7e4}


class PurePosterior(NamedTuple):
    """A solution, what the estimate shows of it, the errors by the rig (None: it is exact), and the
    degrees of freedom that went to the problem's nuisance."""

    solution: Solution
    parts: EstimateParts
    rig_errors: Float[Numbers, "k c n"] | None
    nuisance_dof: Float[Array, ""]


def posterior(problem: LineProblem, prior: Prior, path: str, tolerance: float) -> PurePosterior:
    """The posterior by this path, to a relative tolerance on the iterative one; NaN where the
    system is too ill-conditioned for its precision."""
    if path == "iterative":
        solution = implicit.solve((problem, prior), tolerance)
    elif path == "spectral":
        solution = spectral.solve(problem, prior)
    else:
        solution = direct.solve(problem, prior, direct.whiten(problem))
        is_trusted = solution.condition < TRUSTED[problem.data.dtype.name]
        factor = jnp.where(is_trusted, 1.0, jnp.nan)
        value, stderr = factor * solution.value, factor * solution.stderr
        solution = solution._replace(value=value, stderr=stderr)
    left = problem.data - problem.forward(solution.value)
    residual = implicit.Residual.of(problem, left)
    cleaned = with_fields(problem, data=problem.data - residual.signal, nuisance=None)
    parts = cleaned.estimate_parts(solution.value, solution.stderr)
    fitted, squares = parts.fitted + residual.signal, residual.squares(left)
    parts = parts._replace(fitted=fitted, squares=squares)
    return PurePosterior(solution, parts, _rig_errors(problem, solution), residual.dof)


def _rig_errors(problem: LineProblem, solution: Solution) -> Float[Numbers, "k c n"] | None:
    """The changes of the solution by one standard deviation of the rig."""
    if problem.rig_changes is None or solution.rig_errors is not None:
        return solution.rig_errors

    def gathered(y: Float[Array, "e n"]) -> Float[Array, "c n"]:
        return problem.forward.adjoint(implicit.Residual.of(problem, y).weighed)

    changes = jnp.asarray(problem.rig_signals(solution.value))
    return times_covariance(solution, jax.vmap(gathered)(changes))


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
        rig_sources=problem.rig_sources,
        mean_unobserved=problem.mean_unobserved,
        signal_unit=problem.signal_unit,
        status=Status.CONVERGED,
        warnings=(*warnings, *diagnostics.unchecked()),
        stats={**stats, "path": how[0], **further},
    )
