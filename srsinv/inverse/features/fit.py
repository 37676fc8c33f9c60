"""Fit of features to a signal: type, position, width, height or amplitude, and friction.

Shapes are searched from many starts; what enters linearly (amplitudes, frictions, offsets) is
solved out. Candidates are ranked by their evidence, the probability of the data under each with all
its parameters integrated out.
"""

import copy
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import partial, reduce
from itertools import product
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ... import false_alarm
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...grid import Open, Periodic, as_real
from ...known import outside_traces
from ...quantities import quantity
from ...resolution import cell_m
from ...status import Status
from ..gridding.cells import Window
from ..noise.residual import ResidualNoise
from ..noise.sliding import Levels
from ..nonlinear import Fit, Solver, TracedFit, WithNuisance, fit, fit_many
from ..rig.error import CELLS, MISFIT, OTHER_MINIMUM, SensorError, UncertainSetup
from ..rig.setup import OF_CONTACT
from .budget import budget_of, contradicted, names_of_facts
from .causes import Explained, FittedModel, explained
from .contact import are_noticed, cell_for, cells_may_show, checked_names
from .cylinder import contact_of
from .estimate import FeatureEstimate, explains
from .loading import AnyFeature, Features
from .misfit import FitMisfit
from .model import FeatureModel, filled_model, filled_up, scan_extent
from .search import STARTS, Blocks, FeatureSearch, given_start, prior_reach

RIG_ROUNDS = 4  # of a fit beside the facts of a rig, each linear about those found before
SETTLED = 0.1  # standard deviations that the facts move in a last round
WIDTHS, RESIZED = {"width_m", "half_width_m"}, (0.85, 1.15)  # of shapes that are tried again
SAME_COST = 0.5  # half the squares by which two minima are one
APART = 4.0  # standard errors: a shape that is another
GOOD_ENOUGH = 2.0  # chi-square per degree of freedom, before the sliding noise is known


