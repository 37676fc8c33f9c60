"""Plans beside brute force (hours).

For each of the twelve scenes of experiment=effects_auto and three tolerances, p by Wiener's filter:
what the plan predicts, what its recipe then does (medians of five calls), and the quickest of all
combinations of cells, refinement, effects and precision that keeps what is asked, told by the
converged result with every effect on.
"""

import itertools
from typing import Any

import jax

from srsinv import config
from srsinv.jobs._plan_recipes import Recipe, RecipeOutcome
from srsinv.jobs._plan_scene import SceneRecipes, Scenes
from srsinv.jobs._plan_search import Plan, search
from srsinv.jobs.trials import Row
from srsinv.parts import merged, varied
from tests.claims.study import Study, combinations
from tests.jobs.run import composed

ERRORS = (0.3, 0.1, 0.03)
QUANTITY, METHOD = "p", "Wiener"
FINER = 4  # times as fine as the plan's most exact cells is what errors are told by
TOLERANCES = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3)  # of the sets of effects that brute force tries
REFINEMENTS = 4  # the coarsest of them


def scenes() -> dict[str, dict[str, Any]]:
    """Configurations of the scenes, with the noise of experiment=plan."""
    base, plan = composed("experiment=effects_auto"), composed("experiment=plan", "error=0.1")
    own = {"noise": {"snr": plan["plan"]["scene_noise"]}, "method": plan["method"]}
    return {
        name: {**merged(base, changes), **own}
        for name, changes in base["effects_auto"]["scenes"].items()
    }


def recipes_of(cfg: dict[str, Any]) -> SceneRecipes:
    """Recipes of one scene, as experiment=plan makes them."""

    def with_(r: Recipe, **changed: float) -> dict[str, Any]:
        some = config.select_effects(cfg, r.effects or ())
        return varied(some, r.line, r.refinement or 1, **changed)

    given = Scenes(
        config.line(cfg), tuple(config.part(cfg, "effects")), config.random_key(cfg),
        config.friction(cfg), lambda r: config.simulation(with_(r)),
        lambda r, t: config.screened(with_(r, tolerance=t))[1], lambda: config.methods(cfg),
    )  # fmt: skip
    return SceneRecipes(given, QUANTITY, METHOD)


def quickest(
    recipes: SceneRecipes, plan: Plan, reference: RecipeOutcome, error: float
) -> RecipeOutcome | None:
    """Of all combinations, the quickest whose error is at most `error`."""
    beside = plan.beside.recipe
    subsets = {beside.effects, *(recipes.called_for(beside, each) for each in TOLERANCES)}
    settings = itertools.product(
        recipes.counts, recipes.refinements[:REFINEMENTS], subsets, ("float64", "float32")
    )
    tried = (
        recipes(beside.with_(count=count, refinement=refinement, effects=on, precision=precision))
        for count, refinement, on, precision in settings
    )
    within = (each for each in tried if each.error_from(reference) <= error)
    return min(within, key=lambda each: each.seconds, default=None)


@jax.enable_x64(True)
def planned(scene: str, error: float) -> Row:
    """One scene at one tolerance."""
    recipes = recipes_of(scenes()[scene])
    plan = search(recipes, error, None)
    reference = recipes(recipes.finer(plan.beside.recipe, FINER))
    best = quickest(recipes, plan, reference, error)
    # Both again, one after the other: the machine may have been busier with one of them.
    ours, other = recipes.run(plan.outcome.recipe), best and recipes.run(best.recipe)
    return {
        "error_predicted": plan.error,
        "error_found": ours.error_from(reference),
        "floor": plan.outcome.floor,
        "time_s_predicted": plan.outcome.seconds,
        "time_s_found": ours.seconds,
        "time_s_quickest": other and other.seconds,
    }


STUDY = Study("plans", planned, lambda: combinations(scene=scenes(), error=ERRORS))
