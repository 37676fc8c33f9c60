"""One dataset of estimates: what methods make of the same signals, and their scores by a truth.

Every variable is (dims, values, units) as [`srsinv.report.data.dataset`][] takes it. `dims` are
those of the array of problems that were solved; there are none for one problem.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from jaxtyping import Float

from ..inverse.constrained_estimate import ConstrainedEstimate
from ..inverse.diagnostics import without_wiring
from ..inverse.estimate import COMPONENTS, Estimate, relative_error
from ..inverse.line.problem import LineProblem
from ..inverse.quality import Quality

Variables = dict[str, tuple[Any, ...]]
Answer = TypeVar("Answer")


@dataclasses.dataclass(frozen=True)
class Answers(Generic[Answer]):
    """Answers to the same problems, one for each method and problem, with times [s].

    - `first_call_s` (method,): the first call, which includes any compilation; `steady_call_s`
      (method,): further ones.
    - `shape`: of the array of problems, its last dimension the fastest.
    """

    of: Mapping[str, Sequence[Answer]]
    first_call_s: Float[np.ndarray, " method"]
    steady_call_s: Float[np.ndarray, " method"]
    shape: tuple[int, ...] = ()

    def each(self, get: Callable[[Answer], Any]) -> np.ndarray:
        """(method, *shape, ...): what `get` takes from each answer."""
        rows = np.asarray([[get(answer) for answer in answers] for answers in self.of.values()])
        return rows.reshape(len(self.of), *self.shape, *rows.shape[2:])

    def mapped(self, change: Callable[[Answer], Answer]) -> "Answers[Answer]":
        """The same with every answer changed."""
        of = {name: tuple(map(change, answers)) for name, answers in self.of.items()}
        return dataclasses.replace(self, of=of)

    @property
    def first(self) -> dict[str, Answer]:
        """Each method's answer to the first problem."""
        return {name: answers[0] for name, answers in self.of.items()}


def of_simulated(variables: Variables) -> Variables:
    """Variables of answers to simulated signals: warnings without advice on a recording's
    wiring."""
    said = {
        name: (dim, [without_wiring(each) for each in texts], *rest)
        for name, (dim, texts, *rest) in variables.items()
        if name in ("warnings", "reasons")
    }
    return variables | said


def estimate_variables(
    answers: Answers[Estimate], dims: Sequence[str], units: tuple[str, str], cells: np.ndarray
) -> Variables:
    """p and q with their standard errors, the fitted signal with what it leaves, and the times of
    the calls; `units` of signal and traction; `cells` (n,): a mask of those that were measured."""
    by, (signal, traction) = ("estimator", *dims), units
    along, samples = (*by, "component", "x"), (*by, "element", "x")
    return {
        "estimate": (along, answers.each(lambda e: e.value), traction),
        "estimate_stderr": (along, answers.each(lambda e: valid_stderr(e, cells)), traction),
        **_band_variables(answers, along, traction),
        "fitted_signal": (samples, answers.each(lambda e: e.fitted), signal),
        "whitened_residual": (samples, answers.each(lambda e: e.whitened), "1"),
        "first_call_s": ("estimator", answers.first_call_s, "s", "first_call_s_{estimator}"),
        "steady_call_s": ("estimator", answers.steady_call_s, "s", "steady_call_s_{estimator}"),
    }


def _band_variables(answers: Answers[Estimate], along: tuple[str, ...], unit: str) -> Variables:
    """The ends of 90 % bands, where some are not symmetric."""
    every = (answer for each in answers.of.values() for answer in each)
    if not any(isinstance(answer, ConstrainedEstimate) for answer in every):
        return {}
    ends = zip(("estimate_low", "estimate_high"), (0, 1), strict=True)
    return {name: (along, answers.each(lambda e, i=i: e.band[i]), unit) for name, i in ends}


def score_variables(
    answers: Answers[Estimate], dims: Sequence[str], truth: Float[np.ndarray, "c n"],
    cells: np.ndarray,
) -> Variables:  # fmt: skip
    """Relative error of p and of q, and the fraction of `cells` whose 90 % band holds the truth,
    all of the deviation from the mean over these; NaN where a method gives no band."""
    by, value = ("estimator", *dims, "component"), answers.each(lambda e: e.value)
    stderr = answers.each(lambda e: e.deviation(cells)[1])
    inside = answers.each(lambda e: e.coverage(truth, cells))
    has_band = ~np.isnan(stderr[..., cells]).all(axis=-1)
    return {
        "error": (by, relative_error(value, truth, cells), "1"),
        "coverage": (by, np.where(has_band, inside, np.nan), "1"),
    }


def valid_stderr(estimate: Estimate, cells: np.ndarray) -> Float[np.ndarray, "2 n"]:
    """Standard errors of the deviation from the mean over `cells`; infinite where the answer
    failed."""
    stderr = estimate.deviation(cells)[1]
    return np.full_like(stderr, np.inf) if estimate.quality is Quality.FAILED else stderr


def estimate_coordinates(problem: LineProblem, names: Sequence[str]) -> Variables:
    """Coordinates of [`estimate_variables`][] by methods of these names."""
    assert problem.sensor is not None
    return {
        "x": (np.asarray(problem.line.x), "m"),
        "component": (list(COMPONENTS), "1"),
        "estimator": (list(names), "1"),
        "element": (problem.sensor.element_names, "1"),
    }
