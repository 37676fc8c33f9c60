"""Result of a nonlinear fit: a minimum described as a `Fit`."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...compiled import compiled
from ...grid import as_real
from ...status import Status
from ...views import Arrays, ViewData, Views
from ..diagnostics import of_fit, unchecked_residual
from ..quality import Quality, independent_share, quality, reasons
from ._parameters import Layout, Tree
from ._profile import asymmetric, profiles
from ._search import Objective, Search
from ._uncertainty import Spread, spread

MOST_PROFILED = 15  # parameters that a report profiles: those that it lists
ENOUGH = 2.0  # standard deviations of chi squared up to which a residual counts as noise


@dataclasses.dataclass(frozen=True, repr=False)
class Fit(Views):
    """Result of a nonlinear fit: values and standard errors of the parameters.

    `print` gives a report; `plot`, `to_xarray`, `to_dataframe` give a figure, arrays, a table.

    - `value`, `stderr`: trees like the parameters; the standard error is 0 for fixed parameters and
      infinite for those that the data do not determine.
    - `names` (m,): the free parameters in a row; `covariance`, `correlation` (m, m) in that order,
      nan for pairs that are not determined.
    - `residual` (of the data's shape): data - model, nan where they are left out; `whitened` (n,):
      the same in units of the noise, 0 there. `jacobian` (n, m): the derivative of `whitened`.
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
    _search: Search
    notes: tuple[str, ...] = ()
    _may_profile: bool = True
    _asymmetric: dict[str, tuple[float, float] | None] = dataclasses.field(
        init=False, default_factory=dict
    )
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

    @cached_property
    def _plain(self) -> Spread:
        """The spread by noise and priors alone."""
        return spread(
            self.whitened_rows(), float(np.finfo(np.asarray(self._objective.row).dtype).eps)
        )

    @property
    def row(self) -> np.ndarray:
        """Values (m,) of the free parameters."""
        return self._z

    @property
    def plain_stderr(self) -> np.ndarray:
        """Standard errors (m,) of the free parameters by noise and priors alone."""
        return self._plain.stderr()

    @property
    def noise_unit(self) -> float:
        """Level of the noise in units of the objective's whitened residual."""
        if self.noise_rms is None or self._is_over_noise:
            return 1.0
        return self.noise_rms / float(self._objective.scale)

    def profile(self, names: Iterable[str] | None = None) -> dict[str, tuple[float, float]]:
        """The ends of 90 % intervals by profile likelihood, which need not be symmetric, by name.

        - `names`: of fitted parameters; None: all.

        At an end, with all other parameters fitted again, chi-square has risen by 1.645 squared (in
        units of the noise's estimated level, where it was not given). Those of a linear model are
        1.645 standard errors from the fit. An end is infinite where chi-square stays lower up to 30
        standard errors, and on a bound where that comes first. Errors beside the noise add in
        squares.

        Raises `BadInput` for a fit that did not converge, a robust loss, unknown names, a lower
        cost beside the fit, and refits that do not converge.
        """
        return profiles(self, names)

    def asymmetric(self, names: Iterable[str] | None = None) -> dict[str, tuple[float, float]]:
        """The intervals of [`profile`][srsinv.Fit.profile] that a report has in place of those of
        standard errors, as an end is off by more than a tenth.

        - `names`: of fitted parameters; None: all. Empty for more than a report lists, and for fits
          of [`fit_many`][srsinv.fit_many], whose models would be compiled again.
        """
        names = self.names if names is None else tuple(names)
        if not self._may_profile or len(names) > MOST_PROFILED:
            return {}
        known = self._asymmetric
        left = [name for name in names if name not in known]
        if left:
            known.update(dict.fromkeys(left) | asymmetric(self, left))
        return {name: ends for name in names if (ends := known[name]) is not None}

    @property
    def converged(self) -> bool:
        """Whether the search ended in a minimum. It may be one of several: see `explains`."""
        return self.status is Status.CONVERGED

    @property
    def explains(self) -> bool | None:
        """Whether the residual is no larger than the noise, by its chi-square; None where the noise
        is not known.

        If not, the standard errors, which are those of the noise, are too small: the model is
        wrong, the minimum is a local one, or some data are outliers.
        """
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

    def view_data(self) -> ViewData:
        signal, whitened = self.signal() + self.residual, self.whitened
        if self.noise_rms and not self._is_over_noise:
            whitened = whitened / self.noise_rms
        whitened = np.where(np.isnan(signal), np.nan, whitened.reshape(signal.shape))
        rows = -1, signal.shape[-1]
        samples = "element", "sample"
        variables: Arrays = {
            "signal": (samples, signal.reshape(rows), "1"),
            "fitted_signal": (samples, np.asarray(self.signal()).reshape(rows), "1"),
            "whitened_residual": (samples, whitened.reshape(rows), "1"),
            "chi2_per_freedom": ((), self.known_chi2 or np.nan, "1"),
        }
        if self.noise_rms is not None:
            variables["noise_rms"] = ((), self.noise_rms, "1")
        count = len(variables["signal"][1])
        names = [""] if count == 1 else np.arange(count).astype(str)
        title = f"Fit of {len(self.names)} parameter{'s' * (len(self.names) != 1)}"
        parameters, notes = self._reported()
        of_row = self._objective.layout.free_names  # `names` may have others of facts
        intervals = dict(zip(self.names, of_row, strict=True))
        intervals = {intervals[name]: ends for name, ends in self.asymmetric().items()}
        notes = dict.fromkeys(intervals, "asymmetric") | notes
        coordinates: Arrays = {"element": (names, "1")}
        return ViewData(title, variables, coordinates, parameters, notes, intervals=intervals)

    def _reported(self) -> tuple[dict[str, tuple[float, float]], dict[str, str]]:
        """Every parameter's value and standard error, and notes on those that have no valid one."""
        layout, row = self._objective.layout, np.array(self._objective.row, float)
        names, stderrs = list(layout.names), np.zeros(row.size)
        row[np.asarray(layout.free)], stderrs[np.asarray(layout.free)] = (
            self._z,
            self._spread.stderr(),
        )
        notes = {name: "fixed" for i, name in enumerate(names) if i not in layout.free}
        for i, name in zip(layout.free, self.names, strict=True):
            if name in self.at_bound:
                notes[names[i]] = "on a bound"
            elif not np.isfinite(stderrs[i]):
                notes[names[i]] = "not identifiable"
            elif name != names[i]:  # a fact of the rig
                notes[names[i]] = f"error of {name} over its tolerance"
        pairs = zip(row.tolist(), stderrs.tolist(), strict=True)
        return dict(zip(names, pairs, strict=True)), notes

    @property
    def _is_over_noise(self) -> bool:
        """Whether `whitened` is in units of the noise: else of its unknown level, by least squares
        without priors, in units of the data."""
        objective = self._objective
        is_weighed = objective.is_robust or objective.prior_mean is not None
        return self.noise_rms is None or is_weighed

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
        unit = float(objective.scale) if self.noise_rms is not None and self._is_over_noise else 1.0
        return objective.whiten.whitened(signal).astype(float) / unit

    def whitened_rows(self) -> np.ndarray:
        """The derivative (n + m, m) of the whitened residual and of the priors' terms by the free
        parameters, in units of the noise: the standard errors of noise and priors alone follow."""
        level = 1.0 if self._is_over_noise or self.noise_rms is None else self.noise_rms
        weight = self._objective.prior_weight
        known = np.zeros(len(self.names)) if weight is None else np.asarray(weight, float)
        return np.vstack([np.asarray(self.jacobian, float) / level, np.diag(known)])

    def moves(self, change: np.ndarray) -> np.ndarray:
        """The changes (m,) of the free parameters, to first order, if the data change by `change`,
        of the data's shape; 0 in directions that the data do not determine."""
        by = self._objective.whiten.whitened(change).astype(float)
        factor = self._spread.factor
        return factor @ (factor.T @ (self.jacobian[: by.size].T @ by))

    def stopped_near(self) -> "Fit":
        """The same fit, marked as stopped short of its minimum. Its standard errors include the
        distance to it."""
        distance = self.stats["distance_to_minimum"]
        wider = self._spread.times(float(np.hypot(1.0, distance)))
        return dataclasses.replace(self, status=Status.CONVERGED, _spread=wider)

    def moves_to(self, other: "Fit") -> np.ndarray:
        """The changes (m,) of the free parameters from this fit to another of the same model."""
        return other._z - self._z

    def with_error(self, moves: np.ndarray) -> "Fit":
        """The same fit with further errors in its covariance: `moves` (m, k), each column a change
        of the free parameters by one standard deviation."""
        return dataclasses.replace(self, _spread=self._spread.with_error(moves))

    def moves_by_noise(self) -> np.ndarray:
        """The errors (m, m) of the free parameters by noise: independent columns of one standard
        deviation each. The errors of the priors' means are not in them."""
        own, factor = self.jacobian[: self.whitened.size], self._spread.factor
        strength, directions = np.linalg.eigh((own @ factor).T @ (own @ factor))
        return factor @ directions * np.sqrt(np.maximum(strength, 0.0))

    def with_misfit(self, moves: np.ndarray) -> "Fit":
        """The same fit with its misfit in the standard errors: `moves` (m, k), each column a change
        of the free parameters. The residual then no longer makes the fit fail."""
        return dataclasses.replace(self.with_error(moves), _narrower=self)

    @property
    def is_widened(self) -> bool:
        """Whether the standard errors contain the misfit."""
        return self._narrower is not None

    @property
    def without_misfit(self) -> "Fit":
        """The same fit, its standard errors without the misfit."""
        return self if self._narrower is None else self._narrower

    def moved(self, moves: np.ndarray) -> "Fit":
        """The same fit with its free parameters changed by `moves` (m,). Its residual stays that of
        the old values."""
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

        - `function` maps the tree of parameters to a number or an array (k,). It is compiled in
          each call; an equinox module is compiled once.
        - `steps`: `{name: step}` for parameters whose derivative is a central difference over this
          step, over one standard error for the other parameters; None: derivatives by JAX.

        The standard error is infinite where the data do not determine the function.
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
