"""From a solution to the parts of an estimate, and the numbers that its warnings go by.

Under a run of missing samples the band is the prior's. A weight is chosen by the waves that are
close to the noise; traction may change far more over a run than a prior of that weight allows, and
nothing in the residual says so. Every run adds such an error to the level of what follows.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...grid import half_spectrum_weights
from ...known import by_numpy
from ...numerics import runs
from ..estimate import Numbers
from ..noise.nuisance import WithoutNuisance
from ..noise.whitener import residual_squares
from .model import EstimateParts, with_means
from .prior import Prior, Solution
from .problem import LineProblem
from .spectral import (
    ModePosterior,
    OrthogonalModel,
    noise_whitener,
    posterior,
    prior_root,
    square,
    stacked,
    whitened,
)
from .transforms import from_spectrum, times, to_spectrum


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
    # The mean over the cells that lie in runs.
    cells = round(float(missing @ missing / missing.sum()))
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


Roots = list[Float[np.ndarray, " k"]]


class Checks(NamedTuple):
    """Of each component (c,): the prior's `pull` on the estimate, squared, over its variance; the
    fraction of the prior's variance that the signal has `explained`; and the resolution of the
    `shortest` wave. `difference_dof`: the degrees of freedom that are resolved of the difference of
    p and q; infinite of one component. `runs`: without a sample, if any."""

    pull: Float[np.ndarray, " c"]
    explained: Float[np.ndarray, " c"]
    shortest: Float[np.ndarray, " c"]
    difference_dof: float
    runs: Runs | None = None


class CheckedSolution(NamedTuple):
    """A solution, what the estimate shows of it, its checks, and the degrees of freedom that went
    to the problem's nuisance."""

    solution: Solution
    parts: EstimateParts
    checks: Checks
    nuisance_dof: float = 0.0


def spectral_answer(problem: LineProblem, prior: Prior) -> CheckedSolution:
    """The posterior on a periodic line with every sample valid, in numpy and double precision."""
    n, dtype, root = problem.line.n, problem.data.dtype, prior_root(problem.line, prior)
    white, model = noise_whitener(problem), whitened(problem)
    spectrum = to_spectrum(np.asarray(problem.data, float))
    roots = list(np.asarray(root, float))
    solved = posterior(model, model.inner(spectrum * white), roots)
    fitted = times(np.asarray(problem.forward.transfer), solved.value)
    residual = (spectrum - fitted) * white
    if not white[:, 0].any():  # the signal's offset is not known, and takes the mean
        fitted[:, 0] = spectrum[:, 0]
    rows = [*solved.value, *fitted, *residual, *(row for rows in solved.resolution for row in rows)]
    # All at once: a call takes as long as a thousand samples.
    cells = from_spectrum(np.stack(rows), n).astype(dtype, copy=False)
    c, e = len(solved.value), len(fitted)
    value, fitted, residual = cells[:c], cells[c : c + e], cells[c + e : c + 2 * e]
    averaging = cells[c + 2 * e :].reshape(c, c, n)
    ahead = n - n // 2
    stderr = np.array(solved.stderr(n))
    solution = Solution(
        value,
        np.broadcast_to(stderr.astype(dtype)[:, None], value.shape),
        stacked(solved.covariance),
        np.concatenate([averaging[..., ahead:], averaging[..., :ahead]], axis=-1),
        np.array(solved.resolved_dof(n)),
        solved.condition,
    )
    parts = EstimateParts(
        *with_means(problem, value, solution.stderr),
        fitted + np.asarray(problem.mean_signal),
        residual,
        np.asarray(np.vdot(residual, residual)),
    )
    return CheckedSolution(solution, parts, _checks(solved, stderr, model, roots, n))


def answer_of(problem: LineProblem, prior: Prior, solution: Solution) -> CheckedSolution:
    """The answer of any other solution; the waves' checks are the nearest periodic problem's."""
    n, roots = problem.line.n, list(np.asarray(prior_root(problem.line, prior), float))
    cleaned = WithoutNuisance.of(problem, solution.value)
    parts, pull, variance = _estimate_parts(cleaned.problem, prior, solution)
    squares = np.asarray(residual_squares(cleaned.problem, parts))
    if problem.nuisance is not None:
        parts = parts._replace(fitted=parts.fitted + cleaned.signal)
    parts = parts._replace(squares=squares)
    averaging = np.einsum("ccn->cn", np.asarray(solution.averaging, float))
    checks = Checks(
        np.asarray(pull, float),
        1 - np.asarray(variance, float) / _variances(roots, n),
        np.abs(to_spectrum(averaging))[:, -1],
        difference_dof(whitened(problem), roots, n),
        missing_runs(problem, prior, solution.value),
    )
    return CheckedSolution(solution, parts, checks, cleaned.dof)


