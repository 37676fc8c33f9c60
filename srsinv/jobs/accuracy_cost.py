"""Accuracy against cost: every part of the package over its sizes and settings, with its peers.

Each part makes trials; they are measured in turns while the budget lasts, and each becomes a row of
one table. Peers are the packages of a clone's `benchmarks` that do the same work; without these the
rows are ours alone.
"""

from collections.abc import Callable, Collection, Iterable
from functools import lru_cache
from types import ModuleType
from typing import Any

import jax
import numpy as np

from .. import config
from ..forward.simulation import Simulation
from ..namespaces import benchmark
from ..report.result import Result
from ..report.section import sections
from . import (
    _cost_contact,
    _cost_effects,
    _cost_fit,
    _cost_forward,
    _cost_inversion,
    _cost_recordings,
)
from ._cost_plots import effect_costs, fit_counts
from ._cost_rows import RowFile
from ._cost_runner import run as run_trials
from ._cost_settings import CONVERGED_WITHIN, TIGHT, CostSettings
from ._cost_table import tables, title
from ._cost_trials import CostTrial

# Of the configuration, what no row depends on; and what only its own trials do.
_APART = {"job", "section", "hydra", "accuracy_cost", "experiment", "compilation_cache"}


def run(cfg: config.Config) -> Result:
    """Measure all parts.

    Raises `BadInput` for what cannot be measured, and refusals of the configuration's parts.
    """
    settings, peers = CostSettings.checked(cfg["accuracy_cost"]), benchmark("peers")
    with jax.enable_x64(True):
        parts = _parts(cfg, settings, peers)
        trials = [trial for name in settings.parts for trial in parts[name]()]
        known = RowFile(settings.rows, _rests_on(cfg, settings))
        how = settings.repeats, known, settings.budget_s, settings.is_fresh
        done = run_trials(trials, *how)
    data = tables(
        done,
        **_facts(settings, peers is not None),
        noise=", ".join(cfg["noise"]) or "no",
        seed=cfg["seed"],
        refinement=cfg["grid"]["refinement"],
    )
    own = {"fit_counts": fit_counts, "effect_costs": effect_costs}
    return Result(title(data), data, sections("accuracy_cost", **own))


def _parts(
    whole: config.Config, settings: CostSettings, peers: ModuleType | None
) -> dict[str, Callable[[], Iterable[CostTrial]]]:
    """What makes the trials of each part of a whole configuration, by the part's name."""

    def simulated(line: str, cells: int) -> Simulation:
        return config.simulation({**whole, "grid": {**whole["grid"], "line": line, "cells": cells}})

    @lru_cache(1)
    def scanned(samples: int) -> Simulation:
        grid, cell = whole["grid"], whole["grid"]["length_m"] / whole["grid"]["cells"]
        middle = grid["start_m"] + grid["length_m"] / 2
        own = {"length_m": samples * cell, "start_m": middle - samples * cell / 2}
        grid = {**grid, **own, "line": "open", "cells": samples}
        return config.simulation({**whole, "grid": grid})

    def inversions() -> Iterable[CostTrial]:
        given = config.methods(whole), config.random_key(whole), config.friction(whole)
        return _cost_inversion.trials(simulated, settings, *given, peers)

    def fits() -> Iterable[CostTrial]:
        given = config.sensor(whole), config.scan(whole), config.seed(whole)
        return _cost_fit.trials(settings, *given, peers)

    def with_effects(cells: int, names: Collection[str]) -> Simulation:
        # All of these act: nothing is screened.
        own = {name: each for name, each in whole.items() if name != "tolerance"}
        own |= {"effects": {**settings.effects, **config.part(whole, "effects")}}
        grid = {**whole["grid"], "cells": cells}
        return config.simulation(config.select_effects({**own, "grid": grid}, names))

    def effects() -> Iterable[CostTrial]:
        named, line = list(config.part(whole, "effects")), whole["grid"]["line"]
        return _cost_effects.trials(with_effects, settings, named, line, config.random_key(whole))

    def recordings() -> Iterable[CostTrial]:
        given = config.methods(whole), config.seed(whole), config.friction(whole)
        return _cost_recordings.trials(scanned, settings, *given)

    return {
        "contact": lambda: _cost_contact.trials(settings, peers),
        "effects": effects,
        "recordings": recordings,
        "forward": lambda: _cost_forward.trials(simulated, settings, peers),
        "inversion": inversions,
        "fit": fits,
    }


def _rests_on(whole: config.Config, settings: CostSettings) -> dict[str, Any]:
    """What of the configuration every row depends on; the rest its own trial has."""
    grid = {name: each for name, each in whole["grid"].items() if name not in ("cells", "line")}
    rest = {name: each for name, each in whole.items() if name not in _APART}
    fit = settings.fit.samples, settings.fit.snr_dB
    return {**rest, "grid": grid, "repeats": settings.repeats, "fit": fit}


def _facts(settings: CostSettings, has_peers: bool) -> dict[str, Any]:
    budget = settings.budget_s
    return {
        "repeats": settings.repeats,
        "budget_s": np.inf if budget is None else float(budget),
        "is_fresh": int(settings.is_fresh),
        "positions": min(settings.forward_cells),
        "reference_cells": _cost_forward.FINER,
        "exact_tolerance": TIGHT,
        "fit_samples": settings.fit.samples,
        "fit_snr_dB": settings.fit.snr_dB,
        "fit_signals": settings.fit.signals,
        "converged_within": CONVERGED_WITHIN,
        "has_peers": int(has_peers),
    }
