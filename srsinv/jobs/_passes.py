"""What averaging of passes found, of an inversion: as every job with one reports it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..inverse.estimate import Estimate
from ..inverse.line_model import CHI2
from ..inverse.line_problem import LineProblem
from ..report.result import scalars


def pass_variables(problem: LineProblem, estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """What averaging of passes found, and how much of what a method leaves of their mean repeats:
    chi-square less that of what they differ by."""
    found = problem.passes
    if found is None:
        return {}
    left = [each.stats[CHI2] or np.nan for each in estimates.values()]
    repeats = np.maximum(1 - found.scatter**2 / np.array(left, float), 0.0)
    numbers = {"passes_onwards": found.onwards, "passes_back": found.back}
    return {
        "pass_shift": ("pass", found.shifts_m, "m"),
        "repeating_share": ("method", repeats, "1", "residual_repeating_share_{method}"),
        **scalars(numbers | {"pass_scatter": found.scatter}),
        **scalars({"pass_shift_stderr_m": found.shift_stderr_m}),
    }
