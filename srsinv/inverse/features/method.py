"""The fit of features as a method: a problem to the features' parameters and their traction."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import equinox as eqx
import jax
import numpy as np

from ... import false_alarm
from ...errors import echo, mapping, of_kind, refuse
from ...forward.feature import Feature
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...grid import Open, Periodic
from ...known import is_traced, outside_traces
from ...modules import with_fields
from ...quantities import quantity
from ..diagnostics import beyond_modulus, negative_load
from ..line.problem import LineProblem
from ..method import Method
from ..noise.model import SampleNoise, Samples
from ..noise.residual import residual_noise
from ..nonlinear import Solver
from ..problem import Problem
from .causes import TRENDS
from .contact import checked_pressure
from .estimate import FeatureEstimate
from .fit import FeatureFitter
from .loading import FEATURES, AnyFeature, Features
from .traced import UNTRACED_CELLS, TracedFeatureEstimate, traceable, traced_estimate
from .window import stretch_of

if TYPE_CHECKING:  # of known numbers, as nearly all are
    AnyEstimate = FeatureEstimate
else:
    AnyEstimate = FeatureEstimate | TracedFeatureEstimate

MOST_TRENDS = 5  # that are looked for in what a fit leaves, one after the other


class LatestCache:
    """The latest of what was made for a sensor, a motion and so on: many problems share them."""

    def __init__(self):
        self._key, self._made = None, None

    def of(self, given: Any, make: Callable[[], Any]) -> Any:
        """What was made for the same arrays and settings, else what `make` gives."""
        key = _key(given)
        if self._made is None or key != self._key:
            self._key, self._made = key, make()
        return self._made


def _key(given: Any) -> tuple[Any, tuple[bytes, ...]]:
    """Equal for the same arrays and settings."""
    leaves, tree = jax.tree.flatten(given)
    return tree, tuple(np.asarray(leaf).tobytes() for leaf in leaves)


class FeatureFit(Method):
    """The fit of features as a method: it takes a problem and gives a `FeatureEstimate`.

    - `features`: by name; all of traction, or all of a surface, which acts through the skin's
      contact with it.
    - `solver`: of the nonlinear fit; None: optimistix.
    - `also`: of a surface, further parameters to fit: `edge_length_m`, `depth_m`, `gain`,
      `nominal_pressure_Pa`.
    - `start`: of a surface, values to start from, by the parameters' names as in the result.
    - `nominal_sensor`: a known sensor near the problem's. Its depth gives cells, search ranges and
      starts; None: the problem's own does.

    A long recording is fitted in the stretch where its signal is above the noise (see
    [`stretch_of`][]).

    The traction lies on fine cells of its own; the estimate is on the problem's line where that has
    one. A surface repeats with the problem's window, and is pressed on with its nominal pressure;
    noise whose level is an estimate is there estimated from the residual. Computations that depend
    on the sensor and its motion alone are done once.

    Under `jax.jit`, `vmap`, `grad` and `jvp`, jax may trace the data, the noise and the sensor of a
    `LineProblem`, the latter with `nominal_sensor`. The estimate is then a
    [`TracedFeatureEstimate`][].

    Raises `BadInput` for features of both kinds or none, and in a call for a surface whose nominal
    pressure is not known.
    """

    features: Mapping[str, AnyFeature]
    solver: Solver | None
    also: tuple[str, ...] = eqx.field(static=True)
    start: Mapping[str, float] = eqx.field(static=True)
    nominal_sensor: Sensor | None
    _latest: LatestCache = eqx.field(static=True, repr=False)

    def __init__(
        self,
        features: Features,
        solver: Solver | None = None,
        also: tuple[str, ...] = (),
        start: Mapping[str, float] | None = None,
        nominal_sensor: Sensor | None = None,
    ):
        wanted = "a mapping of features by name, as {'strip': StripFeature()}"
        for name, feature in mapping("features", features, wanted).items():
            refuse(
                not isinstance(feature, FEATURES),
                f"The feature {name!r} is {echo(feature)}: give one, as StripFeature().",
            )
        kinds = {feature.is_of_surface for feature in features.values()}
        refuse(
            len(kinds) != 1,
            f"The features are {echo(dict(features))}: give one or more by name, all of "
            "traction or all of a surface.",
        )
        wanted = "a solver, such as Optimistix()"
        self.features = dict(features)
        self.solver = None if solver is None else of_kind("solver", solver, Solver, wanted)
        refuse(is_traced(nominal_sensor), UNTRACED_CELLS)
        wanted = "a known sensor near the problem's, as Sensor()"
        self.nominal_sensor = (
            None
            if nominal_sensor is None
            else of_kind("nominal_sensor", nominal_sensor, Sensor, wanted)
        )
        self.also, self.start, self._latest = tuple(also), dict(start or {}), LatestCache()

    @property
    def is_of_surface(self) -> bool:
        """Whether the features act through contact."""
        return any(feature.is_of_surface for feature in self.features.values())

    def __call__(self, problem: Problem | LineProblem) -> AnyEstimate:
        return self.candidate(self.features, problem)

    def candidate(self, features: Features, problem: Problem | LineProblem) -> AnyEstimate:
        """The fit of some of the features, or of none, to the stretch of the recording that is
        chosen for all of them."""
        if is_traced(problem):
            return cast(FeatureEstimate, self._traced(features, problem))
        if isinstance(problem, LineProblem):
            return self._fitted(features, problem)
        stretch = stretch_of(problem, self.features)
        estimate = self._fitted(features, stretch.problem)
        if not stretch.is_part:
            return estimate
        evidence = estimate.log_evidence + stretch.log_prior_ratio(features)
        warnings = *estimate.warnings, *stretch.warnings
        return dataclasses.replace(estimate, log_evidence=evidence, warnings=warnings)

    def _traced(self, features: Features, problem: Problem | LineProblem) -> TracedFeatureEstimate:
        """The fit where jax traces the data, the noise or the sensor."""
        problem = traceable(features, problem)
        samples = problem.samples()
        fitter = self._fitter(problem, samples)
        return traced_estimate(fitter, features, problem, samples, self.start)

    def _fitted(self, features: Features, problem: Problem | LineProblem) -> FeatureEstimate:
        """The fit, beside a drift and jumps of the signals where these explain a misfit."""
        if isinstance(problem, LineProblem):
            return self._fit(features, problem)
        problem = problem.aligned()
        estimate, noise = self._fit(features, problem), problem.noise
        for _ in range(MOST_TRENDS):
            drifting = _with_trend(noise, estimate)
            if drifting is None:
                break
            other = self._fit(features, with_fields(problem, noise=drifting))
            odds = other.log_evidence - estimate.log_evidence
            if not odds > -np.log(false_alarm.NOISE_PART):
                break
            estimate, noise = other, drifting
        if noise.is_drift_found == problem.noise.is_drift_found:
            return estimate  # it is as stated
        return dataclasses.replace(estimate, warnings=(*estimate.warnings, _trend_found(noise)))

    def _fit(self, features: Features, problem: Problem | LineProblem) -> FeatureEstimate:
        samples = problem.samples()
        fitter, noise = self._fitter(problem, samples), samples.noise
        if self.is_of_surface and isinstance(problem, Problem) and samples.is_estimate:
            noise = residual_noise(problem, samples)
        estimate = fitter(features, samples.signal, noise, self.start, rig=problem.rig)
        return _placed(estimate, problem)

    def many(self, problems: Sequence[Problem | LineProblem]) -> list[FeatureEstimate]:
        """The estimates of many problems.

        One feature of traction is fitted to all recordings of the same sensor, motion and noise at
        once. Each fit starts where its own search leads, and from the minima of the others. A
        residual that still exceeds the noise has a warning (see [`fit_many`][]). All other problems
        are fitted one after the other.
        """
        samples = [problem.samples() for problem in problems]
        is_batched = len(self.features) == 1 and not self.is_of_surface and not self.start
        alike: dict[Any, list[int]] = {}
        for i, each in enumerate(samples):
            own = None if is_batched and problems[i].rig is None else i
            alike.setdefault((own, _key((each.sensor, each.motion, each.noise))), []).append(i)
        estimates: dict[int, FeatureEstimate] = {}
        for group in alike.values():
            if len(group) == 1:
                estimates[group[0]] = self(problems[group[0]])
                continue
            first, ((name, feature),) = samples[group[0]], self.features.items()
            fitter = self._fitter(problems[group[0]], first)
            signals = np.stack([samples[i].signal for i in group])
            fitted = fitter.estimates(name, feature, signals, first.noise)
            for i, estimate in zip(group, fitted, strict=True):
                estimates[i] = _placed(estimate, problems[i])
        return [estimates[i] for i in range(len(problems))]

    def _fitter(self, problem: Problem | LineProblem, samples: Samples) -> FeatureFitter:
        """The fitter along the samples' motion."""
        nominal = samples.sensor if self.nominal_sensor is None else self.nominal_sensor
        refuse(is_traced(nominal), UNTRACED_CELLS)
        counts = len(nominal.elements), len(samples.sensor.elements)
        refuse(
            counts[0] != counts[1],
            f"The nominal sensor has {counts[0]} films, and the problem's has "
            f"{counts[1]}: give one with as many.",
        )
        with outside_traces():
            fitter = self._fitter_of(nominal, samples.motion, problem)
        return fitter if self.nominal_sensor is None else fitter.under(samples.sensor)

    def _fitter_of(
        self, sensor: Sensor, motion: Motion, problem: Problem | LineProblem
    ) -> FeatureFitter:
        """That of a known sensor."""
        if not self.is_of_surface:
            make = lambda: FeatureFitter.along(sensor, motion, self.solver)  # noqa: E731
            return self._latest.of((sensor, motion), make)
        window, pressure = problem.window, checked_pressure(problem.nominal_pressure_Pa)
        repeats = isinstance(problem, LineProblem) and isinstance(problem.line, Periodic)
        kind = Periodic if repeats else Open
        given = window, pressure, self.also, self.solver, kind
        return self._latest.of(
            (sensor, motion, tuple(window), pressure, kind),
            lambda: FeatureFitter.on_window(sensor, motion, self.features, *given),
        )


