"""The Monte Carlo runner: every method's answer to every problem that was drawn, with its time."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar

import jax
import numpy as np
from jaxtyping import Float

from ..errors import refuse
from ..forward.feature import Feature
from ..inverse.estimate import COMPONENTS, Estimate
from ..inverse.features.method import FeatureFit
from ..inverse.line.problem import LineProblem
from ..inverse.method import Method
from ..inverse.nonlinear import Solver
from ..progress import steps
from ..report.text import unit_of, without_unit

FEATURE_FIT = "Feature fit"
Variables = dict[str, tuple[Any, ...]]
Problem = TypeVar("Problem")
Answer = TypeVar("Answer")


@dataclasses.dataclass(frozen=True)
class Answers(Generic[Answer]):
    """Answers to the same problems: of each method one for each problem, and the times [s] of the
    calls. The problems are those of an array of `shape`, its last dimension the fastest."""

    of: Mapping[str, Sequence[Answer]]
    time_s: Float[np.ndarray, "method problem"]
    shape: tuple[int, ...]

    def each(self, get: Callable[[Answer], Any]) -> np.ndarray:
        """(method, *shape, ...): what `get` takes from each answer."""
        rows = np.asarray([[get(answer) for answer in answers] for answers in self.of.values()])
        return rows.reshape(len(self.of), *self.shape, *rows.shape[2:])

    def mapped(self, change: Callable[[Answer], Answer]) -> "Answers[Answer]":
        """The same with every answer changed."""
        of = {name: tuple(map(change, answers)) for name, answers in self.of.items()}
        return dataclasses.replace(self, of=of)

    @property
    def first_call_s(self) -> Float[np.ndarray, " method"]:
        """Time of each method's first call, which includes any compilation."""
        return self.time_s[:, 0]

    @property
    def steady_call_s(self) -> Float[np.ndarray, " method"]:
        """Median of the times of the further calls."""
        return np.median(self.time_s[:, 1:] if self.time_s.shape[1] > 1 else self.time_s, axis=1)


def simulate_and_fit(
    problems: Sequence[Problem],
    methods: Mapping[str, Callable[[Problem], Answer]],
    shape: tuple[int, ...] | None = None,
) -> Answers[Answer]:
    """Every method on every problem; `shape` of the array of problems, None for a row of them."""
    answers, times = {}, []
    for name, method in methods.items():
        with steps(f"{name}, {len(problems)} times", problems) as each:
            answers[name], own = zip(*(_timed(method, problem) for problem in each), strict=True)
        times.append(own)
    return Answers(answers, np.array(times), (len(problems),) if shape is None else shape)


def _timed(method: Callable[[Problem], Answer], problem: Problem) -> tuple[Answer, float]:
    start = time.perf_counter()
    answer = method(problem)
    return answer, time.perf_counter() - start


def inversions(
    methods: Mapping[str, Method], features: Mapping[str, Feature], solver: Solver
) -> dict[str, Callable[[LineProblem], Estimate]]:
    """The methods by the page's names, and the fit of the sum of features, where there are any.

    Raises `BadInput` for fewer than two.
    """
    named = dict(methods) | ({FEATURE_FIT: FeatureFit(features, solver)} if features else {})
    refuse(
        len(named) < 2,
        f"There are fewer than two methods to compare ({len(named)}): give two at least, by "
        "method=[wiener_evidence,tikhonov] and feature=[strip_load].",
    )
    return {name: computed(method) for name, method in named.items()}


def computed(method: Method) -> Callable[[LineProblem], Estimate]:
    """The method with its traction and bands computed, which else are when they are asked for."""

    def solve(problem: LineProblem) -> Estimate:
        estimate = method(problem)
        jax.block_until_ready((estimate.value, estimate.stderr))
        return estimate

    return solve


def estimate_variables(
    answers: Answers[Estimate], dims: Sequence[str], units: tuple[str, str]
) -> Variables:
    """What every estimate of p and q gives, over methods and the problems' `dims`; `units` of
    signal and traction."""
    by, (signal, traction) = ("estimator", *dims), units
    return {
        "estimate": ((*by, "component", "x"), answers.each(lambda e: e.value), traction),
        "fitted_signal": ((*by, "element", "x"), answers.each(lambda e: e.fitted), signal),
        "misfit": (by, answers.each(lambda e: e.misfit), "1"),
        "converged": (by, answers.each(lambda e: e.status == "converged").astype(np.int8), "1"),
        "quality": (by, answers.each(lambda e: str(e.quality)), "1"),
        "log_evidence": (by, answers.each(lambda e: getattr(e, "log_evidence", np.nan)), "1"),
        "first_call_s": ("estimator", answers.first_call_s, "s", "first_call_s_{estimator}"),
        "steady_call_s": ("estimator", answers.steady_call_s, "s", "steady_call_s_{estimator}"),
    }


def estimate_coordinates(problem: LineProblem, answers: Answers[Estimate]) -> Variables:
    """Coordinates of [`estimate_variables`][], and of the parameters of the feature fit, if any."""
    assert problem.sensor is not None
    names = parameter_names(answers) if FEATURE_FIT in answers.of else []
    return {
        "x": (np.asarray(problem.line.x), "m"),
        "component": (list(COMPONENTS), "1"),
        "estimator": (list(answers.of), "1"),
        "element": (problem.sensor.element_names, "1"),
        "parameter": (names, "1"),
        "unit": ("parameter", [unit_of(name) for name in names], "1"),
        "words": ("parameter", [without_unit(name) for name in names], "1"),
    }


def parameter_names(answers: Answers[Estimate]) -> list[str]:
    """The names of the feature fit's parameters: a fit without a load has no friction."""
    return list(dict.fromkeys(name for fit in answers.of[FEATURE_FIT] for name in fit.parameters))


def parameter_draws(answers: Answers[Estimate]) -> Float[np.ndarray, "*draw parameter 2"]:
    """Value and standard error of the feature fit's parameters, in SI units, NaN where a fit has
    none of the name."""
    names, none = parameter_names(answers), (np.nan, np.nan)
    fits = [[fit.parameters.get(name, none) for name in names] for fit in answers.of[FEATURE_FIT]]
    return np.array(fits).reshape(*answers.shape, -1, 2)
