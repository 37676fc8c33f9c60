"""The estimate under a constraint, from the Gaussian one: its most probable traction, and bands.

Bands are those of projected draws: each draw of the Gaussian posterior is replaced by the nearest
admissible traction, in the posterior's own metric (Everink, Dong and Andersen 2023, regularised
Gaussians). So a cell without contact has p = 0 with a probability above zero, as it is in a
contact. Draws of the Gaussian posterior that is truncated to p >= 0 never have p = 0. Over many
cells without contact they repel each other from it, and their 90 % bands then miss the truth nearly
everywhere.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...errors import refuse
from ...grid import half_spectrum_weights
from ...known import in_jax, is_traced
from ...status import Status
from .. import diagnostics
from ..constrained_estimate import ConstrainedEstimate
from ..estimate import TractionEstimate
from . import direct
from .constraint import Constraint
from .model import CHI2, FREEDOM, chi2, with_means
from .prior import Prior
from .problem import LineProblem
from .shared import decorrelated
from .solve import DIRECT_LIMIT
from .spectral import noise_whitener, prior_root, white_model
from .splitting import (
    Dense,
    GaussianPosterior,
    Penalised,
    PerWave,
    SplitMinimum,
    inverse_of_blocks,
    minimise,
)

TOLERANCE = 3e-2  # standard errors by which a cell of the estimate may be off
DRAW_TOLERANCE = 1e-1  # and of a draw, or of an estimate with edges
MOST_STEPS = 20_000
# Penalty to begin with, over the geometric mean of the extreme precisions: of 0.2 to 1 that with
# the fewest steps, half of those of 1, over six scenes of surfaces at 20 and 30 dB.
FIRST_PENALTY = 0.3
SEED = 0  # of the draws: the same problem has the same bands
# Precision of the Gaussian prior that is left beside edges, so that every wave has a prior: the
# jumps of 30 of its standard deviations that it still allows are left to the edges.
LEFT_OF_PRIOR = 1e-3


class Centred(NamedTuple):
    """A Gaussian posterior, its mean (c, n), the level (c, 1) [Pa] that makes it the whole
    traction, whether a component's mean is fixed, and the penalty of each to begin with."""

    posterior: GaussianPosterior
    mean: Float[Any, "c n"]
    level: Float[Any, "c 1"]
    is_fixed: Bool[Any, " c"]
    rho: Float[Any, " c"]


def constrained(
    problem: LineProblem, prior: Prior, estimate: TractionEstimate, constraint: Constraint
) -> TractionEstimate:
    """The estimate under the constraint, from that of the Gaussian prior.

    Where the constraint says nothing, for want of a known pressure, it is the Gaussian estimate
    with a warning. Raises `BadInput` for more unknowns than the direct path has, and for a known
    friction above the greatest one.
    """
    if not constraint.is_active or not estimate.status.is_answer:
        return estimate
    if problem.shared_noise is not None:
        made = constrained(decorrelated(problem), prior, estimate, constraint)
        is_same = made.fitted is estimate.fitted
        return made if is_same else made.of_elements(problem.shared_noise.to_elements)
    refuse(
        is_traced(problem, prior),
        f"{type(constraint).__name__} cannot be computed under jit, vmap or grad: call the method "
        "outside, or leave the constraint out.",
    )
    _check(problem, constraint)
    if constraint.bounds_pressure and not has_level(problem):
        return estimate.with_warnings(diagnostics.no_level())  # pyright: ignore[reportReturnType]
    with jax.enable_x64(True):
        best, draws = _solved(problem, prior, estimate, constraint)
        value, within = np.asarray(best.value), np.asarray(draws.value)
        parts = problem.estimate_parts(value[0], np.std(within, axis=0))
    whole = np.stack([with_means(problem, each, each)[0] for each in within])
    further = diagnostics.noise_alone() if constraint.laplace_order else ()
    is_solved = float(best.distance[0]) <= _tolerance(constraint)
    is_solved &= float(np.max(draws.distance)) <= DRAW_TOLERANCE
    status = Status.CONVERGED if is_solved else Status.STALLED
    return _estimate(problem, estimate.with_warnings(further), parts, whole, best, status)


def _tolerance(constraint: Constraint) -> float:
    """Of the estimate: edges take a hundred times as many steps."""
    return DRAW_TOLERANCE if constraint.laplace_order else TOLERANCE


def has_level(problem: LineProblem) -> bool:
    """Whether the whole pressure is known from the deviation that is solved for."""
    hidden = problem.forward.is_circular and problem.known_mean_Pa[0] is None
    return problem.background_Pa[0] is not None and not hidden


