"""Scenes that decide on their own effects: the error of what they leave out, and the time saved."""

import time
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray

from srsinv.errors import refuse
from srsinv.jobs import build
from srsinv.jobs.change import Cost, cost, difference, merged, pair, with_only
from srsinv.progress import stage
from srsinv.report import figures
from srsinv.report.outcome import Outcome, Section, Table


class Decided(NamedTuple):
    """One scene at one tolerance: what is on, its bounds, the measured error, and times."""

    scene: str
    tolerance: float
    on: tuple[str, ...]
    bound: float
    error: float
    deciding: Cost
    taken: Cost
    full: Cost

    @property
    def saved(self) -> Cost:
        """Against all effects on."""
        return Cost(*(a - b for a, b in zip(self.full, self.taken, strict=True)))


def run(cfg: build.Config) -> Outcome:
    """Every scene with all effects, and with those it calls for at each tolerance.

    Raises `BadInput` for tolerances that are none, and what the configuration's parts refuse.
    """
    settings = cfg["effects_auto"]
    tolerances, scenes = settings["tolerances"], settings["scenes"]
    refuse(not tolerances or not scenes, "effects_auto needs a scene and a tolerance: name some.")
    rows, bounds = [], {}
    with build.precision(cfg):
        key = build.random_key(cfg)
        for name, changes in scenes.items():
            with stage(f"scene: {name}"):
                own = merged(cfg, changes)
                full, full_cost = cost(own, key)
                for tolerance in tolerances:
                    asked = {**own, "tolerance": tolerance}
                    (kept, verdicts), deciding = _decided(asked)
                    on = tuple(sorted(kept["effects"]))
                    less, taken = cost(with_only(own, on), key)
                    whole, reduced = pair(full, less, key)
                    bounds[name] = {v.name: v.share for v in verdicts}
                    bound = sum(v.share for v in verdicts if not v.on)
                    error = difference(reduced, whole)
                    rows.append(
                        Decided(name, tolerance, on, bound, error, deciding, taken, full_cost)
                    )
    table = _table(rows)
    return Outcome(
        f"{len(scenes)} scenes decide on their effects",
        _metrics(rows),
        _dataset(rows, bounds, scenes, tolerances),
        _sections(cfg, rows, table, bounds),
        table,
    )


def _decided(cfg: build.Config):
    """The decision, with what it takes from nothing compiled, and again."""

    def once():
        start = time.perf_counter()
        return build.decided(cfg), time.perf_counter() - start

    jax.clear_caches()
    found, first = once()
    return found, Cost(first, min(once()[1] for _ in range(3)))


def _metrics(rows: list[Decided]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "error_over_tolerance_max": max(row.error / row.tolerance for row in rows),
        "deciding_over_saved_first_median": float(
            np.median([row.deciding.first_s / max(row.saved.first_s, 1e-9) for row in rows])
        ),
    }
    for row in rows:
        tag = f"{row.scene}_{row.tolerance:g}"
        found |= {
            f"error_{tag}": row.error,
            f"bound_{tag}": row.bound,
            f"effects_on_{tag}": len(row.on),
            f"time_s_deciding_first_{tag}": row.deciding.first_s,
            f"time_s_deciding_steady_{tag}": row.deciding.steady_s,
            f"time_s_saved_first_{tag}": row.saved.first_s,
            f"time_s_saved_steady_{tag}": row.saved.steady_s,
        }
    return found


def _table(rows: list[Decided]) -> Table:
    return Table(
        ("scene", "tolerance", "on", "error", "bound", "all on [s]", "decided [s]", "deciding [s]",
         "all on, steady [ms]", "decided [ms]", "deciding [ms]"),
        tuple(
            (
                row.scene, f"{row.tolerance:g}", len(row.on), f"{row.error:.2e}",
                f"{row.bound:.2e}", row.full.first_s, row.taken.first_s, row.deciding.first_s,
                1e3 * row.full.steady_s, 1e3 * row.taken.steady_s, 1e3 * row.deciding.steady_s,
            )
            for row in rows
        ),
        "Error: rms of what the effects left out change, over the rms of the signal with all on. "
        "Times in seconds are first calls with all compilation, steady ones in milliseconds.",
    )  # fmt: skip


def _dataset(rows: list[Decided], bounds, scenes, tolerances) -> xarray.Dataset:
    shape = (len(scenes), len(tolerances))
    effects = sorted(next(iter(bounds.values())))
    along = ("scene", "tolerance")

    def each(get):
        return np.array([get(row) for row in rows], float).reshape(shape)

    on = np.array([[name in row.on for name in effects] for row in rows], np.int8)
    shares = [[one[name] for name in effects] for one in bounds.values()]
    return xarray.Dataset(
        {
            "error": (along, each(lambda r: r.error), {"units": "1"}),
            "bound": (along, each(lambda r: r.bound), {"units": "1"}),
            "time_all_on": (along, each(lambda r: r.full.first_s), {"units": "s"}),
            "time_decided": (along, each(lambda r: r.taken.first_s), {"units": "s"}),
            "time_deciding": (along, each(lambda r: r.deciding.first_s), {"units": "s"}),
            "on": ((*along, "effect"), on.reshape(*shape, -1), {"units": "1"}),
            "share": (("scene", "effect"), np.array(shares), {"units": "1"}),
        },
        {
            "scene": ("scene", list(scenes), {"units": "1"}),
            "tolerance": ("tolerance", list(tolerances), {"units": "1"}),
            "effect": ("effect", effects, {"units": "1"}),
        },
    )


def _sections(cfg: build.Config, rows: list[Decided], table: Table, bounds) -> tuple[Section, ...]:
    effects = sorted(next(iter(bounds.values())))
    shares = Table(
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
            ("Each scene is looked at once, without any effect; a bound says how much each effect "
             "could change, and the smallest are left out as long as their sum is within the "
             "tolerance.",),
            {"errors": errors},
            {"errors": "Measured error of what was left out, for each tolerance (dashed). Where "
             "nothing but effects that change nothing was left out the error is zero, and not "
             "drawn."},
            tables=(table,),
        ),
        Section("Bounds", (), tables=(shares,)),
        Section(
            "What was assumed",
            (f"{cfg['grid']['line']} line of {cfg['grid']['cells']} cells, computed on cells "
             f"{cfg['grid']['refinement']} times finer; no noise but the bursts of snap_back, the "
             "same ones with and without the other effects.",),
        ),
    )  # fmt: skip
