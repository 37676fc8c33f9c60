"""Noise whose level varies along the line: the nearest problem under one level, and the variance.

Noise of the covariance S N S, S the factor in each cell, has the precision N^-1 + u N^-1 + N^-1 u
to first order in u = -log S, so that the traction's variance at x changes by
-2 sum_z (C^-1 G^H)(x - z) u(z) (N^-1 G C^-1)(z - x): a convolution. Of a level that is the same
everywhere the variance is nearly a power: it is its logarithm that is taken as linear.
"""

import numpy as np
from jaxtyping import Float

from ...grid import as_real
from ...modules import with_fields
from ..line.near_periodic import NearPeriodic
from ..line.problem import LineProblem
from ..line.transforms import adjoint, from_spectrum, times, to_spectrum


def at_one_level(problem: LineProblem) -> LineProblem:
    """The same problem under noise of its typical level everywhere, and nothing else."""
    if problem.nuisance is not None:
        problem = with_fields(problem, nuisance=None)
    if problem.noise_scale is None:
        return problem
    level = np.exp(2 * np.mean(_log_scale(problem)[problem.is_observed]))
    return with_fields(problem, noise=as_real(np.asarray(problem.noise) * level), noise_scale=None)


def change_of_variance(problem: LineProblem, near: NearPeriodic) -> Float[np.ndarray, "c n"]:
    """The variance of the traction under the noise's own level in each cell, less that under one
    level; `near` is the nearest periodic problem of [`at_one_level`][]."""
    if problem.noise_scale is None:
        return np.zeros((problem.unknowns, problem.line.n))
    log_scale, cells = _log_scale(problem), np.arange(problem.line.n)
    # Where a sample is missing, the factor is that of the samples beside it.
    rows = zip(log_scale, problem.is_observed, strict=True)
    filled = np.stack(
        [np.interp(cells, cells[own], row[own]) if own.any() else 0.0 * row for row, own in rows]
    )
    louder = filled - np.mean(log_scale[problem.is_observed])
    model = near.model / np.where(near.white > 0, near.white, np.inf)[:, None]
    response = np.einsum("ijk,jlk->ilk", near.covariance, adjoint(model))
    kernel = near.lags(response) * near.lags(adjoint(near.expected))
    relative = 2 * from_spectrum(times(to_spectrum(kernel), to_spectrum(louder)), near.n)
    variance = np.diagonal(near.lags(near.covariance)[..., 0])[:, None]
    return variance * np.expm1(relative / variance)


def _log_scale(problem: LineProblem) -> Float[np.ndarray, "e n"]:
    return np.log(np.asarray(problem.noise_scale, float))