class FeatureFitter:
    """Fitter of features to signals of one sensor along one motion; what does not depend on the
    signal is done once."""

    def __init__(
        self,
        model: FeatureModel,
        search: FeatureSearch,
        sensor: Sensor,
        motion: Motion,
        solver: Solver | None = None,
    ):
        self._model, self._search, self._sensor, self._motion = model, search, sensor, motion
        self._rig: SensorError | None = None
        self._facts: UncertainSetup | None = None
        self._stretch, self._depth_m = scan_extent(sensor, motion), float(sensor.depth_m)
        self._filled = filled_up(motion)
        self._given_solver, self._solver = solver, model.loading.solver(solver)

    @classmethod
    def along(cls, sensor: Sensor, motion: Motion, solver: Solver | None = None) -> "FeatureFitter":
        """Of features of traction."""
        coarse_m = cell_m("load_search", float(sensor.depth_m))
        blocks = Blocks(motion, coarse_m)
        model = filled_model(motion, lambda own: FeatureModel.along(sensor, own, is_shared=True))
        coarse = filled_model(
            blocks.motion, lambda own: FeatureModel.along(sensor, own, coarse_m, is_shared=True)
        )
        search = FeatureSearch(coarse, blocks, scan_extent(sensor, motion))
        return cls(model, search, sensor, motion, solver)

    @classmethod
    def on_window(
        cls,
        sensor: Sensor,
        motion: Motion,
        features: Features,
        window: Window,
        nominal_pressure_Pa: float,
        also: Sequence[str] = (),
        solver: Solver | None = None,
        kind: type[Open] | type[Periodic] = Open,
    ) -> "FeatureFitter":
        """Of features of a surface, or some of them.

        - `window`: the surface's period; `nominal_pressure_Pa`: the mean pressure over it.
        - `also`: names of `KNOWN` to fit beside heights, lengths and frictions.
        - `kind`: of the line over the window: see [`FeatureModel.on_window`][].

        Raises `BadInput` for a window that does not hold the scan, and for names that are not
        known.
        """
        also, depth = checked_names(features, tuple(also)), float(sensor.depth_m)
        blocks, contact = (
            Blocks(motion, cell_m("contact_search_samples", depth)),
            contact_of(features),
        )

        def model_on(motion: Motion, cell: float, also: tuple[str, ...] = ()) -> FeatureModel:
            given = window, cell, nominal_pressure_Pa, also, kind, contact
            return filled_model(motion, lambda own: FeatureModel.on_window(sensor, own, *given))

        model = model_on(motion, cell_for(features, depth), also)
        coarse = model_on(blocks.motion, cell_m("contact_search", depth))
        search = FeatureSearch(coarse, blocks, scan_extent(sensor, motion))
        return cls(model, search, sensor, motion, solver)

    def under(self, sensor: Sensor) -> "FeatureFitter":
        """The same cells, ranges and search for the signals of a sensor near the fitter's own,
        which has as many films, and which jax may trace."""
        own = copy.copy(self)
        own._model, own._sensor = self._model.under(sensor, self._filled), sensor
        return own

    @property
    def model(self) -> FeatureModel:
        """The model, without features."""
        return self._model

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
        noise: Any = None,
        start: Mapping[str, float] | None = None,
        starts: int = STARTS,
        rig: SensorError | None = None,
    ) -> FeatureEstimate:
        """Fit the features' parameters to `y`, NaN where a sample is missing.

        - `noise`: as [`nonlinear.fit`][] takes it; a [`ResidualNoise`][], or None for one without
          waves or drift: estimated from the residual, in rounds.
        - `start`: values to start from, by the parameters' names as in the result: all of a
          feature's, taken where they explain the data better than the search, or some of them, and
          the rest is searched.
        - `starts`: how many of the search's shapes are fitted from.
        - `rig`: how well gains, depth, angles and offsets are known; None: exactly.

        Features of a sum are found one after the other, each beside those found before, and then
        fitted together. No feature at all is a candidate too.
        """
        y = np.asarray(y, float)
        rough = ResidualNoise(self._motion, self._depth_m) if noise is None else noise
        rough = rough if isinstance(rough, ResidualNoise) else None
        levels = rough.first(y) if rough else None
        using = rough.whitener(levels, y) if rough and levels else noise
        given = {name: given_start(start or {}, name, features) for name in features}
        rig = None if rig is None else rig.without(self._facts_aside)
        # About the facts as stated, which are held: the fit beside them is the same program.
        stated = copy.copy(self)
        stated._facts = None if rig is None else rig.uncertain(self._sensor, self._filled)
        result = stated._fit_in_turn(features, y, using, levels, given, starts)
        model = self._model.with_features(features)
        if result is None:
            levels = rough.alone(y) if rough else None
            using = rough.whitener(levels, y) if rough and levels else noise
            return FeatureEstimate.of_nothing(model, y, using, levels)
        allowing, sources, rivals = self, (), Rivals()
        plain = result
        if rig is not None:
            # Before the noise is estimated: what wrong facts leave is no noise.
            allowing, sources, result, rivals = stated._allowing_for(
                rig, features, result, y, using
            )
        if rough and levels:
            again = lambda begun, white: allowing._fit(features, begun, y, white)  # noqa: E731
            result, levels = rough.settled(again, result, levels, y)
        model = allowing._model.with_features(features)
        moves = dict(rivals.moves)
        if any(feature.is_of_surface for feature in features.values()):
            moves |= allowing._moves_by_cells(model, result)
        wider = reduce(Fit.with_error, moves.values(), result)
        misfit = self._misfit(features, y, result)
        if misfit.times > 1:
            moves[MISFIT] = misfit.moves(result)
            wider = wider.with_misfit(moves[MISFIT])
        report = partial(model.loading.report, features)
        read = report(wider)
        budget = budget_of(result, read, report, sources, moves)
        evidence = self._evidence(features, result)
        of_noise = rough.warnings(levels, y, result) if rough and levels else ()
        against = (*rivals.warnings, *of_noise)
        against = (*against, *misfit.warnings, *contradicted(result, sources))
        causes = Explained()
        if against or result.warnings:
            by_facts = allowing if stated._facts is None else stated
            begun = FittedModel(plain, using, *by_facts._model_and_facts(features))
            last = rough.whitener(levels, y) if rough and levels else using
            ended, white = (
                FittedModel(result, last, model),
                None if levels is None else levels.white,
            )
            causes = explained(y, begun, ended, white, self._motion, self._depth_m)
            against = (*against, *causes.warnings)
        wider = wider.renamed(names_of_facts(sources))
        made = FeatureEstimate.of(features, wider, model, y, read, evidence, levels, against)
        return dataclasses.replace(made, budget=budget, causes=causes.causes)

    def traced(
        self,
        features: Features,
        y: Float[Array, "e sample"],
        observed: Bool[np.ndarray, "e sample"],
        noise: Any,
        start: Mapping[str, float],
    ) -> tuple[FeatureModel, TracedFit, Mapping[str, Any]]:
        """The model, the fit, and the priors of its linear parameters, of signals that jax traces;
        `observed`: where they are there; `start`: as of a call."""
        y = jnp.where(observed, y, 0.0)
        before, params, end = {}, self._common(y), None
        for name, feature in features.items():
            shapes = self._traced_starts(y, observed, (before, params), feature,
                                         given_start(start, name, features))  # fmt: skip
            own = {part: values[0] for part, values in shapes.items()}
            begun = params | {name: own | self._model.loading.begun(feature)}
            starts = {f"{name}.{part}": values for part, values in shapes.items()}
            before = before | {name: feature}
            model, settings = self._model.with_features(before), self._settings(before, y, noise)
            steps = model.steps or None
            made = cast(TracedFit, fit(model, begun, y, starts=starts, steps=steps, **settings))
            params, end = jax.lax.stop_gradient(made.value), (model, made, settings["priors"])
        assert end is not None
        return end

    def _traced_starts(
        self, y, observed, before, feature: AnyFeature, given: Mapping[str, float]
    ) -> dict[str, Float[Array, " start"]]:
        """As `_shapes`, of signals that jax traces."""
        is_part = bool(given) and not feature.axes.keys() <= given.keys()
        found = [
            self._search.traced(y, observed, before, feature, each)
            for each in ([given, {}] if is_part else [given])
        ]
        return {part: jnp.concatenate([each[part] for each in found]) for part in feature.axes}

    def many(
        self, name: str, feature: AnyFeature, ys: Float[np.ndarray, "draw e sample"], noise: Any
    ) -> tuple[FeatureModel, list[Fit]]:
        """Fit one feature to many signals, of known noise, each from where the search finds it."""
        model, parts = self._model.with_features({name: feature}), {name: feature}
        shapes = self._search.best(ys, feature)
        own = {part: float(values[0]) for part, values in shapes.items()}
        start = self._common(ys[0]) | {name: own | self._model.loading.begun(feature)}
        each = {f"{name}.{part}": values for part, values in shapes.items()}
        settings = self._settings(parts, ys, noise)
        return model, fit_many(model, start, ys, each=each, **settings)

    def estimates(
        self, name: str, feature: AnyFeature, ys: Float[np.ndarray, "draw e sample"], noise: Any
    ) -> list[FeatureEstimate]:
        """The estimates of these fits."""
        model, fits = self.many(name, feature, ys, noise)
        loading, features = model.loading, {name: feature}
        shapes = {part: np.array([fit.value[name][part] for fit in fits]) for part in feature.axes}
        ratios = loading.log_prior_ratio(feature, shapes, self._search)

        def estimate_of(fit: Fit, y: np.ndarray, ratio: float) -> FeatureEstimate:
            misfit, evidence = self._misfit(features, y, fit), _evidence_of(fit, float(ratio))
            wider = fit.with_misfit(misfit.moves(fit)) if misfit.times > 1 else fit
            read, against = loading.report(features, wider), misfit.warnings
            return FeatureEstimate.of(features, wider, model, y, read, evidence, None, against)

        return list(map(estimate_of, fits, ys, ratios))

    def _model_and_facts(self, features: Features) -> tuple[FeatureModel, int]:
        """The model, and the number of the rig's facts that it is a function of."""
        model = self._model.with_features(features)
        if self._facts is not None:
            return model, self._facts.root.shape[1]
        return model, 0 if model.nuisance is None else len(model.nuisance)

    def _misfit(
        self, features: Features, y: Float[np.ndarray, "e sample"], result: Fit
    ) -> FitMisfit:
        """What a fit leaves beyond the noise."""
        turns = len(self._motion.directions) > 1
        others = [
            f"feature.{name}.{each.other_setting}"
            for name, each in features.items()
            if turns and each.is_of_surface and each.other_setting
        ]
        remedy = f" Passed both ways, it may be that {' or '.join(others)}." if others else ""
        return FitMisfit.of(result, y, self._motion.position_m, self._depth_m, remedy)

    def _fit_in_turn(
        self,
        features: Features,
        y: np.ndarray,
        noise: Any,
        levels: Levels | None,
        given: Mapping[str, Mapping[str, float]],
        starts: int,
    ) -> Fit | None:
        """The fit of all features together, found one after the other; None where there is nothing
        to fit."""
        white = np.ones(len(y)) if levels is None else levels.white
        clean = noise.without(y) if isinstance(noise, WithNuisance) else y
        parts: dict[str, AnyFeature] = {}
        params, result = self._common(y), None
        if not features and self._model.free_offset:
            return self._fit({}, params, y, noise)
        for name, feature in features.items():
            before, parts = (parts, params), parts | {name: feature}
            ends: list[Fit] = []
            for shape in self._shapes(clean, white, before, feature, given[name], starts):
                own = shape | self._model.loading.begun(feature)
                end = self._fit(parts, params | {name: own}, y, noise)
                ends.append(end)
                if levels is None:
                    is_good = explains(end)
                else:
                    is_good = end.stats["chi2_per_freedom"] < GOOD_ENOUGH
                if is_good:
                    break
            result = min(ends, key=lambda end: end.stats["cost"])
            params = dict(result.value)
        return result

    def _shapes(
        self, y, white, before, feature: AnyFeature, given: Mapping[str, float], starts: int
    ) -> Iterator[dict[str, float]]:
        """Shapes to start from: with the values given, then, where these are incomplete, without
        them."""
        yield from self._search.starts(y, white, before, feature, given)[:starts]
        if given and not feature.axes.keys() <= given.keys():
            yield from self._search.starts(y, white, before, feature, {})[:starts]

    def _common(self, y: Any) -> dict[str, Any]:
        """First values of the parameters that are no feature's."""
        offset = {"offset": np.zeros(len(y))} if self._model.free_offset else {}
        known = self._facts
        facts = {} if known is None else {"calibration": np.zeros(known.root.shape[1])}
        with outside_traces():
            return self._model.loading.common() | offset | facts

    def _fit(self, parts: Features, start: dict[str, Any], y: np.ndarray, noise: Any) -> Fit:
        if self._facts is not None and self._model.uncertain is None:
            # Here, as it takes long where the search has refused to begin.
            self._model = self._model.about(self._facts, start["calibration"])
        model = self._model.with_features(parts)
        settings = self._settings(parts, y, noise)
        found = fit(model, start, y, steps=model.steps or None, **settings)
        return model.loading.accepted(parts, found)

    def _settings(self, parts: Features, y: Any, noise: Any) -> dict[str, Any]:
        model, loading = self._model.with_features(parts), self._model.loading
        reach = prior_reach(y)
        priors = loading.common_priors() if parts else {}
        for name, feature in parts.items():
            priors |= loading.priors(name, feature, reach, self._search)
        if model.free_offset:
            priors["offset"] = (0.0, reach)
        with outside_traces():
            bounds = loading.bounds(model.line, parts, self._stretch) if parts else {}
        if self._rig is not None:
            priors["calibration"] = (0.0, 1.0)
        if model.uncertain is not None and self._rig is not None:
            most = model.uncertain.setup.reach
            bounds["calibration"] = -most, most
        linear = model.linear if parts else ("offset",)
        return {
            "noise": noise,
            "bounds": bounds,
            "free": [*bounds, *linear],
            "linear": linear,
            "priors": priors,
            "solver": self._solver,
        }

    def _evidence(self, features: Features, result: Fit) -> float:
        """Log evidence, with each amplitude's prior at the fitted shape.

        The fit used that of the shape with the strongest signal; both are too wide to move it.
        """
        weigh, values = self._model.loading.log_prior_ratio, result.value
        each = (float(weigh(f, values[n], self._search)[0]) for n, f in features.items())
        return _evidence_of(result, sum(each, 0.0))

    def _moves_by_cells(
        self, model: FeatureModel, result: Fit
    ) -> dict[str, Float[np.ndarray, "m 1"]]:
        """The moves of a fit's parameters that half as wide cells would make, where they are
        noticed."""
        if result.noise_rms is not None or not cells_may_show(result):
            return {}
        params = jax.tree.map(as_real, result.value)
        finer = np.asarray(model.on_finer_cells(params, self._sensor, self._filled))
        change = finer - result.signal()
        moves = result.moves(change)
        return {CELLS: moves[:, None]} if are_noticed(moves, result) else {}

    @property
    def _facts_aside(self) -> frozenset[str]:
        """Facts of the rig that are fitted, of gains that of the first element, and those that the
        features' signals do not depend on."""
        loading = self._model.loading
        freed = ("gain_1" if name == "gain" else name for name in loading.freed)
        return frozenset(freed) | (frozenset(OF_CONTACT) - frozenset(loading.FACTS))

    def _allowing_for(
        self, rig: SensorError, features: Features, result: Fit, y: np.ndarray, noise: Any
    ) -> tuple["FeatureFitter", tuple[str, ...], Fit, "Rivals"]:
        """The fitter with room for what is not known of the rig, the sources of its errors, the
        fit, and other minima. Tolerances are large: the facts are parameters as the
        others are. What a calibration leaves is small, so that signals are linear in it."""
        own, model = copy.copy(self), self._model.with_features(features)
        own._rig, start, known = rig, dict(result.value), self._facts
        if known is None:
            columns = rig.columns(
                self._sensor,
                np.asarray(model(result.value)),
                lambda setup: model.with_setup(setup, self._filled)(result.value),
            )
            own._model = self._model.with_nuisance(columns)
            start["calibration"] = np.zeros(len(columns))
            return own, rig.sources(len(columns)), own._fit(features, start, y, noise), Rivals()
        own._solver = model.loading.solver(self._given_solver, has_facts=True)
        result = own._beside_facts(known, features, start, y, noise)
        # What is no minimum has none beside it.
        resized = own._resized(features, result) if result.status == Status.CONVERGED else ()
        others = [own._fit(features, each, y, noise) for each in resized]
        best = min(others, key=_cost, default=result)
        if _cost(best) < _cost(result) - SAME_COST:
            others.append(result)
            result = own._beside_facts(known, features, dict(best.value), y, noise)
        return own, rig.sources(known.root.shape[1]), result, Rivals.of(features, result, others)

    def _resized(self, features: Features, result: Fit) -> Iterator[dict[str, Any]]:
        """Starts with each feature narrower and wider than in a fit: its width and that of a film's
        strip can stand for each other."""
        for name, feature in features.items():
            own, ranges = result.value[name], feature.ranges(self._stretch)
            for part in ranges.keys() & WIDTHS:
                for factor in RESIZED:
                    width = np.clip(factor * float(own[part]), *ranges[part])
                    yield {**result.value, name: {**own, part: width}}

    def _beside_facts(
        self,
        known: UncertainSetup,
        features: Features,
        start: dict[str, Any],
        y: np.ndarray,
        noise: Any,
    ) -> Fit:
        """The fit beside the facts of a rig, in rounds, the model about those found before."""
        rounds = 0
        while True:
            off, uncertain = np.asarray(start["calibration"]), self._model.uncertain
            if uncertain is None or np.any(off != np.asarray(uncertain.at)):
                self._model = self._model.about(known, off)
            result, rounds = self._fit(features, start, y, noise), rounds + 1
            start = dict(result.value)
            moved = np.max(np.abs(np.asarray(start["calibration"]) - off))
            is_settled = moved < SETTLED or result.status != Status.CONVERGED
            if is_settled or rounds == RIG_ROUNDS:
                return result


