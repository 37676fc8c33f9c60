"""Error against time: forward model, inversions and feature fit, with numpy and scipy beside them.

Every measurement is a row: part, line, family and cells, the error and the time. Functions are
compiled with their arrays as arguments, and return the traction or the signal alone. Two rows of a
part do more: the direct path forms the whole covariance, and the iterative one solves for the
averaging kernel too.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray

from .. import config
from ..errors import refuse
from ..forward.simulation import Simulation
from ..grid import LINES
from ..inverse import direct, iterative, spectral
from ..inverse.estimate import COMPONENTS
from ..inverse.line_problem import LineProblem
from ..inverse.prior import Prior
from ..progress import stage
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from . import accuracy_cost_fit as fitting
from . import peers
from .accuracy_cost_fit import FitSettings
from .analysis import deviation, timed
from .simulation import noisy_problem

REFERENCE = 8  # refinement of the forward reference over the finest cells tried
DIRECT_CELLS = 512  # beyond, the dense factors take longer than all the rest
TIGHT = 1e-12  # tolerance of the open line's reference solution
PRECISIONS = ("float64", "float32")
NUMPY, SCIPY = "numpy", "scipy cg"

Row = dict[str, Any]
Simulated = Callable[[str, int], Simulation]  # by the kind of line and the number of cells


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


def run(cfg: config.Config) -> Outcome:
    """The job: measure all parts, lay out the page."""
    settings = CostSettings.checked(cfg["accuracy_cost"])

    def simulated(line: str, cells: int) -> Simulation:
        return config.simulation({**cfg, "grid": {**cfg["grid"], "line": line, "cells": cells}})

    with jax.enable_x64(True):
        rows = []
        for line in LINES:
            with stage(f"forward model, {line} line"):
                rows += _forward(simulated, settings, line)
        with stage("data and weights"):
            key, friction = config.random_key(cfg), config.friction(cfg)
            problems = _problems(simulated, settings.inverse_cells, key, friction)
            smallest, _ = problems["periodic", min(settings.inverse_cells)]
            methods = config.methods(cfg).items()
            priors = {name.lower(): method.prior_fixed_on(smallest) for name, method in methods}
        for (line, cells), (problem, truth) in problems.items():
            with stage(f"inversions, {line} line, {cells} cells"):
                rows += _inversions(settings, priors, line, problem, truth)
        fits = fitting.rows_of(
            settings.fit, settings.repeats, config.sensor(cfg), config.scan(cfg), config.seed(cfg)
        )
    _against_peers(rows, "cells")
    _against_peers(fits, "setting")
    data = (
        f"{', '.join(cfg['noise'])} noise, seed {cfg['seed']}, from cells "
        f"{cfg['grid']['refinement']} times finer"
    )
    *parts, how = _sections(settings, data, rows)
    return Outcome(
        "Accuracy against cost: forward model, Wiener, Tikhonov and feature fit",
        _metrics(rows) | fitting.metrics(fits),
        _dataset(rows).merge(fitting.dataset(fits), combine_attrs="override"),
        (*parts, *fitting.sections(settings.fit, fits), how),
        _summary(rows, fits),
    )


def _against_peers(rows: list[Row], size: str) -> None:
    """Each row's time over that of its peer at the same size, None where there is no peer."""
    baselines = {(row["part"], row["line"], row["family"], row[size]): row for row in rows}
    for row in rows:
        peer = baselines.get((row["part"], row["line"], row["peer"], row[size]))
        row["against_peer"] = peer and row["steady_call_s"] / peer["steady_call_s"]


def _compiled(function: Callable, *arguments) -> tuple[Callable, float]:
    """`function` compiled for such arguments, and the time [s] that this took."""
    start = time.perf_counter()
    fresh = jax.jit(lambda *given: function(*given)).lower(*arguments).compile()
    return fresh, time.perf_counter() - start


def _relative(value, reference) -> float:
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))


# --- forward model ---------------------------------------------------------------------------


