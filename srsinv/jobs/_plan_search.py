"""The search of a plan: errors along curves of ever finer cells, and the quickest recipe within."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ._plan_recipes import Recipe, RecipeOutcome, Recipes

LEAST_ORDER, MOST_ORDER = 0.5, 2.0  # of convergence, with which a curve is continued
PART_LEFT = 0.15  # of the error asked for, that the reference's cells and its refinement leave each
MARGIN = 0.9  # of the error asked for, that the measured one may be
MOST_TRIED, ENOUGH = 8, 2  # combinations, of those predicted best; of those that keep what is asked


# What is made finer along a curve, and the stage that this takes longer.
CURVES = {"count": "invert_s", "refinement": "simulate_s"}


@dataclass(frozen=True)
class Rung:
    """A setting of one curve: the outcome, and the `error` that is left by it [1]."""

    outcome: RecipeOutcome
    error: float


def climb(
    run: Callable[[Recipe], RecipeOutcome],
    recipes: Sequence[Recipe],
    fineness: Sequence[float],
    wanted: float,
    *,
    ends_exactly: bool,
    is_enough: Callable[[RecipeOutcome], bool] = lambda outcome: False,
) -> list[Rung]:
    """The recipes from the coarsest on, two at least, until the error that the last one leaves is
    `wanted`, or it `is_enough`.

    The error is the distance from the last value, and what a continuation with the observed order
    adds; none after the last recipe where the curve `ends_exactly`.
    """
    outcomes: list[RecipeOutcome] = []
    left = math.inf
    for recipe in recipes:
        outcomes.append(run(recipe))
        left = _left(outcomes, fineness)
        if ends_exactly and len(outcomes) == len(recipes):
            left = 0.0
        if left <= wanted or (len(outcomes) > 1 and is_enough(outcomes[-1])):
            break
    return [Rung(outcome, outcome.error_from(outcomes[-1]) + left) for outcome in outcomes]


def _left(outcomes: Sequence[RecipeOutcome], fineness: Sequence[float]) -> float:
    """What the last outcome of a curve leaves: infinite where it is the only one."""
    if len(outcomes) < 2:
        return math.inf
    ratio, last = fineness[len(outcomes) - 1] / fineness[len(outcomes) - 2], outcomes[-1]
    step = outcomes[-2].error_from(last)
    order = 1.0
    if len(outcomes) > 2 and step > 0:
        before = fineness[len(outcomes) - 2] / fineness[len(outcomes) - 3]
        fall = outcomes[-3].error_from(last) / step
        # Of an error that falls as a power: (before^p ratio^p - 1) / (ratio^p - 1).
        orders = np.linspace(LEAST_ORDER, MOST_ORDER, 31)
        falls = ((before * ratio) ** orders - 1) / (ratio**orders - 1)
        order = float(orders[np.argmin(np.abs(falls - fall))])
    return step / (ratio**order - 1)


@dataclass(frozen=True)
class Option:
    """A recipe that differs in one setting from another: what it adds to the error, and the factors
    on the two stages' seconds."""

    setting: str
    value: Any
    error: float
    factors: tuple[float, float]


@dataclass(frozen=True)
class Plan:
    """The outcome chosen, and the `error` that it leaves, predicted; `outcomes`: all there are.

    Errors are measured from the outcome `beside`, whose settings are the most exact ones on cells
    that are fine enough, and which itself leaves the error `left`; `of_curves` are those of the
    curves of ever finer cells.
    """

    outcome: RecipeOutcome
    error: float
    beside: RecipeOutcome
    left: float
    outcomes: tuple[RecipeOutcome, ...]
    of_curves: Mapping[Recipe, float]

    @property
    def first_call_s(self) -> float:
        """The first call of the chosen outcome by itself: what other effects have compiled before
        it is compiled there, too."""
        own = self.outcome.recipe.with_(effects=None)
        return max(each.first_s for each in self.outcomes if each.recipe.with_(effects=None) == own)

    def error_of(self, outcome: RecipeOutcome) -> float:
        """The error that an outcome leaves: along its curve where it is one of them."""
        beside = self.left + outcome.error_from(self.beside)
        return min(beside, self.of_curves.get(outcome.recipe, math.inf))


