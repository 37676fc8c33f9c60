"""Plans: the search on ways whose errors and times are known, and the job on scenes."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.jobs._plan_recipes import Recipe, RecipeOutcome, Recipes
from srsinv.jobs._plan_search import Plan, climb, search
from tests.golden.check import golden_test
from tests.jobs.run import check_page, outcome, short_form, short_run

FORMS = ("plan",)
EFFECTS = {("ripple", "lag"): (0.0, 3.0), ("lag",): (2e-3, 2.0), (): (3e-2, 1.0)}
PRECISIONS = {"float64": (0.0, 1.0), "float32": (1e-4, 0.6)}
PATHS = {"auto": 1.0, "iterative": 0.5}

test_nothing_has_moved = golden_test(FORMS)


class KnownRecipes(Recipes):
    """Each setting moves the value along an axis of its own, by an error that is a power of the
    cells; seconds are known, too."""

    points, rows, unit = np.arange(5.0), ("p",), "Pa"
    counts, refinements = (16, 8, 4, 2, 1), (1, 2, 4, 8, 16, 32, 64, 128, 256)
    coarsest = Recipe(16, 1, "periodic", "float64", ("ripple", "lag"), "Wiener", "auto")

    def __init__(self, order, size):
        super().__init__()
        self.order, self.size = order, size

    def run(self, recipe):
        cells = 1024 // recipe.count
        away = [
            self.size * (recipe.count**self.order - 1) * 1e-3,
            self.size * 5e-2 / recipe.refinement**self.order,
            EFFECTS[recipe.effects][0],
            PRECISIONS[recipe.precision][0],
        ]
        simulate = EFFECTS[recipe.effects][1] * (1 + recipe.refinement)
        invert = PATHS[recipe.path] * (1 + cells / 100)
        seconds = [PRECISIONS[recipe.precision][1] * each for each in (simulate, invert)]
        return RecipeOutcome(recipe, np.array([[1.0, *away]]), *seconds, 1.0, 1e-3, cells, 1e6)

    def alternatives(self, recipe, error):
        del error
        return {
            "effects": [recipe.with_(effects=on) for on in EFFECTS if on != recipe.effects],
            "precision": [recipe.with_(precision="float32")],
            "path": [recipe.with_(path="iterative")],
        }

    def every(self):
        """All recipes that there are."""
        settings = itertools.product(
            self.counts, self.refinements, EFFECTS, PRECISIONS, PATHS
        )  # fmt: skip
        names = ("count", "refinement", "effects", "precision", "path")
        return [self.coarsest.with_(**dict(zip(names, each, strict=True))) for each in settings]

    def error(self, outcome):
        """The distance from the exact answer."""
        return float(np.linalg.norm(outcome.value[0, 1:]))


@pytest.mark.parametrize("order", [1.0, 2.0])
@pytest.mark.parametrize("size", [0.3, 1.0])
@pytest.mark.parametrize("error", [0.1, 0.01, 1e-3])
def test_a_plan_keeps_the_error_and_is_nearly_the_quickest(order, size, error):
    recipes = KnownRecipes(order, size)
    plan = search(recipes, error, None)
    every = [recipes.run(recipe) for recipe in recipes.every()]
    # Nothing can be told of a way whose error is just the one asked for.
    quickest = min(each.seconds for each in every if recipes.error(each) <= 0.7 * error)
    assert recipes.error(plan.outcome) <= plan.error <= error
    assert plan.outcome.seconds <= 1.5 * quickest


@pytest.mark.parametrize("budget_s", [4.0, 10.0, 100.0])
def test_a_plan_keeps_the_budget_and_uses_it(budget_s):
    recipes = KnownRecipes(2.0, 1.0)
    plan = search(recipes, None, budget_s)
    every = [recipes.run(recipe) for recipe in recipes.every()]
    least = min(recipes.error(each) for each in every if each.seconds <= budget_s)
    assert plan.outcome.seconds <= budget_s
    assert recipes.error(plan.outcome) <= max(3 * least, 1e-3)


def test_what_cannot_be_reached_is_the_most_exact():
    recipes = KnownRecipes(1.0, 1.0)
    plan = search(recipes, 1e-7, None)
    assert plan.error > 1e-7
    assert plan.outcome is plan.beside
    assert plan.outcome.cells == 1024


def test_a_first_call_compiles_what_another_trial_has_compiled():
    recipes = KnownRecipes(2.0, 1.0)
    first, fewer = recipes.coarsest, recipes.coarsest.with_(effects=())
    took = {first: 7.0, fewer: 0.01, first.with_(path="iterative"): 9.0}
    every = tuple(replace(recipes.run(each), first_s=took[each]) for each in took)
    assert Plan(every[1], 0.0, every[0], 0.0, every, {}).first_call_s == 7.0


@pytest.mark.parametrize("order", [0.5, 1.0, 1.6, 2.0])
def test_a_curve_is_continued_by_its_order(order):
    recipes = KnownRecipes(order, 1.0)
    some = [recipes.coarsest.with_(count=1, refinement=r) for r in (1, 2, 4, 8)]
    steps = climb(recipes, some, [1.0, 2.0, 4.0, 8.0], 0.0, ends_exactly=False)
    assert len(steps) == len(some)
    for step in steps:
        true = 5e-2 / step.outcome.recipe.refinement**order
        assert step.error == pytest.approx(true, rel=0.05)


@pytest.fixture(scope="module")
def planned():
    """The short form, run."""
    return outcome(*short_form("plan"), "plan.run=true", "error=0.05")


@pytest.mark.full
def test_what_is_found_is_within_what_was_predicted(planned):
    metrics = planned.metrics
    assert metrics["plan_error_found"] <= 0.05
    assert metrics["plan_error_predicted"] <= 0.05
    assert metrics["plan_meets_error"]
    check_page(planned)


@pytest.mark.full
def test_an_error_below_the_floor_is_said_to_be_not_in_the_data(planned):
    floor = planned.metrics["plan_floor"]
    result = short_run("plan")
    assert (result.metrics["plan_is_in_data"], planned.metrics["plan_is_in_data"]) == (
        False,
        bool(floor <= 0.05),
    )
    assert result.metrics["plan_error_predicted"] > 0


@pytest.mark.full
def test_a_signal_is_planned_without_an_inversion():
    result = outcome(*short_form("plan"), "quantity=signal", "error=0.01", "plan.run=true")
    assert result.metrics["plan_error_found"] <= 0.01
    assert set(result.dataset["invert_time_s"].values) == {0.0}


@pytest.mark.full
def test_a_recording_is_planned(tmp_path):
    del tmp_path
    result = outcome(
        "experiment=plan", "error=0.5", "method=[wiener]",
        "recording.path=srsinv/examples/strip_two_element.csv",
    )  # fmt: skip
    assert result.metrics["plan_error_predicted"] <= 0.5


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (("error=null",), "error and budget_s are both null"),
        (("error=-1",), "error is -1"),
        (("error=null", "budget_s=0"), "budget_s is 0"),
        (("quantity=mu",), "quantity is 'mu'"),
        (("plan.run=3",), "plan.run is 3"),
    ],
)
def test_refusals(overrides, said):
    with pytest.raises(BadInput, match=said):
        outcome(*short_form("plan"), *overrides)
