"""Screening of effects: the error by those left out, and the time saved."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.effects import forget_screenings
from srsinv.errors import mapping, refuse
from srsinv.forward.trace import cost, difference, pair
from srsinv.parts import merged
from srsinv.progress import stage, steps
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import significant

BY = ("scene", "allowed_change")
# Of one scene at one tolerance: the effects `on`, the `bound` on the error by the others, the
# `bounds` of each effect and the `error`; the costs with all effects on, `full`, with those
# screened, `auto`, and with the same ones `named`.
Screened = dict[str, Any]


def run(cfg: config.Config) -> Result:
    """Every scene with all effects, and with those screened at each tolerance.

    Raises `BadInput` for invalid tolerances, and refusals of the configuration's parts.
    """
    settings = cfg["effects_auto"]
    tolerances, scenes = settings["tolerances"], settings["scenes"]
    refuse(
        not tolerances or not scenes,
        "effects_auto.scenes or effects_auto.tolerances is empty: give at least one of each.",
    )
    screened: dict[str, list[Screened]] = {name: [] for name in scenes}
    with config.precision(cfg), steps("scenes", scenes.items()) as each:
        key, line = config.random_key(cfg), config.line(cfg)
        for scene, changes in each:
            with stage(f"scene: {scene}"):
                own = merged(cfg, mapping(f"effects_auto.scenes.{scene}", changes))
                named = {k: v for k, v in own.items() if k != "tolerance"}
                sim, full = cost(partial(config.simulation, named), key)
                done = {}  # measured once for tolerances that need the same effects
                for tolerance in tolerances:
                    asked = {**own, "tolerance": tolerance}
                    screening = config.screened(asked)[1]
                    assert screening is not None
                    on = tuple(sorted(screening.on))
                    if on not in done:
                        selected = partial(config.simulation, config.select_effects(named, on))
                        less, alone = cost(selected, key)
                        whole, reduced = pair(sim, less, key)
                        error = difference(reduced, whole)
                        forget_screenings()  # the first call weighs, further ones reuse it
                        auto = cost(partial(config.simulation, asked), key)[1]
                        done[on] = {"error": error, "full": full, "auto": auto, "named": alone}
                    of_each = screening.relative_change_bounds
                    bounds = {"on": on, "bound": screening.bound, "bounds": of_each}
                    screened[scene].append(done[on] | bounds)
    data = _dataset(screened, tolerances).assign_attrs(
        line=line.kind, cells=line.n, refinement=config.part(cfg, "grid")["refinement"]
    )
    return Result(_title(data), data, sections(__file__))


def _title(data: xarray.Dataset) -> str:
    scenes, tolerances, effects = (data.sizes[dim] for dim in (*BY, "effect"))
    on, worst = data["effects_on"], float(data["error_over_tolerance_max"])
    return (
        f"effects=auto keeps {int(on.min())} to {int(on.max())} of {effects} effects; the others "
        f"change the signal by at most {significant(100 * worst, 2)} % of the tolerance "
        f"({scenes} scene{'s' * (scenes > 1)}, {tolerances} tolerances)"
    )


def _dataset(screened: Mapping[str, list[Screened]], tolerances: Sequence[float]) -> xarray.Dataset:
    """`screened` by scene, at each tolerance."""
    bounds = [row[-1]["bounds"] for row in screened.values()]
    effects = sorted(bounds[0])
    bound, error, full, auto, named = (
        np.array([[each[name] for each in row] for row in screened.values()])
        for name in ("bound", "error", "full", "auto", "named")
    )
    on = [[[int(n in each["on"]) for n in effects] for each in row] for row in screened.values()]
    of_effect = [[each[name] for name in effects] for each in bounds]
    over_tolerance = error / np.array(tolerances)
    over_bound = np.divide(error, bound, out=np.zeros_like(error), where=bound != 0)
    key = "{scene}_{allowed_change}"
    variables = {
        "error": (BY, error, "1", f"error_{key}"),
        "bound": (BY, bound, "1", f"bound_{key}"),
        "effects_on": (BY, np.sum(on, axis=-1), "1", f"effects_on_{key}"),
        "error_over_tolerance": (BY, over_tolerance, "1"),
        "error_over_bound": (BY, over_bound, "1"),
        "on": ((*BY, "effect"), on, "1"),
        "effect_bound": (("scene", "effect"), of_effect, "1"),
    }
    deciding, saved = auto - named, (full - auto)[..., 0]
    for name, costs in (("all_on", full), ("auto", auto), ("deciding", deciding)):
        first, steady = np.moveaxis(costs, -1, 0)
        variables[f"time_{name}"] = BY, first, "s", f"first_call_s_{name}_{key}"
        variables[f"steady_call_s_{name}"] = BY, steady, "s", f"steady_call_s_{name}_{key}"
    ratios = deciding[saved > 0, 0] / saved[saved > 0]
    variables |= scalars({
        "error_over_tolerance_max": over_tolerance.max(),
        "error_over_bound_max": over_bound.max(),
        "deciding_over_saved_first_median": np.median(ratios) if ratios.size else None,
        "time_s_saved_first_total": saved.sum(),
        "time_s_deciding_first_total": deciding[..., 0].sum(),
    })  # fmt: skip
    coordinates = {"scene": list(screened), "allowed_change": list(tolerances), "effect": effects}
    return dataset(variables, {name: (labels, "1") for name, labels in coordinates.items()})
