"""Summary of a minimum as a `Fit`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...status import Status
from ._answer import Fit
from ._loss import Loss
from ._parameters import Parameters
from ._search import Objective, SearchEnd
from ._second_order import newton_fall
from ._solvers import Solver
from ._uncertainty import log_evidence, nothing_known, offset, spread

AT_BOUND = 1e-6  # standard errors from a bound up to which a parameter counts as on it
SAME = 1e-8  # relative difference of two costs up to which they are one minimum


def summarise(
    objective: Objective, unknowns: Parameters, ends: SearchEnd, level_known: bool, solver: Solver
) -> Fit:
    """The `Fit` at a minimum: values, errors, warnings and statistics."""
    layout, z = objective.layout, np.asarray(ends.z, float)
    eps = max(float(np.finfo(np.asarray(ends.z).dtype).eps), solver.derivative_rounding)
    terms, jacobian = _terms(objective, ends)
    free = np.asarray(layout.free)
    with np.errstate(all="ignore"):
        gradient, squares = jacobian.T @ terms, np.sum(jacobian**2, axis=0)
        cost = 0.5 * float(terms @ terms)
    finite = bool(np.isfinite([*gradient, *squares, cost]).all())
    known = spread(rows_of(objective, ends), eps) if finite else nothing_known(z.size)
    count = objective.whiten.count(objective.y.shape)
    freedom = count - known.factor.shape[1]
    level = _inflation(objective, ends, level_known, freedom) if finite else 1.0
    known = known.times(level)
    # A solver that works in other variables reaches a bound up to rounding only.
    near = AT_BOUND * np.sqrt(np.sum(known.factor**2, axis=1)) + 8 * eps * np.abs(z)
    low, high = z - unknowns.lower <= near, unknowns.upper - z <= near
    held = (low & (gradient >= 0)) | (high & (gradient <= 0))
    least = 1.0 if level_known else 0.0  # rms of a known noise in its own units
    distance, along = offset(jacobian, terms, held, eps, least) if finite else (np.inf, 0.0)
    near_enough = max(solver.near_enough, 2 * np.sqrt(eps * count / z.size))
    if 0 < level < along and distance > near_enough:
        # The residual is rounding, of which this much can still be a move.
        known = known.times(along / level)
    covariance, errors = known.covariance(), known.stderr()
    row, stderr = np.asarray(objective.row, float).copy(), np.zeros(len(layout.names))
    row[free], stderr[free] = z, errors
    costs = np.asarray(ends.costs)
    weight = objective.prior_weight
    weight = np.zeros(z.size) if weight is None else np.asarray(weight, float)
    sigma = np.where(weight > 0, 1 / np.where(weight > 0, weight, 1.0), np.inf)
    # Back from the unit in place of an unknown noise level.
    is_unit = level_known or objective.is_robust or objective.prior_mean is not None
    unit = 1.0 if is_unit else float(objective.scale)
    evidence = None
    if level_known and finite and not objective.is_robust:
        volume = objective.whiten.log_volume(objective.y.shape) + count / 2 * np.log(2 * np.pi)
        evidence = log_evidence(
            terms, jacobian, volume,
            np.where(low, unknowns.lower, np.where(high, unknowns.upper, z)),
            unknowns.lower, unknowns.upper, sigma,
        )  # fmt: skip
    return Fit(
        value=layout.host_tree(row),
        stderr=layout.host_tree(stderr),
        names=layout.free_names,
        covariance=covariance,
        correlation=_correlation(covariance),
        residual=np.where(objective.whiten.observed(objective.y.shape), ends.residual, np.nan),
        whitened=unit * np.asarray(ends.white),
        jacobian=unit * np.asarray(ends.jacobian),
        noise_rms=None if level_known else _rms(objective, ends, freedom),
        status=_status(
            finite, distance, near_enough, terms, jacobian, held, objective, ends, solver, eps
        ),
        at_bound=tuple(layout.free_names[i] for i in np.flatnonzero(low | high)),
        undetermined=known.directions(layout.free_names, z),
        log_evidence=evidence,
        stats={
            "solver": solver.name,
            "cost": unit**2 * cost,
            "data": count,
            "degrees_of_freedom": freedom,
            "chi2_per_freedom": 2 * unit**2 * cost / freedom if freedom > 0 else None,
            "iterations": int(ends.iterations),
            "starts": int(ends.start_costs.size),
            "searches": int(costs.size),
            "searches_at_best": int(np.sum(costs <= costs.min() * (1 + SAME) + SAME**2)),
            "distance_to_minimum": distance,
        },
        _objective=objective,
        _z=z,
        _spread=known,
    )


def _rms(objective: Objective, ends: SearchEnd, freedom: int) -> float:
    """The level of the noise, where it is estimated."""
    if objective.is_robust:
        return float(objective.scale)
    with np.errstate(over="ignore"):
        white = np.asarray(ends.white, float)
        return float(objective.scale) * float(np.linalg.norm(white)) / np.sqrt(max(freedom, 1))


def _terms(objective: Objective, ends: SearchEnd) -> tuple[np.ndarray, np.ndarray]:
    """The terms of the sum of squares, and their derivative."""
    root, slope = _rooted(objective.loss, ends.white)
    jacobian = np.asarray(slope)[:, None] * np.asarray(ends.jacobian)
    return _with_priors(objective, ends, np.asarray(root), jacobian)


@eqx.filter_jit
def _rooted(loss: Loss, white):
    """The loss's root, and its slope."""
    return jax.jvp(loss.root, (white,), (jnp.ones_like(white),))


