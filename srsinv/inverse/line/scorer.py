"""Scores of priors, which rules go by: of a family of priors by their weights, on the path that
will solve the problem.

A rule sees the terms of a [`Score`][] alone, so that it serves every method and every path.
"""

import abc
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...errors import refuse
from ...grid import Line
from ...known import Numbers, in_numpy, is_traced
from ..noise.levels import at_one_level
from ..noise.nuisance import scored
from . import direct, spectral
from .gaps import Gaps
from .near_periodic import PeriodicModel, PriorScore
from .prior import Prior, Score
from .problem import LineProblem
from .search import WeightSearch, each_row, on_grids, weights_at
from .shared import decorrelated
from .solve import choose_path
from .transforms import each_on_a_core

BATCH = 21  # weights of one call at least, more than in a rule's first scan: one program serves all
TOGETHER = 3  # weights that are scored at once on the spectral path: memory is read once for them

Criterion = Callable[[Score, Any], Any]
Rows = Float[Numbers, "b c"]


class Family(eqx.Module):
    """A family of priors, by their log10 weights, for a rule to choose from: P is that of weights 0
    times 10^(`sign` log10 weight), for each component.

    `has_shape`: whether a further number follows the weights, which changes the prior's shape.
    """

    sign: ClassVar[int]
    has_shape: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, log_weights: Float[Numbers, " c"]) -> Prior:
        """The prior with these weights."""


class Scores(eqx.Module):
    """What the scores of a family's priors have in common. `together`: how many are computed at
    once; `is_double`: whether in double precision even where jax has single; `scanned`: how many
    weights a rule looks at first, where one costs little; `has_shape`: of the family."""

    together: ClassVar[int]
    scanned: ClassVar[int | None] = None
    is_double: ClassVar[bool]
    has_shape: ClassVar[bool] = False

    @property
    def search(self) -> tuple[int, int | None, bool]:
        """How a rule searches them."""
        return self.together, self.scanned, self.has_shape

    @abc.abstractmethod
    def at(self, log_weights: Float[Array, " c"]) -> Score:
        """The score of the prior with these log10 weights."""

    def criterion(self, criterion: Criterion, samples: Any, logs: Float[Array, " c"]) -> Any:
        """The criterion of the prior with these log10 weights."""
        return criterion(self.at(logs), samples)


class WeightScores(Scores):
    """Scores of a family whose priors differ by their weights alone."""

    sign: int = eqx.field(static=True)

    @abc.abstractmethod
    def of(self, factor: Float[Array, " c"]) -> Score:
        """The score of the prior whose root P^(1/2) is `factor` times that of weights of 1."""

    def at(self, log_weights: Float[Array, " c"]) -> Score:
        return self.of(10.0 ** (self.sign * log_weights / 2))


class DirectScores(WeightScores):
    """Scores by Cholesky factors, one after the other: side by side LAPACK may wait for itself on a
    CPU."""

    together: ClassVar[int] = 1
    is_double: ClassVar[bool] = False
    scored: direct.Scored

    def of(self, factor: Float[Array, " c"]) -> Score:
        return direct.score(factor, self.scored)


class DirectShapeScores(Scores):
    """Scores by Cholesky factors of a family whose priors differ in shape, too."""

    together: ClassVar[int] = 1
    is_double: ClassVar[bool] = False
    has_shape: ClassVar[bool] = True
    family: Family
    problem: LineProblem
    white: direct.Whitened
    information: Float[Array, "m m"]

    def at(self, log_weights: Float[Array, " c"]) -> Score:
        prior = self.family(log_weights)
        of = direct.scored_under(self.problem, prior, self.white, self.information)
        return direct.score(jnp.ones(self.problem.unknowns), of)


class SpectralShapeScores(Scores):
    """Scores of the nearest periodic problem of a family whose priors differ in shape, too."""

    together: ClassVar[int] = TOGETHER
    is_double: ClassVar[bool] = True
    has_shape: ClassVar[bool] = True
    family: Family
    line: Line
    reduced: spectral.Reduced

    def at(self, log_weights: Float[Array, " c"]) -> Score:
        root = spectral.prior_root(self.line, self.family(log_weights))
        return spectral.score(self.reduced, root)


class SpectralScores(WeightScores):
    """Scores of the nearest periodic problem. In double precision: weights lie in flat minima,
    where rounding would choose."""

    together: ClassVar[int] = TOGETHER
    is_double: ClassVar[bool] = True
    reduced: spectral.Reduced
    root: Float[Numbers, "c k"]

    def of(self, factor: Float[Array, " c"]) -> Score:
        return spectral.score(self.reduced, factor[:, None] * self.root)


