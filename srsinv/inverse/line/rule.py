"""Choosing the regularisation: evidence, generalised cross validation, unbiased predictive risk,
corrected Akaike criterion, discrepancy principle, L-curve, normalised cumulative periodogram,
quasi-optimality.

A rule depends on a method only through its scores, a batch of log10 weights (b, c) at a time. So it
serves every method and every path alike. Where signals have nuisance columns, a first estimate of
the traction shows these well enough for a rule.
"""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...errors import of_kind, refuse
from ...grid import as_real
from ...known import is_traced
from ...status import Status
from ..diagnostics import not_for_bands
from ..estimate import Numbers
from ..noise.nuisance import scored
from . import iterative
from .problem import LineProblem
from .scorer import Family, LineScorer, Scorer
from .solve import choose_path


class Choice(eqx.Module):
    """The chosen log10 weights (c,) and how the choice ended."""

    log_weights: Float[Numbers, " c"]
    status: Status = eqx.field(static=True, converter=Status)


class Rule(eqx.Module):
    """Base of rules: a choice of a method's regularisation weights.

    `choose` and the rule's `name` are to be defined. `is_for_bands`: whether bands with its weights
    hold what they state, as `experiment=calibration_of_bands` tests it; estimates by another rule
    have a warning.
    """

    name: ClassVar[str]
    is_for_bands: ClassVar[bool] = True

    @property
    def band_warnings(self) -> Sequence[str]:
        """Warnings on bands with its weights."""
        return () if self.is_for_bands else not_for_bands(self.name)

    @abc.abstractmethod
    def choose(self, scorer: Scorer, box: Float[Array, "2 c"]) -> Choice:
        """The weights, within the box from its lower to its upper log10 weights.

        A component whose two ends are equal has a fixed weight.
        """


class CriterionRule(Rule):
    """A rule that minimises a criterion of the score. `is_joint`: whether all weights move together
    along the box's diagonal, as under a criterion that determines one number alone."""

    is_joint: ClassVar[bool] = False

    @staticmethod
    @abc.abstractmethod
    def criterion(score: Any, samples: int) -> Any:
        """The criterion to minimise, from the terms of a [`Score`][], one number for each prior."""

    def choose(self, scorer: Scorer, box: Float[Array, "2 c"]) -> Choice:
        logs = scorer.least(self.criterion, box, self.is_joint)
        if is_traced(logs, box):
            return Choice(logs, Status.CONVERGED)
        low, high = np.asarray(box)
        logs = np.clip(logs, low, high)
        ended = (high > low) & ((logs <= low) | (logs >= high))
        status = Status.RANGE_END if np.any(ended) else Status.CONVERGED
        return Choice(jnp.asarray(logs), status)


class GeneralisedCrossValidation(CriterionRule):
    """Minimise (residual/N) / (1 - freedom/N)^2: Golub, Heath and Wahba (1979).

    It needs no noise level, but takes the noise's colour as given.
    """

    name: ClassVar[str] = "generalised cross validation"

    @staticmethod
    def criterion(score: Any, samples: int) -> Any:
        return score.residual / samples / (1 - score.freedom / samples) ** 2


class Evidence(CriterionRule):
    """The rule of maximum evidence: weights under which the data are most likely, the traction
    integrated out (MacKay 1992).

    It takes the noise level as known, and fits every method that has weights.
    """

    name: ClassVar[str] = "evidence"

    @staticmethod
    def criterion(score: Any, samples: int) -> Any:
        del samples
        return -score.log_evidence


class UnbiasedPredictiveRisk(CriterionRule):
    """Minimise residual + 2 freedom, which is the expected error of the predicted signal but for a
    constant: Mallows (1973), Stein (1981). It takes the noise level as known."""

    name: ClassVar[str] = "unbiased predictive risk"

    @staticmethod
    def criterion(score: Any, samples: int) -> Any:
        del samples
        return score.residual + 2 * score.freedom


class CorrectedAkaikeCriterion(CriterionRule):
    """Minimise log(residual) + 2 (freedom + 1) / (N - freedom - 2): Hurvich, Simonoff and Tsai
    (1998). It needs no noise level. Akaike's own criterion, which has N below, prefers to fit
    everything."""

    name: ClassVar[str] = "corrected Akaike criterion"
    is_for_bands: ClassVar[bool] = False

    @staticmethod
    def criterion(score: Any, samples: int) -> Any:
        left = samples - score.freedom - 2
        penalty = 2 * (score.freedom + 1) / jnp.where(left > 0, left, 1.0)
        return jnp.where(left > 0, jnp.log(score.residual) + penalty, jnp.inf)