def _check(problem: LineProblem, constraint: Constraint) -> None:
    size, most = problem.unknowns * problem.line.n, constraint.greatest_friction
    refuse(
        not problem.separable and size > DIRECT_LIMIT,
        f"This prior would factor {size} unknowns, more than {DIRECT_LIMIT}: give wider cells or "
        "prior=gaussian.",
    )
    friction = problem.friction
    refuse(
        friction is not None and most is not None and abs(float(friction)) > most,
        f"friction is {friction}, but prior.friction_max is {most}: give a larger friction_max, or "
        "leave it out.",
    )


def _solved(
    problem: LineProblem, prior: Prior, estimate: TractionEstimate, constraint: Constraint
) -> tuple[SplitMinimum, SplitMinimum]:
    """The most probable traction, and projected draws."""
    share = LEFT_OF_PRIOR if constraint.laplace_order else 1.0
    centred = centred_posterior(problem, prior, constraint, share)
    posterior, mean = centred.posterior, jnp.asarray(centred.mean)[None]
    penalised = penalties(problem, prior, constraint, centred)
    best = minimise(posterior, mean, constraint, penalised, _tolerance(constraint), MOST_STEPS)
    key, of_rig = jax.random.split(jax.random.key(SEED))
    centres = mean + posterior.draw(key, constraint.draws)
    if estimate.rig_errors is not None:
        sizes = jax.random.normal(of_rig, (constraint.draws, len(estimate.rig_errors)))
        centres = centres + jnp.einsum("dj,jcn->dcn", sizes, jnp.asarray(estimate.rig_errors))
    return best, minimise(posterior, centres, constraint, penalised, DRAW_TOLERANCE, MOST_STEPS)


def penalties(
    problem: LineProblem, prior: Prior, constraint: Constraint, centred: Centred
) -> Penalised:
    """What is minimised over, with penalties to begin with."""
    order, rho = constraint.laplace_order, centred.rho
    split = np.zeros(len(rho))
    split[: 1 if constraint.greatest_friction is None else None] = constraint.bounds_pressure
    edges, edge_rho = np.zeros_like(rho), np.zeros_like(rho)
    if order:
        variance = difference_variance(problem, prior, order)
        edges = np.sqrt(2 / variance)
        edge_rho = 1 / variance
    numbers = centred.level, centred.is_fixed, edges, rho * split, edge_rho
    return Penalised(*map(jnp.asarray, numbers))


def difference_variance(problem: LineProblem, prior: Prior, order: int) -> Float[np.ndarray, " c"]:
    """The variance of each component's differences of this order under the Gaussian prior [Pa^2],
    waves aside that it leaves free."""
    line = problem.line
    roots = np.asarray(prior_root(line, prior), float)
    symbol = (2 * np.sin(np.asarray(line.k) * float(line.cell_m) / 2)) ** order
    power = np.divide(symbol**2, roots**2, where=roots > 0, out=np.zeros_like(roots))
    return power @ half_spectrum_weights(line.n)


def centred_posterior(
    problem: LineProblem, prior: Prior, constraint: Constraint, share: float = 1.0
) -> Centred:
    """The Gaussian posterior under this `share` of the prior's precision.

    Where friction bounds the shear, the level of q that nothing observes is free: it is normal, of
    the standard deviation of the greatest mean shear.
    """
    known = zip(problem.known_mean_Pa, problem.background_Pa, strict=True)
    levels = [sum(float(part) for part in pair if part is not None) for pair in known]
    level = np.array(levels[: problem.unknowns])[:, None]
    most, spread = constraint.greatest_friction, None
    if most is not None and problem.unknowns == 2 and _is_free(problem):
        spread = most * max(abs(levels[0]), np.finfo(float).tiny)
    waves = _per_wave(problem, prior, share, spread)
    variances = np.einsum("cck->ck", np.asarray(waves.covariance)).real[:, 1:]
    rho = FIRST_PENALTY / np.sqrt(variances.min(axis=1) * variances.max(axis=1))
    is_fixed = np.asarray(problem.zero_mean) & ((spread is None) | (np.arange(len(rho)) == 0))
    if problem.separable:
        data = np.fft.rfft(np.asarray(problem.data, float)) * noise_whitener(problem)
        right = np.einsum("eck,ek->ck", white_model(problem).conj(), data)
        mean = np.einsum("ijk,jk->ik", np.asarray(waves.covariance), right)
        return Centred(waves, np.fft.irfft(mean, problem.line.n), level, is_fixed, rho)
    posterior, mean = _dense(problem, prior, share, spread)
    return Centred(posterior, mean, level, is_fixed, rho)


