"""Quality of an answer by one rule: good, doubtful, no bands or failed, and the reasons.

Under the model, the squares of the whitened residual add up to the samples less the numbers that
were fitted: they are chi-square.
"""

import enum
import math
from collections.abc import Collection

import numpy as np
from jaxtyping import Float

from ..status import Status

# The root of chi-square per degree of freedom beyond which an answer has failed. Bands are those of
# the noise as stated; where the residual is s times that noise, so are the errors, or more, and a
# 90 % band covers P(|z| < 1.645 / s). At s = 1.645 / 0.674 = 2.44 (chi-square 5.9) that is a half:
# beyond it a band misses the truth more often than it covers it. The model or the noise is wrong
# then, by an unknown amount.
FAILED_RMS = 1.6449 / 0.6745
# Standard deviations of the root of a chi-square (1 / sqrt(2 dof) each) that count as chance: with
# fewer than six degrees of freedom they reach beyond `FAILED_RMS`.
SIGNIFICANT = 5.0
WITHOUT_BANDS = "The method gives no standard errors, so the size of its error is unknown."
BANDS, LEAST_IN_BAND = 16, 8  # of a residual's spectrum, and the least wavenumbers in one
MEDIAN_VARIANCE = 2.08  # relative, of m exponential variates' median, times m: 1 / log(2)^2


class Quality(enum.StrEnum):
    """Quality of a result.

    - `GOOD`: no warnings on it or its bands.
    - `DOUBTFUL`: an answer with warnings; its bands may be too narrow.
    - `NO_BANDS`: an answer without standard errors, and without warnings.
    - `FAILED`: no answer: the search did not converge, or the residual is so far beyond the noise
      that no band is valid.
    """

    GOOD = "good"
    DOUBTFUL = "doubtful"
    NO_BANDS = "no bands"
    FAILED = "failed"


def quality(
    status: Status,
    chi2_per_dof: float | int | None,
    warnings: Collection[str],
    degrees_of_freedom: float | int = math.inf,
    has_bands: bool = True,
) -> Quality:
    """The quality of a result.

    - `status`: how the computation ended.
    - `chi2_per_dof`: squares of the whitened residual over their degrees of freedom; None where the
      noise was not known.
    - `warnings`: sentences on the validity of the result.
    - `degrees_of_freedom`: of the residual; with few of them a large chi-square can be chance.
    - `has_bands`: whether the result has standard errors.
    """
    if not status.is_answer:
        return Quality.FAILED
    if chi2_per_dof is not None and is_excess(chi2_per_dof, degrees_of_freedom, FAILED_RMS):
        return Quality.FAILED
    if warnings:
        return Quality.DOUBTFUL
    return Quality.GOOD if has_bands else Quality.NO_BANDS


def is_excess(
    chi2_per_dof: float | int,
    degrees_of_freedom: float | int,
    most_rms: float = 0.0,
    level_stderr: float = 0.0,
) -> bool:
    """Whether the root of a chi-square per degree of freedom exceeds `most_rms` beyond chance; NaN
    does.

    `level_stderr`: relative standard error of the noise's level, which scales every residual.
    """
    if not degrees_of_freedom >= 1:
        return False
    chance = 1 + SIGNIFICANT * math.hypot(1 / math.sqrt(2 * degrees_of_freedom), level_stderr)
    return not chi2_per_dof <= max(most_rms, chance) ** 2


def independent_share(whitened: Float[np.ndarray, " n"]) -> float:
    """How much of the values' number counts as independent in the scatter of their mean square,
    where noise is correlated from one to the next (a low-pass, say): with the power spectrum P it
    is mean(P)^2 / mean(P^2). P is taken from medians over bands, which neither a line nor a slow
    misfit moves."""
    power = np.abs(np.fft.rfft(whitened)[1:]) ** 2
    if power.size < BANDS * LEAST_IN_BAND:
        return 1.0
    bands = np.array([np.median(each) for each in np.array_split(power, BANDS)])
    square = float(np.mean(bands**2))
    if not square > 0:
        return 1.0
    # Medians scatter, and their squares' mean is larger by that, too.
    scatter = 1 + MEDIAN_VARIANCE * BANDS / power.size
    return min(1.0, float(np.mean(bands)) ** 2 / square * scatter)


def reasons(status: Status, warnings: Collection[str], has_bands: bool = True) -> tuple[str, ...]:
    """Reasons why a result is not good, as sentences; none for a good one.

    A chi-square that makes it fail is among the warnings, too.
    """
    stopped = () if status.is_answer else (f"There is no answer: {status}. {status.advice}",)
    return (*stopped, *warnings, *(() if has_bands else (WITHOUT_BANDS,)))
