"""The comparison on a recording, without a truth: methods are scored on held-out samples.

The recording's cells are split into two halves, every other one to each: over a depth there are
several cells, so that either half determines the same traction, with independent noise. A method's
fit to one half is compared with the samples of the other.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float, Int

from ..inverse.estimate import COMPONENTS, Estimate, deviation
from ..inverse.line.problem import LineProblem
from ..numerics import mean_known
from ..report.answers import answer_variables
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from ..report.text import significant
from ._statistics import differences, ranks
from .estimates import Answers, Variables, estimate_coordinates, estimate_variables
from .monte_carlo import (
    FEATURE_FIT,
    fit_variables,
    parameter_coordinates,
    parameter_draws,
    simulate_and_fit,
)

ROUNDING = 1e-9  # of the range: values that differ by less are the same but for rounding
PARTS = ("all", "even cells", "odd cells")
BY = ("estimator", "part")


def on_recording(
    name: str,
    problem: LineProblem,
    methods: Mapping[str, Callable[[LineProblem], Estimate]],
    units: tuple[str, str],
    facts: Mapping[str, Any],
) -> Result:
    """Every method on all cells of the recording and on its two halves; `units` of the signal and
    of p and q, "1" where they are relative."""
    problems = problem, *split_odd_even(problem)
    answers = simulate_and_fit(problems, methods)
    signal = np.asarray(problem.data + problem.mean_signal)
    signal = np.where(problem.is_observed, signal, np.nan)
    of_all = answer_variables(answers.first)
    of_all["quality_all"] = of_all.pop("quality")
    halves = [" ".join(each.status.advice for each in of[1:]) for of in answers.of.values()]
    own = _samples(problem, answers, signal, units)
    variables = (
        own
        | _held_out(problems, answers)
        | _profiles(problem, own, units[1])
        | of_all
        | {"status_halves": ("estimator", halves, "1")}
        | scalars({"cells": problem.line.n})
    )
    if FEATURE_FIT in methods:
        value, stderr = np.moveaxis(parameter_draws(answers), -1, 0)
        by = ("part", "parameter")
        variables |= {
            "parameter_value": (by, value, "SI"),
            "parameter_value_stderr": (by, stderr, "SI"),
        }
    coordinates = estimate_coordinates(problem, list(methods)) | {
        **parameter_coordinates(answers),
        "part": (list(PARTS), "1"),
        "other": (list(methods), "1"),
        "half": (list(PARTS[1:]), "1"),
    }
    said = {f"mean_of_{component}": words for component, words in problem.mean_statement().items()}
    attributes = {"mean_unobserved": ",".join(COMPONENTS), **facts, **said}
    if units[1] != "Pa":
        attributes["is_relative"] = 1
    data = dataset(variables, coordinates, **attributes)
    return Result(_title(name, data), data, sections("compare_recording", "assumed"))


def split_odd_even(problem: LineProblem) -> tuple[LineProblem, LineProblem]:
    """The same problem with the samples of every other cell: two draws of the noise."""
    parity = np.arange(problem.line.n) % 2
    return problem.restricted_to(parity == 0), problem.restricted_to(parity == 1)


def holdout_chi2(estimate: Estimate, problem: LineProblem) -> float:
    """Mean square of the problem's samples less the fitted signal, in units of the noise.

    For held-out samples; under a correct model 1 plus the estimate's own uncertainty.
    """
    rest = np.asarray(problem.data + problem.mean_signal) - np.asarray(estimate.fitted)
    rest = np.where(problem.is_observed, rest, np.nan)
    if problem.has_free_offset:
        rest = rest - mean_known(rest, axis=-1)[..., None]
    return float(mean_known(rest**2)) / problem.noise_rms**2


def _title(name: str, data: xarray.Dataset) -> str:
    left, names = data["holdout_chi2_mean"].values, data["estimator"].values
    first, second = (
        f"{significant(float(left[m]))} times" for m in np.argsort(left, kind="stable")[:2]
    )
    best, next_best = names[np.argsort(left, kind="stable")[:2]]
    return (
        f"{name}: {best} predicts held-out samples best, with a residual of {first} the noise's "
        f"power ({next_best}: {second})"
    )


def _samples(
    problem: LineProblem, answers: Answers[Estimate], signal: np.ndarray, units: tuple[str, str]
) -> Variables:
    """The signal, and what each method makes of it."""
    cells, samples = problem.observed_cells, ("element", "x")
    own = estimate_variables(answers, ("part",), units, cells)
    own |= fit_variables(answers, ("part",))
    return own | {
        "signal": (samples, signal, units[0]),
        "observed": (samples, problem.is_observed.astype(np.int8), "1"),
        "misfit_all": ("estimator", own["misfit"][1][:, 0], "1", "misfit_{estimator}"),
        "all_converged": (
            "estimator",
            own["converged"][1].all(axis=1),
            "1",
            "converged_{estimator}",
        ),
    }


def _held_out(problems: Sequence[LineProblem], answers: Answers[Estimate]) -> Variables:
    """The score of each half's fit on the other half."""
    _, even, odd = problems
    left = np.array(
        [[holdout_chi2(of[1], odd), holdout_chi2(of[2], even)] for of in answers.of.values()]
    )
    by, rank = ("estimator", "half"), ranks(left)
    return {
        "holdout_chi2": (by, left, "1"),
        "holdout_chi2_mean": ("estimator", left.mean(axis=1), "1", "holdout_chi2_{estimator}"),
        "rank": (by, rank, "1"),
        "rank_mean": ("estimator", rank.mean(axis=1), "1", "rank_mean_{estimator}"),
        **differences(left, list(answers.of)),
    }


def _profiles(problem: LineProblem, own: Variables, units: str) -> Variables:
    """p and q: how wide their bands are, where they are highest, how well the halves repeat them,
    and by how much the methods differ."""
    cells, x = problem.observed_cells, np.asarray(problem.line.x)
    value, stderr = own["estimate"][1], own["estimate_stderr"][1][:, 0]
    moved = deviation(value[:, 1], cells) - deviation(value[:, 2], cells)
    p = deviation(value[:, 0, 0], cells)
    distances = np.linalg.norm(p[:, None] - p[None], axis=-1)
    stated = np.sqrt(np.mean(stderr[..., cells] ** 2, axis=-1))
    by, unit = ("estimator", "component"), "Pa" if units == "Pa" else "relative"
    return {
        "repeatability": (by, np.sqrt(np.mean(moved**2, axis=-1)) / 2, units,
                          f"{{component}}_repeatability_{unit}_{{estimator}}"),
        "stderr_rms": (by, stated, units, f"{{component}}_stderr_rms_{unit}_{{estimator}}"),
        "peak_position": (by, x[cells][_peak(value[:, 0][..., cells])], "m",
                          "{component}_peak_position_m_{estimator}"),
        "difference_of_p": (("estimator", "other"),
                            distances / (np.linalg.norm(p, axis=-1) + 1e-300)[None], "1"),
    }  # fmt: skip


def _peak(values: Float[np.ndarray, "... x"]) -> Int[np.ndarray, "..."]:
    """Where the values are largest: in the middle, where several are but for rounding."""
    top, spread = values.max(axis=-1, keepdims=True), np.ptp(values, axis=-1, keepdims=True)
    is_top = values >= top - ROUNDING * spread
    last = values.shape[-1] - 1 - np.argmax(is_top[..., ::-1], axis=-1)
    return (np.argmax(is_top, axis=-1) + last) // 2
