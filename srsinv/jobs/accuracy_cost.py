"""Error against time: forward model, inversions and feature fit, with their peers beside them.

Every measurement is a row of a table: part, line, family and size, the error and the time. Peers
are the packages of a clone's `benchmarks` that do the same work; without these the rows are ours
alone.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import ModuleType
from typing import Any

import jax
import numpy as np
import xarray
from matplotlib.figure import Figure

from .. import config
from ..forward.simulation import Simulation
from ..grid import LINES
from ..inverse.method import Method
from ..namespaces import benchmark
from ..progress import stage
from ..report.plot.panels import Curve, Panel, PanelAxis, panels
from ..report.result import Result, dataset, key_of
from ..report.section import sections
from ..report.text import quantity
from . import _cost_fit as fitting
from ._cost_linear import (
    REFERENCE,
    Row,
    Simulated,
    forward_rows,
    inversion_rows,
    noisy_problems,
)
from ._cost_settings import TIGHT, CostSettings

WITHIN = (1e-2, 1e-6)  # relative distances from the exact solution at which the fastest is named
WITHIN_STDERR = (fitting.CONVERGED_WITHIN, 1e-3)  # of a fit from its minimum, in standard errors
MEASURES = ("error", "error_p", "error_q", "algebraic_error", "first_call_s", "steady_call_s")


def run(cfg: config.Config) -> Result:
    """Measure all parts.

    Raises `BadInput` for what cannot be measured, and refusals of the configuration's parts.
    """
    settings, peers = CostSettings.checked(cfg["accuracy_cost"]), benchmark("peers")

    def simulated(line: str, cells: int) -> Simulation:
        return config.simulation({**cfg, "grid": {**cfg["grid"], "line": line, "cells": cells}})

    with jax.enable_x64(True):
        methods, key, friction = config.methods(cfg), config.random_key(cfg), config.friction(cfg)
        rows = list(_linear_rows(simulated, settings, methods, key, friction, peers))
        fits = fitting.rows_of(
            settings.fit, settings.repeats, config.sensor(cfg), config.scan(cfg),
            config.seed(cfg), peers,
        )  # fmt: skip
    quickest = list(_fastest(rows, fits))
    data = _dataset(rows, fits, quickest).assign_attrs(
        _facts(settings, peers is not None),
        noise=", ".join(cfg["noise"]) or "no",
        seed=cfg["seed"],
        refinement=cfg["grid"]["refinement"],
    )
    return Result(_title(quickest), data, sections("accuracy_cost", fit_counts=fit_counts))


def _linear_rows(
    simulated: Simulated,
    settings: CostSettings,
    methods: Mapping[str, Method],
    key: jax.Array,
    friction: float | None,
    peers: ModuleType | None,
) -> Iterator[Row]:
    """Forward model and inversions."""
    for line in LINES:
        with stage(f"forward model, {line} line"):
            yield from forward_rows(
                simulated, settings.forward_cells, settings.repeats, line, peers
            )
    with stage("data and weights"):
        problems = noisy_problems(simulated, settings.inverse_cells, key, friction)
        smallest, _ = problems["periodic", min(settings.inverse_cells)]
        priors = {name.lower(): method.prior_fixed_on(smallest) for name, method in methods.items()}
    for (line, cells), (problem, truth) in problems.items():
        with stage(f"inversions, {line} line, {cells} cells"):
            yield from inversion_rows(
                settings.tolerances, settings.repeats, priors, line, problem, truth, peers
            )


def _dataset(rows: Sequence[Row], fits: Sequence[Row], quickest: Sequence[Row]) -> xarray.Dataset:
    """Three tables: forward model and inversions, fits, and the fastest of each part."""
    return dataset(
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
    )  # fmt: skip


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
    """The fastest of ours and the fastest of the peers."""
    ours, peer = (
        min(
            (row for row in rows if row["is_peer"] == is_peer),
            key=lambda row: row["steady_call_s"],
            default={"family": "none", "steady_call_s": np.nan},
        )
        for is_peer in (False, True)
    )
    return {
        "family": ours["family"],
        "steady_call_s": ours["steady_call_s"],
        "peer": peer["family"],
        "peer_steady_call_s": peer["steady_call_s"],
    }


def _title(quickest: Sequence[Row]) -> str:
    """The fastest inversions of the last method, as exact as asked for at most."""
    part = quickest[-len(WITHIN_STDERR) - 1]["part"]
    own = [row for row in quickest if (row["part"], row["within"]) == (part, WITHIN[-1])]
    ways = [
        f"{row['family']} on the {row['line']} line ({quantity(row['steady_call_s'], 's')})"
        for row in own
    ]
    within = f"{WITHIN[-1]:g}".replace("e-0", "e-")
    listed = ", ".join(ways).replace("e-0", "e-")
    return f"Fastest within {within} of exact on {own[0]['size']}: {listed}"


def _facts(settings: CostSettings, has_peers: bool) -> dict[str, Any]:
    return {
        "repeats": settings.repeats,
        "positions": min(settings.forward_cells),
        "reference_cells": REFERENCE * max(settings.forward_cells),
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
    success = PanelAxis("fits at the minimum", "1", limits=(-0.05, 1.05))
    alone, together = (
        PanelAxis(time, "s", limits=(0.0, None))
        for time in ("time for each signal", "time for each, together")
    )

    def panel(sweep: str, name: str, count: str, y: PanelAxis) -> Panel:
        own = ds.isel(fit=np.flatnonzero(ds["fit_sweep"] == sweep))
        curves = [
            Curve(each[name].values, str(family), each["fit_setting"].values, look={"marker": "o"})
            for family in dict.fromkeys(own["fit_family"].values.tolist())
            for each in [own.isel(fit=np.flatnonzero(own["fit_family"] == family))]
        ]
        counts = own["fit_setting"]
        ends = (0.95 * float(counts.min()), 1.05 * float(counts.max()))
        return Panel(curves, PanelAxis(count, is_log=True, limits=ends), y)

    return panels(
        [
            panel("starts", "fit_converged", "starts", success),
            panel("starts", "fit_steady_call_s", "starts", alone),
            panel("batch", "fit_steady_call_s", "signals in one call, one start each", together),
        ]
    )