def _forward(simulated: Simulated, settings: CostSettings, line: str) -> Iterator[Row]:
    sizes = settings.forward_cells
    common = min(sizes)  # positions that every grid has

    def model(cells: int):
        sim = simulated(line, cells)
        return sim.sensor.operator(sim.line, sim.scan), sim.traction(sim.line)

    operator, traction = model(REFERENCE * max(sizes))
    reference = np.asarray(operator(traction))[:, :: REFERENCE * max(sizes) // common]

    def row(family: str, cells: int, work: Callable[[], Any], compile_s: float, exact) -> Row:
        value, first, steady = timed(work, settings.repeats)
        value = np.asarray(value, float)
        return {
            "part": "forward",
            "line": line,
            "family": family,
            "cells": cells,
            "value": value,
            "error": _relative(value[:, :: cells // common], reference),
            "algebraic_error": 0.0 if exact is None else _relative(value, exact),
            "first_call_s": compile_s + first,
            "steady_call_s": steady,
            "peer": NUMPY,
        }

    for cells in sizes:
        exact = None
        for precision in PRECISIONS:
            with jax.enable_x64(precision == "float64"):
                given = model(cells)
                work, compile_s = _compiled(lambda operator, r: operator(r), *given)
                yield (ours := row(precision, cells, partial(work, *given), compile_s, exact))
            exact = ours["value"] if exact is None else exact
        operator, traction = model(cells)
        transfer, r = np.asarray(operator.transfer), np.asarray(traction)

        work = partial(peers.numpy_apply, transfer, r, operator.n, operator.length)
        yield row(NUMPY, cells, work, 0.0, exact)


# --- inversions ------------------------------------------------------------------------------


Problems = dict[tuple[str, int], tuple[LineProblem, np.ndarray]]


def _problems(
    simulated: Simulated, sizes: Sequence[int], key: jax.Array, friction: float | None
) -> Problems:
    """The noisy problem and its true traction, by line and number of cells."""
    problems = {}
    for cells in sizes:
        for line in LINES:
            sim = simulated(line, cells)
            problem = noisy_problem(sim, key, friction)
            truth = np.asarray(sim.traction(sim.line))[: problem.unknowns]
            problems[line, cells] = problem, _without_mean(truth)
    return problems


def _without_mean(values) -> np.ndarray:
    """Deviation from the mean over all cells."""
    return deviation(np.asarray(values, float), np.ones(np.shape(values)[-1], bool))


class _Solver(NamedTuple):
    """One solver of a problem, the family to compare its time with, its compilation [s]."""

    family: str
    peer: str
    work: Callable[[], Any]
    compile_s: float = 0.0


def _inversions(
    settings: CostSettings,
    priors: Mapping[str, Callable[[LineProblem], Prior]],
    line: str,
    problem: LineProblem,
    truth: np.ndarray,
) -> Iterator[Row]:
    size = np.linalg.norm(truth, axis=1)
    size = np.where(size > 0, size, np.nan)
    for part, prior_of in priors.items():
        exact, solvers = _solvers(settings.tolerances, problem, prior_of(problem))
        for family, peer, work, compile_s in solvers:
            value, first, steady = timed(work, settings.repeats)
            value = _without_mean(value)
            errors = np.linalg.norm(value - truth, axis=1) / size
            yield {
                "part": part,
                "line": line,
                "family": family,
                "cells": problem.line.n,
                "error": _relative(value, truth),
                **{f"error_{c}": float(e) for c, e in zip(COMPONENTS, errors, strict=False)},
                "algebraic_error": _relative(value, exact),
                "first_call_s": compile_s + first,
                "steady_call_s": steady,
                "peer": peer,
            }


def _solvers(
    tolerances: Sequence[float], problem: LineProblem, prior: Prior
) -> tuple[np.ndarray, list[_Solver]]:
    """The exact minimiser, and the solvers to compare with it.

    Exact is the spectral solution; on the open line that of conjugate gradients to `TIGHT`.
    """
    given = problem, prior
    normal = peers.NumpyNormal(*given)
    iterate, iterate_s = _compiled(_iterative, *given, jnp.asarray(TIGHT))
    ways = []
    if problem.forward.is_circular:
        spectrally, compile_s = _compiled(_spectral, *given)
        exact = spectrally(*given)
        ways.append(_Solver("spectral, float64", NUMPY, partial(spectrally, *given), compile_s))
        with jax.enable_x64(False):
            single = _single(given)
            work, compile_s = _compiled(_spectral, *single)
        ways.append(_Solver("spectral, float32", NUMPY, partial(work, *single), compile_s))
        ways.append(_Solver(NUMPY, NUMPY, normal.solve))
        tolerances, direct_peer = [min(tolerances)], NUMPY  # the preconditioner is the solution
    else:
        exact = iterate(*given, jnp.asarray(TIGHT))
        direct_peer = f"{SCIPY}, {min(tolerances):g}"
    if problem.line.n <= DIRECT_CELLS:
        work, compile_s = _compiled(_direct, *given)
        ways.append(_Solver("direct", direct_peer, partial(work, *given), compile_s))
    for tolerance in tolerances:
        peer = f"{SCIPY}, {tolerance:g}"
        work = partial(iterate, *given, jnp.asarray(tolerance))
        ways.append(_Solver(f"iterative, {tolerance:g}", peer, work, iterate_s))
        ways.append(_Solver(peer, peer, partial(normal.conjugate_gradients, tolerance)))
    return _without_mean(exact), ways


def _single(tree):
    """Convert arrays to the working precision, float32."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), tree)


def _spectral(problem: LineProblem, prior: Prior):
    return spectral.solve(problem, prior).value


def _direct(problem: LineProblem, prior: Prior):
    return direct.solve(problem, prior, direct.whiten(problem)).value


def _iterative(problem: LineProblem, prior: Prior, tolerance):
    return iterative.solve(problem, prior, tolerance)[0].value


# --- the page --------------------------------------------------------------------------------

MEASURES = ("error", "error_p", "error_q", "algebraic_error", "first_call_s", "steady_call_s")


def _metrics(rows: list[Row]) -> dict[str, Any]:
    def key(row: Row) -> str:
        family = row["family"].replace(", ", "_").replace(" ", "_")
        return f"{row['part']}_{row['line']}_{family}_{row['cells']}"

    return {f"{key(row)}_{m}": row[m] for row in rows for m in MEASURES if m in row}


def _dataset(rows: list[Row]) -> xarray.Dataset:
    units = {m: "s" if m.startswith("time_s") else "1" for m in MEASURES}
    names = ("part", "line", "family")
    return xarray.Dataset(
        {m: ("case", [row.get(m, np.nan) for row in rows], {"units": units[m]}) for m in MEASURES}
        | {"size": ("case", [row["cells"] for row in rows], {"units": "1"})},
        {name: ("case", [row[name] for row in rows], {"units": "1"}) for name in names},
        {"title": "Accuracy against cost"},
    )


def _table(rows: list[Row]) -> Table:
    """Table of one part; forward rows have no separate p and q."""
    apart = [m for m in ("error_p", "error_q") if m in rows[0]] or ["error"]
    return Table(
        ("line", "family", "cells", *(m.replace("_", " of ") for m in apart), "algebraic error",
         "steady [ms]", "first call [ms]", "steady / peer's", "peer"),
        tuple(
            (
                row["line"], row["family"], row["cells"], *(row[m] for m in apart),
                row["algebraic_error"], 1e3 * row["steady_call_s"], 1e3 * row["first_call_s"],
                "-" if row["against_peer"] is None else round(row["against_peer"], 2), row["peer"],
            )
            for row in rows
        ),
    )  # fmt: skip


def _curves(rows: list[Row], measure: str, title: str) -> Callable:
    """The figure of `measure` against steady time; values that are zero by definition are left
    out."""
    shown = [
        {
            "family": row["family"],
            "label": "",
            "size": row["cells"],
            "error": row[measure],
            "time_s": row["steady_call_s"],
        }
        for row in rows
        if row[measure] > 0
    ]
    return lambda: figures.accuracy_cost(shown, title)


def _sections(settings: CostSettings, data: str, rows: list[Row]) -> tuple[Section, ...]:
    parts = dict.fromkeys(row["part"] for row in rows)
    return (
        *(_section(part, [r for r in rows if r["part"] == part]) for part in parts),
        Section(
            "What was measured and how", tables=(Table(("what", "how"), _how(settings, data)),)
        ),
    )


def _section(part: str, rows: list[Row]) -> Section:
    """One part: a figure and a caption for each line, all its rows as a table."""
    if part == "forward":
        name, measure, caption = "Forward model", "error", _forward_caption
        words = ("Voltage of every element from traction on the grid.",)
    else:
        name, measure, caption = part.capitalize(), "algebraic_error", _inversion_caption
        words = (
            "Noise and prior make the error against the truth, so that it hardly tells the ways "
            "of solving apart; the distance to the exact minimiser of the same problem does.",
        )
    lines = {line: [r for r in rows if r["line"] == line] for line in LINES}
    what = measure.replace("_", " ")
    return Section(
        name,
        words,
        {
            f"{part}_{line}": _curves(members, measure, f"{name}, {line} line: {what} and time")
            for line, members in lines.items()
        },
        {f"{part}_{line}": caption(members) for line, members in lines.items()},
        (_table(rows),),
    )


def _forward_caption(rows: list[Row]) -> str:
    members = {f: [r for r in rows if r["family"] == f] for f in (*PRECISIONS, NUMPY)}
    first, last = members["float64"][0], members["float64"][-1]
    return (
        f"From {first['cells']} to {last['cells']} cells the error of float64 falls "
        f"{first['error'] / last['error']:.3g}-fold (second order: "
        f"{(last['cells'] / first['cells']) ** 2:.3g}). There float32 has "
        f"{members['float32'][-1]['error'] / last['error']:.3g} times its error; float64 takes "
        f"{1e3 * last['steady_call_s']:.3g} ms, float32 "
        f"{1e3 * members['float32'][-1]['steady_call_s']:.3g} ms and numpy "
        f"{1e3 * members[NUMPY][-1]['steady_call_s']:.3g} ms."
    )


def _inversion_caption(rows: list[Row]) -> str:
    cells = max(row["cells"] for row in rows)
    largest = sorted((r for r in rows if r["cells"] == cells), key=lambda row: row["steady_call_s"])
    fast, slow = largest[0], largest[-1]
    errors = [row["error"] for row in largest]
    return (
        f"At {cells} cells the fastest is {fast['family']} ({1e3 * fast['steady_call_s']:.3g} ms), "
        f"the slowest {slow['family']} ({1e3 * slow['steady_call_s']:.3g} ms). Errors against the "
        f"truth lie between {min(errors):.4g} and {max(errors):.4g}. What is exact by definition "
        "is not drawn."
    )


def _how(settings: CostSettings, data: str) -> tuple[tuple[str, str], ...]:
    """Rows of the page; `data` says what the inversions' data come from."""
    return (
        ("steady time", f"the least of {settings.repeats} calls after the first, result waited "
         "for; arrays are arguments, so that nothing is computed beforehand"),
        ("first call", "with compilation, which both tolerances share (numpy and scipy have none)"),
        ("forward error", f"relative rms over {min(settings.forward_cells)} positions that all "
         f"grids have, against float64 on {REFERENCE * max(settings.forward_cells)} cells of "
         "the same line"),
        ("forward work", "FFT, product with the transfer, inverse FFT; the transfer is ready"),
        ("inversion's data", f"{data}; the same noise per sample at every size, so more cells are "
         "more data"),
        ("inversion's work", "p and q from the signal, no standard error; the direct way makes its "
         "covariance and the iterative one its averaging kernel all the same"),
        ("weights", "fixed: Wiener's spectra as configured, Tikhonov's by its rule on the "
         "smallest size of the periodic line"),
        ("error of p, q", "of the deviation from the mean, against the true cell averages"),
        ("algebraic error", "against float64's solution of the same problem: forward, ours in "
         f"float64; periodic, spectral; open, conjugate gradients to {TIGHT:g}"),
        ("peers", "numpy: one 2x2 system per wavenumber; scipy: cg on the same normal equations "
         "with the same preconditioner"),
    )  # fmt: skip


def _summary(rows: list[Row], fits: list[Row]) -> Table:
    largest = {part: max(r["cells"] for r in rows if r["part"] == part) for part in
               dict.fromkeys(row["part"] for row in rows)}  # fmt: skip
    swept = [row for row in fits if row["line"] == "tolerance"]
    least = min(row["setting"] for row in swept)
    tightest: list[Row] = [row | {"cells": "-"} for row in swept if row["setting"] == least]
    return Table(
        ("part", "line", "family", "cells", "error", "steady [ms]", "steady / peer's"),
        tuple(
            (
                row["part"], row["line"], row["family"], row["cells"], row["error"],
                1e3 * row["steady_call_s"],
                "-" if row["against_peer"] is None else round(row["against_peer"], 2),
            )
            for row in (*(r for r in rows if r["cells"] == largest[r["part"]]), *tightest)
        ),
        "At the largest size of each part, the fit at the tightest tolerance with its error in "
        "standard errors; the peer is numpy or scipy doing the same work.",
    )  # fmt: skip