@by_numpy
def _estimate_parts(
    problem: LineProblem, prior: Prior, solution: Solution, xp: Any = jnp
) -> tuple[EstimateParts, Float[Numbers, " c"], Float[Numbers, " c"]]:
    """The parts of the estimate, the prior's pull squared over the variance, and that variance:
    means over the cells with samples. The pull is C P r, C the posterior covariance: the estimate
    less what the data alone would have in its place, as far as they can tell."""
    line, covariance = problem.line, solution.covariance
    weighted = xp.asarray(prior.apply(line, xp.asarray(solution.value)))
    if covariance.ndim == 3:
        pull = xp.fft.irfft(xp.einsum("ijk,jk->ik", covariance, xp.fft.rfft(weighted)), line.n)
    else:
        pull = (covariance @ xp.ravel(weighted)).reshape(weighted.shape)
    observed = xp.ones(line.n, bool) if problem.observed is None else problem.observed.any(axis=0)
    count = xp.maximum(xp.sum(observed), 1)
    pull = pull - xp.sum(pull * observed, axis=-1, keepdims=True) / count
    variance = xp.sum(solution.stderr**2 * observed, axis=-1) / count
    squares = xp.sum(pull**2 * observed, axis=-1) / count
    parts = problem.estimate_parts(solution.value, solution.stderr)
    return parts, squares / xp.where(variance > 0, variance, 1.0), variance


def _checks(
    solved: ModePosterior, stderr: np.ndarray, model: OrthogonalModel, roots: Roots, n: int
) -> Checks:
    """The checks of a posterior on a periodic line; the pull by its spectrum."""
    weighted = [root**2 * each for root, each in zip(roots, solved.value, strict=True)]
    pulls = times(solved.covariance, weighted)
    squares = square(pulls[:, 1:]) @ half_spectrum_weights(n)[1:] / n
    return Checks(
        squares / np.where(stderr > 0, stderr, 1.0) ** 2,
        1 - stderr**2 / _variances(roots, n),
        np.array([np.abs(row[c][-1]) for c, row in enumerate(solved.resolution)]),
        difference_dof(model, roots, n),
    )


def _variances(roots: Roots, n: int) -> Float[np.ndarray, " c"]:
    """The variance of the prior of these roots, infinite where it leaves a wave free; its mean
    aside, which many priors leave free."""
    weights = half_spectrum_weights(n)[1:]
    each = (root[1:] for root in roots)
    return np.array([weights @ (1 / root / root) if root.all() else np.inf for root in each])


def difference_dof(model: OrthogonalModel, roots: Roots, n: int) -> float:
    """Resolved degrees of freedom of the linear combination of p and q that is observed least,
    infinite of one component. The second singular direction v of each wavenumber has
    s^2/(s^2 + v^H P v) of them."""
    if model.ratio is None:
        return np.inf
    small, of_p = second_direction(model.squares[0], model.shared, model.squares[1])
    held = of_p * roots[0] ** 2 + (1 - of_p) * roots[1] ** 2
    resolved = small / np.maximum(small + held, np.finfo(float).tiny)
    return n * float(np.mean(resolved[1:]))


def second_direction(
    first: Float[np.ndarray, " k"], shared: Float[np.ndarray, " k"], own: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """The second singular value squared of the columns A_1 and t A_1 + B, from the squares of A_1,
    t A_1 and B, and the fraction of the first component in its direction.

    Both values have the product |A_1|^2 |B|^2, which loses no digits where columns are nearly
    parallel.
    """
    total = first + shared + own
    safe = np.where(total > 0, total, 1.0)
    root = np.sqrt(np.maximum(1 - 4 * (first / safe) * (own / safe), 0.0))
    large = total * (1 + root) / 2
    small = first * (own / np.where(total > 0, large, 1.0))
    between = large - small
    of_p = np.where(between > 0, (large - first) / np.where(between > 0, between, 1.0), 0.5)
    return small, np.clip(of_p, 0.0, 1.0)
