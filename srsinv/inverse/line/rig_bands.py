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

import numpy as np
from jaxtyping import Float

from ..estimate import Numbers
from ..noise.nuisance import Nuisance
from ..noise.whitener import NoisePrecision
from .gaps import Gaps
from .prior import Solution
from .problem import LineProblem
from .transforms import from_spectrum, to_spectrum

MOST_DIRECTIONS = 64  # their part of a standard error is then right to 9 %


def fewer_directions(changes: Float[np.ndarray, "j *shape"]) -> Float[np.ndarray, "i *shape"]:
    """At most `MOST_DIRECTIONS` random combinations of independent directions, whose sum of outer
    products has the mean of theirs, for paths to which each is a solve: a measured kernel has
    hundreds."""
    if len(changes) <= MOST_DIRECTIONS:
        return changes
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (MOST_DIRECTIONS, len(changes)))
    return np.einsum("ij,j...->i...", signs / np.sqrt(MOST_DIRECTIONS), changes)


def rig_errors(problem: LineProblem, solution: Solution) -> Float[Numbers, "j c n"] | None:
    """The changes f_j of a solution; None where the rig is exact."""
    if problem.rig_changes is None or solution.rig_errors is not None:
        return solution.rig_errors
    precision = NoisePrecision(problem, Gaps.of(problem.is_observed))
    weigh = precision if problem.nuisance is None else Nuisance(problem, precision).weigh
    signals = problem.rig_signals(solution.value)
    right = [np.asarray(problem.forward.adjoint(weigh(each)), float) for each in signals]
    return _times_covariance(solution, np.stack(right))


def _times_covariance(
    solution: Solution, right: Float[np.ndarray, "j c n"]
) -> Float[np.ndarray, "j c n"]:
    covariance = np.asarray(solution.covariance)
    if covariance.ndim == 3:
        spectra = np.einsum("cdk,jdk->jck", covariance, to_spectrum(right))
        return from_spectrum(spectra, right.shape[-1])
    return (right.reshape(len(right), -1) @ covariance.T).reshape(right.shape)


def with_rig_errors(
    problem: LineProblem, stderr: Float[Numbers, "2 n"], moved: Float[Numbers, "j c n"]
) -> Float[np.ndarray, "2 n"]:
    """Standard errors of p and q with these changes by the rig, less their mean where that of the
    standard errors is taken out."""
    weights = np.asarray(problem.mean_weights)
    each = np.asarray(moved)
    off = each - np.einsum("jcn,cn->jc", each, weights)[..., None]
    added = np.sum(off**2, axis=0)
    if problem.friction is not None:
        added = np.concatenate([added, float(problem.friction) ** 2 * added])
    own = np.asarray(stderr)
    return np.sqrt(own.astype(float) ** 2 + added).astype(own.dtype)
