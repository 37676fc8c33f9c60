"""Error against time: forward model, inversions and feature fit, with their peers beside them.

Every measurement is a row of a table: part, line, family and size, the error and the time. Peers
are the packages of a clone's `benchmarks` that do the same work; without these the rows are ours
alone.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray
from matplotlib.figure import Figure

from .. import config
from ..errors import refuse
from ..forward.simulation import Simulation
from ..grid import LINES
from ..namespaces import benchmark
from ..progress import stage
from ..report.plot.panels import Axis, Curve, Panel, panels
from ..report.result import Result, dataset, key_of
from ..report.section import sections
from . import _cost_fit as fitting
from ._cost_fit import FitSettings
from ._cost_linear import (
    REFERENCE,
    TIGHT,
    Row,
    forward_rows,
    inversion_rows,
    noisy_problems,
)

WITHIN = (1e-2, 1e-6)  # relative distances from the exact solution at which the fastest is named
WITHIN_STDERR = (fitting.CONVERGED_WITHIN, 1e-3)  # of a fit from its minimum, in standard errors
MEASURES = ("error", "error_p", "error_q", "algebraic_error", "first_call_s", "steady_call_s")


@dataclass(frozen=True)
class CostSettings:
    """`accuracy_cost` of the configuration: numbers of cells, calls after the first of which the
    least time counts, tolerances of the iterative solvers, and the settings of the fit."""

    forward_cells: Sequence[int]
    inverse_cells: Sequence[int]
    repeats: int
    tolerances: Sequence[float]
    fit: FitSettings

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> "CostSettings":
        """Those given; raises `BadInput` for what cannot be measured."""
        for name in ("forward_cells", "inverse_cells"):
            cells = given[name]
            refuse(
                not cells or any(not isinstance(n, int) or n < 8 or n % cells[0] for n in cells),
                f"accuracy_cost.{name} is {cells}: give whole numbers from 8, each a multiple of "
                "the first.",
            )
        refuse(
            not (isinstance(given["repeats"], int) and given["repeats"] >= 1),
            f"accuracy_cost.repeats is {given['repeats']}: give a whole number from 1.",
        )
        refuse(
            any(not TIGHT < tolerance < 1 for tolerance in given["tolerances"]),
            f"accuracy_cost.tolerances is {given['tolerances']}: give numbers between {TIGHT:g} "
            "and 1.",
        )
        return cls(
            forward_cells=given["forward_cells"],
            inverse_cells=given["inverse_cells"],
            repeats=given["repeats"],
            tolerances=given["tolerances"],
            fit=FitSettings.checked(given["fit"]),
        )


def run(cfg: config.Config) -> Result:
    """Measure all parts."""
    settings, peers = CostSettings.checked(cfg["accuracy_cost"]), benchmark("peers")
    with jax.enable_x64(True):
        rows = list(_linear_rows(cfg, settings))
        fits = fitting.rows_of(
            settings.fit, settings.repeats, config.sensor(cfg), config.scan(cfg),
            config.seed(cfg), peers,
        )  # fmt: skip
    quickest = list(_fastest(rows, fits))
    data = dataset(
        {**_measured(rows, "case", "", "{part}_{line}_{family}_{size}", MEASURES),
         "size": ("case", [row["size"] for row in rows], "1"),
         **_measured(fits, "fit", "fit_", "fit_{fit_sweep}_{fit_key}_{fit_setting}",
                     fitting.MEASURES),
         "fit_setting": ("fit", [row["size"] for row in fits], "1"),
         **_named(quickest, "fastest", "fastest_", ("family", "peer", "unit")),
         **{f"fastest_{name}": ("fastest", [row[name] for row in quickest], units)
            for name, units in (("within", "1"), ("steady_call_s", "s"),
                                ("peer_steady_call_s", "s"))}},
        {**_named(rows, "case", "", ("part", "line", "family", "peer")),
         **{f"fit_{name}": ("fit", [row[of] for row in fits], "1")
            for name, of in (("sweep", "line"), ("family", "family"), ("peer", "peer"))},
         "fit_key": ("fit", [key_of(row["family"]).replace("-", "_") for row in fits], "1"),
         **_named(quickest, "fastest", "fastest_", ("part", "line", "size"))},
        **_facts(cfg, settings, peers is not None),
    )  # fmt: skip
    return Result(_title(quickest), data, sections("accuracy_cost", fit_counts=fit_counts))


def _linear_rows(cfg: config.Config, settings: CostSettings) -> Iterator[Row]:
    """Forward model and inversions."""
    peers = benchmark("peers")

    def simulated(line: str, cells: int) -> Simulation:
        return config.simulation({**cfg, "grid": {**cfg["grid"], "line": line, "cells": cells}})

    for line in LINES:
        with stage(f"forward model, {line} line"):
            yield from forward_rows(
                simulated, settings.forward_cells, settings.repeats, line, peers
            )
    with stage("data and weights"):
        key, friction = config.random_key(cfg), config.friction(cfg)
        problems = noisy_problems(simulated, settings.inverse_cells, key, friction)
        smallest, _ = problems["periodic", min(settings.inverse_cells)]
        methods = config.methods(cfg).items()
        priors = {name.lower(): method.prior_fixed_on(smallest) for name, method in methods}
    for (line, cells), (problem, truth) in problems.items():
        with stage(f"inversions, {line} line, {cells} cells"):
            yield from inversion_rows(
                settings.tolerances, settings.repeats, priors, line, problem, truth, peers
            )


def _measured(
    rows: Sequence[Row], dim: str, prefix: str, key: str, measures: Iterable[str]
) -> dict[str, tuple[Any, ...]]:
    """Each measure along `dim`, a metric of `key` and its name, and the time over that of the
    peer at the same size, NaN where there is no peer."""
    same = {(row["part"], row["line"], row["family"], row["size"]): row for row in rows}
    peers = [same.get((row["part"], row["line"], row["peer"], row["size"])) for row in rows]
    ratio = [
        np.nan if peer is None else row["steady_call_s"] / peer["steady_call_s"]
        for row, peer in zip(rows, peers, strict=True)
    ]
    return {
        f"{prefix}{name}": (
            dim, [row.get(name, np.nan) for row in rows], "s" if name.endswith("_s") else "1",
            f"{key}_{name}",
        )
        for name in measures
    } | {f"{prefix}steady_call_s_over_peer": (dim, ratio, "1")}  # fmt: skip


def _named(
    rows: Sequence[Row], dim: str, prefix: str, names: Iterable[str]
) -> dict[str, tuple[Any, ...]]:
    return {f"{prefix}{name}": (dim, [row[name] for row in rows], "1") for name in names}


def _fastest(rows: Sequence[Row], fits: Sequence[Row]) -> Iterator[Row]:
    """The fastest way of ours and of the peers to come so near to the exact solution, of every part
    at its largest size."""
    for part, line in dict.fromkeys((row["part"], row["line"]) for row in rows):
        own = [row for row in rows if (row["part"], row["line"]) == (part, line)]
        size = max(row["size"] for row in own)
        largest = [row for row in own if row["size"] == size]
        for within in WITHIN:
            near = [row for row in largest if row["algebraic_error"] <= within]
            yield {"part": part, "line": line, "size": f"{size} cells", "unit": "relative",
                   "within": within, **_quickest(near)}  # fmt: skip
    swept = [row for row in fits if row["line"] == "tolerance"]
    for within in WITHIN_STDERR:
        near = [row for row in swept if row["error"] <= within]
        yield {"part": fitting.PART, "line": "open", "size": "one strip",
               "unit": "standard errors", "within": within, **_quickest(near)}  # fmt: skip


def _quickest(rows: Sequence[Row]) -> Row:
    found: Row = {}
    for name, are_peers in (("", False), ("peer_", True)):
        every = [row for row in rows if row["is_peer"] == are_peers]
        best = min(every, key=lambda row: row["steady_call_s"], default=None)
        found["peer" if are_peers else "family"] = best["family"] if best else "none"
        found[f"{name}steady_call_s"] = best["steady_call_s"] if best else np.nan
    return found


def _title(quickest: Sequence[Row]) -> str:
    """The fastest inversions of the last method, as exact as asked for at most."""
    part = quickest[-len(WITHIN_STDERR) - 1]["part"]
    own = [row for row in quickest if (row["part"], row["within"]) == (part, WITHIN[-1])]
    ways = [
        f"{row['family']} on the {row['line']} line ({1e3 * row['steady_call_s']:.2g} ms)"
        for row in own
    ]
    within = f"{WITHIN[-1]:g}".replace("e-0", "e-")
    return f"Fastest within {within} of exact on {own[0]['size']}: {', '.join(ways)}"


def _facts(cfg: config.Config, settings: CostSettings, has_peers: bool) -> dict[str, Any]:
    return {
        "repeats": settings.repeats,
        "positions": min(settings.forward_cells),
        "reference_cells": REFERENCE * max(settings.forward_cells),
        "noise": ", ".join(cfg["noise"]) or "no",
        "seed": cfg["seed"],
        "refinement": cfg["grid"]["refinement"],
        "exact_tolerance": TIGHT,
        "fit_samples": settings.fit.samples,
        "fit_snr_dB": settings.fit.snr_dB,
        "fit_signals": settings.fit.signals,
        "converged_within": fitting.CONVERGED_WITHIN,
        "has_peers": int(has_peers),
    }


def fit_counts(ds: xarray.Dataset) -> Figure:
    """How often a fit is at its minimum and how long it takes, over the number of starts; and how
    long over the number of signals that are fitted together."""
    success = Axis("fits at the minimum", "1", limits=(-0.05, 1.05))
    time = Axis("time for each signal", "s", limits=(0.0, None))

    def panel(sweep: str, name: str, count: str, y: Axis) -> Panel:
        own = ds.isel(fit=np.flatnonzero(ds["fit_sweep"] == sweep))
        curves = [
            Curve(each[name].values, str(family), each["fit_setting"].values, look={"marker": "o"})
            for family in dict.fromkeys(own["fit_family"].values.tolist())
            for each in [own.isel(fit=np.flatnonzero(own["fit_family"] == family))]
        ]
        return Panel(curves, Axis(count, is_log=True), y)

    return panels(
        [
            panel("starts", "fit_converged", "starts", success),
            panel("starts", "fit_steady_call_s", "starts", time),
            panel("batch", "fit_steady_call_s", "signals in one call, one start each", time),
        ]
    )
