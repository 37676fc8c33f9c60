"""The fit of features under jit, vmap, grad and jvp, by the data, their noise and the sensor.

Its parts are those of a known fit. The bank of matched filters gives shapes to start from, one
feature after the other, and `srsinv.fit` the least of the minima reached, with its derivatives. (A
known fit takes the first that explains the data.) What checks a known fit is left out: its misfit
and the error of its cells, which widen the standard errors, a drift, and other minima.

Cells, ranges and shapes to start from are those of a known sensor: of a traced one they are of the
nominal one.

Of a surface the pressure's derivative jumps where an edge moves over a cell. So the derivatives of
the estimate, too, are by differences over whole cells. They are those that the standard errors are
made of.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...errors import refuse
from ...forward.surface_feature import CylinderFeature
from ...grid import Line
from ...known import is_traced
from ..line.problem import LineProblem
from ..noise.model import Samples
from ..nonlinear import TracedFit, whitener
from ..quality import Quality
from .contact import ContactLoading
from .fit import FeatureFitter
from .identifiability import DETECTION_SIGMA, STRONG_CORRELATION
from .loading import Features
from .model import FeatureModel

Pair = tuple[Float[Array, ""], Float[Array, ""]]


class TracedFeatureEstimate(eqx.Module):
    """Features as jax traces their fit: see [`FeatureEstimate`][].

    - `parameters`: as a known fit reports them; NaN where the search did not converge.
    - `fit`: the [`TracedFit`][] below. `line`: of the traction `value`, `stderr` (2, n) [Pa].
    - `warnings`: that the fit was not checked; its `quality` is doubtful.
    """

    features: Features
    fit: TracedFit
    model: FeatureModel
    parameters: Mapping[str, Pair]
    line: Line
    background_Pa: Float[Array, " 2"]

    @property
    def value(self) -> Float[Array, "2 n"]:
        """p and q [Pa] on the line."""
        return self._traction()[0] + jnp.asarray(self.background_Pa)[:, None]

    @property
    def stderr(self) -> Float[Array, "2 n"]:
        """Its standard error [Pa], to first order."""
        return self._traction()[1]

    @property
    def warnings(self) -> tuple[str, ...]:
        """That JAX traced the fit."""
        return self.fit.warnings

    @property
    def quality(self) -> Quality:
        """Doubtful, as nothing was checked."""
        return self.fit.quality

    def _traction(self) -> tuple[Float[Array, "2 n"], Float[Array, "2 n"]]:
        turn = np.array([[1.0], [1.0 if self.model.operator.directions[0] else -1.0]])

        def of(params: Any) -> Float[Array, " row"]:
            return jnp.ravel(turn * self.model.filled.cell_traction(params, self.line))

        value, stderr = self.fit.derive(of)
        return value.reshape(2, -1), stderr.reshape(2, -1)


UNTRACED = (
    "Under jit, vmap and grad a fit of features needs a LineProblem without a rig, of which JAX "
    "traces the data, the noise or the sensor alone: of a recorded problem make one outside "
    "(grid = problem.to_grid()), and put the data in it by eqx.tree_at(lambda p: p.data, grid, y)."
)
UNTRACED_CELLS = (
    "JAX traces the sensor, so that its depth gives no cells and no starts: give a known sensor "
    "near it, as FeatureFit(features, nominal_sensor=Sensor())."
)


def traceable(features: Features, problem: Any) -> LineProblem:
    """The problem, where its features can be fitted as jax traces it."""
    refuse(
        any(isinstance(feature, CylinderFeature) for feature in features.values()),
        "JAX does not trace the fit of a cylinder: fit it outside jit, vmap and grad.",
    )
    refuse(
        not isinstance(problem, LineProblem)
        or not features
        or problem.rig is not None
        or is_traced(problem.line, problem.scan, problem.background_Pa),
        UNTRACED,
    )
    return problem


def traced_estimate(
    fitter: FeatureFitter,
    features: Features,
    problem: LineProblem,
    samples: Samples,
    start: Mapping[str, float],
) -> TracedFeatureEstimate:
    """The estimate of a problem of which jax traces the data, the noise or the sensor."""
    assert problem.scanned is not None
    observed = np.asarray(problem.is_observed)[:, problem.scanned.cells]
    y = jnp.where(observed, jnp.asarray(samples.signal), 0.0)
    model, fit, priors = fitter.traced(features, y, observed, samples.noise, start)
    read: dict[str, Pair] = {}
    if any(feature.is_of_surface for feature in features.values()):
        is_missed = ~(_gain(fit, y, samples.noise, model.free_offset) >= DETECTION_SIGMA**2)
        read = _of_surface(features, fit, is_missed)
    else:
        for name in features:
            read |= _of_traction(features, name, fit, priors)
    known = (0.0 if each is None else each for each in problem.background_Pa)
    background = jnp.stack([jnp.asarray(each, float) for each in known])
    return TracedFeatureEstimate(dict(features), fit, model, read, problem.line, background)


def _of_traction(
    features: Features, name: str, fit: TracedFit, priors: Mapping[str, Any]
) -> dict[str, Pair]:
    """A feature's parameters as `DirectLoading.report` has them of a known fit."""
    feature, prefix = features[name], f"{name}_" if len(features) > 1 else ""
    is_at_bound, limited = dict(zip(fit.names, fit.is_at_bound, strict=True)), _limited(fit)
    missed = {other: _is_missed(f"{other}.", each, fit) for other, each in features.items()}
    alike = [missed[n] for n, f in features.items() if n != name and type(f) is type(feature)]
    own, spread = fit.value[name], fit.stderr[name]
    shape, amplitude = feature.axes, feature.amplitude
    error = {
        part: _unless(limited[f"{name}.{part}"] | missed[name], spread[part]) for part in shape
    }
    strength = jnp.where(missed[name], priors[f"{name}.{amplitude}"][1], spread[amplitude])
    others = jnp.any(jnp.array([limited[f"{name}.{amplitude}"], *alike]))
    error[amplitude] = _unless(others, strength)
    listed = feature.canonical({part: own[part] for part in error})
    read: dict[str, Pair] = {prefix + part: (listed[part], error[part]) for part in error}
    if feature.friction is None:

        def ratio_of(params: Any) -> Any:
            return params[name][feature.shear] / params[name][amplitude]

        ratio, spread = fit.derive(ratio_of)
        unsure = missed[name] | is_at_bound.get(f"{name}.position_m", False)
        read[f"{prefix}friction"] = ratio, _unless(unsure, spread)
    return read


