"""Uncertainty of the parameters at a minimum: covariance, undetermined directions, evidence."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

# A singular value of the Jacobian with columns of length one, relative to the largest, below which
# its direction is rounding: it is not identifiable from the data.
ROUNDING_FACTOR = 5e3
TOUCHED = 1e-6  # of a unit vector: a direction of less does not hold a parameter
CONVERGED = 1e-3  # standard errors from the minimum of the linearised problem (Bates, Watts 1981)

LEAST_CURVATURE = 1e-4  # of the whole curvature, left where the bounds gave nearly all of it


@dataclass(frozen=True)
class Spread:
    """Covariance = `factor` factor^T over the determined directions; `null` (m, d) spans the rest.

    `columns` (m,) are the norms that scale the parameters for directions. Where no degrees of
    freedom remain to estimate the noise, `is_scaled` is False and every error is infinite.
    """

    factor: np.ndarray
    null: np.ndarray
    columns: np.ndarray
    is_scaled: bool = True

    def times(self, level: float) -> "Spread":
        """The spread under noise of another level, infinite where that is not known."""
        if np.isinf(level):
            return replace(self, is_scaled=False)
        return replace(self, factor=self.factor * level)

    def stderr(self) -> np.ndarray:
        """Standard errors (m,), infinite for parameters in an undetermined direction."""
        finite = np.sqrt(np.sum(self.factor**2, axis=1))
        return np.where(self._is_undetermined(), np.inf, finite)

    def covariance(self) -> np.ndarray:
        """(m, m): infinite variances and nan beside them where the data do not determine."""
        undetermined = self._is_undetermined()
        covariance = self.factor @ self.factor.T
        covariance[undetermined[:, None] | undetermined[None, :]] = np.nan
        covariance[np.diag_indices(len(undetermined))] = self.stderr() ** 2
        return covariance

    def correlation(self) -> np.ndarray:
        """(m, m), nan for pairs that the data do not determine."""
        covariance = self.covariance()
        with np.errstate(invalid="ignore", divide="ignore"):
            stderr = np.sqrt(np.diagonal(covariance))
            correlation = covariance / np.outer(stderr, stderr)
        correlation[np.diag_indices(len(stderr))] = 1.0
        return correlation

    def with_error(self, moves: np.ndarray) -> "Spread":
        """The spread where the parameters may also be off by each of `moves` (m, k)."""
        return replace(self, factor=np.column_stack([self.factor, moves]))

    def along(self, gradient: np.ndarray) -> np.ndarray:
        """Standard errors (k,) of quantities with these gradients (k, m)."""
        finite = np.sqrt(np.sum((gradient @ self.factor) ** 2, axis=1))
        scaled = gradient / self.columns
        touched = np.abs(scaled @ self.null) > 1e-6 * np.linalg.norm(scaled, axis=1)[:, None]
        unscaled = (not self.is_scaled) & (finite > 0)
        return np.where(touched.any(axis=1) | unscaled, np.inf, finite)

    def directions(
        self, names: tuple[str, ...], values: np.ndarray
    ) -> tuple[dict[str, float], ...]:
        """Each undetermined direction: the move of each parameter in its own unit, the largest
        relative move being one; parts below 1 % are left out."""
        size = np.where(np.isfinite(values) & (values != 0), np.abs(values), 1.0)
        directions = []
        for direction in self.null.T:
            move = direction / self.columns
            relative_move = np.abs(move) / size
            selected = relative_move >= 0.01 * relative_move.max()
            move = move / relative_move.max() * np.sign(move[np.argmax(relative_move)])
            directions.append({names[i]: float(move[i]) for i in np.flatnonzero(selected)})
        return tuple(directions)

    def _is_undetermined(self) -> np.ndarray:
        return np.any(np.abs(self.null) > TOUCHED, axis=1) | (not self.is_scaled)


def spread(jacobian: np.ndarray, eps: float) -> Spread:
    """The spread under unit noise, from the Jacobian (n, m) of whitened terms."""
    columns = np.linalg.norm(jacobian, axis=0)
    columns = np.where(columns > 0, columns, 1.0)
    m = len(columns)
    scaled = jacobian / columns
    if len(scaled) < m:
        scaled = np.vstack([scaled, np.zeros((m - len(scaled), m))])
    _, s, vt = np.linalg.svd(scaled, full_matrices=False)
    determined = s > ROUNDING_FACTOR * eps * max(s[0], eps)
    factor = (vt[determined] / s[determined, None]).T / columns[:, None]
    return Spread(factor, vt[~determined].T, columns)


def nothing_known(m: int) -> Spread:
    """The spread where the derivatives are not finite."""
    return Spread(np.zeros((m, 0)), np.eye(m), np.ones(m))


def offset(
    jacobian: np.ndarray,
    terms: np.ndarray,
    size: int,
    held: np.ndarray,
    eps: float,
    least: float,
) -> tuple[float, float]:
    """Distance of a point from the minimum of the problem linearised there, of `size` terms.

    The length of the residual's part along the Jacobian's columns, bounds that hold left out, per
    root parameter: in units of its rms across them or of `least`, the greater, and absolute.
    """
    columns = np.linalg.norm(jacobian, axis=0)
    moving = ~held & (columns > 0)
    if not moving.any():
        return 0.0, 0.0
    u, s, _ = np.linalg.svd(jacobian[:, moving] / columns[moving], full_matrices=False)
    along = u[:, s > ROUNDING_FACTOR * eps * s[0]].T @ terms
    across = max(terms @ terms - along @ along, 0.0)
    freedom = size - len(along)
    rms = max(np.sqrt(across / freedom) if freedom > 0 else 0.0, least)
    distance = np.linalg.norm(along) / np.sqrt(max(len(along), 1))
    if rms > 0:
        return float(distance / rms), float(distance)
    return (0.0 if distance == 0 else np.inf), float(distance)


def log_evidence(
    terms: np.ndarray,
    jacobian: np.ndarray,
    log_norm: float,
    z: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    prior_stderr: np.ndarray,
) -> float | None:
    """The log marginal likelihood by Laplace's method, None where a prior is not proper, as over
    bounds that are infinite or closed, or where rounding leaves a direction open.

    A parameter has its Gaussian prior (in `terms` already), else a uniform one over its bounds,
    which also bounds the curvature from below (by its own variance) and cuts the Gaussian's mass.
    `log_norm` is the data's own log volume. (MacKay 2003, chapters 27 and 28.)
    """
    gaussian = np.isfinite(prior_stderr)
    width = upper - lower
    with np.errstate(divide="ignore", over="ignore"):
        added = np.where(gaussian, 0.0, 12 / width**2)
    if not (np.isfinite(added) & (gaussian | np.isfinite(width))).all():
        return None
    rows = np.vstack([jacobian, np.diag(np.sqrt(added))])
    scale = np.linalg.norm(rows, axis=0)
    _, roots, axes = np.linalg.svd(rows / scale, full_matrices=False)
    if not roots[-1] > ROUNDING_FACTOR * np.finfo(float).eps * roots[0]:
        return None
    log_det = 2 * (np.sum(np.log(roots)) + np.sum(np.log(scale)))
    log_prior = np.where(gaussian, -np.log(prior_stderr) - 0.5 * np.log(2 * np.pi), -np.log(width))
    value = -0.5 * terms @ terms - log_norm + log_prior.sum()
    value += len(z) / 2 * np.log(2 * np.pi) - 0.5 * log_det
    stderr = np.linalg.norm(axes.T / roots, axis=1) / scale
    slope = jacobian.T @ terms
    return float(value + sum(map(_log_mass, z, slope, stderr, lower, upper, added)))


def _log_mass(
    z: float, slope: float, stderr: float, lower: float, upper: float, added: float
) -> float:
    """Log of the mass of the Gaussian of this standard error within the bounds.

    Within, the curvature that was `added` for the bounds' sake is left out, and the slope at a
    bound is included, so that it is exact for one parameter.
    """
    whole = stderr**-2
    curvature = max(whole - added, LEAST_CURVATURE * whole)
    slope = slope if z <= lower or z >= upper else 0.0
    root = np.sqrt(curvature)
    low, high = sorted([(lower - z) * root + slope / root, (upper - z) * root + slope / root])
    if low > 0:  # the same mass in the other tail, where its log is precise
        low, high = -high, -low
    log_mass = scipy.special.log_ndtr(high) + np.log1p(
        -np.exp(scipy.special.log_ndtr(low) - scipy.special.log_ndtr(high))
    )
    return float(0.5 * np.log(whole / curvature) + slope**2 / (2 * curvature) + log_mass)
