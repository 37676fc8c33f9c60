"""How many listed minima of the problems of More, Garbow and Hillstrom `srsinv.fit` reaches, and in
how many evaluations, beside scipy's two methods of least squares (minutes).
"""

from functools import lru_cache
from typing import Any

import jax
import numpy as np
import scipy.optimize

import srsinv
from srsinv.jobs.trials import Row
from tests.claims.study import Study, combinations
from tests.reference.mgh import FACTORS, PROBLEMS, LeastSquaresProblem

STEPS = 2000  # of `srsinv.fit` as it is, for scipy too
TOLERANCE = 1e-12  # of scipy's stopping rules: their defaults end short of six digits
METHODS = ("srsinv", "lm", "trf")  # of scipy all but the first
BY_NAME = {problem.name: problem for problem in PROBLEMS}


def fits(problem: LeastSquaresProblem) -> list[srsinv.Fit]:
    """The fits from the three starts, by one compiled program."""

    def model(x):
        return -problem.residual(x)

    zeros = np.zeros(jax.eval_shape(problem.residual, np.array(problem.start)).shape)
    return [srsinv.fit(model, problem.start_at(factor), zeros) for factor in FACTORS]


def rows_of(problem: LeastSquaresProblem, solutions: list[srsinv.Fit]) -> list[Row]:
    """A row of the table for each start."""
    return [
        _row(problem, 2 * fit.stats["cost"], fit.converged, fit.stats["iterations"])
        for fit in solutions
    ]


def by_scipy(problem: LeastSquaresProblem, method: str) -> list[Row]:
    """The same by one of scipy's methods, with the exact Jacobian."""
    residual: Any = jax.jit(problem.residual)
    derivative: Any = jax.jit(jax.jacfwd(problem.residual))
    rows = []
    for factor in FACTORS:
        try:
            with np.errstate(all="ignore"):
                solution = scipy.optimize.least_squares(
                    residual, problem.start_at(factor), derivative, method=method,
                    max_nfev=STEPS, xtol=TOLERANCE, ftol=TOLERANCE, gtol=TOLERANCE,
                )  # fmt: skip
        except ValueError:  # the residual or its square is not finite at the start
            rows.append(_row(problem, np.inf, False, 0))
        else:
            rows.append(_row(problem, 2 * solution.cost, solution.status > 0, solution.nfev))
    return rows


def _row(problem: LeastSquaresProblem, squares: float, converged: bool, evaluations: int) -> Row:
    return {
        "sum_of_squares": float(squares),
        "minimum": problem.minimum_at(squares),
        "converged": bool(converged),
        "evaluations": int(evaluations),
    }


def summary(rows: list[Row]) -> Row:
    """Minima reached, those of them that were said to be, and all evaluations."""
    reached = [row for row in rows if row["minimum"] is not None]
    return {
        "starts": len(rows),
        "minima_reached": len(reached),
        "reached_and_converged": sum(row["converged"] for row in reached),
        "evaluations": sum(row["evaluations"] for row in rows),
        "median_evaluations": float(np.median([row["evaluations"] for row in reached])),
    }


@lru_cache(maxsize=1)
def _by(method: str, problem: str) -> list[Row]:
    """The rows from the three starts: what is compiled for one serves all."""
    of = BY_NAME[problem]
    return rows_of(of, fits(of)) if method == "srsinv" else by_scipy(of, method)


STUDY = Study(
    "mgh",
    lambda problem, method, factor: _by(method, problem)[FACTORS.index(factor)],
    lambda: combinations(problem=BY_NAME, method=METHODS, factor=FACTORS),
    lambda rows: {by: summary([row for row in rows if row["method"] == by]) for by in METHODS},
)
