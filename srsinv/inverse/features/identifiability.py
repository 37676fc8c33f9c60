"""Identifiability in a fit of features: undetected features, and parameters on a bound. Their
linearised standard errors are not valid."""

from collections.abc import Mapping

import numpy as np

from ...forward.feature import Feature
from ...forward.surface_feature import SurfaceFeature
from ..nonlinear import Fit

# Standard errors of a strength from zero. Noise alone, searched at every place and width, gives
# features of up to four.
DETECTION_SIGMA = 5.0
ALIKE = 1e-14  # least eigenvalue of a correlation that a float64 resolves: less is rounding
STRONG_CORRELATION = 0.3  # correlation above which one parameter's bound limits another


def undetected_features(
    features: Mapping[str, Feature | SurfaceFeature], fit: Fit
) -> tuple[str, ...]:
    """Features not detected above the noise: their place, width and friction are then those of
    noise."""
    fit = fit.without_misfit
    if any(feature.is_of_surface for feature in features.values()):
        return () if _gain(fit) >= DETECTION_SIGMA**2 else tuple(features)
    return tuple(
        name
        for name, feature in features.items()
        if not _strength(name, feature.linear, fit) >= DETECTION_SIGMA
    )


def limited_by_bounds(fit: Fit) -> frozenset[str]:
    """Parameters on a bound, and those correlated with them: the unbounded optimum lies beyond, and
    no standard error covers it."""
    fit = fit.without_misfit
    rows = [fit.names.index(name) for name in fit.at_bound]
    with np.errstate(invalid="ignore"):
        traded = np.any(np.abs(fit.correlation[rows]) > STRONG_CORRELATION, axis=0)
    return frozenset(np.array(fit.names, object)[traded]) | frozenset(fit.at_bound)


def _strength(name: str, linear: tuple[str, ...], fit: Fit) -> float:
    """Mahalanobis distance of the amplitudes of p and q from zero, in standard errors."""
    at = [fit.names.index(f"{name}.{part}") for part in linear]
    value = np.array([fit.value[name][part] for part in linear])
    stderr = np.sqrt(np.diagonal(fit.covariance))[at]
    if not np.all((stderr > 0) & np.isfinite(stderr)):
        return np.inf if not np.any(stderr) and np.any(value) else 0.0
    unit = value / stderr
    values, axes = np.linalg.eigh(fit.correlation[np.ix_(at, at)])
    return float(np.sqrt(np.sum((axes.T @ unit) ** 2 / np.maximum(values, ALIKE))))


def _gain(fit: Fit) -> float:
    """Reduction of chi squared by the features, constants taken out."""
    white = fit.whitened + fit.whitened_signal()
    constant = [i for i, name in enumerate(fit.names) if name.partition("[")[0] == "offset"]
    if constant:
        basis, _ = np.linalg.qr(fit.jacobian[:, constant])
        white = white - basis @ (basis.T @ white)
    return float(white @ white - fit.whitened @ fit.whitened)
