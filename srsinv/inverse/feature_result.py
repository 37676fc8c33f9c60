"""Result of a fit of features: a candidate, its parameters and its warnings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import softmax

from ..forward.feature import Feature
from ..forward.surface_feature import SurfaceFeature
from ..grid import as_real
from ..status import Status
from .diagnostics import of_fit, undetected
from .feature_model import FeatureModel
from .identifiability import undetected_features
from .nonlinear import Fit, whitener
from .quality import Quality, quality, reasons
from .surface_model import SurfaceModel


@dataclass(frozen=True)
class FeatureFit:
    """A fitted candidate.

    - `features`: by name; none for "nothing there". `fit`: the fit below, None without any free
      parameter. `model`: parameters to signal and traction.
    - `parameters`: reported (value, standard error) by name: the shape, the amplitude and the
      friction of each feature, of a surface the height and the frictions; names begin with the
      feature's where there are several. Their standard errors are infinite where the fit failed.
    - `log_evidence`: log probability density of the data under the candidate.
    - `chi2_per_freedom` of the residual's `degrees_of_freedom`; None where it is undefined.
    - `noise_warnings`: warnings on noise that was estimated from the residual.
    """

    features: Mapping[str, Feature | SurfaceFeature]
    fit: Fit | None
    model: FeatureModel | SurfaceModel
    parameters: dict[str, tuple[float, float]]
    log_evidence: float
    chi2_per_freedom: float | None
    degrees_of_freedom: float | int
    noise_warnings: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The features' names, joined."""
        return " + ".join(self.features) or "nothing"

    @property
    def status(self) -> Status:
        """How the search ended."""
        return Status.CONVERGED if self.fit is None else self.fit.status

    @property
    def explains(self) -> bool:
        """Whether the residual is no larger than the noise."""
        return self.fit is not None and explains(self.fit)

    @classmethod
    def of(
        cls,
        features: Mapping[str, Feature | SurfaceFeature],
        fit: Fit,
        model: FeatureModel | SurfaceModel,
        parameters: dict[str, tuple[float, float]],
        log_evidence: float,
        noise_warnings: tuple[str, ...] = (),
    ) -> "FeatureFit":
        """A candidate with features or constants fitted."""
        if fit.quality is Quality.FAILED:  # its standard errors are not valid
            parameters = {name: (value, np.inf) for name, (value, _) in parameters.items()}
        freedom = fit.stats["degrees_of_freedom"]
        return cls(
            features, fit, model, parameters, log_evidence, fit.known_chi2, freedom, noise_warnings
        )

    @classmethod
    def of_nothing(cls, model: FeatureModel | SurfaceModel, y, noise: Any) -> "FeatureFit":
        """The candidate that the data (element, sample) are noise alone."""
        data = np.asarray(y, float)
        white, observed = whitener(noise, data.shape)
        rest = np.asarray(white(as_real(np.where(observed, data, 0.0))))
        count = white.count(data.shape)
        volume = white.log_volume(data.shape) + count / 2 * np.log(2 * np.pi)
        chi2 = float(rest @ rest) / count if count else None
        return cls({}, None, model, {}, float(-0.5 * rest @ rest - volume), chi2, count)

    @property
    def undetected(self) -> tuple[str, ...]:
        """Features that are not detected."""
        return () if self.fit is None else undetected_features(self.features, self.fit)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on the parameters and their standard errors, as sentences."""
        if self.fit is None:
            chi2, freedom = self.chi2_per_freedom, self.degrees_of_freedom
            return (*of_fit(chi2, freedom, (), ()), *self.noise_warnings)
        return (*self.fit.warnings, *map(undetected, self.undetected), *self.noise_warnings)

    @property
    def quality(self) -> Quality:
        """Good, doubtful (any warning) or failed."""
        chi2, freedom = self.chi2_per_freedom, self.degrees_of_freedom
        return quality(self.status, chi2, self.warnings, freedom)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the quality is not good, as sentences."""
        return reasons(self.status, self.warnings)

    def signal(self) -> Float[np.ndarray, "e sample"]:
        """The fitted signal."""
        value = {} if self.fit is None else self.fit.value
        return np.asarray(self.model(jax.tree.map(as_real, value)))


def explains(end: Fit) -> bool:
    """Whether a fit's residual is no larger than the noise."""
    return bool(end.converged and end.explains)


def traction_band(fitted: FeatureFit) -> tuple[np.ndarray, np.ndarray]:
    """p and q (2, n) [Pa] on the model's line while sliding towards +x, and their standard error
    to first order, infinite where the fit failed."""
    n = fitted.model.line.n
    if fitted.fit is None:
        return np.zeros((2, n)), np.zeros((2, n))
    value, stderr = fitted.fit.derive(lambda params: jnp.ravel(fitted.model.traction(params)))
    if fitted.quality is Quality.FAILED:
        stderr = np.full_like(stderr, np.inf)
    return value.reshape(2, n), stderr.reshape(2, n)


def probabilities(candidates: Sequence[FeatureFit]) -> np.ndarray:
    """Posterior probability of each candidate (c,), all equally probable a priori."""
    return np.asarray(softmax([candidate.log_evidence for candidate in candidates]))
