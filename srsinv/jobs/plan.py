"""Accuracy against time, answered: the quickest way to an answer of so much error.

Ways differ in cells, line, precision, effects, method and path. Each is tried on the data
themselves: errors are measured along curves of ever finer cells and continued by their order.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np
import xarray
from matplotlib.figure import Figure

from .. import config
from ..errors import choice, number, refuse
from ..parts import varied
from ..progress import stage
from ..report.data import dataset, scalars
from ..report.plot.panels import Curve, Mark, Panel, PanelAxis, panels
from ..report.plot.style import GREY
from ..report.result import Result
from ..report.section import sections
from ..report.text import quantity as in_words
from ..report.text import significant
from ._plan_recipes import QUANTITIES, SIGNAL, Recipe, RecipeOutcome, Recipes
from ._plan_recording import RecordingRecipes
from ._plan_scene import SceneRecipes, Scenes
from ._plan_search import Plan, search

MOST_LISTED = 4  # effects: of more the page names those that are off
AROUND = 1.3  # a margin around what is drawn, as a factor
FINER = 4  # times: the converged answer beside the one that others are measured against
Variables = dict[str, tuple[Any, ...]]
SETTINGS = ("cells", "refinement", "line", "precision", "effects", "method", "path")


@dataclass(frozen=True)
class Asked:
    """What is asked for: a quantity, its error, the seconds, and whether the plan is to be run."""

    quantity: str
    error: float | None
    budget_s: float | None
    runs: bool

    @classmethod
    def checked(cls, quantity: str, error: Any, budget_s: Any, runs: Any) -> "Asked":
        """Raises `BadInput` where nothing is asked for, and for what is no number."""
        refuse(
            error is None and budget_s is None,
            "error and budget_s are both null: give error=0.01 for an answer within 1 %, "
            "budget_s=1 for one within a second, or both.",
        )
        refuse(runs not in (True, False), f"plan.run is {runs}: give true or false.")
        wanted = "a positive number, as 0.01 for 1 %"
        error = None if error is None else float(number("error", error, wanted, above=0))
        wanted = "a positive number of seconds"
        if budget_s is not None:
            budget_s = float(number("budget_s", budget_s, wanted, above=0))
        return cls(quantity, error, budget_s, bool(runs))


def run(cfg: config.Config) -> Result:
    """The job: plan for every method named, take the quickest; with `plan.run` compute the
    converged answer, too.

    Raises `BadInput` where neither an error nor a budget is asked for, and for a quantity that is
    none.
    """
    settings, wanted = config.part(cfg, "plan"), choice("quantity", cfg["quantity"], QUANTITIES)
    asked = Asked.checked(wanted, cfg["error"], cfg["budget_s"], settings["run"])
    start = time.perf_counter()
    with jax.enable_x64(True), stage("trying settings"):
        if config.part(cfg, "recording")["path"] is None:
            # The scene has its own noise and elements where none are named.
            noise, facts = config.part(cfg, "noise"), dict(settings["scene_sensor"])
            if set(noise) == {"white"} and noise["white"].get("rms") is None:
                noise = {"snr": settings["scene_noise"]}
            if config.part(cfg, "sensor").get("elements") is not None:
                facts.pop("elements", None)
            cfg = config.with_facts({**cfg, "noise": noise}, facts, {"poisson_ratio": 0.5})
            line, effects = config.line(cfg), tuple(config.part(cfg, "effects"))

            def with_(r: Recipe, **changed: float) -> config.Config:
                some = config.select_effects(cfg, r.effects or ())
                return varied(some, r.line, r.refinement or 1, **changed)

            given = Scenes(
                line, effects, config.random_key(cfg), config.friction(cfg),
                lambda r: config.simulation(with_(r)),
                lambda r, t: config.screened(with_(r, tolerance=t))[1],
                lambda: config.methods(cfg),
            )  # fmt: skip
            make = partial(SceneRecipes, given)
        else:
            recorded = partial(config.recorded_problem, cfg, config.recording(cfg))
            make = partial(RecordingRecipes, recorded, partial(config.methods, cfg))
        names = [""] if wanted == SIGNAL else list(config.methods(cfg))
        ways = map(partial(make, wanted), names)
        tried = [(one, search(one, asked.error, asked.budget_s)) for one in ways]
        recipes, plan = min(tried, key=lambda each: _rank(each[1], asked))
        spent_s = time.perf_counter() - start
        measured = None
        if asked.runs:
            with stage("the converged answer"):
                converged = recipes(recipes.finer(plan.beside.recipe, FINER))
            with stage("the planned answer"):
                measured = PlanCheck(recipes.run(plan.outcome.recipe), converged)
    data = _dataset([each for _, each in tried], plan, measured, recipes, asked)
    data = data.assign(dataset(scalars({"plan_planning_time_s": spent_s}), {}))
    title = _title(plan, asked)
    return Result(title, data, sections("plan", tradeoff=tradeoff, answers=answers))


def _rank(plan: Plan, asked: Asked) -> tuple[float, ...]:
    """The least is best: what is asked for first, then what the noise leaves, where that is more,
    then the quickest, or the most exact."""
    seconds, floor = plan.outcome.seconds, plan.outcome.floor
    if asked.error is not None:
        return max(plan.error, asked.error), max(floor, asked.error), seconds
    return max(seconds, asked.budget_s or 0.0), max(floor, plan.error), plan.error


@dataclass(frozen=True)
class PlanCheck:
    """The planned answer, computed again, and the converged one."""

    planned: RecipeOutcome
    converged: RecipeOutcome


def _dataset(
    plans: Sequence[Plan], plan: Plan, measured: PlanCheck | None, recipes: Recipes, asked: Asked
) -> xarray.Dataset:
    """Every outcome, the numbers of the plan, and its answer beside the converged one."""
    rows = [(outcome, of) for of in plans for outcome in of.outcomes]
    each = [outcome for outcome, _ in rows]
    variables: Variables = {
        "error": ("trial", [of.error_of(outcome) for outcome, of in rows], "1"),
        "steady_call_s": ("trial", [outcome.seconds for outcome in each], "s"),
        "simulate_time_s": ("trial", [outcome.simulate_s for outcome in each], "s"),
        "invert_time_s": ("trial", [outcome.invert_s for outcome in each], "s"),
        "first_call_s": ("trial", [outcome.first_s for outcome in each], "s"),
        "memory": ("trial", [outcome.memory_bytes for outcome in each], "B"),
        "is_chosen": ("trial", [int(outcome is plan.outcome) for outcome in each], "1"),
        "changed": ("trial", [_changed(outcome, of) for outcome, of in rows], "1"),
        **{
            name: ("trial", [_word(outcome, name, of) for outcome, of in rows], "1")
            for name in SETTINGS
        },
    }
    coordinates: Variables = {"trial": (np.arange(len(rows)), "1")}
    if measured is not None:
        along = "row", "point"
        variables["planned"] = along, measured.planned.value, recipes.unit
        variables["converged"] = along, measured.converged.value, recipes.unit
        coordinates |= {"row": (list(recipes.rows), "1"), "point": (recipes.points, recipes.along)}
    numbers = scalars(_numbers(plan, measured, asked))
    return dataset(variables | numbers, coordinates, quantity=asked.quantity)


def _numbers(plan: Plan, measured: PlanCheck | None, asked: Asked) -> dict[str, Any]:
    one, error, budget_s = plan.outcome, asked.error, asked.budget_s
    return {
        "plan_error_asked": error,
        "plan_budget_s_asked": budget_s,
        "plan_error_predicted": plan.error,
        "plan_error_found": measured and measured.planned.error_from(measured.converged),
        "plan_time_s_predicted": one.seconds,
        "plan_time_s_found": measured and measured.planned.seconds,
        "plan_first_call_s_predicted": plan.first_call_s,
        "plan_memory_bytes_predicted": one.memory_bytes,
        "plan_floor": one.floor,
        "plan_meets_error": None if error is None else plan.error <= error,
        "plan_meets_budget": None if budget_s is None else one.seconds <= budget_s,
        "plan_is_in_data": None if error is None else one.floor <= error,
    }


def _changed(outcome: RecipeOutcome, plan: Plan) -> str:
    """The settings in which an outcome differs from the one that errors are measured from."""
    both = ((name, _word(outcome, name, plan), _word(plan.beside, name, plan)) for name in SETTINGS)
    return ", ".join(name for name, own, other in both if own != other) or "reference"


def _word(outcome: RecipeOutcome, name: str, plan: Plan) -> str:
    if name == "cells":
        return str(outcome.cells)
    value = getattr(outcome.recipe, name)
    if name != "effects" or value is None:
        return str(value or "")
    off = [each for each in plan.beside.recipe.effects or () if each not in value]
    if len(value) > max(MOST_LISTED, len(off)):
        return f"all but {', '.join(off)}" if off else f"all {len(value)} that are named"
    return ", ".join(value) or "none"


def _title(plan: Plan, asked: Asked) -> str:
    quantity, error, budget_s = asked.quantity, asked.error, asked.budget_s
    outcome, predicted = plan.outcome, f"{significant(100 * plan.error, 2)} %"
    seconds = in_words(outcome.seconds, "s")
    what = f"{quantity} on {outcome.cells} cells"
    if error is not None and plan.error > error:
        return f"The target error is not met: {what} has {predicted}, and no trial has less"
    if error is not None and outcome.floor > error:
        return (
            f"The standard error is {significant(100 * outcome.floor, 2)} %; {what} adds a "
            f"numerical error of {predicted} in {seconds}"
        )
    if budget_s is not None and outcome.seconds > budget_s:
        budget = in_words(budget_s, "s")
        return f"The budget of {budget} is exceeded: {what} takes {seconds} for {predicted}"
    what = what if what[1] == " " else what[0].upper() + what[1:]  # p and q are symbols
    return f"{what}: a numerical error of {predicted} in {seconds}"


def tradeoff(ds: xarray.Dataset) -> Figure:
    """Error against time of every outcome, with the one chosen and what was asked for."""
    curves = [
        Curve(own["error"].values, str(changed), own["steady_call_s"].values,
              look={"marker": "o", "linestyle": "none"})
        for changed in dict.fromkeys(ds["changed"].values.tolist())
        for own in [ds.isel(trial=np.flatnonzero(ds["changed"] == changed))]
    ]  # fmt: skip
    chosen = ds.isel(trial=np.flatnonzero(ds["is_chosen"]))
    ring = {"marker": "o", "markersize": 13, "markerfacecolor": "none", "linestyle": "none"}
    curves.append(
        Curve(chosen["error"].values, "chosen", chosen["steady_call_s"].values, look=ring)
    )
    marks = [
        Mark(float(ds[name]), label, axis, look={"color": GREY, "linestyle": linestyle})
        for name, label, axis, linestyle in (
            ("plan_error_asked", "target error", "y", "--"),
            ("plan_budget_s_asked", "time budget", "x", ":"),
            ("plan_floor", "standard error", "y", "-."),
        )
        if name in ds and float(ds[name]) > 0
    ]
    lines = {axis: [mark.at for mark in marks if mark.axis == axis] for axis in ("x", "y")}
    time = _axis("time of a further call", "s", [*ds["steady_call_s"].values, *lines["x"]])
    error = _axis("numerical error", "1", [*ds["error"].values, *lines["y"]])
    return panels([Panel(curves, time, error, marks=marks)], height_in=4.0)


def _axis(name: str, unit: str, values: Sequence[float]) -> PanelAxis:
    """A logarithmic axis with a margin around all that is above zero."""
    above = [float(value) for value in values if 0 < value < np.inf]
    ends = (min(above) / AROUND, max(above) * AROUND) if above else (None, None)
    return PanelAxis(name, unit, is_log=True, limits=ends)


def answers(ds: xarray.Dataset) -> Figure:
    """The planned answer beside the converged one, and their difference."""
    x = PanelAxis("x" if ds["point"].units == "m" else "time", ds["point"].units)
    rows = []
    for row in ds["row"].values.tolist():
        own = ds.sel(row=row)
        unit, difference = own["planned"].units, own["planned"] - own["converged"]
        both = [
            Curve(own["converged"].values, "converged", look={"linewidth": 3, "alpha": 0.4}),
            Curve(own["planned"].values, "planned"),
        ]
        rows.append(Panel(both, x, PanelAxis(row, unit), own["point"].values))
        differences = [Curve(difference.values, "planned less converged")]
        rows.append(
            Panel(differences, x, PanelAxis(f"difference of {row}", unit), own["point"].values)
        )
    return panels(rows)
