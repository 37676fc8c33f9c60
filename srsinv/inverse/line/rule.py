"""Choosing the regularisation: generalised cross validation, evidence.

A rule depends on a method only through its scores, a batch of log10 weights (b, c) at a time. So it
serves every method and every path alike. Where signals have nuisance columns, a first estimate of
the traction shows these well enough for a rule.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...grid import as_real
from ...status import Status
from ..noise.nuisance import scored
from . import iterative
from .problem import LineProblem
from .solve import Family, Scorer, choose_path


class Choice(eqx.Module):
    """The chosen log10 weights (c,) and how the choice ended."""

    log_weights: Float[Array, " c"]
    status: Status = eqx.field(static=True, converter=Status)


class Rule(eqx.Module):
    """Base of rules: a choice of a method's regularisation weights.

    `choose` and the rule's `name` are to be defined.
    """

    name: ClassVar[str]

    @abc.abstractmethod
    def choose(self, scorer: Scorer, box: Float[Array, "2 c"]) -> Choice:
        """The weights, within the box from its lower to its upper log10 weights.

        A component whose two ends are equal has a fixed weight.
        """


class CriterionRule(Rule):
    """A rule that minimises a criterion of the score."""

    @staticmethod
    @abc.abstractmethod
    def criterion(score: Any, samples: int) -> Any:
        """The criterion to minimise, from the terms of a [`Score`][], one number for each prior."""

    def choose(self, scorer: Scorer, box: Float[Array, "2 c"]) -> Choice:
        # A scan along the box's diagonal, then grids about the best point, each half as wide: no
        # derivative, bounded, and the same answer every time.
        low, high = np.asarray(box)

        known: dict[tuple[float, ...], float] = {}  # the grids share points

        def best(points):
            rows = [tuple(row) for row in points.tolist()]
            new = [row for row in dict.fromkeys(rows) if row not in known]
            if new:
                values = np.asarray(scorer.values(self.criterion, np.array(new)))
                known.update(zip(new, values.tolist(), strict=True))
            every = np.array([known[row] for row in rows])
            return points[np.argmin(np.where(np.isfinite(every), every, np.inf))]

        fractions = np.linspace(1, 0, 19)[:, None]  # from strong to weak: ties go to the smoother
        centre = best(low + fractions * (high - low))
        for half in (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625):
            ends = zip(centre, low, high, strict=True)
            axes = [np.clip([c + half, c, c - half], a, b) for c, a, b in ends]
            grid = np.meshgrid(*axes, indexing="ij")
            centre = best(np.stack(grid, axis=-1).reshape(-1, len(low)))
        ended = (high > low) & ((centre <= low) | (centre >= high))
        status = Status.RANGE_END if np.any(ended) else Status.CONVERGED
        return Choice(jnp.asarray(centre), status)


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


TOLERANCE = 1e-4


def to_score(
    problem: LineProblem, family: Family, box: Float[np.ndarray, "2 c"], path: str
) -> LineProblem:
    """The problem whose scores a rule goes by, its weights in the `box`.

    The direct path scores columns as they are. The iterative one has scores without any: their
    sizes are taken beside a traction of the weights of greatest evidence, which what is left of
    the columns moves little.
    """
    if problem.nuisance is None or choose_path(problem, path) != "iterative":
        return problem
    first = Evidence().choose(Scorer(family, problem, path), as_real(box)).log_weights
    return scored(problem, iterative.value(problem, family(first), TOLERANCE).value)
