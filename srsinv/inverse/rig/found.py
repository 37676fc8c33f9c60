"""Facts of a rig that were found at the greatest evidence, and the problem under them."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...errors import refuse
from ..line.problem import LineProblem
from .error import FOUND, RigError
from .maxima import greatest, information_of
from .stationary import DEPTH, FARTHEST, StationaryEvidence, gain_of

# Standard errors beyond which a fact is not identifiable, in logarithms and radians: 10 % of a
# depth or a gain, as what is stated by hand is better than that, and 6 degrees.
MOST_STDERR = 0.1
NEAR_END = 0.98  # of the range of a fact, where its search ends
TRIED = 0.05  # a change of a fact, which has to change the response


class FoundRig(RigError):
    """The covariance of facts that the signals of an unknown surface showed, and of those that were
    stated beside them. `with_area`: strips whose width changes their charge."""

    with_area: tuple[str, ...] = eqx.field(static=True, default=())

    def sources(self, directions: int) -> tuple[str, ...]:
        return (FOUND,) * directions

    def keeps_area(self, name: str) -> bool:
        return name.startswith("strip_width_") and name not in self.with_area


class FoundFacts(NamedTuple):
    """Facts of a rig at the greatest evidence of a `stated` problem.

    - `model` of the evidence; `x`: its parameters there; `covariance` of `x`.
    - `names` of the unknown facts; `lost`: those that the signals do not determine.
    - `log_evidence`: its logarithm, a constant aside.
    """

    stated: LineProblem
    model: StationaryEvidence
    x: Float[np.ndarray, " m"]
    covariance: Float[np.ndarray, "m m"]
    names: tuple[str, ...]
    lost: tuple[str, ...] = ()
    log_evidence: float = np.nan

    @classmethod
    def of(cls, problem: LineProblem, names: tuple[str, ...]) -> "FoundFacts":
        """Those of a problem's signals. Raises `BadInput` where the sensor's response does not
        change with one of them."""
        model = cls.model_of(problem, names)
        best = greatest(model)
        found = cls.at(problem, model, best.x)
        ranges = (FARTHEST[name.split("_")[0]] for name in names)
        at_end = [abs(each) > NEAR_END * most for each, most in zip(best.x, ranges, strict=False)]
        is_lost = np.array(at_end) | (best.stderr > MOST_STDERR) | (not best.converged)
        lost = tuple(name for name, each in zip(names, is_lost, strict=True) if each)
        wider = np.ones(len(best.x))
        wider[: len(names)] = best.stderr / np.sqrt(np.diag(found.covariance)[: len(names)])
        covariance = found.covariance * np.outer(wider, wider)
        return found._replace(covariance=covariance, lost=lost, log_evidence=-best.value)

    @classmethod
    def model_of(cls, problem: LineProblem, names: tuple[str, ...]) -> StationaryEvidence:
        """The evidence of a problem's signals, as a function of these facts. Raises `BadInput`
        where the response does not change with one of them."""
        values = tuple(_stated_value(problem, name) for name in names)
        model = StationaryEvidence.of(problem, names, values, _other_facts(problem, names))
        start = model.start()
        response = np.asarray(gain_of(model, start))
        for i, name in enumerate(names):
            changed = start.copy()
            changed[i] = TRIED
            refuse(
                np.array_equal(np.asarray(gain_of(model, changed)), response),
                f"The sensor's response does not change with {name}, as it was measured or has no "
                "such fact: leave it out of method.semi_blind.unknown.",
            )
        return model

    @classmethod
    def at(
        cls, problem: LineProblem, model: StationaryEvidence, x: Float[np.ndarray, " m"]
    ) -> "FoundFacts":
        """The facts of these parameters, of the covariance that the signals leave them."""
        covariance = np.linalg.inv(np.asarray(information_of(model, x)))
        return cls(problem, model, x, covariance, model.unknown)

    def without(self, names: tuple[str, ...]) -> "FoundFacts":
        """Those of the same signals, but for facts of these names, which are as stated."""
        left = tuple(name for name in self.names if name not in names)
        if not left:
            return self._replace(names=(), lost=())
        return FoundFacts.of(self.stated, left)

    @property
    def values(self) -> Float[np.ndarray, " u"]:
        """The unknown facts in their own units; gains relative to what is stated."""
        model = self.model
        changes = [model.change(name, i, self.x[i]) for i, name in enumerate(model.unknown)]
        return np.asarray(model.values) + np.array(changes, float)

    @property
    def slopes(self) -> Float[np.ndarray, " u"]:
        """The change of each fact, in its own unit, by its parameter."""
        named = zip(self.model.unknown, self.values, strict=True)
        return np.array([180 / np.pi if n.startswith("angle") else value for n, value in named])

    def reported(self, name: str) -> tuple[str, float, float]:
        """The name of a fact among an estimate's parameters, its value and its standard error."""
        i = self.model.unknown.index(name)
        stderr = float(self.slopes[i] * np.sqrt(self.covariance[i, i]))
        return name.replace("gain_", "gain_ratio_"), float(self.values[i]), stderr

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Values and standard errors of the facts, by the names that an estimate has."""
        each = (self.reported(name) for name in self.names)
        return {key: (value, stderr) for key, value, stderr in each}

    @property
    def problem(self) -> LineProblem:
        """The problem under the facts found, with their errors; the speed as it is stated."""
        model, of = self.model, self.model.parted(self.x)
        size = of.unknown.size + of.facts.size
        x, covariance = self.x[:size].copy(), self.covariance[:size, :size]
        root = np.asarray(model.root)
        if "speed" in model.facts:
            row = np.zeros(size)
            row[of.unknown.size :] = root[model.facts.index("speed")]
            x -= covariance @ row * (row @ x) / (row @ covariance @ row)
        known = self._replace(x=np.append(x, self.x[size:]))
        sensor = model.setup(model.parted(known.x)).sensor
        return self.stated.with_rig(sensor, known._rig(covariance))

    def _rig(self, covariance: Float[np.ndarray, "i i"]) -> FoundRig:
        """The errors of all facts; `covariance`: of the parameters of those of the model. The gain
        of element 1 is that of all, where others are found beside it."""
        model, root = self.model, np.asarray(self.model.root)
        of = model.parted(self.x)
        to_facts = np.zeros((of.unknown.size + len(root), len(covariance)))
        to_facts[: of.unknown.size, : of.unknown.size] = np.diag(self.slopes)
        to_facts[of.unknown.size :, of.unknown.size :] = root
        whole = to_facts @ covariance @ to_facts.T
        values = np.append(self.values, np.asarray(model.fact_values) + root @ of.facts)
        names = (*model.unknown, *model.facts)
        common = _common_gain(self.stated, model.unknown)
        if common is not None:
            is_gain = np.array([name.startswith("gain_") for name in names])
            row = np.append(values * is_gain, 1.0) * common
            whole = np.pad(whole, (0, 1)) + np.outer(row, row)
            names, values = (*names, "gain_1"), np.append(values, 1.0)
        keeps = dict(zip(model.facts, model.keeps_area, strict=True))
        with_area = tuple(n for n in model.facts if not keeps[n])
        return FoundRig(names, values, (whole + whole.T) / 2, with_area=with_area)


def _stated_value(problem: LineProblem, name: str) -> float:
    """What is stated of a fact; of a gain 1."""
    sensor = problem.sensor
    assert sensor is not None
    if name == DEPTH:
        return float(sensor.depth_m)
    if name.startswith("angle_"):
        return float(np.rad2deg(sensor.elements[int(name.split("_")[1]) - 1].angle_rad))
    return 1.0


def _stated_rig(problem: LineProblem) -> RigError | None:
    of_signals = None if problem.rig is None else problem.rig.of_signals
    return of_signals if isinstance(of_signals, RigError) else None


def _other_facts(problem: LineProblem, names: tuple[str, ...]) -> RigError | None:
    """What is known of the facts that are not searched for. The gain of element 1 goes with the
    traction's level where those of others are found beside it."""
    rig, found = _stated_rig(problem), set(names)
    if any(name.startswith("gain_") for name in names):
        found.add("gain_1")
    return None if rig is None else rig.without(frozenset(found))


def _common_gain(problem: LineProblem, names: tuple[str, ...]) -> float | None:
    """The relative standard error of the gain of element 1, where others are found beside it."""
    rig = _stated_rig(problem)
    if rig is None or "gain_1" not in rig.names or not any(n.startswith("gain_") for n in names):
        return None
    i = rig.names.index("gain_1")
    return float(rig.stderr[i] / abs(rig.values[i]))
