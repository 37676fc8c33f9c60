"""How features load the skin: from their parameters to the traction on a line."""

import abc
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...forward.feature import Feature, ScanExtent
from ...forward.operator import MotionOperator
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...forward.surface_feature import SurfaceFeature
from ...grid import Line
from ..nonlinear import Fit, Solver
from ..rig.setup import Setup

AnyFeature = Feature | SurfaceFeature
FEATURES = (Feature, SurfaceFeature)
Features = Mapping[str, Any]  # by name, all of the loading's kind
Traction = Float[Array, "2 n"]
Range = tuple[float, float]
Normal = tuple[float, Any]  # mean and standard deviation of a prior


class TrialShapes(NamedTuple):
    """Shapes that a search tries: their parameters (start,) by name, and the signals of unit linear
    parameters (start, part, e, sample) beyond the `fixed` one (start, e, sample)."""

    shapes: dict[str, np.ndarray]
    fixed: np.ndarray
    signals: np.ndarray


@runtime_checkable
class Strengths(Protocol):
    """How strong a feature's signals are, as a search has tried them."""

    def strongest(self, feature: AnyFeature) -> list[float]:
        """The strongest signal of each unit linear parameter over all shapes."""
        ...

    def relative_signal(self, feature: AnyFeature, own: Mapping[str, Any]) -> np.ndarray:
        """That of shapes (b,), relative to the strongest: (b, a)."""
        ...


class Loading(eqx.Module):
    """How features load the skin.

    - `PROFILES`: names of what acts along the line, p and q [Pa] first.
    - `FACTS`: those of the rig's facts of contact that the loading follows from.
    - `LINEAR`: of the parameters that are no feature's, those that enter linearly.
    - `ARE_FEW`: whether all shapes that a search tries are few enough to be held at once.
    """

    PROFILES: ClassVar[tuple[str, ...]] = ("p", "q")
    FACTS: ClassVar[tuple[str, ...]] = ()
    LINEAR: ClassVar[tuple[str, ...]] = ()
    ARE_FEW: ClassVar[bool] = True

    # --- the model ---

    @abc.abstractmethod
    def tractions(
        self, line: Line, features: Features, params: Any, directions: tuple[bool, ...]
    ) -> list[Traction]:
        """p and q [Pa] on the line, beyond their background, for each way of sliding."""

    @abc.abstractmethod
    def cell_traction(self, line: Line, features: Features, params: Any, onto: Line) -> Traction:
        """Averages of p and q [Pa] over the cells of any line, while sliding towards +x; `line` is
        the features' own."""

    def end(self, features: Features, params: Any) -> Float[Array, " 2"] | None:
        """p and q [Pa] that go on beyond the line's end while sliding towards +x."""
        del features, params
        return None

    def profiles(self, line: Line, features: Features, params: Any) -> Float[Array, "profile n"]:
        """What acts along the line while sliding towards +x, in the order of `PROFILES`."""
        return self.tractions(line, features, params, (True,))[0]

    def operator(self, operator: MotionOperator, features: Features, params: Any) -> MotionOperator:
        """The operator at these parameters."""
        del features, params
        return operator

    def at(self, sensor: Sensor, motion: Motion) -> "Loading":
        """The loading of another sensor and motion."""
        del sensor, motion
        return self

    def with_operator_of(self, sensor: Sensor, motion: Motion) -> "Loading":
        """The loading as the operator is made of another sensor and motion, but not the contact:
        itself where it leaves the operator as it is."""
        del sensor, motion
        return self

    @property
    def freed(self) -> tuple[str, ...]:
        """Names of the rig's facts that are fitted as parameters."""
        return ()

    def params_at(self, features: Features, params: Any, setup: Setup) -> Any:
        """The parameters with the facts of a setup, those that are `freed` aside."""
        del features, setup
        return params

    def gain(self, params: Any) -> Any:
        """A factor on the signal; None for none."""
        del params
        return None

    def steps(self, line: Line, features: Features) -> dict[str, float]:
        """Steps for central differences, by parameter, where derivatives need them."""
        del line, features
        return {}

    # --- the search ---

    @abc.abstractmethod
    def trial_shapes(
        self, model: Any, feature: AnyFeature, stretch: ScanExtent, given: Mapping[str, float]
    ) -> Iterator[TrialShapes]:
        """The shapes of a feature to try on a coarse model, a part at a time; `given`: the user's
        start values of some of its parameters, or of all, which are then one more shape."""

    # --- the fit ---

    def common(self) -> dict[str, Any]:
        """Start values of parameters that are no feature's."""
        return {}

    @abc.abstractmethod
    def begun(self, feature: AnyFeature) -> dict[str, float]:
        """A feature's parameters beside its shape, to start from."""

    @abc.abstractmethod
    def bounds(self, line: Line, features: Features, stretch: ScanExtent) -> dict[str, Range]:
        """Bounds of all free parameters that are not linear."""

    @abc.abstractmethod
    def priors(
        self, name: str, feature: AnyFeature, reach: Any, search: "Strengths"
    ) -> dict[str, Normal]:
        """(mean, standard deviation) of a feature's linear parameters; `reach`: the signal at one
        standard deviation of an amplitude."""

    def log_prior_ratio(
        self, feature: AnyFeature, own: Mapping[str, Any], search: "Strengths"
    ) -> Float[np.ndarray, " b"]:
        """Log of the priors' densities that belong to fitted shapes (b,), over those of the fit."""
        del feature, search
        return np.zeros(np.size(next(iter(own.values()))))

    def common_priors(self) -> dict[str, Range]:
        """Those of the linear parameters that are no feature's."""
        return {}

    def solver(self, solver: Solver | None, has_facts: bool = False) -> Solver | None:
        """The solver, told what the residual is like; `has_facts`: beside those of the rig."""
        del has_facts
        return solver

    @abc.abstractmethod
    def values(self, features: Features, params: Any) -> dict[str, float]:
        """Reported values of parameters, among others that a fit may not report."""

    @abc.abstractmethod
    def report(self, features: Features, fit: Fit) -> dict[str, tuple[float, float]]:
        """Reported value and standard error of each parameter."""

    def accepted(self, features: Features, fit: Fit) -> Fit:
        """The fit, without those of its parameters on a bound that end there by their nature."""
        del features
        return fit

    def warnings(self, line: Line, features: Features, fit: Fit) -> tuple[str, ...]:
        """Warnings on the fit, beside those that every fit has."""
        del line, features, fit
        return ()

    def intervals(self, features: Features, fit: Fit) -> dict[str, tuple[float, float]]:
        """90 % intervals, by reported names, of parameters whose standard error gives none."""
        del features, fit
        return {}


def turned(traction: Float[Array, "2 *n"]) -> Float[Array, "2 *n"]:
    """p and q while sliding back, of those while sliding towards +x: friction turns."""
    return traction * jnp.array([1.0, -1.0]).reshape(2, *[1] * (traction.ndim - 1))
