"""Whether what a fit leaves is noise that is the same everywhere, or lies where the feature is.

A noise level that is taken from the residual takes up what the model misses, and one that was
measured elsewhere is compared with the mean over all samples. Noise has no place of its own; a
misfit lies where the fitted signal is. Let w be the whitened residual, white of variance one but
for the directions Q that the fit took out of it, and b = B w its sums over blocks of samples, of
covariance P = 1 - B Q Q^T B^T. With C_a the covariance of a correlated misfit under weights a (the
fitted signal's local amplitude), the score of a local excess is b^T C_a b, of mean tr(C_a P) and
variance 2 tr(C_a P C_a P). It is taken as a multiple of a chi-square with these (Satterthwaite),
the uncertainty of the noise's level added to its variance.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ... import false_alarm
from ...numerics import orthonormal_basis
from ..diagnostics import widened_for_misfit
from ..nonlinear import Fit
from ..quality import is_excess

MOST_BLOCKS = 512  # of samples, each with its mean: a misfit is as long as the film is deep
UNEXPLAINED = 0.25  # of the signals' power: a fit that leaves more is of another thing
PRESENT = 0.1  # of the fitted signal's greatest amplitude: from there on it is at a place


def local_excess(
    whitened: Float[np.ndarray, "e sample"],
    fitted: Float[np.ndarray, "e sample"],
    position_m: Float[np.ndarray, " sample"],
    depth_m: float,
    taken: Float[np.ndarray, "e sample m"] | None = None,
    level_stderr: float = 0.0,
) -> float:
    """The whitened residual's power where the fitted signal is, or within a depth of it, over that
    of noise; 1 where chance makes as much.

    - `whitened`: NaN where a sample is missing. `fitted`: the fitted signal.
    - `taken`: the derivatives of `whitened` by the parameters that were fitted.
    - `level_stderr`: relative standard error of the noise's level.
    """
    size = -(-whitened.shape[1] // MOST_BLOCKS)
    x = _means(position_m[None], size)[0]
    path = np.append(0.0, np.cumsum(np.abs(np.diff(x))))  # passes of one place are apart
    lag = np.abs(path[:, None] - path)
    power = np.nanmean(_means(fitted**2, size), axis=0)
    amplitude = np.sqrt(power / max(power.max(), np.finfo(float).tiny))
    near = np.max(np.where(lag <= depth_m, amplitude, 0.0), axis=-1)
    correlation = np.exp(-2 * lag / depth_m)
    observed = np.isfinite(whitened)
    counts = np.maximum(_sums(observed.astype(float), size), 1)
    blocks = _sums(np.where(observed, whitened, 0.0), size) / np.sqrt(counts)
    basis = _basis(taken, observed)
    basis = np.stack([_sums(rows, size) / np.sqrt(counts) for rows in basis], axis=-1)
    # A wrong shape is missed where the signal is large; flanks lie beside it, and may be small.
    weights = amplitude, near, (near >= PRESENT).astype(float)
    excesses = (
        _excess(blocks, basis, weight[:, None] * correlation * weight, level_stderr)
        for weight in weights
    )
    return max((each for each, p in excesses if p < false_alarm.CHECK / len(weights)), default=1.0)


def _basis(
    taken: Float[np.ndarray, "e sample m"] | None, observed: np.ndarray
) -> Float[np.ndarray, "k e sample"]:
    """An orthonormal basis of what the fit took out of the residual."""
    if taken is None or not taken.shape[-1]:
        return np.zeros((1, *observed.shape))
    columns = np.where(observed[..., None], taken, 0.0).reshape(observed.size, -1)
    return orthonormal_basis(columns).T.reshape(-1, *observed.shape)


def _excess(
    blocks: Float[np.ndarray, "e block"],
    basis: Float[np.ndarray, "e block k"],
    local: Float[np.ndarray, "block block"],
    level_stderr: float,
) -> tuple[float, float]:
    """The power along `local` over that of noise, and the probability of as much: with P = 1 - Q
    Q^T, tr(C P C P) = tr(C C) - 2 tr(Q^T C C Q) + tr(Q^T C Q Q^T C Q)."""
    turned = local @ basis
    inner = np.einsum("ebk,ebl->kl", basis, turned)
    mean = len(blocks) * float(np.trace(local)) - float(np.trace(inner))
    squares = len(blocks) * float(np.sum(local**2)) - 2 * float(np.sum(turned**2))
    variance = 2 * (squares + float(np.sum(inner**2)))
    if not (mean > 0 and variance > 0):
        return 1.0, 1.0
    ratio = float(np.einsum("eb,bc,ec->", blocks, local, blocks, optimize=True)) / mean
    freedom = 2 / (variance / mean**2 + 4 * level_stderr**2)
    return ratio, float(scipy.special.chdtrc(freedom, freedom * ratio))


def _sums(values: Float[np.ndarray, "row sample"], size: int) -> Float[np.ndarray, "row block"]:
    """Sums over blocks of samples."""
    return np.add.reduceat(values, np.arange(0, values.shape[-1], size), axis=-1)


def _means(values: Float[np.ndarray, "row sample"], size: int) -> Float[np.ndarray, "row block"]:
    """Means over blocks of samples; NaN, which is missing, is left out."""
    known = np.isfinite(values)
    counts = np.maximum(_sums(known.astype(float), size), 1)
    return _sums(np.where(known, values, 0.0), size) / counts


def excess_of(fit: Fit, y: Float[np.ndarray, "e sample"], position_m: Any, depth_m: float) -> float:
    """The power of what a fit to the signals `y` at these positions leaves where its signal is,
    over that of the noise; 1 where chance makes as much, and where the noise was not known.

    `depth_m`: of the film, which gives the scale of a misfit.
    """
    if fit.noise_rms is not None:
        return 1.0
    observed = np.isfinite(fit.residual)
    whitened = np.where(observed, np.reshape(fit.whitened, y.shape), np.nan)
    taken = np.reshape(fit.jacobian[: y.size], (*y.shape, -1))
    x, level_stderr = np.asarray(position_m, float), fit.noise_level_stderr
    return local_excess(whitened, y - fit.residual, x, depth_m, taken, level_stderr)


class FitMisfit(NamedTuple):
    """How many `times` the noise a fit leaves, 1 where chance makes as much, and the warnings on
    it. Errors of parameters by the noise are as many times as large."""

    times: float
    warnings: tuple[str, ...]

    @classmethod
    def of(
        cls,
        fit: Fit,
        y: Float[np.ndarray, "e sample"],
        position_m: Any,
        depth_m: float,
        remedy: str = "",
    ) -> "FitMisfit":
        """That of a fit to the signals `y` at these positions. None where the fit is no answer, or
        leaves more than `UNEXPLAINED` beyond the noise: no errors of its parameters hold then.

        `remedy`: see `widened_for_misfit`.
        """
        chi2, freedom = fit.known_chi2, fit.stats["degrees_of_freedom"]
        is_over = chi2 is not None and is_excess(chi2, freedom, 0.0, fit.noise_level_stderr)
        overall = chi2 if chi2 is not None and is_over else 1.0
        missed = (1 - 1 / overall) * np.nansum(fit.residual**2)
        explained = np.nansum((y - fit.residual) ** 2)
        if not fit.status.is_answer or missed > UNEXPLAINED * (missed + explained):
            return cls(1.0, ())
        local = excess_of(fit, y, position_m, depth_m)
        said = widened_for_misfit(overall, local, remedy)
        return cls(float(np.sqrt(max(overall, local))), tuple(said))

    def moves(self, fit: Fit) -> Float[np.ndarray, "m m"]:
        """The moves of the fit's parameters that are added to those by the noise."""
        return np.sqrt(self.times**2 - 1) * fit.moves_by_noise()
