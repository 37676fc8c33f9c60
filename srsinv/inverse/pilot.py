"""A first estimate of the traction, beside which the nuisance is known well enough for a rule."""

import numpy as np
from jaxtyping import Float

from ..grid import as_real
from . import iterative
from .line_problem import LineProblem
from .nuisance import scored
from .quadratic import Family, Scorer, choose_path
from .rule import Evidence

TOLERANCE = 1e-4


def to_score(
    problem: LineProblem, family: Family, box: Float[np.ndarray, "2 c"], path: str
) -> LineProblem:
    """The problem whose scores a rule goes by, its weights in the `box`.

    The direct path scores columns as they are. The iterative one has scores without any: their
    sizes are taken beside a traction of the weights of greatest evidence, which what is left of
    the columns moves little.
    """
    if problem.nuisance is None or choose_path(problem, path) != "iterative":
        return problem
    first = Evidence().choose(Scorer(family, problem, path), as_real(box)).log_weights
    return scored(problem, iterative.value(problem, family(first), TOLERANCE).value)
