"""Classification of textures by the spectra of their scans, the same for every set of sensors.

The features are the logarithms of the power in bands of frequency. In a band of many waves the
logarithm is nearly Gaussian, with a variance that does not depend on the texture, so that linear
discriminant analysis (Fisher 1936) is the likelihood's own rule. Its covariance is shrunk towards
the diagonal by the amount that Schaefer and Strimmer (2005) derive from the data.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from experiments.textures.texture import tapered_power

from .scans import Finger, Texture

FOLDS = 5  # parts of the surfaces, each classified by what the others teach
CASES = ("film", "accelerometer", "both")
RESAMPLES = 1000
ENDS = (0.05, 0.95)  # of a band of 90 %
FIRST = 2  # a Hann window spreads the mean over the wave below


class Classification(NamedTuple):
    """How textures are classified: so many `surfaces` of each, whose log rms height scatters by
    `spread`; the first `samples` of a scan; `bands` of frequency."""

    finger: Finger
    surfaces: int
    spread: float
    samples: int
    bands: int

    def pressed(
        self, textures: Sequence[Texture], nominal_Pa: float
    ) -> Float[np.ndarray, "texture surface n"]:
        """Pressure [Pa] under every surface."""
        given = nominal_Pa, self.surfaces, self.spread
        return np.stack([self.finger.pressed(each, i, *given) for i, each in enumerate(textures)])

    def right(
        self,
        textures: Sequence[Texture],
        pressed: Mapping[float, Float[np.ndarray, "texture surface n"]],
        key: Any,
    ) -> Bool[np.ndarray, "case pressure texture surface"]:
        """Whether each scan is assigned to its texture, by the films, the accelerometer and both,
        at every nominal pressure of `pressed`."""
        every = []
        for i, (nominal, pressures) in enumerate(pressed.items()):
            scans = self.finger.scans(textures, pressures, nominal, jax.random.fold_in(key, i))
            rows = log_band_powers(scans, self.samples, self.bands)
            cases = rows[:-1], rows[-1:], rows
            every.append([is_right(np.concatenate(list(case), axis=-1)) for case in cases])
        return np.stack(every, axis=1)


def log_band_powers(
    signals: Float[np.ndarray, "row texture surface n"], samples: int, bands: int
) -> Float[np.ndarray, "row texture surface band"]:
    """Logarithm of every row's power in up to so many bands, even in the logarithm of frequency, of
    the first `samples` of each scan."""
    power = tapered_power(signals, samples)
    edges = np.unique(np.round(np.geomspace(FIRST, power.shape[-1] - 1, bands + 1)).astype(int))
    sums = np.add.reduceat(power[..., : edges[-1]], edges[:-1], axis=-1)
    return np.log(sums / np.diff(edges))


def is_right(features: Float[np.ndarray, "texture surface d"]) -> Bool[np.ndarray, "t s"]:
    """Whether every scan is assigned to its texture, by what other surfaces teach: in `FOLDS`
    parts, no surface being in both."""
    textures, surfaces = features.shape[:2]
    chosen, part = np.zeros((textures, surfaces), int), np.arange(surfaces) % FOLDS
    for fold in range(FOLDS):
        held = part == fold
        chosen[:, held] = discriminated(features[:, ~held], features[:, held])
    return chosen == np.arange(textures)[:, None]


def discriminated(
    known: Float[np.ndarray, "texture surface d"], new: Float[np.ndarray, "*rows d"]
) -> Int[np.ndarray, "*rows"]:
    """The most likely texture of each row, by linear discriminant analysis."""
    mean = known.mean(axis=1)
    covariance = shrunk_covariance((known - mean[:, None]).reshape(-1, mean.shape[-1]))
    weights = np.linalg.solve(covariance, mean.T)  # (d, texture)
    score = new @ weights - np.sum(mean.T * weights, axis=0) / 2
    return score.argmax(axis=-1)


def shrunk_covariance(deviations: Float[np.ndarray, "row d"]) -> Float[np.ndarray, "d d"]:
    """Covariance of rows of mean zero, whose correlations are shrunk by the estimated ratio of
    their variance to their square."""
    size = np.sqrt(np.mean(deviations**2, axis=0))
    unit = deviations / size
    count = len(unit)
    correlation = unit.T @ unit / count
    variance = ((unit**2).T @ unit**2 / count - correlation**2) / count
    off = ~np.eye(len(size), dtype=bool)
    square = np.sum(correlation[off] ** 2)
    amount = min(1.0, float(np.sum(variance[off]) / square)) if square > 0 else 1.0
    correlation[off] *= 1 - amount
    return correlation * size * size[:, None]


def accuracies(
    right: Bool[np.ndarray, "case pressure texture surface"], seed: int
) -> tuple[Float[np.ndarray, "case 3"], Float[np.ndarray, "3"]]:
    """Accuracy of every case over all pressures, and how much the last case has above the best of
    the others: value, least and greatest of a 90 % interval.

    The interval is by bootstrap over surfaces (Efron and Tibshirani 1993): the scans of a surface
    at all pressures are drawn together.
    """
    each = right.mean(axis=1)  # case, texture, surface
    cases, textures, surfaces = each.shape
    random = np.random.default_rng(seed)
    drawn = random.integers(surfaces, size=(RESAMPLES, textures, surfaces))
    resampled = np.take_along_axis(each[:, None], drawn[None], axis=-1).mean(axis=(2, 3))
    gain = resampled[-1] - resampled[:-1].max(axis=0)
    mean = each.mean(axis=(1, 2))
    ends = np.quantile(resampled, ENDS, axis=1).T
    value = np.concatenate([mean[:, None], ends], axis=1)
    own = mean[-1] - mean[:-1].max()
    return value.reshape(cases, 3), np.array([own, *np.quantile(gain, ENDS)])