def _is_free(problem: LineProblem) -> bool:
    """Whether the level of q is neither known nor observed."""
    known = problem.known_mean_Pa[1] is not None
    return not known and (bool(problem.zero_mean[1]) or problem.background_Pa[1] is None)


def _per_wave(problem: LineProblem, prior: Prior, share: float, spread: float | None) -> PerWave:
    """The posterior of the nearest periodic problem."""
    model, n = white_model(problem), problem.line.n
    root = np.asarray(prior_root(problem.line, prior), float)
    precision = np.einsum("eik,ejk->ijk", model.conj(), model)
    precision[range(len(root)), range(len(root))] += share * root**2
    is_solved = np.ones(root.shape, bool)
    is_solved[:, 0] = ~np.asarray(problem.zero_mean)
    if spread is not None and not is_solved[1, 0]:
        is_solved[1, 0] = True
        precision[:, 1, 0] = precision[1, :, 0] = 0.0
        precision[1, 1, 0] = 1 / (n * spread**2)
    precision = np.where(is_solved[:, None] & is_solved, precision, 0.0)
    # The last wavenumber of an even line has a real traction.
    if n % 2 == 0:
        precision[..., -1] = np.real(precision[..., -1])
    blocks, solved = jnp.asarray(precision), jnp.asarray(is_solved)
    return PerWave(
        line=problem.line,
        precision=blocks,
        covariance=inverse_of_blocks(blocks, solved),
        is_solved=solved,
    )


def _dense(
    problem: LineProblem, prior: Prior, share: float, spread: float | None
) -> tuple[Dense, Float[np.ndarray, "c n"]]:
    """The posterior by dense matrices, and its mean."""
    of = direct.scored(problem, prior)
    precision = np.asarray(of.information, float) + share * np.asarray(of.penalty, float)
    zero_mean, n = np.asarray(problem.zero_mean), problem.line.n
    means = np.kron(np.diag(zero_mean), np.full((n, n), 1 / n))
    off = np.eye(len(precision)) - means
    precision = off @ precision @ off
    scale = np.mean(np.diag(precision))
    inverse = np.linalg.inv(np.linalg.cholesky(precision + scale * means))
    covariance = inverse.T @ inverse - means / scale
    right = off @ np.asarray(of.white.model.T @ of.white.data.ravel(), float)
    mean, root, is_free = covariance @ right, off @ inverse.T, ~zero_mean
    if spread is not None:
        along = np.repeat(np.arange(2) == 1, n).astype(float)
        weighed = precision @ along
        precision = precision - np.outer(weighed, weighed) / (1 / spread**2 + along @ weighed)
        if zero_mean[1]:
            precision = precision + np.outer(along, along) / (n * spread) ** 2
        covariance = covariance + spread**2 * np.outer(along, along)
        root = np.column_stack([root, spread * along])
        is_free = np.array([is_free[0], True])
    posterior = Dense(
        line=problem.line,
        precision=jnp.asarray(precision),
        covariance=jnp.asarray(covariance),
        root=jnp.asarray(root),
        is_free=jnp.asarray(is_free),
    )
    return posterior, mean.reshape(problem.unknowns, n)


def _estimate(
    problem: LineProblem, gaussian: Any, parts: Any, draws: np.ndarray,
    best: SplitMinimum, status: Status,
) -> TractionEstimate:  # fmt: skip
    """The estimate of these parts; warnings and averaging are the Gaussian estimate's."""
    distance = float(best.distance[0])
    dof = sum(gaussian.stats.get(f"resolved_dof_{name}", 0.0) for name in "pq")
    squares = chi2(problem, float(dof), float(parts.squares))
    stats = gaussian.stats | squares | {
        "steps": int(best.steps), "distance_to_minimum": distance, "draws": len(draws),
    }  # fmt: skip
    warnings = gaussian.warnings
    before, after = (
        diagnostics.residual_over_noise(of[CHI2], of[FREEDOM] or 0.0)
        for of in (gaussian.stats, squares)
    )
    if not before:
        warnings = (*warnings, *after)
    names = "value", "stderr", "fitted", "whitened"
    return ConstrainedEstimate(
        line=gaussian.line,
        **in_jax({name: getattr(parts, name) for name in names}),
        averaging=gaussian.averaging,
        friction=gaussian.friction,
        mean_unobserved=gaussian.mean_unobserved,
        signal_unit=gaussian.signal_unit,
        status=status,
        warnings=warnings,
        stats=stats,
        draws=draws,
    )
