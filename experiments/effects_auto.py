"""Screening of effects: the error by those left out, and the time saved."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray

from srsinv import config
from srsinv.errors import refuse
from srsinv.forward.trace import Cost, cost, difference, pair
from srsinv.parts import merged
from srsinv.progress import stage
from srsinv.report.result import Result, dataset, scalars
from srsinv.report.section import sections
from srsinv.report.text import significant

_KEY = "{scene}_{tolerance}"  # of a metric's name


class Decided(NamedTuple):
    """One scene at one tolerance: effects on, bound and measured error, and the cost with all
    effects on, with screening, and with the same effects named."""

    scene: str
    tolerance: float
    on: tuple[str, ...]
    bound: float
    error: float
    full: Cost
    auto: Cost
    named: Cost

    @property
    def saved(self) -> Cost:
        """Cost saved against all effects on, screening included."""
        return Cost(*(a - b for a, b in zip(self.full, self.auto, strict=True)))

    @property
    def deciding(self) -> Cost:
        """Cost of screening over naming the effects."""
        return Cost(*(a - b for a, b in zip(self.auto, self.named, strict=True)))


def run(cfg: config.Config) -> Result:
    """Every scene with all effects, and with those screened at each tolerance.

    Raises `BadInput` for invalid tolerances, and refusals of the configuration's parts.
    """
    settings = cfg["effects_auto"]
    tolerances, scenes = settings["tolerances"], settings["scenes"]
    refuse(not tolerances or not scenes, "effects_auto needs a scene and a tolerance: name some.")
    rows, bounds = [], {}
    with config.precision(cfg):
        key, line = config.random_key(cfg), config.line(cfg)
        refinement = config.part(cfg, "grid")["refinement"]
        for name, changes in scenes.items():
            with stage(f"scene: {name}"):
                own = merged(cfg, changes)
                named = {k: v for k, v in own.items() if k != "tolerance"}
                full, all_on = cost(partial(config.simulation, named), key)
                # Measured once for tolerances that need the same effects.
                done = {}
                for tolerance in tolerances:
                    asked = {**own, "tolerance": tolerance}
                    screening = config.screened(asked)[1]
                    assert screening is not None
                    on = tuple(sorted(screening.on))
                    if on not in done:
                        selected = config.select_effects(named, on)
                        less, alone = cost(partial(config.simulation, selected), key)
                        whole, reduced = pair(full, less, key)
                        auto = cost(partial(config.simulation, asked), key)[1]
                        done[on] = difference(reduced, whole), auto, alone
                    bounds[name] = screening.relative_change_bounds
                    error, auto, alone = done[on]
                    costs = all_on, auto, alone
                    rows.append(Decided(name, tolerance, on, screening.bound, error, *costs))
    data = _dataset(rows, bounds, tolerances).assign_attrs(
        line=line.kind, cells=line.n, refinement=refinement
    )
    return Result(_title(rows, data.sizes["effect"]), data, sections(__file__))


def _title(rows: Sequence[Decided], effects: int) -> str:
    worst = max(row.error / row.tolerance for row in rows)
    scenes, tolerances = {row.scene for row in rows}, {row.tolerance for row in rows}
    on = [len(row.on) for row in rows]
    plural = "s" * (len(scenes) > 1)
    return (
        f"{len(scenes)} scene{plural} at {len(tolerances)} tolerances: {min(on)} to {max(on)} of "
        f"{effects} effects stay on, and what is left out changes the signal by at most "
        f"{significant(worst, 2)} of the tolerance"
    )


def _dataset(
    rows: Sequence[Decided], bounds: Mapping[str, Mapping[str, float]], tolerances: Sequence[float]
) -> xarray.Dataset:
    """`rows` by scene and tolerance; `bounds` on each effect's change, by scene and effect."""
    effects, by = sorted(next(iter(bounds.values()))), ("scene", "tolerance")

    def each(get: Callable[[Decided], Any]) -> np.ndarray:
        values = np.array([get(row) for row in rows])
        return values.reshape(len(bounds), len(tolerances), *values.shape[1:])

    return dataset(
        {
            "error": (by, each(lambda r: r.error), "1", f"error_{_KEY}"),
            "bound": (by, each(lambda r: r.bound), "1", f"bound_{_KEY}"),
            "effects_on": (by, each(lambda r: len(r.on)), "1", f"effects_on_{_KEY}"),
            "error_over_tolerance": (by, each(lambda r: r.error / r.tolerance), "1"),
            "error_over_bound": (by, each(lambda r: r.error / r.bound if r.bound else 0.0), "1"),
            "on": ((*by, "effect"), each(lambda r: [int(n in r.on) for n in effects]), "1"),
            "effect_bound": (("scene", "effect"),
                             [[one[name] for name in effects] for one in bounds.values()], "1"),
            **_times(by, each),
            **_over_all(rows),
        },
        {"scene": (list(bounds), "1"), "tolerance": (list(tolerances), "1"),
         "effect": (effects, "1")},
    )  # fmt: skip


def _times(
    by: tuple[str, ...], each: Callable[[Callable[[Decided], Any]], np.ndarray]
) -> dict[str, tuple[Any, ...]]:
    """First and further calls with all effects on, with screening, and of screening itself."""
    times: dict[str, tuple[Any, ...]] = {}
    for name in ("full", "auto", "deciding"):
        costs = each(lambda row, name=name: getattr(row, name))
        word = {"full": "all_on"}.get(name, name)
        for i, (variable, metric) in enumerate(
            ((f"time_{word}", "first_call_s"), (f"steady_call_s_{word}", "steady_call_s"))
        ):
            times[variable] = (by, costs[..., i], "s", f"{metric}_{word}_{_KEY}")
    return times


def _over_all(rows: Sequence[Decided]) -> dict[str, tuple[Any, ...]]:
    ratios = [r.deciding.first_s / r.saved.first_s for r in rows if r.saved.first_s > 0]
    return scalars(
        {
            "error_over_tolerance_max": max(row.error / row.tolerance for row in rows),
            "error_over_bound_max": max((r.error / r.bound for r in rows if r.bound), default=0.0),
            "deciding_over_saved_first_median": float(np.median(ratios)) if ratios else None,
            "time_s_saved_first_total": sum(row.saved.first_s for row in rows),
            "time_s_deciding_first_total": sum(row.deciding.first_s for row in rows),
        }
    )
