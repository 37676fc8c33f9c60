"""Result of a nonlinear fit: a minimum described as a `Fit`."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ... import false_alarm
from ...compiled import compiled
from ...grid import as_real
from ...status import Status
from ..diagnostics import (
    Quality,
    independent_share,
    of_fit,
    quality,
    reasons,
    unchecked_residual,
)
from ._loss import Loss
from ._parameters import Layout, Parameters, Tree
from ._search import Objective, SearchEnd
from ._second_order import newton_fall
from ._solvers import Solver
from ._uncertainty import Spread, log_evidence, nothing_known, offset, spread

ENOUGH = 2.0  # standard deviations of chi squared up to which a residual counts as noise


@dataclasses.dataclass(frozen=True)
class Fit:
    """Result of a nonlinear fit.

    - `value`, `stderr`: trees like the parameters; the standard error is 0 for fixed parameters and
      infinite for those that the data do not determine.
    - `names` (m,): the free parameters in a row; `covariance`, `correlation` (m, m) in that order,
      nan for pairs that are not determined.
    - `residual`: data - model, like the data, nan where they are left out; `whitened`: the same in
      units of the noise, in a row, 0 there. `jacobian` (n, m): the derivative of `whitened`.
    - `noise_rms`: the noise's level where it was not given, else None.
    - `status`: how the search ended; `at_bound`: parameters on a bound. Standard errors
      there are those without the bound.
    - `undetermined`: directions of unidentifiable moves, each a mapping of names to moves.
    - `warnings`: sentences on the validity of the standard errors; `quality`: good, doubtful (any
      warning) or failed; `reasons`: why it is not good.
    - `notes`: further warnings, of a fit among many.
    - `log_evidence`: the log marginal likelihood (Laplace), where the noise and proper priors for
      all free parameters are given, else None.
    - `stats`: cost (half the sum of squares), chi2 per degree of freedom, iterations, starts.
    """

    value: Tree
    names: tuple[str, ...]
    residual: np.ndarray
    whitened: np.ndarray
    jacobian: np.ndarray
    noise_rms: float | None
    status: Status
    at_bound: tuple[str, ...]
    undetermined: tuple[dict[str, float], ...]
    log_evidence: float | None
    stats: dict[str, Any]
    _objective: Objective
    _z: np.ndarray
    _spread: Spread
    notes: tuple[str, ...] = ()
    _narrower: "Fit | None" = None

    @cached_property
    def stderr(self) -> Tree:
        """Standard errors, a tree like the parameters."""
        layout, row = self._objective.layout, np.zeros(np.size(self._objective.row))
        row[np.asarray(layout.free)] = self._spread.stderr()
        return layout.host_tree(row)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(m, m) of the free parameters."""
        return self._spread.covariance()

    @cached_property
    def correlation(self) -> np.ndarray:
        """(m, m) of the free parameters."""
        return self._spread.correlation()

    @property
    def converged(self) -> bool:
        """Whether the search ended in a minimum. It may be one of several: see `explains`."""
        return self.status is Status.CONVERGED

    @property
    def explains(self) -> bool | None:
        """Whether the residual is no larger than the noise, by chi squared; None where the noise
        was not known. Where it is False the standard errors, which are those of the noise, are too
        small: the model is wrong, or the minimum is local, or some data are outliers."""
        freedom = self.stats["degrees_of_freedom"]
        if self.noise_rms is not None:
            return None
        return bool(2 * self.stats["cost"] <= freedom + ENOUGH * np.sqrt(2 * max(freedom, 1)))

    @property
    def known_chi2(self) -> float | None:
        """Chi-square per degree of freedom; None where the noise was not known, or no degrees of
        freedom remain."""
        return self.stats["chi2_per_freedom"] if self.noise_rms is None else None

    @property
    def noise_level_stderr(self) -> float:
        """Relative standard error of the level of the noise that was given."""
        return float(self._objective.whiten.level_stderr)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on the standard errors, as sentences."""
        freedom = self.stats["degrees_of_freedom"]
        independent = freedom * independent_share(self.whitened)
        level_stderr = self.noise_level_stderr
        chi2 = None if self.is_widened else self.known_chi2
        own = of_fit(chi2, independent, self.at_bound, self.undetermined, level_stderr)
        unchecked = () if self.noise_rms is not None else unchecked_residual(self.known_chi2)
        return (*own, *unchecked, *self.notes)

    @property
    def quality(self) -> Quality:
        """Good, doubtful or failed."""
        freedom = self.stats["degrees_of_freedom"]
        chi2 = None if self.is_widened else self.known_chi2
        return quality(self.status, chi2, self.warnings, freedom)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the quality is not good, as sentences."""
        return reasons(self.status, self.warnings)

    @property
    def prior_stderr(self) -> dict[str, float]:
        """Standard deviations of the priors, infinite where there is none."""
        weight = self._objective.prior_weight
        known = np.zeros(len(self.names)) if weight is None else np.asarray(weight, float)
        return {n: 1 / w if w > 0 else np.inf for n, w in zip(self.names, known, strict=True)}

    @property
    def prior_pull(self) -> np.ndarray:
        """How far the free parameters (m,) are from their priors' means, in standard deviations of
        these; 0 where there is none."""
        mean, weight = self._objective.prior_mean, self._objective.prior_weight
        if mean is None or weight is None:
            return np.zeros(len(self.names))
        return (self._z - np.asarray(mean, float)) * np.asarray(weight, float)

    def renamed(self, names: Mapping[str, str]) -> "Fit":
        """The same fit with other names of some free parameters."""
        return dataclasses.replace(
            self,
            names=tuple(names.get(name, name) for name in self.names),
            at_bound=tuple(names.get(name, name) for name in self.at_bound),
            undetermined=tuple(
                {names.get(name, name): move for name, move in each.items()}
                for each in self.undetermined
            ),
        )

    def signal(self) -> np.ndarray:
        """The fitted signal, like the data; 0 where they are left out."""
        objective = self._objective
        observed = objective.whiten.observed(objective.y.shape)
        return np.where(observed, np.asarray(objective.y) - self.residual, 0.0)

    def whitened_signal(self) -> np.ndarray:
        """The fitted signal in units of the noise, in a row like `whitened`."""
        objective, signal = self._objective, self.signal()
        # With an unknown noise level, least squares and no priors, neither is in units of the
        # noise.
        level_counts = objective.is_robust or objective.prior_mean is not None
        unit = float(objective.scale) if self.noise_rms is not None and level_counts else 1.0
        return objective.whiten.whitened(signal).astype(float) / unit

    def moves(self, change: np.ndarray) -> np.ndarray:
        """The moves (m,) of the free parameters, to first order, as the model's signal changes by
        `change`, like the data; 0 along what the data do not determine."""
        by = self._objective.whiten.whitened(change).astype(float)
        factor = self._spread.factor
        return factor @ (factor.T @ (self.jacobian[: by.size].T @ by))

    def stopped_near(self) -> "Fit":
        """The same fit as an answer that stopped short of its minimum, its errors with how far."""
        distance = self.stats["distance_to_minimum"]
        wider = self._spread.times(float(np.hypot(1.0, distance)))
        return dataclasses.replace(self, status=Status.CONVERGED, _spread=wider)

    def moves_to(self, other: "Fit") -> np.ndarray:
        """The moves (m,) of the free parameters that lead to another fit of the same."""
        return other._z - self._z

    def with_error(self, moves: np.ndarray) -> "Fit":
        """The same fit where the free parameters may also be off by each of `moves` (m, k)."""
        return dataclasses.replace(self, _spread=self._spread.with_error(moves))

    def moves_by_noise(self) -> np.ndarray:
        """The moves (m, m) of the free parameters, each by one standard deviation, that the noise
        makes: without what is left open by their priors' means."""
        own, factor = self.jacobian[: self.whitened.size], self._spread.factor
        strength, directions = np.linalg.eigh((own @ factor).T @ (own @ factor))
        return factor @ directions * np.sqrt(np.maximum(strength, 0.0))

    def with_misfit(self, moves: np.ndarray) -> "Fit":
        """The same fit, its standard errors with moves (m, k) by what the model misses: its
        residual speaks no more against them."""
        return dataclasses.replace(self.with_error(moves), _narrower=self)

    @property
    def is_widened(self) -> bool:
        """Whether what the model misses is in the standard errors."""
        return self._narrower is not None

    @property
    def without_misfit(self) -> "Fit":
        """The same fit, without what the model misses in its standard errors."""
        return self if self._narrower is None else self._narrower

    def moved(self, moves: np.ndarray) -> "Fit":
        """The same fit with its free parameters moved by `moves` (m,): for what is derived from
        them, not for its residual."""
        z, layout = self._z + moves, self._objective.layout
        row = np.array(self._objective.row, float)
        row[np.asarray(layout.free)] = z
        return dataclasses.replace(self, value=layout.host_tree(row), _z=z)

    def ratio(self, above: str, below: str) -> tuple[float, float]:
        """The ratio of two free parameters, by their names, and its standard error to first
        order."""
        at = [self.names.index(above), self.names.index(below)]
        gradient = np.zeros((1, len(self.names)))
        with np.errstate(divide="ignore", invalid="ignore"):
            value = self._z[at[0]] / self._z[at[1]]
            gradient[0, at] = 1 / self._z[at[1]], -value / self._z[at[1]]
            return float(value), float(self._spread.along(gradient)[0])

    def derive(
        self, function: Callable[[Tree], Any], steps: Mapping[str, float] | None = None
    ) -> tuple[Any, Any]:
        """A function of the parameters, and its standard error to first order (the delta method).

        `function` maps the tree of parameters to a number or an array (k,). With `steps` its
        gradient is taken by central differences: over these steps for the parameters named, else
        over its standard error. Infinite standard errors where the data do not determine it. It is
        compiled at each call, once for all where it is an equinox module.
        """

        # Compiled whole: operation by operation takes seconds where a traction is derived.
        is_shared, objective = isinstance(function, eqx.Module), self._objective
        if steps is None:
            slope = _shared_slope if is_shared else eqx.filter_jit(_slope)
            value, gradient = slope(function, objective.layout, objective.row, as_real(self._z))
        else:
            value_at = _shared_value if is_shared else eqx.filter_jit(_value)
            value, gradient = self._differences(
                lambda z: value_at(function, objective.layout, objective.row, z), steps
            )
        along = np.atleast_2d(np.asarray(gradient))
        stderr = self._spread.along(along)
        return (value[()], stderr[0]) if np.ndim(value) == 0 else (np.asarray(value), stderr)

    def _differences(self, of: Callable[[Any], Any], steps: Mapping[str, float]):
        """The function's value, and its gradient (k, m)."""
        own = self._spread.stderr()
        columns = []
        for i, name in enumerate(self.names):
            fallback = own[i] if 0 < own[i] < np.inf else 1e-3 * max(abs(self._z[i]), 1e-9)
            off = np.zeros(self._z.size)
            off[i] = step = steps.get(name, fallback)
            above, below = (np.asarray(of(as_real(self._z + sign * off))) for sign in (1, -1))
            columns.append((above - below) / (2 * step))
        return of(as_real(self._z)), np.stack(columns, axis=-1)


def _value(function, layout: Layout, row, z):
    """A function of the parameters."""
    return jnp.asarray(function(layout.filled(jnp.asarray(row), z)))


def _slope(function, layout: Layout, row, z):
    """A function of the parameters, and its derivative by the free ones."""

    def of(z):
        return _value(function, layout, row, z)

    return of(z), jax.jacfwd(of)(z)


_shared_value, _shared_slope = compiled(_value), compiled(_slope)


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

    def __call__(self, objective: Objective, ends: SearchEnd) -> Fit:
        """The `Fit` at a minimum: values, errors, warnings and statistics."""
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
