"""From the end of a search to its `Fit`: the linearised problem at the minimum, its standard errors
and how the search ended."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ... import false_alarm
from ...compiled import compiled
from ...status import Status
from ._answer import Fit
from ._loss import Loss
from ._parameters import Parameters
from ._search import Objective, Search, SearchEnd
from ._second_order import newton_fall
from ._solvers import Solver
from ._uncertainty import Spread, log_evidence, nothing_known, offset, spread

AT_BOUND = 1e-6  # standard errors from a bound up to which a parameter counts as on it
SAME = 1e-8  # relative difference of two costs up to which they are one minimum


@dataclass(frozen=True)
class _Minimum:
    """The linearised problem where a search ended.

    - `terms` of the sum of squares and their derivative `jacobian` (_, m), turned into as few rows
      as there are columns: lengths and angles are the same.
    - `known`: the spread of the parameters; `low`, `high` (m,): those on a bound, and `held` those
      that it holds.
    - `distance` to the minimum, in standard errors, and how far is `near_enough`.
    - `freedom`: number of the degrees of freedom that are left.
    """

    terms: np.ndarray
    jacobian: np.ndarray
    cost: float
    is_finite: bool
    eps: float
    known: Spread
    low: np.ndarray
    high: np.ndarray
    held: np.ndarray
    distance: float
    near_enough: float
    freedom: int


class Summary:
    """From the end of a search to its `Fit`, for all fits of one model to data of one shape."""

    def __init__(
        self, objective: Objective, unknowns: Parameters, level_known: bool, solver: Solver
    ):
        shape, layout = objective.y.shape, objective.layout
        self.unknowns, self.level_known, self.solver = unknowns, level_known, solver
        self.observed = objective.whiten.observed(shape)
        self.is_complete = bool(self.observed.all())
        self.count = objective.whiten.count(shape)
        self.row, self.free = np.asarray(objective.row, float), np.asarray(layout.free)
        self.names, weight = layout.free_names, objective.prior_weight
        self.weight = np.zeros(len(self.names)) if weight is None else np.asarray(weight, float)
        volume = objective.whiten.log_volume(shape)
        self.log_norm = volume + self.count / 2 * np.log(2 * np.pi)

    def __call__(self, objective: Objective, ends: SearchEnd, search: Search) -> Fit:
        """The `Fit` at a minimum that a search reached: values, errors, warnings and statistics."""
        layout, z = objective.layout, np.asarray(ends.z, float)
        level_known = self.level_known
        at = self._minimum(objective, ends)
        row = self.row.copy()
        row[self.free] = z
        # Back from the unit in place of an unknown noise level.
        is_unit = level_known or objective.is_robust or objective.prior_mean is not None
        unit = 1.0 if is_unit else float(objective.scale)
        has_evidence = level_known and at.is_finite and not objective.is_robust
        return Fit(
            value=layout.host_tree(row),
            names=self.names,
            residual=self._residual(ends),
            whitened=_times(unit, ends.white),
            jacobian=_times(unit, ends.jacobian),
            noise_rms=None if level_known else _rms(objective, ends, at.freedom),
            status=_status(objective, ends, self.solver, at),
            at_bound=tuple(self.names[i] for i in np.flatnonzero(at.low | at.high)),
            undetermined=at.known.directions(self.names, z),
            log_evidence=self._log_evidence(at, z) if has_evidence else None,
            stats=self._stats(ends, at, unit),
            _objective=objective,
            _z=z,
            _spread=at.known,
            _search=search,
        )

    def _residual(self, ends: SearchEnd) -> np.ndarray:
        residual = np.asarray(ends.residual)
        return residual if self.is_complete else np.where(self.observed, residual, np.nan)

    def is_noise(self, cost: np.ndarray) -> np.ndarray:
        """Whether so large a cost is that of noise alone; True where its level is not known."""
        freedom = self.count - len(self.names)
        if not self.level_known or freedom < 1:
            return np.ones(cost.shape, bool)
        return scipy.special.chdtrc(freedom, 2 * cost) >= false_alarm.CHECK

    def _minimum(self, objective: Objective, ends: SearchEnd) -> _Minimum:
        z, solver = np.asarray(ends.z, float), self.solver
        eps = max(float(np.finfo(np.asarray(ends.z).dtype).eps), solver.derivative_rounding)
        full = terms_of(objective, ends)
        terms, jacobian = triangular(*full)
        rows = rows_of(objective, ends) if objective.is_robust else jacobian
        with np.errstate(all="ignore"):
            gradient, squares = jacobian.T @ terms, np.sum(jacobian**2, axis=0)
            cost = 0.5 * float(terms @ terms)
        finite = bool(np.isfinite([*gradient, *squares, cost]).all())
        known = spread(rows, eps) if finite else nothing_known(z.size)
        freedom = self.count - known.factor.shape[1]
        level = _inflation(objective, ends, self.level_known, freedom) if finite else 1.0
        known = known.times(level)
        # A solver that works in other variables reaches a bound up to rounding only.
        near = AT_BOUND * np.sqrt(np.sum(known.factor**2, axis=1)) + 8 * eps * np.abs(z)
        low, high = z - self.unknowns.lower <= near, self.unknowns.upper - z <= near
        held = (low & (gradient >= 0)) | (high & (gradient <= 0))
        least = 1.0 if self.level_known else 0.0  # rms of a known noise in its own units
        distance, along = np.inf, 0.0
        if finite:
            distance, along = offset(jacobian, terms, len(full[0]), held, eps, least)
        near_enough = max(solver.near_enough, 2 * np.sqrt(eps * self.count / z.size))
        if 0 < level < along and distance > near_enough:
            # The residual is rounding, of which this much can still be a move.
            known = known.times(along / level)
        return _Minimum(
            terms, jacobian, cost, finite, eps, known, low, high, held, distance, near_enough,
            freedom,
        )  # fmt: skip

    def _log_evidence(self, at: _Minimum, z: np.ndarray) -> float | None:
        weight, unknowns = self.weight, self.unknowns
        sigma = np.where(weight > 0, 1 / np.where(weight > 0, weight, 1.0), np.inf)
        ends = np.where(at.low, unknowns.lower, np.where(at.high, unknowns.upper, z))
        box = unknowns.lower, unknowns.upper
        return log_evidence(at.terms, at.jacobian, self.log_norm, ends, *box, sigma)

    def _stats(self, ends: SearchEnd, at: _Minimum, unit: float) -> dict[str, Any]:
        costs, cost = np.asarray(ends.costs), unit**2 * at.cost
        return {
            "solver": self.solver.name,
            "cost": cost,
            "data": self.count,
            "degrees_of_freedom": at.freedom,
            "chi2_per_freedom": 2 * cost / at.freedom if at.freedom > 0 else None,
            "iterations": int(ends.iterations),
            "starts": int(ends.start_costs.size),
            "searches": int(costs.size),
            "searches_at_best": int(np.sum(costs <= costs.min() * (1 + SAME) + SAME**2)),
            "distance_to_minimum": at.distance,
        }


def _times(unit: float, values: Any) -> np.ndarray:
    return np.asarray(values) if unit == 1 else unit * np.asarray(values)


def triangular(terms: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The terms and their derivative after a rotation that leaves as many rows as columns."""
    both = np.column_stack([jacobian, terms])
    if len(both) > both.shape[1]:
        both = np.asarray(np.linalg.qr(both, mode="r"))
    return both[:, -1], both[:, :-1]


