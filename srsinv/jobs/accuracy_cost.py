"""Accuracy against cost: every part of the package over its sizes and settings, with its peers.

Each part makes trials; they are measured in turns while the budget lasts, and each becomes a row of
one table. Peers are the packages of a clone's `benchmarks` that do the same work; without these the
rows are ours alone.
"""

import platform
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import lru_cache, partial
from types import ModuleType
from typing import Any

import jax
import numpy as np

from .. import __version__, config
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
from ._cost_settings import CONVERGED_WITHIN, TIGHT, CostSettings
from ._cost_table import tables, title
from ._cost_trials import FAILURES
from ._cost_turns import measure_in_turns
from .trials import Trial, TrialRows, TrialTiming

# Of the configuration, what no row depends on; and what only its own trials do.
_APART = {"job", "section", "hydra", "accuracy_cost", "experiment", "compilation_cache",
          "figures"}  # fmt: skip


def run(cfg: config.Config) -> Result:
    """Measure all parts.

    Raises `BadInput` for what cannot be measured, and refusals of the configuration's parts.
    """
    settings, peers = CostSettings.checked(cfg["accuracy_cost"]), benchmark("peers")
    with jax.enable_x64(True):
        _simulated(cfg, "periodic", min(settings.forward_cells))  # refuses a scene that is none
        parts = _parts(cfg, settings, peers)
        trials = [trial for name in settings.parts for trial in parts[name]()]
        timing = TrialTiming(settings.repeats, settings.is_fresh, FAILURES)
        rows = TrialRows(timing, settings.rows, "accuracy_cost.rows", _rests_on(cfg, settings))
        budget_s = np.inf if settings.budget_s is None else settings.budget_s
        done, left_out = measure_in_turns(trials, rows, budget_s)
    data = tables(
        done,
        left_out,
        **_facts(settings, peers is not None),
        noise=", ".join(cfg["noise"]) or "no",
        seed=cfg["seed"],
        refinement=cfg["grid"]["refinement"],
    )
    own = {"fit_counts": fit_counts, "effect_costs": effect_costs}
    return Result(title(data), data, sections("accuracy_cost", **own))


def _parts(
    whole: config.Config, settings: CostSettings, peers: ModuleType | None
) -> dict[str, Callable[[], Iterable[Trial]]]:
    """What makes the trials of each part of a whole configuration, by the part's name."""
    simulated = partial(_simulated, whole)

    def effects() -> Iterable[Trial]:
        named, line = list(config.part(whole, "effects")), whole["grid"]["line"]
        of = partial(_with_effects, whole, settings.effects)
        return _cost_effects.trials(of, settings, named, line, config.random_key(whole))

    def inversions() -> Iterable[Trial]:
        given = config.methods(whole), config.random_key(whole), config.friction(whole)
        return _cost_inversion.trials(simulated, settings, *given, peers)

    def fits() -> Iterable[Trial]:
        given = config.sensor(whole), config.scan(whole), config.seed(whole)
        return _cost_fit.trials(settings, *given, peers)

    def recordings() -> Iterable[Trial]:
        cell_m = whole["grid"]["length_m"] / whole["grid"]["cells"]
        given = config.methods(whole), config.seed(whole), config.friction(whole), cell_m
        return _cost_recordings.trials(lru_cache(1)(partial(_scanned, whole)), settings, *given)

    return {
        "forward": lambda: _cost_forward.trials(simulated, settings, peers),
        "contact": lambda: _cost_contact.trials(settings, peers),
        "effects": effects,
        "inversion": inversions,
        "fit": fits,
        "recordings": recordings,
    }


def _simulated(whole: config.Config, line: str, cells: int) -> Simulation:
    """The scene on another line."""
    return config.simulation({**whole, "grid": {**whole["grid"], "line": line, "cells": cells}})


def _scanned(whole: config.Config, samples: int) -> Simulation:
    """The scene in the middle of so many cells of an open line, as wide as those configured."""
    grid = whole["grid"]
    length_m = grid["length_m"] / grid["cells"] * samples
    start_m = grid["start_m"] + (grid["length_m"] - length_m) / 2
    of_scan = {**grid, "length_m": length_m, "start_m": start_m}
    return _simulated({**whole, "grid": of_scan}, "open", samples)


def _with_effects(
    whole: config.Config, more: Mapping[str, Any], cells: int, names: Collection[str]
) -> Simulation:
    """The scene with these of its effects and `more`; all of them act, none is screened."""
    own = {name: each for name, each in whole.items() if name != "tolerance"}
    both = {**own, "effects": {**more, **config.part(whole, "effects")}}
    return _simulated(config.select_effects(both, names), whole["grid"]["line"], cells)


def _rests_on(whole: config.Config, settings: CostSettings) -> dict[str, Any]:
    """What of the configuration every row depends on; the rest its own trial has."""
    grid = {name: each for name, each in whole["grid"].items() if name not in ("cells", "line")}
    rest = {name: each for name, each in whole.items() if name not in _APART}
    fit = settings.fit.samples, settings.fit.snr_dB
    how = settings.repeats, settings.is_fresh, platform.node()  # times are those of one machine
    return {**rest, "version": __version__, "grid": grid, "how": how, "fit": fit}


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
