"""Result of a nonlinear fit."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...grid import as_real
from ...status import Status
from ..diagnostics import of_fit, unchecked_residual
from ..quality import Quality, independent_share, quality, reasons
from ._parameters import Layout, Tree
from ._search import Objective
from ._uncertainty import Spread

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
        own = of_fit(self.known_chi2, independent, self.at_bound, self.undetermined, level_stderr)
        unchecked = (
            () if self.noise_rms is not None else unchecked_residual(self.known_chi2, freedom)
        )
        return (*own, *unchecked, *self.notes)

    @property
    def quality(self) -> Quality:
        """Good, doubtful or failed."""
        freedom = self.stats["degrees_of_freedom"]
        return quality(self.status, self.known_chi2, self.warnings, freedom)

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

    def whitened_signal(self) -> np.ndarray:
        """The fitted signal in units of the noise, in a row like `whitened`."""
        objective = self._objective
        observed = objective.whiten.observed(objective.y.shape)
        signal = np.where(observed, np.asarray(objective.y) - self.residual, 0.0)
        # With an unknown noise level, least squares and no priors, neither is in units of the
        # noise.
        level_counts = objective.is_robust or objective.prior_mean is not None
        unit = float(objective.scale) if self.noise_rms is not None and level_counts else 1.0
        return np.asarray(objective.whiten(as_real(signal)), float) / unit

    def moves(self, change: np.ndarray) -> np.ndarray:
        """The moves (m,) of the free parameters, to first order, as the model's signal changes by
        `change`, like the data; 0 along what the data do not determine."""
        by = np.asarray(self._objective.whiten(as_real(change)), float)
        factor = self._spread.factor
        return factor @ (factor.T @ (self.jacobian[: by.size].T @ by))

    def with_error(self, moves: np.ndarray) -> "Fit":
        """The same fit where the free parameters may also be off by `moves` (m,)."""
        return dataclasses.replace(self, _spread=self._spread.with_error(moves))

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

        def of(z):
            return jnp.asarray(function(self._objective.tree(z)))

        # Compiled whole: operation by operation takes seconds where a traction is derived.
        if steps is None:
            slope = _shared_slope if isinstance(function, eqx.Module) else eqx.filter_jit(_slope)
            objective = self._objective
            value, gradient = slope(function, objective.layout, objective.row, as_real(self._z))
        else:
            value, gradient = self._differences(jax.jit(of), steps)
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


def _slope(function, layout: Layout, row, z):
    """A function of the parameters, and its derivative by the free ones."""

    def of(z):
        whole = jnp.asarray(row).at[np.asarray(layout.free)].set(z)
        return jnp.asarray(function(layout.tree(whole)))

    return of(z), jax.jacfwd(of)(z)


_shared_slope = eqx.filter_jit(_slope)
