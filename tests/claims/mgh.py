"""How many listed minima of the problems of More, Garbow and Hillstrom `srsinv.fit` reaches, and in
how many evaluations, beside scipy's two methods of least squares.

`python -m tests.claims.mgh` writes results/mgh.json.
"""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import scipy.optimize

import srsinv
from tests.reference.mgh import FACTORS, PROBLEMS, LeastSquaresProblem

STEPS = 2000  # of `srsinv.fit` as it is, for scipy too
TOLERANCE = 1e-12  # of scipy's stopping rules: their defaults end short of six digits
SCIPY = ("lm", "trf")
RESULTS = Path(__file__).parent / "results" / "mgh.json"


def fits(problem: LeastSquaresProblem) -> list[srsinv.Fit]:
    """The fits from the three starts, by one compiled program."""

    def model(x):
        return -problem.residual(x)

    zeros = np.zeros(jax.eval_shape(problem.residual, np.array(problem.start)).shape)
    return [srsinv.fit(model, problem.start_at(factor), zeros) for factor in FACTORS]


def rows_of(problem: LeastSquaresProblem, solutions: list[srsinv.Fit]) -> list[dict]:
    """A row of the table for each start."""
    return [
        _row(problem, 2 * fit.stats["cost"], fit.converged, fit.stats["iterations"])
        for fit in solutions
    ]


def by_srsinv(problem: LeastSquaresProblem) -> list[dict]:
    """The rows of `srsinv.fit`."""
    return rows_of(problem, fits(problem))


def by_scipy(problem: LeastSquaresProblem, method: str) -> list[dict]:
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


def _row(problem: LeastSquaresProblem, squares: float, converged: bool, evaluations: int) -> dict:
    return {
        "sum_of_squares": float(squares) if np.isfinite(squares) else None,
        "minimum": problem.minimum_at(squares),
        "converged": bool(converged),
        "evaluations": int(evaluations),
    }


def summary(rows: list[dict]) -> dict:
    """Minima reached, those of them that were said to be, and all evaluations."""
    reached = [row for row in rows if row["minimum"] is not None]
    return {
        "starts": len(rows),
        "minima_reached": len(reached),
        "reached_and_converged": sum(row["converged"] for row in reached),
        "evaluations": sum(row["evaluations"] for row in rows),
        "median_evaluations": float(np.median([row["evaluations"] for row in reached])),
    }


def main() -> None:
    methods = {"srsinv": by_srsinv} | {
        method: lambda problem, method=method: by_scipy(problem, method) for method in SCIPY
    }
    table = [
        {"problem": problem.name, "number": problem.number}
        | {name: of(problem) for name, of in methods.items()}
        for problem in PROBLEMS
    ]
    totals = {name: summary([row for line in table for row in line[name]]) for name in methods}
    RESULTS.parent.mkdir(exist_ok=True)
    record = {"factors": FACTORS, "summary": totals, "problems": table}
    RESULTS.write_text(json.dumps(record, indent=1) + "\n")
    print(json.dumps(totals, indent=1))


if __name__ == "__main__":
    main()
