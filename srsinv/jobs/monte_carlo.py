"""Every method's answer to every problem that was drawn, with its time, as trials."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Float

from ..errors import refuse
from ..forward.feature import Feature
from ..inverse.estimate import Estimate
from ..inverse.features.method import FeatureFit
from ..inverse.line.problem import LineProblem
from ..inverse.method import Method
from ..inverse.nonlinear import Solver
from ..report.text import unit_of, without_unit
from .estimates import Answers, Variables
from .trials import Row, Trial, TrialRows

FEATURE_FIT = "Feature fit"
Problem = TypeVar("Problem")
Answer = TypeVar("Answer")


def simulate_and_fit(
    problems: Sequence[Problem],
    methods: Mapping[str, Callable[[Problem], Answer]],
    shape: tuple[int, ...] | None = None,
) -> Answers[Answer]:
    """Every method on every problem; `shape` of the array of problems, None for a row of them."""
    answers, times = {}, []
    for name, method in methods.items():
        trials = [
            Trial({"method": name, "problem": i}, partial(partial, method, problem), _answer)
            for i, problem in enumerate(problems)
        ]
        rows = TrialRows().of_all(trials, f"{name}, {len(problems)} times")
        answers[name] = tuple(row["answer"] for row in rows)
        times.append([row["first_call_s"] for row in rows])
    first, *further = np.array(times).T
    steady = np.median(further or [first], axis=0)
    return Answers(answers, first, steady, (len(problems),) if shape is None else shape)


def _answer(answer: Any) -> Row:
    return {"answer": answer}


def inversions(
    methods: Mapping[str, Method], features: Mapping[str, Feature], solver: Solver
) -> dict[str, Callable[[LineProblem], Estimate]]:
    """The methods by the page's names, and the fit of the sum of features, where there are any.

    Raises `BadInput` for fewer than two, and for a method of the label that the fit has.
    """
    refuse(
        FEATURE_FIT.lower() in map(str.lower, methods),
        f"A method has the label {FEATURE_FIT!r}, which the fit of features has: name its file "
        "otherwise.",
    )
    named = dict(methods) | ({FEATURE_FIT: FeatureFit(features, solver)} if features else {})
    refuse(
        len(named) < 2,
        f"There are fewer than two methods to compare ({len(named)}): give at least "
        "two, by method=[wiener_evidence,tikhonov] and feature=[strip_load].",
    )
    return {name: computed(method) for name, method in named.items()}


def computed(method: Method) -> Callable[[LineProblem], Estimate]:
    """The method with its traction and bands computed, which else are when they are asked for."""

    def solve(problem: LineProblem) -> Estimate:
        estimate = method(problem)
        jax.block_until_ready((estimate.value, estimate.stderr))
        return estimate

    return solve


def fit_variables(answers: Answers[Estimate], dims: Sequence[str]) -> Variables:
    """How well every answer fits its signal, over methods and the problems' `dims`."""
    by = ("estimator", *dims)
    return {
        "misfit": (by, answers.each(lambda e: e.misfit), "1"),
        "converged": (by, answers.each(lambda e: e.status == "converged").astype(np.int8), "1"),
        "quality": (by, answers.each(lambda e: str(e.quality)), "1"),
        "log_evidence": (by, answers.each(lambda e: getattr(e, "log_evidence", np.nan)), "1"),
    }


def parameter_coordinates(answers: Answers[Estimate]) -> Variables:
    """Coordinates of the parameters of the feature fit, if any."""
    names = parameter_names(answers) if FEATURE_FIT in answers.of else []
    return {
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
