"""Screening of effects: the error by those left out, and the time saved."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray
from srsinv.report.outcome import Outcome, Section, Table

from srsinv import config
from srsinv.errors import refuse
from srsinv.forward.trace import Cost, cost, difference, pair
from srsinv.grid import Line
from srsinv.parts import merged
from srsinv.progress import stage
from srsinv.report import figures


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


def run(cfg: config.Config) -> Outcome:
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
    table = _table(rows)
    return Outcome(
        f"{len(scenes)} scenes decide on their effects",
        _metrics(rows),
        _dataset(rows, bounds, scenes, tolerances),
        _sections(rows, table, bounds, line, refinement),
        table,
    )


def _metrics(rows: list[Decided]) -> dict[str, Any]:
    ratios = [r.deciding.first_s / r.saved.first_s for r in rows if r.saved.first_s > 0]
    metrics: dict[str, Any] = {
        "error_over_tolerance_max": max(row.error / row.tolerance for row in rows),
        "error_over_bound_max": max((r.error / r.bound for r in rows if r.bound), default=0.0),
        "deciding_over_saved_first_median": float(np.median(ratios)) if ratios else None,
        "time_s_saved_first_total": sum(row.saved.first_s for row in rows),
        "time_s_deciding_first_total": sum(row.deciding.first_s for row in rows),
    }
    for row in rows:
        tag = f"{row.scene}_{row.tolerance:g}"
        metrics |= {
            f"error_{tag}": row.error,
            f"bound_{tag}": row.bound,
            f"effects_on_{tag}": len(row.on),
            f"first_call_s_all_on_{tag}": row.full.first_s,
            f"first_call_s_auto_{tag}": row.auto.first_s,
            f"first_call_s_deciding_{tag}": row.deciding.first_s,
            f"steady_call_s_all_on_{tag}": row.full.steady_s,
            f"steady_call_s_auto_{tag}": row.auto.steady_s,
            f"steady_call_s_deciding_{tag}": row.deciding.steady_s,
        }
    return metrics


def _table(rows: list[Decided]) -> Table:
    return Table(
        ("scene", "tolerance", "on", "error", "bound", "all on [s]", "auto [s]", "deciding [s]",
         "all on, steady [ms]", "auto [ms]", "deciding [ms]"),
        tuple(
            (
                row.scene, f"{row.tolerance:g}", len(row.on), f"{row.error:.2e}",
                f"{row.bound:.2e}", row.full.first_s, row.auto.first_s, row.deciding.first_s,
                1e3 * row.full.steady_s, 1e3 * row.auto.steady_s, 1e3 * row.deciding.steady_s,
            )
            for row in rows
        ),
        "Error: rms of what the effects left out change, over the rms of the signal with all on; "
        "bound: what screening says that it is at most. "
        "First calls in seconds, all compilation included, and steady ones in milliseconds, both "
        "from the configuration to the signal; deciding is what effects=auto takes beyond naming "
        "the same effects.",
    )  # fmt: skip


def _dataset(rows: list[Decided], bounds, scenes, tolerances) -> xarray.Dataset:
    shape = (len(scenes), len(tolerances))
    effects = sorted(next(iter(bounds.values())))
    along = ("scene", "tolerance")

    def each(get):
        return np.array([get(row) for row in rows], float).reshape(shape)

    on = np.array([[name in row.on for name in effects] for row in rows], np.int8)
    each_bound = [[one[name] for name in effects] for one in bounds.values()]
    return xarray.Dataset(
        {
            "error": (along, each(lambda r: r.error), {"units": "1"}),
            "bound": (along, each(lambda r: r.bound), {"units": "1"}),
            "time_all_on": (along, each(lambda r: r.full.first_s), {"units": "s"}),
            "time_auto": (along, each(lambda r: r.auto.first_s), {"units": "s"}),
            "time_deciding": (along, each(lambda r: r.deciding.first_s), {"units": "s"}),
            "on": ((*along, "effect"), on.reshape(*shape, -1), {"units": "1"}),
            "effect_bound": (("scene", "effect"), np.array(each_bound), {"units": "1"}),
        },
        {
            "scene": ("scene", list(scenes), {"units": "1"}),
            "tolerance": ("tolerance", list(tolerances), {"units": "1"}),
            "effect": ("effect", effects, {"units": "1"}),
        },
    )


def _sections(
    rows: list[Decided], table: Table, bounds, line: Line, refinement: int
) -> tuple[Section, ...]:
    effects = sorted(next(iter(bounds.values())))
    each_bound = Table(
        ("effect", *bounds),
        tuple((name, *(f"{one[name]:.1e}" for one in bounds.values())) for name in effects),
        "Each effect's bound in each scene: rms of what it changes over the rms of the signal.",
    )

    def errors():
        names = list(bounds)
        lines = {
            f"tolerance {t:g}": np.array([r.error for r in rows if r.tolerance == t])
            for t in sorted({r.tolerance for r in rows}, reverse=True)
        }
        return figures.levels(names, lines, "measured error [1]")

    return (
        Section(
            "Error and time",
            ("Each scene is screened once, without any effect; a bound says how much each effect "
             "could change, and the smallest are left out as long as the bound on what they change "
             "together is within the tolerance.",),
            {"errors": errors},
            {"errors": "Measured error of what was left out, for each tolerance (dashed). Where "
             "nothing but effects that change nothing was left out the error is zero, and not "
             "drawn."},
            tables=(table,),
        ),
        Section("Bounds", (), tables=(each_bound,)),
        Section(
            "What was assumed",
            (f"{line.kind} line of {line.n} cells, computed on cells {refinement} times finer; no "
             "noise but the bursts of snap_back, the same ones with and without the other "
             "effects.",),
        ),
    )  # fmt: skip
