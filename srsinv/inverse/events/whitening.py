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
from jaxtyping import Float
from scipy.signal import lfilter

from ...errors import refuse

ORDER = 32  # past samples in a prediction


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
        rms = np.atleast_1d(np.asarray(rms_V, float))
        refuse(
            not np.all((rms > 0) & np.isfinite(rms)),
            f"The noise has the rms {rms.tolist()} V: give a positive one for every element.",
        )
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

        Raises `BadInput` for a stretch of fewer than 20 samples for each sample of the prediction.
        """
        n = signal.shape[-1]
        refuse(
            n < 20 * (order + 1),
            f"The quiet stretch has {n} samples: give at least {20 * (order + 1)}.",
        )
        rest = signal - signal.mean(-1, keepdims=True)
        lags = [np.sum(rest[:, lag:] * rest[:, : n - lag], -1) / n for lag in range(order + 1)]
        own = cls.of_covariance(np.stack(lags, -1))
        left = _left(own.prediction, rest)[:, order:]
        factor = np.linalg.cholesky(left @ left.T / left.shape[-1])
        return cls(own.prediction, np.linalg.inv(factor))

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
        elements = len(self.root)
        refuse(
            signal.ndim != 2 or len(signal) != elements,
            f"The samples have the shape {signal.shape}: give (element, sample), {elements} of the "
            "former.",
        )
        refuse(
            not bool(np.isfinite(signal).all()),
            "Samples are missing or not finite: fill them in before detection.",
        )
        start = np.zeros((signal.shape[0], self.order)) if before is None else before
        joined = np.concatenate([start, signal], axis=-1)
        return self.root @ _left(self.prediction, joined)[:, self.order :]


def _predicted(covariance: Float[np.ndarray, " lag"]) -> tuple[np.ndarray, float]:
    """Weights of the samples before, and the variance that is left."""
    if covariance.size == 1 or not covariance[0] > 0:
        return np.zeros(covariance.size - 1), float(covariance[0])
    weights = scipy.linalg.solve_toeplitz(covariance[:-1], covariance[1:])
    return weights, float(covariance[0] - weights @ covariance[1:])


def _left(prediction: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """The signal less its prediction, where samples before the first are 0."""
    filters = np.concatenate([np.ones((len(prediction), 1)), -prediction], axis=1)
    return np.stack([lfilter(b, [1.0], row) for b, row in zip(filters, signal, strict=True)])
