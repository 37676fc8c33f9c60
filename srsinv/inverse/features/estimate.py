"""The estimate that a fit of features ends with: their parameters, and the traction they make."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from ...errors import BadInput, of_kind
from ...forward.scan import Motion
from ...grid import Line, as_real
from ...status import Status
from ...views import Arrays, ViewData
from ..diagnostics import of_fit, undetected
from ..estimate import COMPONENTS, Estimate, Numbers
from ..line.model import CHI2, FREEDOM
from ..line.problem import LineProblem, ScannedCells
from ..noise.causes import LikelyCause
from ..noise.sliding import Levels
from ..nonlinear import Fit, FitToSample, whitener
from ..problem import Problem
from ..quality import Quality, quality
from .budget import Budget
from .identifiability import undetected_features
from .loading import Features
from .model import FeatureModel

if TYPE_CHECKING:
    import xarray

PROFILE_UNITS = {"height": "m", "gap": "m", "friction": "1"}


class FeatureEstimate(Estimate):
    """Features fitted to a recording: their parameters with standard errors, and their traction.

    Beside what an [`Estimate`][srsinv.Estimate] has:

    - `features`: by name; none for "nothing there". `fit`: the fit below, None without any free
      parameter. `model`: parameters to signal and traction; `data` (e, sample): the signals that
      were fitted, NaN where one is missing.
    - `parameters`: the shape, the amplitude and the friction of each feature, of a surface the
      height and the frictions; names begin with the feature's where there are several. Their
      standard errors are infinite where the fit failed.
    - `log_evidence`: log probability density of the data under these features.
    - `budget`: the parts of each standard error by their source; empty where there is none but the
      noise.
    - `causes`: what explains most of a misfit, the likeliest first; none where nothing does.
    - `levels`: of the noise, where it was estimated from the residual.
    - `cells`: which cells of the problem's line the samples were; None where they were none.
    - `motion`: where the sensor stood at the samples; None where the samples are cells, or where no
      problem was given. `signal_unit`: of `data`, "1" where it is not known.
    - `are_cells`: whether the samples are the cells of `line`.
    - `line`: of the traction; `background_Pa` [Pa]: uniform pressure and shear that are added to
      it. It is computed when it is asked for, with the standard error to first order.
    """

    features: Features
    fit: Fit | None
    model: FeatureModel
    data: Float[np.ndarray, "e sample"]
    whitened: Float[Numbers, "e sample"]
    parameters: Mapping[str, tuple[float, float]]
    log_evidence: float
    status: Status
    warnings: tuple[str, ...]
    stats: dict[str, Any]
    line: Line
    background_Pa: tuple[float, float] = (0.0, 0.0)
    budget: Budget = eqx.field(default_factory=Budget)
    causes: tuple[LikelyCause, ...] = ()
    levels: Levels | None = None
    cells: ScannedCells | None = None
    covariance: Float[Numbers, "m m"] | None = None
    averaging: Float[Numbers, "c c n"] | None = None
    motion: Motion | None = None
    signal_unit: str = eqx.field(static=True, default="1")
    are_cells: bool = eqx.field(static=True, default=False)

    @classmethod
    def of(
        cls,
        features: Features,
        fit: Fit,
        model: FeatureModel,
        y: Float[np.ndarray, "e sample"],
        parameters: Mapping[str, tuple[float, float]],
        log_evidence: float,
        levels: Levels | None = None,
        noise_warnings: tuple[str, ...] = (),
    ) -> "FeatureEstimate":
        """The estimate of fitted features."""
        if fit.quality is Quality.FAILED:  # its standard errors are not valid
            parameters = {name: (value, np.inf) for name, (value, _) in parameters.items()}
        observed = np.isfinite(fit.residual)
        whitened = np.where(observed, np.reshape(fit.whitened, observed.shape), np.nan)
        missed = map(undetected, undetected_features(features, fit))
        parts: dict[str, Any] = {
            "features": features,
            "fit": fit,
            "model": model,
            "data": y,
            "whitened": as_real(whitened),
            "parameters": parameters,
            "log_evidence": log_evidence,
            "status": fit.status,
            "warnings": (
                *fit.warnings,
                *missed,
                *model.loading.warnings(model.line, features, fit),
                *noise_warnings,
            ),
            "stats": {CHI2: fit.known_chi2, FREEDOM: fit.stats[FREEDOM]},
            "line": model.scanned_line,
            "levels": levels,
        }
        return cls(**parts)

    @classmethod
    def of_nothing(
        cls,
        model: FeatureModel,
        y: Float[np.ndarray, "e sample"],
        noise: Any,
        levels: Levels | None = None,
    ) -> "FeatureEstimate":
        """The estimate that the data are noise alone."""
        white, observed = whitener(noise, y.shape)
        rest = white.whitened(np.where(observed, y, 0.0))
        count = white.count(y.shape)
        volume = white.log_volume(y.shape) + count / 2 * np.log(2 * np.pi)
        chi2 = float(rest @ rest) / count if count else None
        whitened = np.where(np.asarray(observed), rest.reshape(y.shape), np.nan)
        parts: dict[str, Any] = {
            "features": {},
            "fit": None,
            "model": model,
            "data": y,
            "whitened": as_real(whitened),
            "parameters": {},
            "log_evidence": float(-0.5 * rest @ rest - volume),
            "status": Status.CONVERGED,
            "warnings": of_fit(chi2, count, (), ()),
            "stats": {CHI2: chi2, FREEDOM: count},
            "line": model.scanned_line,
            "levels": levels,
        }
        return cls(**parts)

    @property
    def name(self) -> str:
        """The features' names, joined."""
        return " + ".join(self.features) or "nothing"

    @property
    def quality(self) -> Quality:
        """Good, doubtful or failed. A misfit that is in the standard errors makes it doubtful, not
        failed."""
        chi2, freedom = self.stats[CHI2], self.stats[FREEDOM]
        is_widened = self.fit is not None and self.fit.is_widened
        return quality(self.status, None if is_widened else chi2, self.warnings, freedom)

    @property
    def _is_of_surface(self) -> bool:
        return any(feature.is_of_surface for feature in self.features.values())

    @property
    def explains(self) -> bool:
        """Whether the residual is no larger than the noise."""
        return self.fit is not None and explains(self.fit)

    @property
    def undetected(self) -> tuple[str, ...]:
        """Features that are not detected."""
        return () if self.fit is None else undetected_features(self.features, self.fit)

    @property
    def fitted(  # pyright: ignore[reportIncompatibleVariableOverride]
        self,
    ) -> Float[np.ndarray, "e sample"]:
        """The fitted signal (e, sample)."""
        data = self.data if self.cells is None else self.data[:, self.cells.cells]
        if self.fit is None:
            signal = np.zeros(data.shape)
        elif bool(np.isfinite(self.fit.residual).all()):
            signal = data - self.fit.residual  # without another call of the model
        else:
            signal = np.asarray(self.model(jax.tree.map(as_real, self.fit.value)))
        return signal if self.cells is None else self.cells.placed(signal)

    @property
    def value(  # pyright: ignore[reportIncompatibleVariableOverride]
        self,
    ) -> Float[np.ndarray, "2 n"]:
        """p and q [Pa] on the line, for the direction in which the scan slides, or slides first."""
        level = np.reshape(self.background_Pa, (2, 1))
        if self.fit is None:
            return np.zeros((2, self.line.n)) + level
        of = _CellTraction(self.model.filled, self.line, None)
        return np.asarray(of(self.fit.value)).reshape(2, -1) + level

    @property
    def stderr(  # pyright: ignore[reportIncompatibleVariableOverride]
        self,
    ) -> Float[np.ndarray, "2 n"]:
        """Its standard error [Pa], infinite where the fit failed."""
        return self._traction(None)[1]

    def _value_and_stderr(self) -> tuple[np.ndarray, np.ndarray]:
        value, stderr = self._traction(None)
        return value + np.reshape(self.background_Pa, (2, 1)), stderr

    @property
    def has_bands(self) -> bool:
        """Yes: every fit has standard errors, infinite where it failed."""
        return True

    def on(self, line: Line) -> "FeatureEstimate":
        of_kind("line", line, Line, "a line, such as Open(256, 1.5e-4)")
        return dataclasses.replace(self, line=line, are_cells=False)

    def of_problem(self, problem: Problem | LineProblem) -> "FeatureEstimate":
        """The same estimate with the problem's uniform pressure and shear added, where they are
        known. If the samples are cells of a line, it is on that line."""
        p, q = (0.0 if each is None else float(each) for each in problem.background_Pa)
        if isinstance(problem, LineProblem) and self._is_of_surface:
            p = float(problem.nominal_pressure_Pa or 0.0)
        parts: dict[str, Any] = {"background_Pa": (p, q)}
        if problem.sensor is not None:
            parts["signal_unit"] = problem.sensor.amplifier.unit
        if isinstance(problem, Problem):
            return dataclasses.replace(self, motion=problem.motion, **parts)
        if (cells := problem.scanned) is not None:
            data, whitened = (cells.placed(np.asarray(each)) for each in (self.data, self.whitened))
            parts |= {"data": data, "whitened": jnp.asarray(whitened), "line": problem.line,
                      "cells": cells, "are_cells": True}  # fmt: skip
        return dataclasses.replace(self, **parts)

    def deviation(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._traction(cells)

    def profiles(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """What acts along the model's `scanned_line` while the sensor slides towards +x.

        p and q [Pa] without the background; of a surface also its height and gap [m] and friction.
        Each has its standard error to first order, infinite where the fit failed.
        """
        names = self.model.loading.PROFILES
        cells, none = self.model.scanned_line.n, np.zeros(self.model.scanned_line.n)
        if self.fit is None:
            return dict.fromkeys(names, (none, none))
        shape = len(names), self.model.line.n
        both = self._derived(_Profiles(self.model.filled), shape)
        value, stderr = (each[:, :cells] for each in both)
        return dict(zip(names, zip(value, stderr, strict=True), strict=True))

    def to_sample(self) -> FitToSample:
        """The fit whose posterior [`sample`][srsinv.sample] draws from, with the parameters as they
        are reported. Raises `BadInput` where no parameter is free."""
        if self.fit is None:
            raise BadInput("No parameter is free, so there is nothing to sample: fit a feature.")
        loading, beside = self.model.loading, set(self.fit.warnings)
        return FitToSample(
            self.fit,
            partial(loading.values, self.features),
            partial(loading.report, self.features),
            tuple(each for each in self.warnings if each not in beside),
        )

    def view_data(self) -> ViewData:
        data = super().view_data()
        samples, _, unit = data.variables["fitted_signal"]
        variables: Arrays = data.variables | {
            "signal": (samples, self.data, unit),
            "log_evidence": ((), self.log_evidence, "1"),
        }
        if self.motion is not None:
            columns = self.motion.time_s, self.motion.position_m, self.motion.speed_m_per_s
            named = zip(("time", "position", "speed"), columns, ("s", "m", "m/s"), strict=True)
            variables |= {name: ("sample", each, unit) for name, each, unit in named}
        title = f"{self.name.replace('_', ' ').capitalize()} fitted"
        intervals = self.asymmetric
        notes = dict.fromkeys(intervals, "asymmetric") | self._notes()
        return data._replace(title=title, variables=variables, notes=notes, intervals=intervals)

    def to_xarray(self) -> "xarray.Dataset":
        """The arrays of any estimate. Of a surface, on the fit's own line, also height and gap [m]
        and friction along x."""
        data, names = super().to_xarray(), self.model.loading.PROFILES
        is_own_line = np.array_equal(self.line.x, self.model.scanned_line.x)
        if not is_own_line or len(names) == len(COMPONENTS):
            return data
        return data.assign(
            {
                name: (dims, values, {"units": units})
                for name, (dims, values, units) in contact_variables(self.profiles()).items()
            }
        )

    @property
    def asymmetric(self) -> dict[str, tuple[float, float]]:
        """Ends of 90 % intervals by profile likelihood, by name: of parameters that are reported as
        they are fitted, where an end is off the standard error's by more than a tenth."""
        if self.fit is None or self.quality is Quality.FAILED:
            return {}
        of_fit = {self._reported_name(name): name for name in self.fit.names}
        params = dict(zip(self.fit.names, self.fit.row, strict=True))
        own = {
            of_fit[name]: name
            for name, (value, stderr) in self.parameters.items()
            if np.isfinite(stderr) and value == params.get(of_fit.get(name, ""))
        }
        intervals = {own[name]: ends for name, ends in self.fit.asymmetric(own).items()}
        return intervals | self.model.loading.intervals(self.features, self.fit)

    def _reported_name(self, name: str) -> str:
        """The name under which a parameter of the fit is reported."""
        return name.replace(".", "_") if len(self.features) > 1 else name.rpartition(".")[2]

    def _notes(self) -> dict[str, str]:
        """Why standard errors of parameters are not valid, by their names."""
        if self.fit is None or self.quality is Quality.FAILED:
            return {}
        are_many, missed = len(self.features) > 1, self.undetected
        of_fit = {each: self._reported_name(each) for each in self.fit.at_bound}
        notes = {}
        for name, (_, stderr) in self.parameters.items():
            is_missed = any(not are_many or name.startswith(f"{each}_") for each in missed)
            if name in of_fit.values():
                notes[name] = "on a bound"
            elif not np.isfinite(stderr):
                notes[name] = "not detected" if is_missed else "not identifiable"
        return notes

    def _traction(self, cells: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        shape = 2, self.line.n
        if self.fit is None:
            return np.zeros(shape), np.zeros(shape)
        weights = None if cells is None else as_real(cells / cells.sum())
        return self._derived(_CellTraction(self.model.filled, self.line, weights), shape)

    def _derived(
        self, function: "_Profiles | _CellTraction", shape
    ) -> tuple[np.ndarray, np.ndarray]:
        assert self.fit is not None
        value, stderr = self.fit.derive(function, self.model.steps or None)
        if self.quality is Quality.FAILED:
            stderr = np.full_like(stderr, np.inf)
        return value.reshape(shape), stderr.reshape(shape)


class _Profiles(eqx.Module):
    """Parameters to the profiles along the model's line, in a row."""

    model: FeatureModel

    def __call__(self, params: Any) -> Float[Array, " row"]:
        return jnp.ravel(self.model.profiles(params))


class _CellTraction(eqx.Module):
    """Parameters to p and q on the cells of a line, in a row, while sliding as the scan does; less
    their means by `weights` (n,)."""

    model: FeatureModel
    line: Line
    weights: Float[Array, " n"] | None

    def __call__(self, params: Any) -> Float[Array, " row"]:
        traction = self.model.cell_traction(params, self.line)
        if not self.model.operator.directions[0]:
            traction = traction * jnp.array([[1.0], [-1.0]])
        if self.weights is not None:
            traction = traction - traction @ self.weights[:, None]
        return jnp.ravel(traction)


def contact_variables(profiles: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Arrays:
    """Of what [`FeatureEstimate.profiles`][] gives, that beside p and q as variables of a dataset:
    height and gap [m] and friction of a surface, with their standard errors."""
    return {
        key: ("x", values, PROFILE_UNITS[name])
        for name, pair in profiles.items()
        if name not in COMPONENTS
        for key, values in zip((name, f"{name}_stderr"), pair, strict=True)
    }


def explains(end: Fit) -> bool:
    """Whether a fit's residual is no larger than the noise."""
    return bool(end.converged and end.explains)


def probabilities(candidates: Sequence[FeatureEstimate]) -> np.ndarray:
    """Posterior probability of each candidate (c,), all equally probable a priori."""
    return np.asarray(scipy.special.softmax([candidate.log_evidence for candidate in candidates]))