class Scorer(eqx.Module):
    """Scores of a family's priors, by the terms that they have in common; `samples`: the number of
    samples."""

    scores: eqx.AbstractVar[Any]
    samples: eqx.AbstractVar[Any]

    def __call__(self, log_weights: Rows) -> Score:
        """One score for each row of log10 weights."""
        return self.values(_as_it_is, log_weights)

    def values(self, criterion: Criterion, log_weights: Rows) -> Any:
        """The criterion, which takes a score and the number of samples, for each row of log10
        weights. It is compiled with the scores, of which it may need some terms alone."""
        count = len(log_weights)
        padded = np.zeros((max(count, BATCH), log_weights.shape[1]))
        padded[:count] = log_weights
        with self._in_double():
            values = _values(criterion, self.samples, self.scores, padded, count)
        # Sliced by numpy, which takes a hundredth of what jax's dispatch takes.
        return jax.tree.map(lambda each: np.asarray(each)[:count], values)

    def least(
        self, criterion: Criterion, box: Float[Numbers, "2 c"], is_joint: bool = False
    ) -> Float[Numbers, " c"]:
        """The log10 weights within the box under which the criterion is least, all of one diagonal
        where they are chosen jointly. Where jax traces the problem or the box they have
        derivatives."""
        if is_traced(self.scores, box):
            known = self.scores, jnp.asarray(box)
            frozen = jax.lax.stop_gradient(known)
            value = partial(_value, criterion, self.samples, is_joint)
            search = WeightSearch.of(is_joint, frozen[1], *self.scores.search)
            found = search.least(partial(value, frozen))
            if not is_joint:  # a weight at an end moves with it
                low, high = known[1]
                found = jnp.where(found <= search.low, low, found)
                found = jnp.where(found >= search.high, high, found)
            return weights_at(is_joint, known[1], search.with_slopes(value, known, found))
        with self._in_double():
            of = criterion, self.samples, is_joint, self.scores, np.asarray(box, float)
            return np.asarray(_least(*of))

    def _in_double(self) -> AbstractContextManager:
        return jax.enable_x64(True) if self.scores.is_double else nullcontext()


class LineScorer(Scorer):
    """Scores of a family's priors of the traction on a line, by the path that will solve the
    problem."""

    family: Family
    problem: LineProblem
    scores: Scores | PeriodicModel
    samples: Any

    def __init__(self, family: Family, problem: LineProblem, path: str):
        problem = decorrelated(problem)
        path = choose_path(problem, path)
        refuse(
            path == "iterative" and problem.observed is not None and is_traced(family, problem),
            "A rule cannot choose weights under jit, vmap or grad on the iterative path with "
            "samples missing: give the weights, or path=direct.",
        )
        self.family, self.problem = family, problem.to_grid().without_warnings()
        if path == "iterative":
            self.problem = at_one_level(scored(self.problem))
        self.samples = self.problem.sample_count
        of_one = np.zeros(self.problem.unknowns)  # log weights
        if path == "direct" and family.has_shape:
            white = direct.whiten(self.problem)
            information = white.model.T @ white.model
            self.scores = DirectShapeScores(family, self.problem, white, information)
        elif path == "direct":
            self.scores = DirectScores(family.sign, direct.scored(self.problem, family(of_one)))
        elif path == "iterative" and problem.observed is not None:
            self.scores = PeriodicModel(self.problem, Gaps.of(problem.is_observed))
        else:
            with nullcontext() if is_traced(family, problem) else jax.enable_x64(True):
                line, reduced = self.problem.line, spectral.reduced(self.problem)
                if family.has_shape:
                    of = _on_device((family, line, reduced))
                    self.scores = SpectralShapeScores(*of)
                else:
                    root = spectral.prior_root(line, family(of_one))
                    self.scores = SpectralScores(family.sign, *_on_device((reduced, root)))

    def values(self, criterion: Criterion, log_weights: Rows) -> Any:
        if not isinstance(periodic := self.scores, PeriodicModel):
            return super().values(criterion, log_weights)
        family = in_numpy(self.family)

        def value(logs: np.ndarray) -> Any:
            score = PriorScore(periodic, family(logs))
            return criterion(
                score.whole if criterion is _as_it_is else cast(Score, score), self.samples
            )

        found = each_on_a_core(value, log_weights, self.problem.line.n)
        return jax.tree.map(lambda *terms: np.array(terms), *found)

    def least(
        self, criterion: Criterion, box: Float[Numbers, "2 c"], is_joint: bool = False
    ) -> Float[Numbers, " c"]:
        if not isinstance(self.scores, PeriodicModel):
            return super().least(criterion, box, is_joint)
        box = np.asarray(box, float)

        def values(rows: np.ndarray) -> np.ndarray:
            logs = [weights_at(is_joint, box, row) for row in rows]
            return self.values(criterion, np.array(logs))

        return weights_at(is_joint, box, on_grids(values, is_joint, box, self.family.has_shape))


def _as_it_is(score: Score, samples: Any) -> Score:
    del samples
    return score


@jax.jit
def _on_device(tree):
    """Arrays of numpy as jax's, all at once."""
    return tree


@partial(jax.jit, static_argnames=("criterion", "samples"))
def _values(criterion: Criterion, samples: int, scores: Scores, log_weights, count):
    value = partial(scores.criterion, criterion, samples)
    return each_row(value, log_weights, count, scores.together)


@partial(jax.jit, static_argnames=("criterion", "samples", "is_joint"))
def _least(criterion: Criterion, samples: int, is_joint: bool, scores: Scores, box):
    value = partial(_value, criterion, samples, is_joint, (scores, box))
    search = WeightSearch.of(is_joint, box, *scores.search)
    return weights_at(is_joint, box, search.least(value))


def _value(
    criterion: Criterion,
    samples: Any,
    is_joint: bool,
    known: tuple[Scores, Float[Array, "2 c"]],
    searched: Float[Array, " s"],
) -> Any:
    """The criterion of what is searched for: of the weights, or of the place on the diagonal."""
    scores, box = known
    return scores.criterion(criterion, samples, weights_at(is_joint, box, searched))