def _rms(objective: Objective, ends: SearchEnd, freedom: int) -> float:
    """The level of the noise, where it is estimated."""
    if objective.is_robust:
        return float(objective.scale)
    with np.errstate(over="ignore"):
        white = np.asarray(ends.white, float)
        return float(objective.scale) * float(np.linalg.norm(white)) / np.sqrt(max(freedom, 1))


def terms_of(objective: Objective, ends: SearchEnd) -> tuple[np.ndarray, np.ndarray]:
    """The terms of the sum of squares, and their derivative."""
    if not objective.is_robust:
        return _with_priors(objective, ends, np.asarray(ends.white), np.asarray(ends.jacobian))
    root, slope = _rooted(objective.loss, jnp.asarray(ends.white))
    jacobian = np.asarray(slope)[:, None] * np.asarray(ends.jacobian)
    return _with_priors(objective, ends, np.asarray(root), jacobian)


@compiled
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
        return terms.astype(float, copy=False), jacobian.astype(float, copy=False)
    weight = np.asarray(objective.prior_weight, float)
    more = (np.asarray(ends.z) - np.asarray(objective.prior_mean)) * weight
    return np.concatenate([terms, more]), np.vstack([jacobian, np.diag(weight)])


def _inflation(objective: Objective, ends: SearchEnd, level_known: bool, freedom: int) -> float:
    """Factor on the standard errors under unit noise.

    One for least squares with known noise; the residual's rms where its level is not known; Huber's
    ratio (1981, section 7.6) for a robust loss. Infinite where no degrees of freedom remain.
    """
    if objective.is_robust:
        observed = objective.whiten.observed(objective.y.shape).ravel()
        influence, slope = (
            np.asarray(v)[observed] for v in objective.loss.influence(jnp.asarray(ends.white))
        )
        mean = max(float(slope.mean()), 1e-12)
        correction = 1 + ends.z.size / slope.size * float(slope.var()) / mean**2
        return float(correction * np.sqrt(influence @ influence / max(freedom, 1)) / mean)
    if level_known or objective.prior_mean is not None:
        return 1.0
    white = np.asarray(ends.white, float)
    return float(np.sqrt(white @ white / freedom)) if freedom > 0 else np.inf


def _status(objective: Objective, ends: SearchEnd, solver: Solver, at: _Minimum) -> Status:
    terms, held, eps = at.terms, at.held, at.eps
    if not at.is_finite:
        return Status.NOT_FINITE
    if at.distance <= at.near_enough or _nothing_left(terms, objective, ends, eps):
        return Status.CONVERGED
    if not bool(ends.done):
        return Status.STEP_LIMIT
    jacobian = terms_of(objective, ends)[1]
    if _rounding_holds(terms, jacobian, held, ends, eps) or (
        # Differences of a discontinuous derivative give no second one.
        solver.derivative_rounding == 0
        and newton_fall(objective, ends.z, jacobian, held) <= eps ** (2 / 3)
    ):
        return Status.CONVERGED
    return Status.STALLED


def _nothing_left(terms, objective: Objective, ends: SearchEnd, eps: float) -> bool:
    """Whether the residual is rounding beside the data, or beside where the search began."""
    white = objective.whiten.whitened(np.asarray(objective.y)).astype(float)
    data = np.linalg.norm(white) / float(objective.scale)
    begun = np.asarray(ends.start_costs)
    begun = np.sqrt(2 * np.max(begun, where=np.isfinite(begun), initial=0.0))
    return bool(np.linalg.norm(terms) <= eps ** (2 / 3) * max(data, begun))


def _rounding_holds(terms, jacobian, held, ends: SearchEnd, eps: float) -> bool:
    """Whether rounding of the parameters alone changes the terms by as much as they are."""
    moved = np.abs(jacobian) @ np.where(held, 0.0, np.abs(np.asarray(ends.z, float)))
    return bool(np.linalg.norm(terms) <= eps * np.linalg.norm(moved))
