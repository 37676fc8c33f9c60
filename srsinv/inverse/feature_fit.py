"""Fit of features to a signal: type, position, width, amplitude and friction.

The shape is searched from many starts; amplitudes of p and of q enter linearly and are solved out.
Friction is their ratio. Candidates are ranked by their evidence, the probability of the data under
each with all its parameters integrated out.
"""

from collections.abc import Sequence
from functools import reduce
from operator import getitem
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..forward.feature import Feature, ScanExtent
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from .feature_estimate import FeatureEstimate, explains
from .feature_model import FeatureModel, Features
from .feature_search import STARTS, Coarse
from .identifiability import limited_by_bounds, undetected_features
from .nonlinear import Fit, Solver, fit, fit_many

# Prior standard deviation of an amplitude: the one whose signal is this multiple of the largest
# datum. Wide enough not to pull. The same rule for every candidate and every shape: one for the
# pressure itself would favour shapes with hardly any signal, as these take any pressure.
AMPLITUDE_PRIOR_REACH = 30.0


class FeatureFitter:
    """Fitter of features to signals of one sensor along one motion.

    Computations that do not depend on the signal are done once, and the programs compiled for the
    first signal serve all.
    """

    def __init__(self, sensor: Sensor, motion: Motion, solver: Solver | None = None):
        self._model, self._coarse = FeatureModel.along(sensor, motion), Coarse(sensor, motion)
        self._solver = solver

    def rank(
        self, candidates: Sequence[Features], y: Float[np.ndarray, "e sample"], noise: Any
    ) -> list[FeatureEstimate]:
        """Fit every candidate, for its evidence.

        All are fitted from their best start, and only where none explains the data to the noise
        from the others too.
        """
        fits = [self(features, y, noise, starts=1) for features in candidates]
        if any(fitted.explains for fitted in fits):
            return fits
        return [self(features, y, noise) for features in candidates]

    def __call__(
        self,
        features: Features,
        y: Float[np.ndarray, "e sample"],
        noise: Any,
        starts: int = STARTS,
    ) -> FeatureEstimate:
        """As [`fit_features`][], from the best `starts` of each feature."""
        y = np.asarray(y, float)
        parts: dict[str, Feature] = {}
        params, priors = self._offset(y)
        result, model = None, self._model.with_features(parts)
        if params and not features:
            result = fit(model, params, y, noise=noise, linear=model.linear, priors=priors)
        for name, feature in features.items():
            shapes, more = self._starts(y, parts, params, name, feature)
            parts, priors = parts | {name: feature}, priors | more
            model = self._model.with_features(parts)
            settings = self._settings(parts, model, noise, priors)
            first = [params | {name: shape} for shape in shapes[:starts]]
            result = _best(model, first, y, settings)
            params = dict(result.value)
        if result is None:
            return FeatureEstimate.of_nothing(model, y, noise)
        evidence = self._evidence(parts, result)
        return FeatureEstimate.of(
            parts, result, model, y, reported_parameters(model, result), evidence
        )

    def _evidence(self, features: Features, result: Fit) -> float:
        """Log evidence, with each amplitude's prior at the fitted shape.

        The fit used that of the shape with the strongest signal; both are too wide to move it.
        """
        if result.log_evidence is None:
            return -np.inf
        relative_signals = (
            self._coarse.relative_signal(f, result.value[name]) for name, f in features.items()
        )
        return float(
            result.log_evidence
            + sum(np.log(relative_signal).sum() for relative_signal in relative_signals)
        )

    def many(
        self, name: str, feature: Feature, ys: Float[np.ndarray, "draw e sample"], noise: Any
    ) -> tuple[FeatureModel, list[Fit]]:
        """Fit one feature to many signals of the same scene.

        All start from the search in the first signal.
        """
        params, priors = self._offset(ys[0])
        shapes, more = self._starts(ys[0], {}, {}, name, feature)
        model = self._model.with_features({name: feature})
        settings = self._settings({name: feature}, model, noise, priors | more)
        return model, fit_many(model, params | {name: shapes[0]}, ys, **settings)

    def _offset(self, y: np.ndarray) -> tuple[dict[str, Any], dict[str, tuple[float, float]]]:
        """First value and prior of each element's constant, where it is not known."""
        if not self._model.free_offset:
            return {}, {}
        return {"offset": np.zeros(len(y))}, {"offset": (0.0, _reach(y))}

    def _starts(self, y, parts: Features, params, name: str, feature: Feature):
        """Parameters of one more feature to start from, and the priors of its amplitudes."""
        shapes, strongest = self._coarse.search(y, parts, params, feature)
        priors = {
            f"{name}.{part}": (0.0, _reach(y) / top if top > 0 else 1.0)
            for part, top in zip(feature.linear, strongest, strict=True)
        }
        return [shape | dict.fromkeys(feature.linear, 0.0) for shape in shapes], priors

    def _settings(self, parts: Features, model: FeatureModel, noise: Any, priors) -> dict[str, Any]:
        return {
            "noise": noise,
            "bounds": _bounds(parts, self._coarse.stretch),
            "linear": model.linear,
            "priors": priors,
            "solver": self._solver,
        }