def _of_surface(features: Features, fit: TracedFit, is_missed: Bool[Array, ""]) -> dict[str, Pair]:
    """The parameters as `ContactLoading.report` has them of a known fit."""
    limited = _limited(fit)
    return {
        reported: (
            ContactLoading.part_of(fit.value, own),
            _unless(is_missed | limited[own], ContactLoading.part_of(fit.stderr, own)),
        )
        for reported, own in ContactLoading.reported(features, fit.names).items()
    }


def _gain(
    fit: TracedFit, y: Float[Array, "e sample"], noise: Any, free_offset: bool
) -> Float[Array, ""]:
    """Reduction of chi squared by the features, constants taken out: see `undetected_features`."""
    white, _ = whitener(noise, y.shape)
    rest = white(y)
    if free_offset:
        units = jnp.eye(len(y))[:, :, None] * jnp.ones(y.shape)
        basis, _ = jnp.linalg.qr(jax.vmap(white, out_axes=1)(units))
        rest = rest - basis @ (basis.T @ rest)
    return jnp.vdot(rest, rest) - jnp.vdot(fit.whitened, fit.whitened)


def _unless(is_unsure: Any, stderr: Any) -> Float[Array, ""]:
    """The standard error, infinite where it is not valid."""
    return jnp.where(is_unsure, jnp.inf, stderr)


def _limited(fit: TracedFit) -> dict[str, Bool[Array, ""]]:
    """Whether each parameter is on a bound, or correlated with one that is."""
    stderr = jnp.sqrt(jnp.diagonal(fit.covariance))
    correlation = jnp.abs(fit.covariance / jnp.outer(stderr, stderr))
    traded = jnp.any((correlation > STRONG_CORRELATION) & fit.is_at_bound[:, None], axis=0)
    return dict(zip(fit.names, traded | fit.is_at_bound, strict=True))


def _is_missed(prefix: str, feature: Any, fit: TracedFit) -> Bool[Array, ""]:
    """Whether a feature is not detected above the noise: see `undetected_features`."""
    at = np.array([fit.names.index(prefix + part) for part in feature.linear])
    value, covariance = fit.row[at], fit.covariance[at[:, None], at]
    return ~(jnp.vdot(value, jnp.linalg.solve(covariance, value)) >= DETECTION_SIGMA**2)
