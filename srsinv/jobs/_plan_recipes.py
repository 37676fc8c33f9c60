"""Recipes of a plan: a way of computing an answer, what it gives at common points, and its time."""

import abc
import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ..grid import Periodic
from ..inverse.estimate import COMPONENTS, Estimate, deviation
from ..inverse.line.problem import LineProblem
from ..inverse.line.solve import AUTO_LIMIT
from ..inverse.method import Method
from ..timing import Timed, timed

REPEATS, MOST_S = 5, 1.0  # calls after the first, whose median counts, as time allows
DIRECT = 2 * AUTO_LIMIT  # unknowns up to which the direct path may be the quickest
SIGNAL, PERIODIC = "signal", "periodic"
QUANTITIES = (*COMPONENTS, SIGNAL)
LEAST_RATIO = 1.9  # times finer is the next of a curve's cells, at least
WIDEST = 0.5  # depths, of a cell
# Arrays of real numbers at once: over a simulation's cells for each element and component, over an
# inversion's cells for each pair of these, and of the squared unknowns on the direct path.
SIMULATED_ARRAYS, INVERTED_ARRAYS, DENSE_ARRAYS = 8, 12, 4

Methods = Callable[[], Mapping[str, Method]]  # in the working precision


@dataclass(frozen=True)
class Recipe:
    """One way of computing the answer.

    - `count`: samples in a cell of the inversion. `refinement` and `effects` are None of a
      recording; `method` and `path` are "" of a signal.
    """

    count: int
    refinement: int | None
    line: str
    precision: str
    effects: tuple[str, ...] | None
    method: str
    path: str

    def with_(self, **changed: Any) -> "Recipe":
        """The same recipe with other settings."""
        return dataclasses.replace(self, **changed)


@dataclass(frozen=True)
class RecipeOutcome:
    """What a recipe came to.

    - `value` (row, point): the quantity at the common points, p or q less the mean.
    - `simulate_s`, `invert_s` [s]: medians of further calls; `first_s`: of both, with compiling.
    - `floor`: the standard error's rms over that of the value; 0 of a signal.
    - `cells`: of the inversion, or of the simulation where there is none.
    - `memory_bytes`: of the largest arrays, about.
    """

    recipe: Recipe
    value: Float[np.ndarray, "row point"]
    simulate_s: float
    invert_s: float
    first_s: float
    floor: float
    cells: int
    memory_bytes: float

    @property
    def seconds(self) -> float:
        """Of both stages."""
        return self.simulate_s + self.invert_s

    def error_from(self, other: "RecipeOutcome") -> float:
        """Distance from another outcome's value, over that one's norm."""
        return float(np.linalg.norm(self.value - other.value) / np.linalg.norm(other.value))


class Recipes(abc.ABC):
    """Runs recipes, each once.

    - `coarsest`: the recipe whose settings are all the most exact ones but for its cells.
    - `counts`, `refinements`: samples in a cell, and refinements, from coarse to fine.
    - `points` (point,) in the unit `along`: [m] along the line, [s] of a signal; `rows`: names of
      the values' rows; `unit` of them.
    """

    coarsest: Recipe
    counts: tuple[int, ...]
    refinements: tuple[int, ...]
    points: Float[np.ndarray, " point"]
    rows: tuple[str, ...]
    unit: str
    along: str = "m"

    def __init__(self):
        self._done: dict[Recipe, RecipeOutcome] = {}

    def __call__(self, recipe: Recipe) -> RecipeOutcome:
        """The outcome of a recipe."""
        if recipe not in self._done:
            self._done[recipe] = self.run(recipe)
        return self._done[recipe]

    def levels(self, name: str) -> tuple[int, ...]:
        """What the setting `name` of a recipe may be, from coarse to fine."""
        return {"count": self.counts, "refinement": self.refinements}[name]

    def fineness(self, name: str) -> list[float]:
        """The inverse widths of the cells at these levels."""
        return [1 / level if name == "count" else float(level) for level in self.levels(name)]

    @property
    def done(self) -> tuple[RecipeOutcome, ...]:
        """All that were run."""
        return tuple(self._done.values())

    def finer(self, recipe: Recipe, times: int) -> Recipe:
        """The recipe on cells at least so many times finer, as far as there are samples."""
        wanted = (count for count in self.counts if times * count <= recipe.count)
        refinement = None if recipe.refinement is None else times * recipe.refinement
        return recipe.with_(count=next(wanted, self.counts[-1]), refinement=refinement)

    @abc.abstractmethod
    def run(self, recipe: Recipe) -> RecipeOutcome:
        """Run it, whether or not it was run before."""

    @abc.abstractmethod
    def alternatives(self, recipe: Recipe, error: float) -> dict[str, list[Recipe]]:
        """What may be quicker than `recipe`, by the setting that it changes, for an `error`."""


def spaced(counts: Iterable[int]) -> tuple[int, ...]:
    """Those of increasing counts that are apart, from the largest to the first."""
    some: list[int] = []
    for count in counts:
        if not some or count >= LEAST_RATIO * some[-1]:
            some.append(count)
    return tuple(reversed(some))


def inverted(methods: Methods, recipe: Recipe, problem: Callable[[], LineProblem]) -> Timed:
    """The estimate by the recipe's method and path, and its times."""
    with jax.enable_x64(recipe.precision == "float64"):
        method = methods()[recipe.method]
        if hasattr(method, "path"):
            method = dataclasses.replace(method, path=recipe.path)
        return timed(lambda: method(problem()), REPEATS, MOST_S)


def outcome_of(
    recipe: Recipe, one: Timed, points: np.ndarray, quantity: str, simulated
) -> RecipeOutcome:
    """The outcome of an estimate and its times, `simulated` the seconds of a first and of a further
    call before it."""
    estimate, (first, steady) = one.value, simulated
    value, floor = _on_points(estimate, points, quantity)
    line, elements = estimate.line, estimate.fitted.shape[0]
    memory = 8.0 * line.n * (elements + 2) ** 2 * INVERTED_ARRAYS
    memory += 8.0 * points.size * (recipe.refinement or 1) * (elements + 2) * SIMULATED_ARRAYS
    if estimate.stats.get("path") == "direct":
        unknowns = line.n * (1 if estimate.friction is not None else 2)
        memory += 8.0 * unknowns**2 * DENSE_ARRAYS
    return RecipeOutcome(
        recipe, value, steady, one.median_s, first + one.first_s, floor, line.n, memory
    )


def paths_of(problem: LineProblem) -> list[str]:
    """The exact paths of which one may be quicker than another."""
    if problem.separable:
        return []
    return ["iterative"] + ["direct"] * (problem.unknowns * problem.line.n <= DIRECT)


def _on_points(
    estimate: Estimate, points: np.ndarray, quantity: str
) -> tuple[Float[np.ndarray, "1 point"], float]:
    """p or q at the points, less its mean, between the cells' centres on straight lines; and the
    standard error's rms over its own."""
    row, line = COMPONENTS.index(quantity), estimate.line
    period = line.n * float(line.cell_m) if isinstance(line, Periodic) else None
    x = np.asarray(line.x, float)
    value, stderr = (
        np.interp(points, x, np.asarray(of[row], float), period=period)
        for of in (estimate.value, estimate.stderr)
    )
    value = deviation(value)
    size = float(np.sqrt(np.mean(value**2)))
    return value[None], float(np.sqrt(np.mean(stderr**2))) / size if size else np.inf
