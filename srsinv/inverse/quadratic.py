"""The quadratic problem under Wiener's filter and Tikhonov's method, and its three paths.

- *spectral*: exact and quickest; a periodic line with every sample valid.
- *direct*: exact; any line, any missing samples, any noise; up to a few thousand unknowns.
- *iterative*: conjugate gradients; any line, any missing samples, any noise, any length. Its
  standard error is within 1 % of the direct one's, and a rule weighs by the nearest periodic
  problem with the same samples missing.
"""

import abc
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..errors import refuse
from ..grid import half_spectrum_weights
from ..status import Status
from . import diagnostics, direct, iterative, near_periodic, spectral
from .estimate import COMPONENTS, TractionEstimate
from .gaps import Gaps
from .line_model import Shown
from .line_problem import LineProblem
from .prior import Prior, Score, Solution

DIRECT_LIMIT, AUTO_LIMIT = 4096, 1024  # unknowns: more are refused, and not chosen
# Condition numbers up to which a solution is accepted: beyond these, errors of 1 % and more occur,
# some 70 times the condition's round-off. The iterative path is in double precision.
TRUSTED = {"float64": 6e11, "float32": 1.7e4}
TRUSTED_ITERATIVE = 6e11
PATHS = ("auto", "spectral", "direct", "iterative")


def solve(
    problem: LineProblem, prior: Prior, path: str = "auto", tolerance: float = 1e-10
) -> TractionEstimate:
    """Posterior mean and standard error of the traction.

    `path` is one of `PATHS`; `tolerance` is the relative tolerance of the iterative one. Raises
    `BadInput` for a path that is unknown or does not serve this problem.
    """
    path = choose_path(problem, path)
    stats: dict = {"path": path}
    status, eps = Status.CONVERGED, float(jnp.finfo(problem.data.dtype).eps)
    if path == "spectral":
        solution = spectral.solve(problem, prior)
    elif path == "direct":
        solution = direct.solve(problem, prior, direct.whiten(problem))
        status = _trusted(solution, TRUSTED[problem.data.dtype.name])
    else:
        tolerance = max(tolerance, 100 * eps)  # round-off allows no less
        solution, steps, converged = iterative.solve(problem, prior, tolerance)
        stats |= {"iterations": steps, "tolerance": tolerance}
        if not converged:
            status = Status.STEP_LIMIT
        elif not problem.separable:
            status = _trusted(solution, TRUSTED_ITERATIVE)
    stats["condition"] = float(solution.condition)
    return _estimate(problem, prior, solution, status, stats)


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
        "path=spectral needs a periodic line with no sample missing: use path=auto.",
    )
    refuse(
        path == "direct" and size > DIRECT_LIMIT,
        f"path=direct would factor {size} unknowns, more than {DIRECT_LIMIT}: use wider cells or "
        f"path=iterative.",
    )
    return path


class Family(eqx.Module):
    """A family of priors, by their log10 weights, for a rule to choose from."""

    @abc.abstractmethod
    def __call__(self, log_weights: Float[Array, " c"]) -> Prior:
        """The prior with these weights."""


class Scorer(eqx.Module):
    """Scores of a family's priors, by the path that will solve the problem."""

    family: Family
    problem: LineProblem
    white: direct.Whitened | None
    has_gaps: bool = eqx.field(static=True)

    def __init__(self, family: Family, problem: LineProblem, path: str):
        path = choose_path(problem, path)
        self.family, self.problem = family, problem
        self.white = direct.whiten(problem) if path == "direct" else None
        self.has_gaps = path == "iterative" and problem.observed is not None

    def __call__(self, log_weights: Float[Array, "b c"]) -> Score:
        """One score for each row of log10 weights."""
        if not self.has_gaps:
            return _scores(self, log_weights)
        gaps = Gaps.of(self.problem.is_observed)
        scores = [near_periodic.score(self.problem, self.family(w), gaps) for w in log_weights]
        return Score(*(jnp.asarray(np.array(terms)) for terms in zip(*scores, strict=True)))


@eqx.filter_jit
def _scores(scorer: Scorer, log_weights: Float[Array, "b c"]) -> Score:
    problem, white = scorer.problem, scorer.white
    if white is None:
        return jax.vmap(lambda logs: spectral.score(problem, scorer.family(logs)))(log_weights)
    return jax.lax.map(lambda logs: direct.score(problem, scorer.family(logs), white), log_weights)


def _estimate(
    problem: LineProblem, prior: Prior, solution: Solution, status: Status, stats: dict
) -> TractionEstimate:
    shown, finite, against = _shown(problem, prior, solution)
    if not bool(finite):
        status = Status.NOT_FINITE
    names, resolved_dof = COMPONENTS[: problem.unknowns], np.asarray(solution.resolved_dof, float)
    stats |= {f"resolved_dof_{name}": float(t) for name, t in zip(names, resolved_dof, strict=True)}
    stats |= problem.chi2(resolved_dof.sum(), float(shown.squares))
    return TractionEstimate(
        line=problem.line,
        value=shown.value,
        stderr=shown.stderr,
        fitted=shown.fitted,
        whitened=shown.whitened,
        covariance=solution.covariance,
        mean_weights=problem.mean_weights,
        averaging=solution.averaging,
        friction=problem.friction,
        status=status,
        warnings=_warnings(problem, prior, solution, shown, against, stats),
        stats=stats,
    )


