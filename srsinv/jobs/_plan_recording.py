"""Recipes of a plan on a recording."""

from collections.abc import Callable

import jax
import numpy as np

from ..errors import refuse
from ..inverse.gridding.cells import sample_spacing_m
from ..inverse.line.problem import LineProblem
from ..inverse.problem import Problem
from ..resolution import cell_m
from ._plan_recipes import (
    SIGNAL,
    WIDEST,
    Methods,
    Recipe,
    RecipeOutcome,
    Recipes,
    inverted,
    outcome_of,
    paths_of,
    spaced,
)


class RecordingRecipes(Recipes):
    """Of a recording: what a method makes of it. `recorded` gives its problem, in the working
    precision."""

    refinements = ()

    def __init__(
        self, recorded: Callable[[], Problem], methods: Methods, quantity: str, method: str
    ):
        super().__init__()
        refuse(
            quantity == SIGNAL,
            "quantity=signal needs a simulated scene, not a recording: give quantity=p "
            "or quantity=q, or leave recording.path out.",
        )
        self._recorded, self._methods, self._quantity, self._problems = (
            recorded, methods, quantity, {},
        )  # fmt: skip
        problem = self._problem("float64")
        refuse(
            problem.cell_m is not None,
            "recording.cell_m is given, but the plan chooses the cells: leave it out.",
        )
        x, depth = np.asarray(problem.motion.position_m), float(problem.sensor.depth_m)
        self._spacing_m = sample_spacing_m(problem.motion)
        widest = int(WIDEST * depth / self._spacing_m)
        finest = max(1, int(cell_m("converged_inversion", depth) / self._spacing_m))
        self.counts = spaced(range(finest, max(widest, finest) + 1))
        size = int(np.ptp(x) / (finest * self._spacing_m)) + 1
        self.points, self.rows, self.unit = np.linspace(x.min(), x.max(), size), (quantity,), "Pa"
        self.coarsest = Recipe(self.counts[0], None, "open", "float64", None, method, "auto")

    def alternatives(self, recipe: Recipe, error: float) -> dict[str, list[Recipe]]:
        del error
        return {
            "precision": [recipe.with_(precision="float32")],
            "path": [recipe.with_(path=path) for path in paths_of(self._gridded(recipe))],
        }

    def _problem(self, precision: str) -> Problem:
        if precision not in self._problems:
            with jax.enable_x64(precision == "float64"):
                self._problems[precision] = self._recorded()
        return self._problems[precision]

    def _gridded(self, recipe: Recipe) -> LineProblem:
        return self._problem(recipe.precision).to_grid(recipe.count * self._spacing_m)

    def run(self, recipe: Recipe) -> RecipeOutcome:
        self._problem(recipe.precision)  # read once, before the time counts
        one = inverted(self._methods, recipe, lambda: self._gridded(recipe))
        return outcome_of(recipe, one, self.points, self._quantity, (0.0, 0.0))