class DiscrepancyPrinciple(CriterionRule):
    """The residual is as large as the noise: residual = N (Morozov 1966). It takes the noise level
    as known, and smooths more than others."""

    name: ClassVar[str] = "discrepancy principle"
    is_for_bands: ClassVar[bool] = False
    is_joint: ClassVar[bool] = True

    @staticmethod
    def criterion(score: Any, samples: int) -> Any:
        return jnp.log(score.residual / samples) ** 2


class LCurve(CriterionRule):
    """The corner of the curve of log seminorm over log residual: the largest curvature, by
    Hansen and O'Leary (1993), equation 18, in the terms of a score. It needs no noise level."""

    name: ClassVar[str] = "L-curve"
    is_for_bands: ClassVar[bool] = False
    is_joint: ClassVar[bool] = True

    @staticmethod
    def criterion(score: Any, samples: int) -> Any:
        # By s = log weight the logarithms of the two norms have the slopes q/R and -q/S. The second
        # derivatives of both have the seminorm's own, which drops out of the curvature.
        residual, seminorm, pull = score.residual, score.seminorm, score.pull
        over = 1 / residual + 1 / seminorm
        size = (1 / residual**2 + 1 / seminorm**2) ** 1.5
        curvature = (1 / pull - 2 * over) / (residual * seminorm * size)
        return jnp.where(_is_partly_resolved(score, samples), -curvature, jnp.inf)


class NormalisedCumulativePeriodogram(CriterionRule):
    """The whitened residual's cumulative periodogram, over its end, is nearest to a straight line:
    white noise is left (Rust 2000; Hansen, Kilmer and Kjeldsen 2006). It needs no noise level."""

    name: ClassVar[str] = "normalised cumulative periodogram"
    is_for_bands: ClassVar[bool] = False
    is_joint: ClassVar[bool] = True

    @staticmethod
    def criterion(score: Any, samples: int) -> Any:
        del samples
        cumulative = jnp.cumsum(score.periodogram[1:])
        line = jnp.arange(1, cumulative.size + 1) / cumulative.size
        return jnp.sum((cumulative / cumulative[-1] - line) ** 2)


class QuasiOptimality(CriterionRule):
    """The solution moves least with the logarithm of the weight: Tikhonov and Glasko (1965). It
    needs no noise level."""

    name: ClassVar[str] = "quasi-optimality"
    is_for_bands: ClassVar[bool] = False
    is_joint: ClassVar[bool] = True

    @staticmethod
    def criterion(score: Any, samples: int) -> Any:
        return jnp.where(_is_partly_resolved(score, samples), jnp.log(score.movement), jnp.inf)


def _is_partly_resolved(score: Any, samples: int) -> Any:
    """Whether a solution resolves something, and is not all of the signal: beyond, it moves no
    more."""
    return (score.freedom > PARTLY) & (score.freedom < samples - PARTLY)


PARTLY = 0.5  # degrees of freedom: at the largest and the smallest singular value
TOLERANCE = 1e-4


def choose(rule: Rule, scorer: Scorer, box: Float[Numbers, "2 c"]) -> Choice:
    """The rule's choice of weights within the box, refused where a rule of somebody else gives
    other ones."""
    name, (low, high) = type(rule).__name__, box
    choice = rule.choose(scorer, as_real(box))
    of_kind(f"what {name}.choose gives", choice, Choice, "a Choice of srsinv.inverse.rule")
    if is_traced(choice, box):
        return choice
    chosen = np.asarray(choice.log_weights)
    fits = chosen.shape == low.shape and np.all((low <= chosen) & (chosen <= high))
    refuse(
        not fits,
        f"{name}.choose gives the log10 weights {chosen.tolist()}: give one for each component "
        f"within the box, from {low.tolist()} to {high.tolist()}.",
    )
    return choice


def to_score(
    problem: LineProblem, family: Family, box: Float[Numbers, "2 c"], path: str
) -> LineProblem:
    """The problem whose scores a rule goes by, its weights in the `box`.

    The direct path scores columns as they are. The iterative one has scores without any: their
    sizes are taken beside a traction of the weights of greatest evidence, which what is left of
    the columns moves little.
    """
    if problem.nuisance is None or choose_path(problem, path) != "iterative":
        return problem
    first = Evidence().choose(LineScorer(family, problem, path), as_real(box)).log_weights
    return scored(problem, iterative.value(problem, family(first), TOLERANCE).value)
