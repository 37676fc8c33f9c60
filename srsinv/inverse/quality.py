"""Quality of a result: good, doubtful, without bands or failed, by one rule for inversions and
fits."""

import enum
import math
from collections.abc import Collection

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
WITHOUT_BANDS = "The method gives no standard errors: the size of its error is not known."


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


def is_excess(chi2_per_dof: float | int, degrees_of_freedom: float | int, most_rms: float) -> bool:
    """Whether the root of a chi-square per degree of freedom exceeds `most_rms` beyond chance; NaN
    does."""
    if not degrees_of_freedom >= 1:
        return False
    chance = 1 + SIGNIFICANT / math.sqrt(2 * degrees_of_freedom)
    return not chi2_per_dof <= max(most_rms, chance) ** 2


def reasons(status: Status, warnings: Collection[str], has_bands: bool = True) -> tuple[str, ...]:
    """Reasons why a result is not good, as sentences; none for a good one.

    A chi-square that makes it fail is among the warnings, too.
    """
    stopped = () if status.is_answer else (f"There is no answer: {status}. {status.advice}",)
    return (*stopped, *warnings, *(() if has_bands else (WITHOUT_BANDS,)))
