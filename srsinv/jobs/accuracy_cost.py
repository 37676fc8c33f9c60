"""Error against time: the forward model and both inversions, with numpy and scipy beside them.

Every measurement is a row: what was run (part, line, family, cells), how wrong it is and how long
it took. Functions are compiled with their arrays as arguments, and give back the traction or the
signal alone, so that all rows of a part did the same work.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.linalg as sla
import xarray

from ..errors import refuse
from ..inverse import direct, iterative, spectral
from ..inverse.prior import Prior
from ..inverse.problem import COMPONENTS, Problem
from ..inverse.tikhonov import DerivativePenalty, Penalties, Tikhonov
from ..inverse.wiener import SpectralPrior
from ..progress import stage
from ..report import figures
from ..report.outcome import Outcome, Section, Table
from . import build
from .analysis import deviation, timed
from .simulate import Simulation, noisy_problem, simulation

REFERENCE = 8  # the forward reference's cells are so many times finer than the finest tried
DIRECT_CELLS = 512  # beyond, the dense factors take longer than all the rest
TIGHT = 1e-12  # tolerance of the open line's reference solution
PRECISIONS = ("float64", "float32")
NUMPY, SCIPY = "numpy", "scipy cg"

Row = dict[str, Any]


def run(cfg: build.Config) -> Outcome:
    """The job: measure everything, lay it out."""
    _check(cfg["accuracy_cost"])
    with build.precision({"precision": "float64"}):
        rows = []
        for line in build.LINES:
            with stage(f"forward model, {line} line"):
                rows += _forward(cfg, line)
        priors = _priors(cfg)
        for cells in cfg["accuracy_cost"]["inverse_cells"]:
            with stage(f"inversions, {cells} cells"):
                rows += _inversions(cfg, priors, cells)
    baselines = {(row["part"], row["line"], row["family"], row["cells"]): row for row in rows}
    for row in rows:
        peer = baselines.get((row["part"], row["line"], row["peer"], row["cells"]))
        row["against_peer"] = peer and row["time_s_steady"] / peer["time_s_steady"]
    return Outcome(
        "Accuracy against cost: forward model, Wiener and Tikhonov",
        _metrics(rows),
        _dataset(rows),
        _sections(cfg, rows),
        _summary(rows),
    )


def _check(settings: dict[str, Any]) -> None:
    for name in ("forward_cells", "inverse_cells"):
        cells = settings[name]
        refuse(
            not cells or any(not isinstance(n, int) or n < 8 or n % cells[0] for n in cells),
            f"accuracy_cost.{name} is {cells}: give whole numbers from 8, each a multiple of the "
            "first.",
        )
    refuse(
        not (isinstance(settings["repeats"], int) and settings["repeats"] >= 1),
        f"accuracy_cost.repeats is {settings['repeats']}: give a whole number from 1.",
    )
    refuse(
        any(not TIGHT < tolerance < 1 for tolerance in settings["tolerances"]),
        f"accuracy_cost.tolerances is {settings['tolerances']}: give numbers between {TIGHT:g} "
        "and 1.",
    )


def _simulation(cfg: build.Config, line: str, cells: int) -> Simulation:
    return simulation({**cfg, "grid": {**cfg["grid"], "line": line, "cells": cells}})


def _compiled(function: Callable, *arguments) -> Callable[[], Any]:
    """A call of `function`, compiled at its first use whatever was compiled before."""
    fresh = jax.jit(lambda *given: function(*given))
    return lambda: fresh(*arguments)


def _relative(value, reference) -> float:
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))


# --- forward model ---------------------------------------------------------------------------


def _forward(cfg: build.Config, line: str) -> Iterator[Row]:
    sizes = cfg["accuracy_cost"]["forward_cells"]
    common = min(sizes)  # positions that every grid has

    def model(cells: int):
        sim = _simulation(cfg, line, cells)
        return sim.line.operator(sim.sensor.signal(sim.scan)), sim.traction(sim.line)

    operator, traction = model(REFERENCE * max(sizes))
    reference = np.asarray(operator(traction))[:, :: REFERENCE * max(sizes) // common]

    def row(family: str, cells: int, work: Callable[[], Any], exact: np.ndarray | None) -> Row:
        value, first, steady = timed(work, cfg["accuracy_cost"]["repeats"])
        value = np.asarray(value, float)
        return {
            "part": "forward",
            "line": line,
            "family": family,
            "cells": cells,
            "value": value,
            "error": _relative(value[:, :: cells // common], reference),
            "algebraic_error": 0.0 if exact is None else _relative(value, exact),
            "time_s_first": first,
            "time_s_steady": steady,
            "peer": NUMPY,
        }

    for cells in sizes:
        exact = None
        for precision in PRECISIONS:
            with build.precision({"precision": precision}):
                work = _compiled(lambda operator, r: operator(r), *model(cells))
                yield (ours := row(precision, cells, work, exact))
            exact = ours["value"] if exact is None else exact
        operator, traction = model(cells)
        transfer, r = np.asarray(operator.transfer), np.asarray(traction)

        def apply(transfer=transfer, r=r, n=operator.n, length=operator.length):
            return _numpy_apply(transfer, r, n, length)

        yield row(NUMPY, cells, apply, exact)


def _numpy_apply(transfer: np.ndarray, r: np.ndarray, n: int, length: int) -> np.ndarray:
    spectrum = np.fft.rfft(r, length)
    total = sum(transfer[:, c] * spectrum[c] for c in range(len(spectrum)))
    return np.fft.irfft(total, length)[:, :n]


# --- inversions ------------------------------------------------------------------------------


def _problem(cfg: build.Config, line: str, cells: int) -> tuple[Problem, np.ndarray]:
    """The noisy problem and its true traction."""
    sim = _simulation(cfg, line, cells)
    key = jax.random.key(cfg["seed"])
    problem = noisy_problem(sim, build.noises(cfg), key, cfg["friction"])
    return problem, np.asarray(sim.traction(sim.line))[: problem.unknowns]


def _priors(cfg: build.Config) -> dict[str, Callable[[Problem], Prior]]:
    """For each method its prior: Tikhonov's weights are chosen once, at the middle size."""
    sizes = cfg["accuracy_cost"]["inverse_cells"]
    middle, _ = _problem(cfg, "periodic", sorted(sizes)[len(sizes) // 2])

    def fixed(name: str, method) -> Callable[[Problem], Prior]:
        if isinstance(method, Tikhonov):
            with stage(f"weights of {name}"):
                stats = method(middle).stats
            weights = [stats[f"weight_{c}_per_Pa2"] for c in COMPONENTS[: middle.unknowns]]
            prior = Penalties(method.length_m, method.order)(jnp.log10(jnp.asarray(weights)))
            return lambda problem: prior
        spectra = (method.p, method.q)[: middle.unknowns]
        return lambda problem: SpectralPrior(jnp.stack([s.power(problem) for s in spectra]))

    return {name.lower(): fixed(name, method) for name, method in build.methods(cfg).items()}


def _inversions(cfg: build.Config, priors, cells: int) -> Iterator[Row]:
    for line in build.LINES:
        problem, truth = _problem(cfg, line, cells)
        there = np.ones(cells, bool)
        truth = deviation(truth, there)
        for part, prior_of in priors.items():
            prior = prior_of(problem)
            exact = None
            for family, peer, work in _solvers(cfg["accuracy_cost"], problem, prior):
                repeats = cfg["accuracy_cost"]["repeats"]
                value, first, steady = timed(work, repeats)
                value = deviation(np.asarray(value, float), there)
                exact = _exact(problem, prior) if exact is None else exact
                size = np.linalg.norm(truth, axis=1)
                errors = np.linalg.norm(value - truth, axis=1) / np.where(size > 0, size, np.nan)
                yield {
                    "part": part,
                    "line": line,
                    "family": family,
                    "cells": cells,
                    "error": _relative(value, truth),
                    **{f"error_{c}": float(e) for c, e in zip(COMPONENTS, errors, strict=False)},
                    "algebraic_error": _relative(value, exact),
                    "time_s_first": first,
                    "time_s_steady": steady,
                    "peer": peer,
                }


def _exact(problem: Problem, prior: Prior) -> np.ndarray:
    """The spectral solution; on the open line that of conjugate gradients to `TIGHT`."""
    if problem.forward.is_circular:
        value = spectral.solve(problem, prior).value
    else:
        value = iterative.solve(problem, prior, jnp.asarray(TIGHT))[0].value
    return deviation(np.asarray(value), np.ones(problem.line.n, bool))


def _solvers(settings, problem: Problem, prior: Prior) -> Iterator[tuple[str, str, Callable]]:
    """(family, the family to compare its time with, work) for one problem."""
    circular = problem.forward.is_circular
    peer = NUMPY
    if circular:
        yield "spectral, float64", peer, _compiled(_spectral, problem, prior)
        with build.precision({"precision": "float32"}):
            yield "spectral, float32", peer, _compiled(_spectral, *_single((problem, prior)))
        yield NUMPY, peer, _NumpyNormal(problem, prior).solve
    else:
        peer = f"{SCIPY}, {min(settings['tolerances']):g}"
    if problem.line.n <= DIRECT_CELLS:
        yield "direct", peer, _compiled(_direct, problem, prior)
    for tolerance in settings["tolerances"]:
        peer = f"{SCIPY}, {tolerance:g}"
        work = _compiled(_iterative, problem, prior, jnp.asarray(tolerance))
        yield f"iterative, {tolerance:g}", peer, work
        normal = _NumpyNormal(problem, prior)
        yield peer, peer, lambda normal=normal, tol=tolerance: normal.conjugate_gradients(tol)


def _single(tree):
    """The same arrays in the working precision, float32."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), tree)


def _spectral(problem: Problem, prior: Prior):
    return spectral.solve(problem, prior).value


def _direct(problem: Problem, prior: Prior):
    return direct.solve(problem, prior, direct.whiten(problem))[0].value


def _iterative(problem: Problem, prior: Prior, tolerance):
    return iterative.solve(problem, prior, tolerance)[0].value


class _NumpyNormal:
    """The normal equations (G^T N^-1 G + P) r = G^T N^-1 m, by numpy and scipy alone."""

    def __init__(self, problem: Problem, prior: Prior):
        self.n, self.length = problem.line.n, problem.forward.length
        self.transfer = np.asarray(problem.forward.transfer)
        self.circulant = np.asarray(problem.forward.circulant().transfer)
        self.data, self.weight = np.asarray(problem.data), np.asarray(problem.whitener) ** 2
        self.root2 = np.asarray(prior.root(problem.line)) ** 2
        self.centred = np.asarray(problem.centred)
        self.order, self.scale = 0, None
        if isinstance(prior, DerivativePenalty) and not problem.forward.is_circular:
            self.order = prior.order
            stretch = float(prior.length_m / problem.line.cell_m) ** (2 * prior.order)
            self.scale = stretch * np.asarray(prior.weights)[:, None]

    def _matrices(self) -> np.ndarray:
        """G^H N^-1 G + P at every wavenumber of the nearest periodic problem (k, c, c)."""
        g = np.moveaxis(self.circulant, -1, 0)
        matrix = g.conj().swapaxes(1, 2) @ (self.weight[:, None, None] * g)
        matrix += self.root2.T[:, :, None] * np.eye(self.root2.shape[0])
        # Where nothing tells the mean its row is empty: any diagonal makes it solvable.
        empty = np.abs(np.diagonal(matrix[0])) == 0
        matrix[0] += np.diag(np.where(empty | self.centred, np.abs(matrix[1]).max(), 0.0))
        return matrix

    def _centre(self, r: np.ndarray) -> np.ndarray:
        return r - np.where(self.centred[:, None], r.mean(axis=-1, keepdims=True), 0.0)

    def _right_side(self, y: np.ndarray) -> np.ndarray:
        weighed = np.fft.irfft(self.weight * np.fft.rfft(y), self.n)
        transpose = self.transfer.conj().swapaxes(0, 1)
        return self._centre(_numpy_apply(transpose, weighed, self.n, self.length))

    def _penalty(self, r: np.ndarray) -> np.ndarray:
        if self.scale is None:
            return np.fft.irfft(self.root2 * np.fft.rfft(r), self.n)
        padded = np.pad(np.diff(r, self.order), ((0, 0), (self.order, self.order)))
        return (-1) ** self.order * self.scale * np.diff(padded, self.order)

    def solve(self) -> np.ndarray:
        """On a periodic line: one small system for each wavenumber."""
        spectrum = self.weight * np.fft.rfft(self.data)
        right = np.einsum("eck,ek->kc", self.transfer.conj(), spectrum)
        value = np.linalg.solve(self._matrices(), right[..., None])[..., 0].T
        return self._centre(np.fft.irfft(value, self.n))

    def conjugate_gradients(self, tolerance: float) -> np.ndarray:
        """On any line, with the nearest periodic problem as preconditioner."""
        shape, size = (self.root2.shape[0], self.n), self.root2.shape[0] * self.n
        inverse = np.linalg.inv(self._matrices())

        def normal(flat: np.ndarray) -> np.ndarray:
            r = self._centre(flat.reshape(shape))
            signal = _numpy_apply(self.transfer, r, self.n, self.length)
            return (self._right_side(signal) + self._centre(self._penalty(r))).ravel()

        def precondition(flat: np.ndarray) -> np.ndarray:
            spectrum = np.fft.rfft(flat.reshape(shape))
            step = np.einsum("kij,jk->ik", inverse, spectrum)
            return self._centre(np.fft.irfft(step, self.n)).ravel()

        value, _ = sla.cg(
            sla.LinearOperator((size, size), normal),
            self._right_side(self.data).ravel(),
            rtol=tolerance,
            M=sla.LinearOperator((size, size), precondition),
        )
        return value.reshape(shape)


# --- what is shown ---------------------------------------------------------------------------

MEASURES = ("error", "error_p", "error_q", "algebraic_error", "time_s_first", "time_s_steady")


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
    """Rows of one part; forward rows know no p and q apart."""
    apart = [m for m in ("error_p", "error_q") if m in rows[0]] or ["error"]
    return Table(
        ("line", "family", "cells", *(m.replace("_", " of ") for m in apart), "algebraic error",
         "steady [ms]", "first call [ms]", "steady / peer's", "peer"),
        tuple(
            (
                row["line"], row["family"], row["cells"], *(row[m] for m in apart),
                row["algebraic_error"], 1e3 * row["time_s_steady"], 1e3 * row["time_s_first"],
                "-" if row["against_peer"] is None else round(row["against_peer"], 2), row["peer"],
            )
            for row in rows
        ),
    )  # fmt: skip


def _curves(rows: list[Row], measure: str, title: str) -> Callable:
    """The figure of `measure` against steady time; what is zero by definition is left out."""
    shown = [
        {
            "family": f"{row['line']}: {row['family']}",
            "label": "",
            "size": row["cells"],
            "error": row[measure],
            "time_s": row["time_s_steady"],
        }
        for row in sorted(rows, key=lambda row: row["line"] == "open")
        if row[measure] > 0
    ]
    return lambda: figures.accuracy_cost(shown, title)


def _sections(cfg: build.Config, rows: list[Row]) -> tuple[Section, ...]:
    parts = {part: [r for r in rows if r["part"] == part] for part in dict.fromkeys(
        row["part"] for row in rows)}  # fmt: skip
    forward = parts.pop("forward")
    return (
        Section(
            "Forward model",
            ("Voltage of every element from traction on the grid. The error falls with the square "
             "of the cell, until float32's round-off stops it; float64 goes on.",),
            {"forward": _curves(forward, "error", "Forward model: error against time")},
            tables=(_table(forward),),
        ),
        *(_inversion_section(part, members) for part, members in parts.items()),
        Section("What was measured and how", tables=(Table(("what", "how"), _how(cfg)),)),
    )  # fmt: skip


def _inversion_section(part: str, rows: list[Row]) -> Section:
    name = part.capitalize()
    return Section(
        name,
        ("Against the truth all ways of solving are as good: noise and prior make the error.",
         "What way and tolerance cost shows against the exact minimiser of the same problem. On "
         "the periodic line the preconditioner is the solution, and the tolerance has no say."),
        {
            f"{part}_truth": _curves(rows, "error", f"{name}: error against the truth"),
            f"{part}_algebra": _curves(rows, "algebraic_error", f"{name}: algebraic error"),
        },
        tables=(_table(rows),),
    )  # fmt: skip


def _how(cfg: build.Config) -> tuple[tuple[str, str], ...]:
    settings = cfg["accuracy_cost"]
    return (
        ("steady time", f"the least of {settings['repeats']} calls after the first, result waited "
         "for; arrays are arguments, so that nothing is computed beforehand"),
        ("first call", "with compilation (numpy and scipy: with their own set-up)"),
        ("forward error", f"relative rms over {min(settings['forward_cells'])} positions that all "
         f"grids have, against float64 on {REFERENCE * max(settings['forward_cells'])} cells of "
         "the same line"),
        ("forward work", "FFT, product with the transfer, inverse FFT; the transfer is ready"),
        ("inversion's data", f"{', '.join(cfg['noise'])} noise, seed {cfg['seed']}, from cells "
         f"{cfg['grid']['refinement']} times finer; the same noise per sample at every size, so "
         "more cells are more data"),
        ("inversion's work", "p and q from the signal, no standard error; the direct way makes its "
         "covariance all the same"),
        ("weights", "fixed: Wiener's spectra as configured, Tikhonov's by its rule on the middle "
         "size of the periodic line"),
        ("error of p, q", "of the deviation from the mean, against the true cell averages"),
        ("algebraic error", "against float64's solution of the same problem: forward, ours in "
         f"float64; periodic, spectral; open, conjugate gradients to {TIGHT:g}"),
        ("peers", "numpy: one 2x2 system per wavenumber; scipy: cg on the same normal equations "
         "with the same preconditioner"),
    )  # fmt: skip


def _summary(rows: list[Row]) -> Table:
    largest = {part: max(r["cells"] for r in rows if r["part"] == part) for part in
               dict.fromkeys(row["part"] for row in rows)}  # fmt: skip
    return Table(
        ("part", "line", "family", "cells", "error", "steady [ms]", "steady / peer's"),
        tuple(
            (
                row["part"], row["line"], row["family"], row["cells"], row["error"],
                1e3 * row["time_s_steady"],
                "-" if row["against_peer"] is None else round(row["against_peer"], 2),
            )
            for row in rows
            if row["cells"] == largest[row["part"]]
        ),
        "At the largest size of each part; the peer is numpy or scipy doing the same work.",
    )  # fmt: skip