def _with_trend(noise: SampleNoise, estimate: FeatureEstimate) -> SampleNoise | None:
    """The noise with a drift or a further jump, where that explains most of what a fit beside it
    leaves."""
    cause = estimate.causes[0] if estimate.causes else None
    if cause is not None and cause.name == "jump_s" and cause.value not in noise.jumps_s:
        jumps_s = (*noise.jumps_s, cause.value)
        return with_fields(noise, is_drift_found=True, jumps_s=jumps_s)
    if cause is not None and cause.name in TRENDS and not noise.is_drift_found:
        return with_fields(noise, is_drift_found=True)
    return None


def _trend_found(noise: SampleNoise) -> str:
    """Warning on a drift or jumps that nobody stated."""
    where = ", ".join(quantity(each, "s") for each in sorted(noise.jumps_s))
    there_is = "A constant or a drift is on the signals"
    if where:
        there_is = f"The signals jump (at {where} from the first sample)"
    return (
        f"{there_is}, which no feature of this kind makes. It is estimated jointly with the "
        "features. If it is a drift, give recording.drift=auto."
    )


def _placed(estimate: FeatureEstimate, problem: Problem | LineProblem) -> FeatureEstimate:
    """The estimate on the problem's own line and over its background, with its warnings."""
    placed = estimate.of_problem(problem)
    pulling = _pulling(placed, problem.surrounding_pressure_Pa)
    beyond = _beyond(placed, problem.modulus_Pa)
    warnings = *problem.warnings, *placed.warnings, *pulling, *beyond
    return dataclasses.replace(placed, warnings=warnings)


def _beyond(estimate: FeatureEstimate, modulus_Pa: float | None) -> Sequence[str]:
    """Warning on loads, or a fitted nominal pressure, that are beyond what the skin bears. At the
    edges of a surface contact presses harder than that."""
    named = [pair for name, pair in estimate.parameters.items() if name.endswith(Feature.amplitude)]
    value, stderr = np.array(named, float).reshape(-1, 2).T
    stderr = np.where(np.isfinite(stderr), stderr, 0.0)
    return beyond_modulus(value, stderr, modulus_Pa, float(len(named)))


def _pulling(estimate: FeatureEstimate, surrounding_Pa: float) -> Sequence[str]:
    """Warning on a feature that pulls. Of several the sum may press all the same, and so does a
    line where its surroundings press."""
    if len(estimate.features) != 1:
        return ()
    ((name, feature),) = estimate.features.items()
    if feature.is_of_surface or feature.is_periodic:
        return ()
    value, stderr = estimate.parameters[feature.amplitude]
    is_pressure = feature.amplitude == Feature.amplitude
    if surrounding_Pa > 0 and not is_pressure:
        return ()
    return negative_load(name, value + surrounding_Pa, stderr)
