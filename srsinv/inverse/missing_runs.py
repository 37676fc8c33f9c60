"""What a prior says of the traction under runs of missing samples, beside what is seen of it.

There the band is the prior's. A weight is chosen by the waves that are close to the noise; traction
may change far more over a run than a prior of that weight allows, and nothing in the residual says
so. Every run adds such an error to the level of what follows.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..numerics import runs
from .estimate import Numbers
from .line_problem import LineProblem
from .prior import Prior
from .spectral import prior_root
from .transforms import from_spectrum


class Runs(NamedTuple):
    """Runs of `cells` cells without a sample, typically, of `length_m` [m].

    - `observed` (c,) [Pa^2]: the mean square of the estimate's change over as many cells where
      there are samples, of about `lengths` independent ones; `of_prior` (c,) [Pa^2]: the prior's.
    """

    cells: int
    length_m: float
    lengths: float
    observed: Float[np.ndarray, " c"]
    of_prior: Float[np.ndarray, " c"]


def missing_runs(problem: LineProblem, prior: Prior, value: Float[Numbers, "c n"]) -> Runs | None:
    """The runs without a sample in a scan; None where there is none, or where no stretch between
    them is as long."""
    is_observed = problem.observed_cells
    at = np.flatnonzero(is_observed)
    first, last = at[0], at[-1] + 1
    missing = np.array([stop - start for start, stop in runs(~is_observed[first:last])])
    if not missing.size:
        return None
    cells = round(
        float(missing @ missing / missing.sum())
    )  # the mean over the cells that lie in runs
    before = np.pad(np.cumsum(is_observed), (1, 0))
    starts = np.flatnonzero(before[cells + 1 :] - before[: -cells - 1] == cells + 1)
    if not starts.size:
        return None
    value = np.asarray(value, float)
    observed = np.mean((value[:, starts + cells] - value[:, starts]) ** 2, axis=-1)
    roots = np.asarray(prior_root(problem.line, prior), float)
    power = np.divide(1.0, roots**2, where=roots > 0, out=np.zeros_like(roots))
    power[:, 0] = 0.0  # of a change, as much as of the mean
    lags = from_spectrum(power, problem.line.n)
    of_prior = np.maximum(2 * (lags[:, 0] - lags[:, cells]), 0.0)
    length = cells * float(problem.line.cell_m)
    return Runs(cells, length, starts.size / cells, observed, of_prior)
