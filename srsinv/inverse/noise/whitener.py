"""The noise's inverse covariance over the samples that are there, as a map."""

import numpy as np
from jaxtyping import Float

from ...numerics import FLAT, is_flat
from ..line.gaps import MOST_STEPS, Gaps, Map, conjugate_gradients
from ..line.model import EstimateParts, LineModel
from ..line.transforms import from_spectrum, to_spectrum

TIGHT = 1e-12

Signal = Float[np.ndarray, "e n"]


class NoisePrecision:
    """R^-1, R the covariance of the noise of a problem, its nuisance aside."""

    def __init__(self, problem: LineModel, gaps: Gaps):
        self.gaps, self.n = gaps, problem.line.n
        self.precision = np.asarray(problem.whitener, float) ** 2
        self.scale, has_offset = problem.noise_scale, problem.has_free_offset
        if self.scale is not None:  # then what an offset takes is no mean
            self.scale = np.asarray(self.scale, float)
            self.precision[:, 0] = self.precision[:, int(has_offset)]
        self.is_observed = problem.is_observed
        at_zero, last = self.precision[:, 0], self.precision[:, -1]
        is_alike = np.abs(at_zero - last) <= FLAT * last
        self.is_white = is_flat(self.precision[:, 1:]) and bool(np.all((at_zero == 0) | is_alike))
        self._fill = None if self.is_white or not gaps.cell.size else self._filler()
        self.of_offset = None
        if self.scale is not None and has_offset:
            self.of_offset = self._weighed(1 / self.scale) / self.scale

    def __call__(self, y: Signal) -> Signal:
        """R^-1 y, zero where samples are missing; R = S N S where the noise has a scale S."""
        if self.scale is None:
            return self._weighed(y)
        y = self._weighed(y / self.scale) / self.scale
        if self.of_offset is None:
            return y
        offset = y.sum(axis=-1, keepdims=True) / self.of_offset.sum(axis=-1, keepdims=True)
        return y - offset * self.of_offset

    def _weighed(self, y: Signal) -> Signal:
        """The same for noise without a scale.

        Missing samples are completed so that N^-1 y vanishes there; white noise needs none of it.
        """
        y = np.where(self.is_observed, y, 0.0)
        if self.is_white:
            if not self.precision[:, 0].any():
                count = np.maximum(self.is_observed.sum(axis=-1, keepdims=True), 1)
                y = y - y.sum(axis=-1, keepdims=True) / count
            return np.where(self.is_observed, y * self.precision[:, -1:], 0.0)
        weighed = self._times_precision(y)
        if self._fill is not None:
            filling = self._fill(self.gaps.picked(weighed))
            weighed = weighed - self._times_precision(self.gaps.placed(filling))
        return np.where(self.is_observed, weighed, 0.0)

    def _filler(self) -> Map:
        """The inverse of N^-1 over the missing samples."""
        lags = from_spectrum(self.precision, self.n)
        each = np.eye(len(self.is_observed))[..., None] * lags
        whole = self.gaps.whole_inverse(each)
        if whole is not None:
            return whole
        blocks = self.gaps.inverses(each)

        def operator(values):
            return self.gaps.picked(self._times_precision(self.gaps.placed(values)))

        return lambda right: conjugate_gradients(operator, blocks, right, TIGHT, MOST_STEPS).value

    def _times_precision(self, y: Signal) -> Signal:
        return from_spectrum(to_spectrum(y) * self.precision, self.n)


def residual_squares(problem: LineModel, parts: EstimateParts) -> float:
    """The residual's sum of squares in units of the noise, exact where samples are missing from
    coloured noise too: a residual that is whitened with zeros in its gaps is not white then."""
    if problem.observed is None or is_flat(np.asarray(problem.noise)[:, 1:]):
        return float(parts.squares)
    left = np.asarray(problem.data + problem.mean_signal, float) - np.asarray(parts.fitted, float)
    left = np.where(problem.is_observed, left, 0.0)
    return float(np.vdot(left, NoisePrecision(problem, Gaps.of(problem.is_observed))(left)))