def _best(model: FeatureModel, starts: list[dict[str, Any]], y, settings: dict[str, Any]) -> Fit:
    """Fit from the starts in order, until one explains the data to the noise."""
    ends: list[Fit] = []
    for start in starts:
        ends.append(fit(model, start, y, **settings))
        if explains(ends[-1]):
            break
    return min(ends, key=lambda end: end.stats["cost"])


def fit_features(
    sensor: Sensor,
    motion: Motion,
    features: Features,
    y: Float[np.ndarray, "e sample"],
    noise: Any,
    solver: Solver | None = None,
) -> FeatureEstimate:
    """Fit the features' parameters to `y` (element, sample).

    - `noise`: as [`nonlinear.fit`][] takes it, and known.
    - Features of a sum are found one after the other, each beside those found before, and then
      fitted together. No feature at all is a candidate too.

    For several candidates or signals a [`FeatureFitter`][] is faster. Raises `BadInput` where the
    data and the motion disagree.
    """
    return FeatureFitter(sensor, motion, solver)(features, y, noise)


def _bounds(parts: Features, stretch: ScanExtent) -> dict[str, tuple[float, float]]:
    return {
        f"{name}.{part}": within
        for name, feature in parts.items()
        for part, within in feature.ranges(stretch).items()
    }


def _reach(y) -> float:
    """Signal at one prior standard deviation of an amplitude: see `AMPLITUDE_PRIOR_REACH`."""
    largest = float(np.max(np.abs(y[np.isfinite(y)]), initial=0.0))
    return AMPLITUDE_PRIOR_REACH * largest if largest > 0 else 1.0


def reported_parameters(model: FeatureModel, result: Fit) -> dict[str, tuple[float, float]]:
    """Reported value and standard error of each parameter.

    The error is infinite where the linearised one is not valid: for the shape and friction of an
    undetected feature (its amplitude has the prior's, as it could lie where its signal is weak);
    for an amplitude beside an undetected feature of the same kind; for parameters on a bound, and
    those strongly correlated with them.
    """
    read: dict[str, tuple[float, float]] = {}
    missed, bound_limited = undetected_features(model.features, result), limited_by_bounds(result)
    for name, feature in model.features.items():
        prefix = f"{name}_" if len(model.features) > 1 else ""
        own, spread = result.value[name], dict(result.stderr[name])
        unsure = {part for part in own if f"{name}.{part}" in bound_limited}
        if name in missed:
            unsure |= {*feature.axes, "friction"}
            spread[feature.amplitude] = result.prior_stderr[f"{name}.{feature.amplitude}"]
        if f"{name}.position_m" in result.at_bound:  # a bound of the scan: it may lie outside
            unsure.add("friction")
        if any(type(model.features[other]) is type(feature) for other in missed if other != name):
            unsure.add(feature.amplitude)
        listed = {part: float(own[part]) for part in (*feature.axes, feature.amplitude)}
        for part, value in feature.canonical(listed).items():
            read[prefix + part] = value, np.inf if part in unsure else float(spread[part])
        if feature.friction is None and own[feature.amplitude] != 0:
            mu, stderr = friction_of(result, name, feature)
            read[f"{prefix}friction"] = mu, np.inf if "friction" in unsure else stderr
    return read


class Ratio(eqx.Module):
    """One parameter over another, each by its keys."""

    above: tuple[str, ...] = eqx.field(static=True)
    below: tuple[str, ...] = eqx.field(static=True)

    def __call__(self, params: Any) -> Float[Array, ""]:
        above, below = (reduce(getitem, keys, params) for keys in (self.above, self.below))
        return above / below


def friction_of(result: Fit, name: str, feature: Feature) -> tuple[float, float]:
    """mu, the ratio of the two amplitudes, and its standard error to first order."""
    value, stderr = result.derive(Ratio((name, feature.shear), (name, feature.amplitude)))
    return float(value), float(stderr)