def search(recipes: Recipes, error: float | None, budget_s: float | None) -> Plan:
    """The quickest recipe within `error`, or the most exact one within `budget_s` [s]; where both
    are given, the quickest within the error."""
    wanted = error * PART_LEFT if error is not None else 0.0
    limit = budget_s if error is None and budget_s is not None else math.inf
    at, left, curves, of_curves = recipes.coarsest, 0.0, {}, {}
    for name, stage in CURVES.items():
        levels = recipes.levels(name)
        if not levels:
            continue
        curve = climb(
            recipes, [at.with_(**{name: level}) for level in levels], recipes.fineness(name),
            wanted, ends_exactly=name == "count" and levels[-1] == 1,
            is_enough=lambda outcome, stage=stage: getattr(outcome, stage) > limit,
        )  # fmt: skip
        of_curves |= {each.outcome.recipe: left + each.error for each in curve}
        step = next((s for s in curve if s.error <= wanted), curve[-1])
        at, left, curves[name] = step.outcome.recipe, left + step.error, (curve, step)
    beside = recipes(at)
    options = [*_along(curves), *_others(recipes, beside, error or left)]
    tried, good = [(beside, left)], 0
    for recipe in _predicted_best(beside, left, options, error, limit):
        outcome = recipes(recipe)
        tried.append((outcome, left + outcome.error_from(beside)))
        good += tried[-1][1] <= MARGIN * error if error is not None else outcome.seconds <= limit
        if good == ENOUGH:
            break
    outcome, total = _best(tried, error, limit)
    return Plan(outcome, total, beside, left, recipes.done, of_curves)


def _along(curves: dict[str, tuple[list[Rung], Rung]]) -> Iterator[Option]:
    """What is coarser than the step that was taken of each curve."""
    for name, (curve, taken) in curves.items():
        for step in curve[: curve.index(taken)]:
            value = getattr(step.outcome.recipe, name)
            yield Option(
                name, value, step.error - taken.error, _factors(step.outcome, taken.outcome)
            )


def _others(recipes: Recipes, beside: RecipeOutcome, error: float) -> Iterator[Option]:
    """What may be quicker by another setting."""
    for name, others in recipes.alternatives(beside.recipe, error).items():
        for recipe in others:
            outcome = recipes(recipe)
            away = outcome.error_from(beside)
            if math.isfinite(away):
                yield Option(name, getattr(recipe, name), away, _factors(outcome, beside))


def _factors(outcome: RecipeOutcome, beside: RecipeOutcome) -> tuple[float, float]:
    stages = (outcome.simulate_s, beside.simulate_s), (outcome.invert_s, beside.invert_s)
    simulate, invert = (one / other if other > 0 else 1.0 for one, other in stages)
    return simulate, invert


def _predicted_best(
    beside: RecipeOutcome,
    left: float,
    options: Sequence[Option],
    error: float | None,
    limit_s: float,
) -> Iterator[Recipe]:
    """Combinations of the options, those first that are best if errors are independent and the
    factors on the times multiply."""
    by_setting: dict[str, list[Option | None]] = {}
    for option in options:
        by_setting.setdefault(option.setting, [None]).append(option)
    ranked = []
    for combination in itertools.product(*by_setting.values()):
        some = [option for option in combination if option is not None]
        total = left + math.hypot(*(option.error for option in some))
        simulate, invert = (math.prod(o.factors[stage] for o in some) for stage in (0, 1))
        seconds = beside.simulate_s * simulate + beside.invert_s * invert
        recipe = beside.recipe.with_(**{option.setting: option.value for option in some})
        if error is not None and total <= MARGIN * error:
            ranked.append((seconds, total, recipe))
        elif error is None and seconds <= limit_s:
            ranked.append((total, seconds, recipe))
    ranked.sort(key=lambda each: each[:2])
    yield from (recipe for _, _, recipe in ranked[:MOST_TRIED])


def _best(
    tried: Sequence[tuple[RecipeOutcome, float]], error: float | None, limit_s: float
) -> tuple[RecipeOutcome, float]:
    """Of those tried the quickest within the error, or the most exact within the time; where there
    is none, the one that comes nearest."""
    if error is None:
        within = [each for each in tried if each[0].seconds <= limit_s]
        return min(within, key=lambda e: e[1]) if within else min(tried, key=lambda e: e[0].seconds)
    within = [each for each in tried if each[1] <= MARGIN * error]
    return min(within, key=lambda e: e[0].seconds) if within else min(tried, key=lambda e: e[1])
