"""Causal whitening of a stream: each sample less its prediction from those before it.

Detectors of this wing work on samples that are independent and normal with variance 1 where there
is noise alone, so that their rates of false alarms are those of white noise. Noise that is
correlated in time is predicted from its last samples (Yule 1927, Walker 1931); what is left is
white where noise is autoregressive of that order, and nearly so for a higher one.
"""

from typing import Any

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import ArrayLike, Float
from scipy.signal import lfilter

from ...errors import number, refuse, whole

ORDER = 32  # past samples in a prediction
REPEATED = 1e-12  # part of an element's noise that it has alone: below, rounding decides


class StreamWhitener(eqx.Module):
    """White noise of variance 1 from the noise of each element.

    - `prediction` (element, order): weights of the samples before, the last one first.
    - `root` (element, element): from what is left to independent samples of variance 1.
    """

    prediction: Float[np.ndarray, "e order"]
    root: Float[np.ndarray, "e e"]

    @classmethod
    def white(cls, rms_V: Any) -> "StreamWhitener":
        """Of white noise, with the rms [V] of each element (e,). Raises `BadInput` for an rms that
        is not positive."""
        given = np.atleast_1d(np.asarray(rms_V)).tolist()
        wanted = "a positive rms in V, for every element"
        rms = np.array([number("noise rms_V", each, wanted, above=0) for each in given], float)
        return cls(np.zeros((rms.size, 0)), np.diag(1 / rms))

    @classmethod
    def of_covariance(cls, covariance_V2: Float[np.ndarray, "e lag"]) -> "StreamWhitener":
        """Of noise that is independent from element to element, from each one's autocovariance
        [V^2] at the lags 0, 1, ... Raises `BadInput` where that is none."""
        made = [_predicted(own) for own in np.atleast_2d(np.asarray(covariance_V2, float))]
        left = np.array([each[1] for each in made])
        refuse(
            not np.all((left > 0) & np.isfinite(left)),
            "The noise's autocovariance is none of a random signal: give one that is positive at "
            "lag 0 and positive definite.",
        )
        return cls(np.stack([each[0] for each in made]), np.diag(1 / np.sqrt(left)))

    @classmethod
    def of_quiet(cls, signal: Float[np.ndarray, "e n"], order: int = ORDER) -> "StreamWhitener":
        """Of a stretch of noise alone, whose elements may have noise in common at the same
        instant.

        Raises `BadInput` for a stretch of fewer than 20 samples for each sample of the prediction,
        samples that are not finite, and elements that repeat one another.
        """
        signal = as_samples(signal)
        order, n = whole("order", order, "a whole number, at least 0", least=0), signal.shape[-1]
        refuse(
            n < 20 * (order + 1),
            f"The quiet stretch has {n} samples: give at least {20 * (order + 1)}.",
        )
        rest = signal - signal.mean(-1, keepdims=True)
        lags = [np.sum(rest[:, lag:] * rest[:, : n - lag], -1) / n for lag in range(order + 1)]
        own = cls.of_covariance(np.stack(lags, -1))
        left = _left(own.prediction, rest)[:, order:]
        covariance = left @ left.T / left.shape[-1]
        size = np.sqrt(np.diag(covariance))
        refuse(
            np.linalg.eigvalsh(covariance / np.outer(size, size))[0] < REPEATED,
            "An element repeats the noise of others: leave it out.",
        )
        return cls(own.prediction, np.linalg.inv(np.linalg.cholesky(covariance)))

    @property
    def order(self) -> int:
        """Number of past samples that a prediction takes."""
        return self.prediction.shape[-1]

    def __call__(
        self, signal: Float[np.ndarray, "e n"], before: Float[np.ndarray, "e order"] | None = None
    ) -> Float[np.ndarray, "e n"]:
        """The whitened samples; `before`: the samples before the first, None where those are 0.

        Raises `BadInput` for another number of elements, and samples that are not finite.
        """
        signal = as_samples(signal, len(self.root))
        if not signal.size:
            return signal
        start = np.zeros((signal.shape[0], self.order)) if before is None else before
        joined = np.concatenate([start, signal], axis=-1)
        return self.root @ _left(self.prediction, joined)[:, self.order :]


def as_samples(signal: ArrayLike, elements: int | None = None) -> Float[np.ndarray, "e n"]:
    """The samples (element, n) as floating-point numbers. Raises `BadInput` for another shape or
    number of elements, and samples that are not finite."""
    samples = np.asarray(signal, float)
    refuse(
        samples.ndim != 2 or elements not in (None, len(samples)),
        f"The samples have the shape {samples.shape}: give (element, sample)"
        f"{'' if elements is None else f', {elements} of the former'}.",
    )
    refuse(
        not bool(np.isfinite(samples).all()),
        "Samples are missing or not finite: fill them in before detection.",
    )
    return samples


def _predicted(covariance: Float[np.ndarray, " lag"]) -> tuple[np.ndarray, float]:
    """Weights of the samples before, and the variance that is left."""
    if covariance.size == 1 or not covariance[0] > 0:
        return np.zeros(covariance.size - 1), float(covariance[0])
    try:
        weights = scipy.linalg.solve_toeplitz(covariance[:-1], covariance[1:])
    except np.linalg.LinAlgError:
        return np.zeros(covariance.size - 1), 0.0
    return weights, float(covariance[0] - weights @ covariance[1:])


def _left(prediction: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """The signal less its prediction, where samples before the first are 0."""
    filters = np.concatenate([np.ones((len(prediction), 1)), -prediction], axis=1)
    return np.stack([lfilter(b, [1.0], row) for b, row in zip(filters, signal, strict=True)])