def _cost(fit: Fit) -> float:
    return float(fit.stats["cost"])


class Rivals(NamedTuple):
    """Warnings on another minimum that is far from a fit's and not much less probable, and the
    moves of the parameters for which it is in their standard errors."""

    warnings: tuple[str, ...] = ()
    moves: Mapping[str, Float[np.ndarray, "m 1"]] = {}

    @classmethod
    def of(cls, features: Features, result: Fit, others: Sequence[Fit]) -> "Rivals":
        """The most probable of the others, where a shape of a feature is far from the fit's.

        Where the one is w times as probable as the other, its distance d adds w/(1+w) d^2 to the
        mean square of what is off the fit.
        """
        parts = [(name, part) for name, feature in features.items() for part in feature.axes]
        for other, (name, part) in product(sorted(others, key=_cost), parts):
            odds = float(np.exp(min(_cost(result) - _cost(other), 0.0)))
            ours, error = float(result.value[name][part]), float(result.stderr[name][part])
            theirs = float(other.value[name][part])
            if odds > false_alarm.CHECK and abs(theirs - ours) > APART * error:
                what = part.rpartition("_")[0].replace("_", " ")
                said = quantity(theirs, "m" if part.endswith("_m") else "1")
                warning = (
                    f"A {what} of {said} is {odds:.2g} times as probable: features and facts of "
                    "the rig explain the signals in two ways. Measure the films' strips, and state "
                    "their tolerance."
                )
                moves = np.sqrt(odds / (1 + odds)) * result.moves_to(other)
                return cls((warning,), {OTHER_MINIMUM: moves[:, None]})
        return cls()


def _evidence_of(fit: Fit, log_prior_ratio: float) -> float:
    return -np.inf if fit.log_evidence is None else float(fit.log_evidence + log_prior_ratio)
