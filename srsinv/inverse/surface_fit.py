"""Fit of features of a surface to a signal: height, width, position and friction.

Height acts on the signal through contact. Frictions enter linearly and are solved out; heights and
lengths are searched from a bank of shapes. The noise is estimated from the residual.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from ..errors import number, refuse
from ..forward.feature import ScanExtent
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from ..grid import Line
from .cells import Window
from .diagnostics import sliding_noise
from .feature_estimate import FeatureEstimate
from .feature_model import scan_extent
from .identifiability import limited_by_bounds, undetected_features
from .nonlinear import Fit, Optimistix, Solver, fit
from .sliding_noise import Levels, estimate, first_levels
from .surface_model import SurfaceFeatures, SurfaceModel, cell_for
from .surface_search import SurfaceSearch

GOOD_ENOUGH = 2.0  # chi-square per degree of freedom, before the sliding noise is known
LEAST_EDGE = 2.0  # cells: the sharpest edge in the search
ROUNDS = 4  # of fitting, and estimating the noise from the residual
# Prior standard deviation of a friction: far beyond any, so as not to pull.
ANY_FRICTION = 10.0
REACH = {  # search ranges of known quantities once freed, as factors
    "edge_length_m": 20.0,
    "depth_m": 3.0,
    "gain": 10.0,
    "nominal_pressure_Pa": 10.0,
}
KNOWN = tuple(REACH)
# Fraction of the signal within which its derivative jumps: cells touch and part one by one.
ROUNDING = 1e-4


class SurfaceFitter:
    """Fitter of features of a surface to signals of one sensor along one motion.

    - `window`: the surface's period; `nominal_pressure_Pa`: the mean pressure over it.
    - `also`: names of `KNOWN` to fit beside heights, lengths and frictions.

    Computations that do not depend on the signal are done once, and the programs compiled for the
    first signal serve all. Raises `BadInput` for a window that does not hold the scan, and for
    names that are not known.
    """

    def __init__(
        self,
        sensor: Sensor,
        motion: Motion,
        features: SurfaceFeatures,
        window: Window,
        nominal_pressure_Pa: float,
        also: Sequence[str] = (),
        solver: Solver | None = None,
    ):
        for name in also:
            refuse(
                name not in KNOWN and not _is_parameter(features, name),
                f"fit.free names {name!r}: beside the features' own parameters it can name "
                f"{', '.join(KNOWN)}.",
            )
        self._depth_m = float(sensor.depth_m)
        self._stretch: ScanExtent = scan_extent(sensor, motion)
        self._pressure, self._also = nominal_pressure_Pa, tuple(n for n in also if n in KNOWN)
        cell_m = cell_for(features, self._depth_m)
        self._model_of_plate = SurfaceModel.on_window(sensor, motion, window, cell_m)
        self._search = SurfaceSearch(self._model_of_plate, window, self._stretch)
        self._solver = (solver or Optimistix()).tolerating(ROUNDING)
        self._models: dict[tuple[str, ...], SurfaceModel] = {}

    def __call__(
        self,
        features: SurfaceFeatures,
        y: Float[np.ndarray, "e sample"],
        noise: Any = None,
        start: Mapping[str, float] | None = None,
    ) -> FeatureEstimate:
        """Fit the features' parameters to `y`.

        - `noise`: as [`nonlinear.fit`][] takes it; None: estimated from the residual, in rounds.
        - `start`: values to start from, by the parameters' names as in the result: all of a
          feature's, taken where they explain the data better than the search, or some of them, and
          the rest is searched.

        Features of a sum are found one after the other, and then fitted together.
        """
        y = np.asarray(y, float)
        first = first_levels(y, self._depth_m)
        using = self._noise(first, y) if noise is None else noise
        parts: dict[str, Any] = {}
        result, params = None, self._plate(len(y))
        for name, feature in features.items():
            given = _own(start or {}, name, features)
            known = {"nominal_pressure_Pa": self._pressure, "edge_length_m": feature.edge_m}
            search = partial(self._search.starts, y, first.white, (parts, params), feature, known)
            parts = parts | {name: feature}
            fixed = dict.fromkeys(feature.frictions, 0.0) | {"edge_length_m": feature.edge_m}
            model = self._model(parts)
            ends: list[Fit] = []
            for shape in _in_turn(search, given, feature.axes.keys() <= given.keys()):
                ends.append(self._fit(model, params | {name: shape | fixed}, y, using))
                if ends[-1].stats["chi2_per_freedom"] < GOOD_ENOUGH:
                    break
            result = min(ends, key=lambda end: end.stats["cost"])
            params = dict(result.value)
        if result is None:
            levels = estimate(y, *self._scale) if noise is None else None
            using = noise if levels is None else self._noise(levels, y)
            return FeatureEstimate.of_nothing(self._model({}), y, using, levels)
        model, levels = self._model(parts), None
        if noise is None:
            result, levels = self._settled(model, result, y, first)
        read, against = reported_parameters(model, result), _against(levels, y)
        evidence = _evidence(result)
        return FeatureEstimate.of(
            dict(features), result, model, y, read, evidence, levels, against
        )  # fmt: skip

    @property
    def line(self) -> Line:
        """The cells of the contact."""
        return self._model_of_plate.line

    @property
    def _scale(self):
        return self._model_of_plate.motion.position_m, self._depth_m

    def _settled(self, model, result: Fit, y, levels: Levels) -> tuple[Fit, Levels]:
        """Fit and noise in turn, until the noise no longer changes."""
        step = float(np.median(np.abs(np.diff(self._model_of_plate.motion.position_m))))
        for _ in range(ROUNDS):
            last, fitted = levels, self._noise(levels, y).coloured(result.jacobian)
            levels = estimate(result.residual, *self._scale, fitted, last)
            result = self._fit(model, dict(result.value), y, self._noise(levels, y))
            if not levels.differs_from(last, max(step, 1e-9 * self._depth_m)):
                break
        return result, levels

    def _noise(self, levels: Levels, y):
        return levels.whitener(np.asarray(self._model_of_plate.motion.position_m), np.isfinite(y))

    def _plate(self, elements: int) -> dict[str, Any]:
        """Parameters of the plate alone."""
        params: dict[str, Any] = {
            "base_friction": 0.0,
            "nominal_pressure_Pa": self._pressure,
            "gain": 1.0,
        }
        if "depth_m" in self._also:
            params["depth_m"] = self._depth_m
        if self._model_of_plate.free_offset:
            params |= {"offset": np.zeros(elements)}
        return params

    def _model(self, parts) -> SurfaceModel:
        key = tuple(parts)
        if key not in self._models:
            self._models[key] = self._model_of_plate.with_features(parts)
        return self._models[key]

    def _fit(self, model: SurfaceModel, start: dict[str, Any], y, noise) -> Fit:
        bounds: dict[str, tuple[float, float]] = {}
        for name, feature in model.features.items():
            for part, within in feature.ranges(self._stretch).items():
                bounds[f"{name}.{part}"] = within
            if "edge_length_m" in self._also:
                # Cells do not resolve sharper ones, nor their derivative.
                low, high = _about("edge_length_m", feature.edge_m)
                low = max(low, LEAST_EDGE * float(model.line.cell_m))
                bounds[f"{name}.edge_length_m"] = low, high
        whole = {"depth_m": self._depth_m, "gain": 1.0, "nominal_pressure_Pa": self._pressure}
        bounds |= {name: _about(name, whole[name]) for name in self._also if name in whole}
        free = [*bounds, *model.linear]
        priors = {name: (0.0, ANY_FRICTION) for name in model.linear if name != "offset"}
        if self._model_of_plate.free_offset:
            largest = float(np.nanmax(np.abs(y)))
            priors["offset"] = (0.0, 30 * largest if largest > 0 else 1.0)
        return fit(
            model,
            start,
            y,
            noise=noise,
            bounds=bounds,
            free=free,
            linear=model.linear,
            priors=priors,
            solver=self._solver,
            steps=model.steps,
        )


def _in_turn(
    search: Callable[[Mapping[str, float]], list[Any]], given: Mapping[str, float], whole: bool
):
    """Start shapes: with the values given, then, where these are incomplete, without them."""
    yield from search(given)
    if given and not whole:
        yield from search({})


def _about(name: str, value: float) -> tuple[float, float]:
    return value / REACH[name], value * REACH[name]


def _is_parameter(features: SurfaceFeatures, name: str) -> bool:
    return name == "base_friction" or any(
        name in (*feature.axes, *feature.frictions) for feature in features.values()
    )


def _own(start: Mapping[str, float], name: str, features: SurfaceFeatures) -> dict[str, float]:
    """The start values of this feature."""
    prefix = f"{name}_" if len(features) > 1 else ""
    own = {}
    for part in features[name].axes:
        if prefix + part in start:
            given = start[prefix + part]
            own[part] = float(number(f"fit.start.{prefix}{part}", given, "a number, in SI units"))
    return own


def _against(levels: Levels | None, y: Float[np.ndarray, "e sample"]) -> tuple[str, ...]:
    """Warnings on noise that was estimated from the residual."""
    if levels is None:
        return ()
    return tuple(sliding_noise(levels.sliding / float(np.sqrt(np.nanmean(y**2)))))


def _evidence(result: Fit) -> float:
    return -np.inf if result.log_evidence is None else float(result.log_evidence)


def reported_parameters(model: SurfaceModel, result: Fit) -> dict[str, tuple[float, float]]:
    """Reported value and standard error of each free parameter: infinite for those on a bound and
    those correlated with them, and for all where the features are not detected."""
    read: dict[str, tuple[float, float]] = {}
    bound_limited = limited_by_bounds(result)
    unsure = (
        frozenset(result.names) if undetected_features(model.features, result) else bound_limited
    )
    for name, feature in model.features.items():
        prefix = f"{name}_" if len(model.features) > 1 else ""
        own, spread = result.value[name], result.stderr[name]
        for part in (*feature.axes, *feature.frictions, "edge_length_m"):
            if f"{name}.{part}" in result.names:
                error = np.inf if f"{name}.{part}" in unsure else float(spread[part])
                read[prefix + part] = float(own[part]), error
    for part in ("base_friction", *KNOWN):
        if part in result.names:
            error = np.inf if part in unsure else float(result.stderr[part])
            read[part] = float(result.value[part]), error
    return read
