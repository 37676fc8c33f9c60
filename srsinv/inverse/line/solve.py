"""The quadratic problem under Wiener's filter and Tikhonov's method, and its three paths.

- *spectral*: exact and quickest; a periodic line with every sample valid.
- *direct*: exact; any line, any missing samples, any noise; up to a few thousand unknowns.
- *iterative*: conjugate gradients; any line, any missing samples, any noise, any length. Its
  standard error is within 3 % of the direct one's, and a rule weighs by the nearest periodic
  problem with the same samples missing.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...errors import refuse
from ...known import in_jax, is_traced
from ...status import Status
from .. import diagnostics
from ..estimate import COMPONENTS, Estimate, TractionEstimate
from . import direct, iterative
from .answer import CheckedSolution, Runs, answer_of, spectral_answer
from .model import chi2
from .prior import Prior, Solution
from .problem import LineProblem
from .pure import TRUSTED, pure_estimate
from .rig_bands import rig_errors, with_rig_errors
from .shared import decorrelated

DIRECT_LIMIT, AUTO_LIMIT = 4096, 1024  # unknowns: more are refused, and not chosen
RAISED = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0)  # decades, by which chosen weights are raised
PATHS = ("auto", "spectral", "direct", "iterative")


def solve(
    problem: LineProblem,
    prior: Prior,
    path: str = "auto",
    tolerance: float = 1e-10,
    *,
    stats: Mapping[str, Any] = MappingProxyType({}),
    warnings: Sequence[str] = (),
) -> TractionEstimate:
    """Posterior mean and standard error of the traction.

    `path` is one of `PATHS`; `tolerance` is the relative tolerance of the iterative one; `stats`
    and `warnings` are what the estimate has besides. Raises `BadInput` for a path that is unknown
    or does not serve this problem.
    """
    if problem.shared_noise is not None:
        how = prior, path, tolerance
        made = solve(decorrelated(problem), *how, stats=stats, warnings=warnings)
        return made.of_elements(problem.shared_noise.to_elements)
    given, problem = problem.warnings, problem.without_warnings()
    path = choose_path(problem, path)
    if is_traced(problem, prior):
        return pure_estimate(problem, prior, (path, tolerance), stats, (*given, *warnings))
    stats = {**stats, "path": path}
    status, eps = Status.CONVERGED, float(jnp.finfo(problem.data.dtype).eps)
    if path == "spectral":
        answer = spectral_answer(problem, prior)
    elif path == "direct":
        solution = direct.solve(problem, prior, direct.whiten(problem))
        status = _trusted(solution, TRUSTED[problem.data.dtype.name])
        answer = answer_of(problem, prior, solution)
    else:
        tolerance = max(tolerance, 100 * eps)  # round-off allows no less
        solution, steps, converged, defect = iterative.solve(problem, prior, tolerance)
        stats |= {"iterations": steps, "tolerance": tolerance}
        warnings = (*warnings, *diagnostics.rough_bands(defect))
        if not converged:
            status = Status.STEP_LIMIT
        elif not problem.separable:
            status = _trusted(solution, iterative.TRUSTED)
        answer = answer_of(problem, prior, solution)
    return _estimate(problem, answer, status, stats, (given, warnings))


def conditioned(attempt: Callable[[float], Estimate]) -> Estimate:
    """The estimate whose weights are raised by the fewest decades that `attempt` solves: rounding
    bounds how weak a prior may be, and a recording is to have an answer."""
    first, *others = RAISED
    decades, estimate = first, attempt(first)
    for more in others:
        if estimate.status not in (Status.ILL_CONDITIONED, Status.STEP_LIMIT):
            break
        decades, estimate = more, attempt(more)
    return estimate.with_warnings(diagnostics.raised_weights(decades))


def _trusted(solution: Solution, most: float) -> Status:
    is_trusted = float(solution.condition) < most
    return Status.CONVERGED if is_trusted else Status.ILL_CONDITIONED


def choose_path(problem: LineProblem, path: str) -> str:
    """The path that `path` names for this problem."""
    refuse(path not in PATHS, f"path is {path!r}: give one of {', '.join(PATHS)}.")
    whole = problem.separable
    size = problem.unknowns * problem.line.n
    if path == "auto":
        path = "spectral" if whole else "direct" if size <= AUTO_LIMIT else "iterative"
    refuse(
        path == "spectral" and not whole,
        "path=spectral needs grid.line=periodic without missing samples: give path=auto.",
    )
    refuse(
        path == "direct" and size > DIRECT_LIMIT,
        f"path=direct would factor {size} unknowns, more than {DIRECT_LIMIT}: give "
        "wider cells or path=iterative.",
    )
    return path


def _estimate(
    problem: LineProblem,
    answer: CheckedSolution,
    status: Status,
    stats: dict,
    warnings: tuple[Sequence[str], Sequence[str]],
) -> TractionEstimate:
    """The estimate; `warnings` are those before its own and after."""
    solution, moved = answer.solution, rig_errors(problem, answer.solution)
    if moved is not None:
        stderr = with_rig_errors(problem, answer.parts.stderr, moved)
        answer = answer._replace(parts=answer.parts._replace(stderr=stderr))
    parts = answer.parts
    stats["condition"] = float(solution.condition)
    if not (np.isfinite(parts.value).all() and np.isfinite(parts.stderr).all()):
        status = Status.NOT_FINITE
    names, resolved_dof = COMPONENTS[: problem.unknowns], np.asarray(solution.resolved_dof, float)
    stats |= {f"resolved_dof_{name}": float(t) for name, t in zip(names, resolved_dof, strict=True)}
    taken = float(resolved_dof.sum()) + answer.nuisance_dof
    stats |= chi2(problem, taken, float(parts.squares))
    return TractionEstimate(
        line=problem.line,
        **in_jax(
            {
                "value": parts.value,
                "stderr": parts.stderr,
                "fitted": parts.fitted,
                "whitened": parts.whitened,
                "covariance": solution.covariance,
                "mean_weights": problem.mean_weights,
                "averaging": solution.averaging,
                "rig_errors": moved,
            }
        ),
        rig_sources=problem.rig_sources,
        friction=problem.friction,
        mean_unobserved=problem.mean_unobserved,
        signal_unit=problem.signal_unit,
        status=status,
        warnings=(*warnings[0], *_warnings(problem, answer, stats), *warnings[1]),
        stats=stats,
    )


def _warnings(problem: LineProblem, answer: CheckedSolution, stats: dict) -> tuple[str, ...]:
    solution, parts, checks = answer.solution, answer.parts, answer.checks
    resolved_dof, noise = np.asarray(solution.resolved_dof, float), np.asarray(problem.noise)
    columns = COMPONENTS[: problem.unknowns], resolved_dof, *checks[:3]
    each = list(zip(*columns, strict=True))
    largest = float(np.max(np.abs(np.asarray(problem.data) + np.asarray(problem.mean_signal))))
    is_any = resolved_dof.sum() >= diagnostics.LEAST_RESOLVED_DOF
    n = problem.line.n
    p, p_stderr = (np.asarray(of)[0, problem.observed_cells] for of in (parts.value, parts.stderr))
    has_level = problem.known_mean_Pa[0] is not None and problem.background_Pa[0] is not None
    return (
        *(diagnostics.shared_out(checks.difference_dof) if is_any else ()),
        *(s for name, t, _, part, _ in each for s in diagnostics.prior_alone(name, t, n, part)),
        *(s for name, t, pull, _, _ in each for s in diagnostics.pulled_by_prior(name, pull, t)),
        *(s for name, *_, least in each for s in diagnostics.unresolved_waves(name, least)),
        *_within_runs(checks.runs, resolved_dof / n),
        *(diagnostics.negative_pressure(p, p_stderr, resolved_dof[0]) if has_level else ()),
        *diagnostics.beyond_modulus(p, p_stderr, problem.modulus_Pa, resolved_dof[0]),
        *diagnostics.unchecked_residual(stats["chi2_per_freedom"]),
        *diagnostics.residual_over_noise(stats["chi2_per_freedom"], stats["degrees_of_freedom"]),
        *diagnostics.below_rounding(float(np.sqrt(noise.min())), largest, noise.dtype),
        *diagnostics.missing(_missing(problem)),
    )


def _within_runs(runs: Runs | None, resolved: Float[np.ndarray, " c"]) -> Sequence[str]:
    """Warning on components of which so much is `resolved` of a cell, in runs without a sample."""
    if runs is None:
        return ()
    each = zip(COMPONENTS, runs.cells * resolved, runs.observed, runs.of_prior, strict=False)
    return tuple(
        s
        for name, *of in each
        for s in diagnostics.changing_in_runs(name, *of, run_m=runs.length_m, lengths=runs.lengths)
    )


def _missing(problem: LineProblem) -> float:
    """The fraction of samples missing between the first and the last cell that has any."""
    if problem.observed is None:
        return 0.0
    observed = np.asarray(problem.observed)
    cells = np.flatnonzero(observed.any(axis=0))
    return float(1 - observed[:, cells[0] : cells[-1] + 1].mean())
