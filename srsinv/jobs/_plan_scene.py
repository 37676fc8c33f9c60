"""Recipes of a plan on a simulated scene."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..effects import ScreeningResult
from ..forward.noise import SignalToNoise
from ..forward.simulation import Simulation
from ..forward.trace import pair, trace
from ..grid import Line, as_real
from ..inverse.gridding.gathered import gathered
from ..inverse.line.problem import LineProblem
from ..inverse.simulated import noisy_problem
from ..timing import timed
from ._plan_recipes import (
    MOST_S,
    PERIODIC,
    REPEATS,
    SIGNAL,
    SIMULATED_ARRAYS,
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

NEARLY_NONE_DB = 200.0  # signal over noise that is far below all that is compared
LEAST_CELLS = 16
REFINEMENTS = (1, 2, 4, 8, 16, 32, 64)  # of a simulation
TOLERANCES = (10.0, 3.0, 1.0, 0.3)  # of the effects, over the error asked for: bounds are not tight


class Scenes(NamedTuple):
    """A scene and what inverts it, made anew in each precision.

    - `line` of the samples; `effects`: names of all; `key`, `friction`: of `noisy_problem`.
    - `simulation`: of a recipe; `screened`: the effects that it calls for at a tolerance;
      `methods`: by name.
    """

    line: Line
    effects: tuple[str, ...]
    key: Any
    friction: float | None
    simulation: Callable[[Recipe], Simulation]
    screened: Callable[[Recipe, float], ScreeningResult | None]
    methods: Methods


class SceneRecipes(Recipes):
    """Of a simulated scene: its signal, or what a method makes of it."""

    def __init__(self, scenes: Scenes, quantity: str, method: str):
        super().__init__()
        self._scenes, self._quantity = scenes, quantity
        self._stages, self._noise = {}, None
        line, path, self.counts, self.refinements = scenes.line, "", (1,), REFINEMENTS
        start = Recipe(1, 1, line.kind, "float64", scenes.effects, method, path)
        sensor = scenes.simulation(start).sensor
        if quantity != SIGNAL:
            path, most = "auto", line.n // LEAST_CELLS
            widest = min(most, int(WIDEST * float(sensor.depth_m) / float(line.cell_m)))
            counts = (m for m in range(1, max(1, widest) + 1) if line.n % m == 0)
            self.counts = spaced(counts)
        self.coarsest = start.with_(count=self.counts[0], path=path)
        self.points, self.rows, self.unit = np.asarray(line.x), (quantity,), "Pa"
        if quantity == SIGNAL:
            signal = trace(self._stage(self.coarsest)[0], scenes.key)
            self.points, self.along = signal.time_s, "s"
            self.rows, self.unit = tuple(sensor.element_names), sensor.amplifier.unit

    def alternatives(self, recipe: Recipe, error: float) -> dict[str, list[Recipe]]:
        assert recipe.effects is not None
        tolerances = [part * error for part in TOLERANCES if part * error < 1]  # of the rms
        subsets = dict.fromkeys(self.called_for(recipe, each) for each in tolerances)
        others: dict[str, list[Recipe]] = {
            "effects": [recipe.with_(effects=on) for on in subsets if on != recipe.effects],
            "precision": [recipe.with_(precision="float32")],
        }
        if recipe.line != PERIODIC:
            others["line"] = [recipe.with_(line=PERIODIC)]
        if recipe.path:
            problem = gathered(self._stage(recipe)[0], recipe.count)
            others["path"] = [recipe.with_(path=path) for path in paths_of(problem)]
        return others

    def called_for(self, recipe: Recipe, tolerance: float) -> tuple[str, ...]:
        """Those that the scene calls for at this tolerance."""
        assert recipe.effects is not None
        screening = self._scenes.screened(recipe, tolerance)
        assert screening is not None
        return tuple(name for name in recipe.effects if name in screening.on)

    def _stage(self, recipe: Recipe) -> tuple[Any, float, float]:
        """The simulation, or the problem of it, and the seconds of a first and a further call."""
        own = recipe.with_(count=1, method="", path="")
        if own not in self._stages:
            with jax.enable_x64(recipe.precision == "float64"):
                self._stages[own] = self._simulated(self._scenes.simulation(recipe))
        return self._stages[own]

    def _simulated(self, sim: Simulation) -> tuple[Any, float, float]:
        key, friction = self._scenes.key, self._scenes.friction
        if self._quantity == SIGNAL:
            one = timed(lambda: trace(sim, key).signal, REPEATS, MOST_S)
            return sim, one.first_s, one.median_s
        clean = sim.with_noises((SignalToNoise(NEARLY_NONE_DB),))
        one = timed(lambda: noisy_problem(clean, key, friction), REPEATS, MOST_S)
        if self._noise is None:
            noisy = noisy_problem(sim, key, friction)
            self._noise = np.asarray(noisy.data - one.value.data), np.asarray(noisy.noise)
        return self._with_noise(one.value), one.first_s, one.median_s

    def _with_noise(self, clean: LineProblem) -> LineProblem:
        """The problem with the noise of the first one: its draw must not differ between recipes."""
        assert self._noise is not None
        drawn, power = self._noise
        data = jnp.where(clean.is_observed, clean.data + as_real(drawn), 0.0)
        return eqx.tree_at(lambda p: (p.data, p.noise), clean, (data, as_real(power)))

    def run(self, recipe: Recipe) -> RecipeOutcome:
        given, first, steady = self._stage(recipe)
        if self._quantity == SIGNAL:
            full = self._stage(self.coarsest)[0]
            value, size = pair(full, given, self._scenes.key)[1].signal, given.fine.n
            memory = 8.0 * SIMULATED_ARRAYS * size * len(value)
            return RecipeOutcome(recipe, value, steady, 0.0, first, 0.0, size, memory)
        one = inverted(self._scenes.methods, recipe, lambda: gathered(given, recipe.count))
        return outcome_of(recipe, one, self.points, self._quantity, (first, steady))
