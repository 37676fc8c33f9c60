"""The weights that come nearest to a known truth, with a problem's own model and noise.

No rule knows them. Their error is what is left to the model, the noise and the prior, so that an
inversion's error over theirs is what the choice of its weights, or of its noise, has cost.
"""

import itertools
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from srsinv.grid import as_real
from srsinv.inverse.estimate import relative_error
from srsinv.inverse.line import direct
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.spectral import square, white_model
from srsinv.inverse.tikhonov import DerivativePenalty

ORDER, LENGTH_M = 1, 0.75e-3  # as Tikhonov's method has them by default
ABOVE, BELOW, APART = 4.0, 10.0, 2.0  # decades of the first weights about the signal's information
FINER = (1.0, 0.5, 0.25, 0.125)  # decades between the next ones, about the best so far


def best_in_hindsight(
    problem: LineProblem, truth: Float[np.ndarray, "2 n"]
) -> Float[np.ndarray, "2"]:
    """Relative errors of p and q with the weights of Tikhonov's method for which the sum of their
    squares is least, by the direct path; infinite where no weights give an answer.

    - `problem`: on the cells that are solved for.
    - `truth` [Pa]: p and q on these.
    """
    problem, cells = problem.to_grid(), problem.observed_cells
    white, own = direct.whiten(problem), truth[: problem.unknowns]
    found: dict[tuple[float, ...], np.ndarray] = {}

    def error(point: tuple[float, ...]) -> np.ndarray:
        prior = DerivativePenalty(10.0 ** np.array(point), as_real(LENGTH_M), ORDER)
        value = np.asarray(direct.solve(problem, prior, white).value)
        own_error = relative_error(value, own, cells)
        return np.where(np.isfinite(own_error), own_error, np.inf)

    def best(points: Iterable[tuple[float, ...]]) -> tuple[float, ...]:
        for point in points:
            if point not in found:
                found[point] = error(point)
        return min(found, key=lambda point: float(np.sum(found[point] ** 2)))

    information = np.sum(square(white_model(problem)), axis=0)
    most = np.log10(np.max(information, axis=-1))
    axes = [np.arange(each - BELOW, each + ABOVE + 0.1, APART).tolist() for each in most]
    centre = best(itertools.product(*axes))
    for step in FINER:
        centre = best(itertools.product(*[(c - step, c, c + step) for c in centre]))
    return np.broadcast_to(found[centre], 2)
