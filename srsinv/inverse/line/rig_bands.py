"""What errors of the rig make of an inversion: a low-rank part of its covariance.

An estimate x = H y is linear in the signals, its weights and noise levels held. A rig that is off
by one standard deviation in the direction j of its covariance S = L L^T changes the signals by
d_j = (dG/dc L)_j x, and the estimate by f_j = H d_j: to first order

    cov x = C + sum_j f_j f_j^T,

C that of a rig that is exact. Columns d_j of the problem, under priors of their own as fits of
features have them, would use what the signals say of the rig. But the prior of x states its size,
and so a gain: x^T P x is about the resolved degrees of freedom m, and takes a gain of relative
error s for wrong by s m standard errors (Rice 1986, on partial splines).
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ...known import array_module
from ..estimate import Numbers, TractionEstimate
from ..noise.nuisance import Nuisance
from ..noise.whitener import NoisePrecision
from ..rig.error import NOISE
from .gaps import Gaps
from .prior import Solution
from .problem import LineProblem
from .transforms import from_spectrum, to_spectrum

MOST_DIRECTIONS = 64  # their part of a standard error is then right to 9 %


def solved_directions(
    solve: Callable[[Float[np.ndarray, "i e n"]], Sequence[np.ndarray]],
    changes: Float[np.ndarray, "j e n"],
    rows: Float[np.ndarray, "k j"] | None,
) -> Float[np.ndarray, "k c n"] | None:
    """What independent directions of the rig's error, `rows` of these changes of the signals, make
    of the solution, by a path to which each is a solve; None of no change.

    Of more than `MOST_DIRECTIONS` changes, as a measured kernel has, as many random combinations of
    the directions, whose sum of outer products has the mean of theirs.
    """
    if not len(changes):
        return None
    if len(changes) > MOST_DIRECTIONS:
        count = len(changes) if rows is None else len(rows)
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (MOST_DIRECTIONS, count))
        mixed = signs / np.sqrt(MOST_DIRECTIONS)
        mixed = mixed if rows is None else mixed @ rows
        changes, rows = np.einsum("ij,jen->ien", mixed, changes), None
    return np.asarray(_in_directions(np.stack(solve(changes)), rows))


def direction_count(problem: LineProblem) -> int:
    """The number of directions that `solved_directions` gives."""
    if problem.rig_changes is None:
        return 0
    changes, rows = len(problem.rig_changes.transfer) // len(problem.data), problem.rig_rows
    if changes > MOST_DIRECTIONS:
        return MOST_DIRECTIONS
    return changes if rows is None else len(rows)


def _in_directions(
    moved: Float[Numbers, "j c n"], rows: Float[np.ndarray, "k j"] | None
) -> Float[Numbers, "k c n"]:
    return moved if rows is None else array_module(moved).einsum("kj,jcn->kcn", rows, moved)


def rig_errors(problem: LineProblem, solution: Solution) -> Float[Numbers, "j c n"] | None:
    """The changes f_j of a solution; None where the rig is exact."""
    if problem.rig_changes is None or solution.rig_errors is not None:
        return solution.rig_errors
    precision = NoisePrecision(problem, Gaps.of(problem.is_observed))
    weigh = precision if problem.nuisance is None else Nuisance(problem, precision).weigh
    signals = problem.changed_signals(solution.value)
    right = [np.asarray(problem.forward.adjoint(weigh(each)), float) for each in signals]
    return _in_directions(times_covariance(solution, np.stack(right)), problem.rig_rows)


def times_covariance(solution: Solution, right: Float[Numbers, "j c n"]) -> Float[Numbers, "j c n"]:
    """The solution's covariance times each of these right sides."""
    xp: Any = array_module(solution, right)
    covariance = xp.asarray(solution.covariance)
    if covariance.ndim == 2:
        return (right.reshape(len(right), -1) @ covariance.T).reshape(right.shape)
    of_numpy: Any = to_spectrum, from_spectrum
    forth, back = of_numpy if xp is np else (xp.fft.rfft, xp.fft.irfft)
    return back(xp.einsum("cdk,jdk->jck", covariance, forth(right)), right.shape[-1])


def rig_parts(
    moved: Float[Numbers, "j c n"], weights: Any, friction: Any
) -> Float[Numbers, "j 2 n"]:
    """What these changes by the rig add to the errors of p and q, less their mean by `weights`
    (c, n) where that of the standard errors is taken out; `friction`: mu where q = mu p."""
    xp = array_module(moved, weights, friction)
    each = xp.asarray(moved, float)
    off = each - xp.einsum("jcn,cn->jc", each, xp.asarray(weights))[..., None]
    return off if friction is None else xp.concatenate([off, xp.asarray(friction) * off], axis=1)


def with_rig_errors(
    problem: LineProblem, stderr: Float[Numbers, "2 n"], moved: Float[Numbers, "j c n"]
) -> Float[Numbers, "2 n"]:
    """Standard errors of p and q with these changes by the rig."""
    parts = rig_parts(moved, problem.mean_weights, problem.friction)
    xp = array_module(parts, stderr)
    own = xp.asarray(stderr)
    return xp.sqrt(own.astype(float) ** 2 + xp.sum(parts**2, axis=0)).astype(own.dtype)


def stderr_by_source(estimate: TractionEstimate) -> dict[str, Float[np.ndarray, "2 n"]]:
    """The parts of the standard errors of p and q by their source, `noise` (with what the prior
    leaves open) first: their squares add up to the square of the standard error. Empty where the
    rig is exact."""
    moved, sources = estimate.rig_errors, estimate.rig_sources
    if moved is None:
        return {}
    none = np.zeros(np.asarray(moved).shape[1:])
    weights = none if estimate.mean_weights is None else estimate.mean_weights
    # At most MOST_DIRECTIONS of many: they are then combinations, of one source.
    named = sources if len(sources) == len(moved) else [sources[0]] * len(moved)
    squares: dict[str, Float[np.ndarray, "2 n"]] = {}
    for source, part in zip(named, rig_parts(moved, weights, estimate.friction), strict=True):
        squares[source] = squares.get(source, 0.0) + part**2
    squares.pop(NOISE, None)
    left = np.asarray(estimate.stderr, float) ** 2 - sum(squares.values())
    return {
        name: np.sqrt(np.maximum(square, 0.0)) for name, square in {NOISE: left, **squares}.items()
    }
