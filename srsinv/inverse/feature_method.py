"""Fits of features as methods: a problem to the features' parameters and the traction they make."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np

from ..forward.feature import Feature
from ..forward.surface_feature import SurfaceFeature
from .feature_estimate import FeatureEstimate
from .feature_fit import FeatureFitter
from .line_problem import LineProblem
from .method import Method
from .nonlinear import Optimistix, Solver
from .problem import Problem
from .surface_fit import SurfaceFitter
from .surface_model import checked_pressure

Fitter = TypeVar("Fitter")


class Latest:
    """The latest of what was made for a sensor, a motion and so on: many problems share them."""

    def __init__(self):
        self._key, self._made = None, None

    def of(self, given: Any, make: Callable[[], Any]) -> Any:
        """What was made for the same arrays and settings, else what `make` gives."""
        leaves, tree = jax.tree.flatten(given)
        key = tree, tuple(np.asarray(leaf).tobytes() for leaf in leaves)
        if self._made is None or key != self._key:
            self._key, self._made = key, make()
        return self._made


class FeatureFit(Method):
    """Features of traction, fitted together as a sum.

    - `features`: by name. `solver`: of the nonlinear fit.

    Their traction lies on fine cells of its own; the estimate is on the problem's line where that
    has one. Computations that depend on the sensor and its motion alone are done once.
    """

    features: Mapping[str, Feature]
    solver: Solver = Optimistix()
    _latest: Latest = eqx.field(static=True, default_factory=Latest, repr=False)

    def fitter(self, problem: Problem | LineProblem) -> FeatureFitter:
        """The fitter along the problem's motion."""
        sensor, motion, *_ = problem.samples()
        return self._latest.of((sensor, motion), lambda: FeatureFitter(sensor, motion, self.solver))

    def __call__(self, problem: Problem | LineProblem) -> FeatureEstimate:
        return self.candidate(self.features, problem)

    def candidate(
        self, features: Mapping[str, Any], problem: Problem | LineProblem
    ) -> FeatureEstimate:
        """The fit of some of the features, or of none."""
        samples = problem.samples()
        estimate = self.fitter(problem)(features, samples.signal, samples.noise)
        return _placed(estimate, problem)


class SurfaceFit(Method):
    """Features of a surface, fitted together as a sum, through the skin's contact with it.

    - `features`: by name. `solver`: of the nonlinear fit.
    - `also`: further parameters to fit, of `surface_fit.KNOWN`; `start`: values to start from, by
      the parameters' names as in the result.

    The surface repeats with the problem's window, pressed on with its nominal pressure; raises
    `BadInput` where that is not known. Noise whose level is an estimate is estimated from the
    residual.
    """

    features: Mapping[str, SurfaceFeature]
    solver: Solver = Optimistix()
    also: tuple[str, ...] = eqx.field(static=True, default=(), converter=tuple)
    start: Mapping[str, float] = eqx.field(static=True, default_factory=dict)
    _latest: Latest = eqx.field(static=True, default_factory=Latest, repr=False)

    def fitter(self, problem: Problem | LineProblem) -> SurfaceFitter:
        """The fitter along the problem's motion."""
        sensor, motion, *_ = problem.samples()
        window, pressure = problem.window, checked_pressure(problem.background_Pa[0])

        def make() -> SurfaceFitter:
            return SurfaceFitter(
                sensor, motion, self.features, window, pressure, self.also, self.solver
            )

        return self._latest.of((sensor, motion, tuple(window), pressure), make)

    def __call__(self, problem: Problem | LineProblem) -> FeatureEstimate:
        return self.candidate(self.features, problem)

    def candidate(
        self, features: Mapping[str, Any], problem: Problem | LineProblem
    ) -> FeatureEstimate:
        """The fit of some of the features, or of none."""
        samples = problem.samples()
        noise = None if samples.is_estimate else samples.noise
        estimate = self.fitter(problem)(features, samples.signal, noise, self.start)
        return _placed(estimate, problem)


def _placed(estimate: FeatureEstimate, problem: Problem | LineProblem) -> FeatureEstimate:
    """The estimate over the problem's background, and on its line where it has one."""
    return estimate.of_problem(problem.background_Pa, problem.own_line, problem.passed)