class _AgainstPrior(NamedTuple):
    """Of each component (c,): the prior's pull on the estimate, squared, over its variance; and the
    fraction of the prior's variance that the signal explains."""

    pull: Float[Array, " c"]
    explained: Float[Array, " c"]


def _warnings(
    problem: LineProblem,
    prior: Prior,
    solution: Solution,
    shown: Shown,
    against: _AgainstPrior,
    stats: dict,
) -> tuple[str, ...]:
    resolved_dof, noise = np.asarray(solution.resolved_dof, float), np.asarray(problem.noise)
    averaging = np.einsum("ccn->cn", np.asarray(solution.averaging))
    shortest = np.abs(np.fft.rfft(averaging.astype(float)))[:, -1]
    pull, explained = (np.asarray(of, float) for of in against)
    columns = COMPONENTS[: problem.unknowns], resolved_dof, pull, explained, shortest
    each = list(zip(*columns, strict=True))
    largest = float(np.max(np.abs(np.asarray(problem.data) + np.asarray(problem.mean_signal))))
    shared, n = (), problem.line.n
    if problem.unknowns > 1 and resolved_dof.sum() >= diagnostics.LEAST_RESOLVED_DOF:
        gain, root = (np.asarray(part)[..., 1:] for part in _whitened_model(problem, prior))
        shared = diagnostics.shared_out(gain, root, n)
    return (
        *problem.warnings,
        *shared,
        *(s for name, t, _, part, _ in each for s in diagnostics.prior_alone(name, t, n, part)),
        *(s for name, t, pull, _, _ in each for s in diagnostics.pulled_by_prior(name, pull, t)),
        *(s for name, *_, least in each for s in diagnostics.unresolved_waves(name, least)),
        *_pulling(problem, shown, resolved_dof[0]),
        *diagnostics.residual_over_noise(stats["chi2_per_freedom"], stats["degrees_of_freedom"]),
        *diagnostics.below_rounding(float(np.sqrt(noise.min())), largest, noise.dtype),
        *diagnostics.missing(_missing(problem)),
    )


def _pulling(problem: LineProblem, shown: Shown, resolved_dof: float) -> Sequence[str]:
    """Warning on pressures below zero, where their level is known."""
    if problem.known_mean_Pa[0] is None or problem.background_Pa[0] is None:
        return ()
    p, stderr = (np.asarray(of)[0, problem.observed_cells] for of in (shown.value, shown.stderr))
    return diagnostics.negative_pressure(p, stderr, resolved_dof)


def _missing(problem: LineProblem) -> float:
    """The fraction of samples missing between the first and the last cell that has any."""
    if problem.observed is None:
        return 0.0
    observed = np.asarray(problem.observed)
    cells = np.flatnonzero(observed.any(axis=0))
    return float(1 - observed[:, cells[0] : cells[-1] + 1].mean())


@eqx.filter_jit
def _whitened_model(problem: LineProblem, prior: Prior):
    """The nearest periodic model over the noise (e, c, k), and the prior's root (c, k)."""
    return problem.forward.circulant().transfer * problem.whitener, prior.root(problem.line)


@eqx.filter_jit
def _shown(
    problem: LineProblem, prior: Prior, solution: Solution
) -> tuple[Shown, Bool[Array, ""], _AgainstPrior]:
    """What the estimate shows, whether all of it is finite, and what speaks against its prior."""
    value, stderr = solution.value, solution.stderr
    finite = jnp.all(jnp.isfinite(value)) & jnp.all(jnp.isfinite(stderr))
    return problem.show(value, stderr), finite, _against_prior(problem, prior, solution)


def _against_prior(problem: LineProblem, prior: Prior, solution: Solution) -> _AgainstPrior:
    """The prior's pull is C P r, C the posterior covariance: the estimate less what the data alone
    would have in its place, as far as they can tell. Over the cells with samples, less its mean."""
    line, covariance = problem.line, solution.covariance
    weighted = prior.apply(line, solution.value)
    if covariance.ndim == 3:
        pull = jnp.fft.irfft(jnp.einsum("ijk,jk->ik", covariance, jnp.fft.rfft(weighted)), line.n)
    else:
        pull = (covariance @ jnp.ravel(weighted)).reshape(weighted.shape)
    observed = jnp.ones(line.n, bool) if problem.observed is None else problem.observed.any(axis=0)
    count = jnp.maximum(jnp.sum(observed), 1)
    pull = pull - jnp.sum(pull * observed, axis=-1, keepdims=True) / count
    variance = jnp.sum(solution.stderr**2 * observed, axis=-1) / count
    squares = jnp.sum(pull**2 * observed, axis=-1) / count
    root = prior.root(line)[:, 1:]  # the mean aside, which many priors leave free
    powers = jnp.where(root > 0, 1 / jnp.where(root > 0, root, 1.0) ** 2, jnp.inf)
    of_prior = powers @ half_spectrum_weights(line.n)[1:]
    safe = jnp.where(variance > 0, variance, 1.0)
    return _AgainstPrior(squares / safe, 1 - variance / of_prior)