def rows_of(objective: Objective, ends: SearchEnd) -> np.ndarray:
    """The derivative of the whitened residual and of the priors' terms."""
    return _with_priors(objective, ends, np.asarray(ends.white), np.asarray(ends.jacobian))[1]


def _with_priors(
    objective: Objective, ends: SearchEnd, terms, jacobian
) -> tuple[np.ndarray, np.ndarray]:
    if objective.prior_mean is None or objective.prior_weight is None:
        return terms.astype(float), jacobian.astype(float)
    weight = np.asarray(objective.prior_weight, float)
    more = (np.asarray(ends.z) - np.asarray(objective.prior_mean)) * weight
    return np.concatenate([terms, more]), np.vstack([jacobian, np.diag(weight)])


def _inflation(objective: Objective, ends: SearchEnd, level_known: bool, freedom: int) -> float:
    """Factor on the standard errors under unit noise.

    One for least squares with known noise; the residual's rms where its level is not known; Huber's
    ratio (1981, section 7.6) for a robust loss. Infinite where no degrees of freedom remain.
    """
    white = np.asarray(ends.white, float)
    if objective.is_robust:
        observed = objective.whiten.observed(objective.y.shape).ravel()
        influence, slope = (np.asarray(v)[observed] for v in objective.loss.influence(ends.white))
        mean = max(float(slope.mean()), 1e-12)
        correction = 1 + ends.z.size / slope.size * float(slope.var()) / mean**2
        return float(correction * np.sqrt(influence @ influence / max(freedom, 1)) / mean)
    if level_known or objective.prior_mean is not None:
        return 1.0
    return float(np.sqrt(white @ white / freedom)) if freedom > 0 else np.inf


def _correlation(covariance: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", divide="ignore"):
        stderr = np.sqrt(np.diagonal(covariance))
        correlation = covariance / np.outer(stderr, stderr)
    correlation[np.diag_indices(len(stderr))] = 1.0
    return correlation


def _status(
    finite, distance, near_enough, terms, jacobian, held, objective: Objective, ends: SearchEnd,
    solver: Solver, eps: float,
) -> Status:  # fmt: skip
    if not finite:
        return Status.NOT_FINITE
    if distance <= near_enough or _nothing_left(terms, objective, ends, eps):
        return Status.CONVERGED
    if not bool(ends.done):
        return Status.STEP_LIMIT
    if _rounding_holds(terms, jacobian, held, ends, eps) or (
        # Differences of a discontinuous derivative give no second one.
        solver.derivative_rounding == 0
        and newton_fall(objective, ends.z, jacobian, held) <= eps ** (2 / 3)
    ):
        return Status.CONVERGED
    return Status.STALLED


def _nothing_left(terms, objective: Objective, ends: SearchEnd, eps: float) -> bool:
    """Whether the residual is rounding beside the data, or beside where the search began."""
    data = np.linalg.norm(np.asarray(objective.whiten(objective.y), float)) / float(objective.scale)
    begun = np.asarray(ends.start_costs)
    begun = np.sqrt(2 * np.max(begun, where=np.isfinite(begun), initial=0.0))
    return bool(np.linalg.norm(terms) <= eps ** (2 / 3) * max(data, begun))


def _rounding_holds(terms, jacobian, held, ends: SearchEnd, eps: float) -> bool:
    """Whether rounding of the parameters alone changes the terms by as much as they are."""
    moved = np.abs(jacobian) @ np.where(held, 0.0, np.abs(np.asarray(ends.z, float)))
    return bool(np.linalg.norm(terms) <= eps * np.linalg.norm(moved))
