"""What averaging of passes found, of an inversion: as every job with one reports it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..inverse.estimate import Estimate
from ..inverse.line.model import CHI2
from ..inverse.line.problem import LineProblem
from ..report.data import scalars


def pass_variables(problem: LineProblem, estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """What averaging of passes found, and how much of what a method leaves of their mean repeats:
    chi-square less that of what they differ by."""
    found = problem.passes
    if found is None:
        return {}
    left = np.array([each.stats[CHI2] or np.nan for each in estimates.values()], float)
    numbers = {"passes_onwards": found.onwards, "passes_back": found.back}
    return {
        "pass_shift": ("pass", found.shifts_m, "m"),
        **repeating_share(problem, left, "estimator"),
        **scalars(numbers | {"pass_scatter": found.scatter}),
        **scalars({"pass_shift_stderr_m": found.shift_stderr_m}),
    }


def repeating_share(
    problem: LineProblem, chi2: Float[np.ndarray, " left"], dim: str
) -> dict[str, tuple[Any, ...]]:
    """How much of residuals of these chi-squares per degree of freedom repeats from pass to pass,
    NaN where no way is passed more than once; nothing of a motion that does not turn."""
    found = problem.passes
    if found is None:
        return {}
    repeats = np.maximum(1 - found.scatter**2 / chi2, 0.0)
    return {"repeating_share": (dim, repeats, "1", f"residual_repeating_share_{{{dim}}}")}
