"""Limits of the inversions: hard cases by every method, in both precisions."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray
from srsinv.jobs.analysis import deviation
from srsinv.report.figures.matrix import matrices
from srsinv.report.outcome import Outcome, Section, Table

from srsinv import config
from srsinv.errors import BadInput, choice, mapping, refuse
from srsinv.forward.simulation import Simulation
from srsinv.inverse.estimate import COMPONENTS
from srsinv.inverse.line_problem import LineProblem
from srsinv.inverse.method import Method
from srsinv.inverse.quality import Quality
from srsinv.inverse.simulated import noisy_problem
from srsinv.parts import merged
from srsinv.progress import stage

PRECISIONS = ("float64", "float32")
CODES = (*Quality, "refused")
LARGEST_Z = 3.0  # standard errors: an rms error beyond, without a warning, is a failure


class Cell(NamedTuple):
    """One case by one method in one precision.

    - `error` (c,): of p and q, norm over that of the truth, means removed; `z_rms` (c,): the
      error's rms in standard errors. NaN where there is no answer, or no truth to compare with.
    - `quality`, `reasons`: the method's own; where it refused, "refused" and why.
    """

    error: np.ndarray
    z_rms: np.ndarray
    condition: float
    quality: str
    reasons: tuple[str, ...]

    @property
    def is_silent_failure(self) -> bool:
        """Whether an error beyond the band comes without a warning."""
        return self.quality == Quality.GOOD and bool(np.any(self.z_rms > LARGEST_Z))


def run(cfg: config.Config) -> Outcome:
    """Every case by every method in every precision.

    Raises `BadInput` for an invalid precision, and for no case or method.
    """
    settings, methods = config.part(cfg, "hard_cases"), list(config.methods(cfg))
    cases = config.part(settings, "cases")
    refuse(not cases, "hard_cases.cases is empty: give a case by name, none: {label: nothing}.")
    precisions = [choice("hard_cases.precisions", p, PRECISIONS) for p in settings["precisions"]]
    cells = {}
    for name, changes in cases.items():
        hard = dict(mapping(f"hard_cases.cases.{name}", changes))
        label = str(hard.pop("label", name))
        refuse(
            (label, precisions[0]) in cells,
            f"Two cases of hard_cases.cases are {label!r}: name them apart.",
        )
        with stage(f"hard case: {label}"):
            own = merged(cfg, hard)
            for precision in precisions:
                with jax.enable_x64(precision == "float64"):
                    cells[label, precision] = _row(
                        config.methods(own).values(),
                        lambda own=own: _problem_of(
                            config.simulation(own), config.random_key(own), config.friction(own)
                        ),
                    )
    labels = list(dict.fromkeys(label for label, _ in cells))
    by_precision = {p: [cells[label, p] for label in labels] for p in precisions}
    dataset = _dataset(by_precision, labels, methods)
    table = _table(by_precision, labels, methods)
    return Outcome(
        f"{len(labels)} hard cases through {len(methods)} methods",
        _metrics(by_precision, labels, methods),
        dataset,
        _sections(dataset, by_precision, labels, methods, table),
        table,
    )


def _problem_of(sim: Simulation, key, friction: float | None) -> tuple[LineProblem, np.ndarray]:
    """The problem with noise, and its true traction."""
    return noisy_problem(sim, key, friction), np.asarray(sim.traction(sim.line))


def _row(
    methods: Collection[Method], case: Callable[[], tuple[LineProblem, np.ndarray]]
) -> list[Cell]:
    """One case by every method; `case` gives its problem and its true traction, or refuses."""
    try:
        problem, truth = case()
    except BadInput as refused:
        return [_refused(str(refused)) for _ in methods]
    return [_cell(method, problem, truth) for method in methods]


def _refused(sentence: str) -> Cell:
    nothing = np.full(len(COMPONENTS), np.nan)
    return Cell(nothing, nothing, np.nan, "refused", (sentence,))


def _cell(method: Method, problem: LineProblem, truth: np.ndarray) -> Cell:
    try:
        estimate = method(problem)
    except BadInput as refused:
        return _refused(str(refused))
    observed = problem.observed_cells
    wanted = deviation(truth, observed)
    wrong = deviation(np.asarray(estimate.value), observed) - wanted
    size = np.linalg.norm(wanted, axis=-1)
    stderr = np.asarray(estimate.stderr, float)[:, observed]
    z_score = np.where(wrong == 0, 0.0, np.abs(wrong) / np.maximum(stderr, np.finfo(float).tiny))
    return Cell(
        np.linalg.norm(wrong, axis=-1) / np.where(size > 0, size, np.nan),
        np.sqrt(np.mean(z_score**2, axis=-1)),  # infinite where a wrong value has no error
        estimate.stats["condition"],
        str(estimate.quality),
        estimate.reasons,
    )


CellsByPrecision = Mapping[str, list[list[Cell]]]  # by precision: (case, method)


def _each(by_precision: CellsByPrecision, get) -> np.ndarray:
    """(precision, case, method, ...)."""
    return np.array(
        [[[get(cell) for cell in row] for row in rows] for rows in by_precision.values()]
    )


def _dataset(by_precision: CellsByPrecision, labels, methods) -> xarray.Dataset:
    along = ("precision", "case", "method")
    return xarray.Dataset(
        {
            "error": (
                (*along, "component"), _each(by_precision, lambda c: c.error), {"units": "1"},
            ),
            "z_rms": (
                (*along, "component"), _each(by_precision, lambda c: c.z_rms), {"units": "1"},
            ),
            "condition": (along, _each(by_precision, lambda c: c.condition), {"units": "1"}),
            "quality": (along, _each(by_precision, lambda c: c.quality), {"units": "1"}),
            "reasons": (along, _each(by_precision, lambda c: " ".join(c.reasons)), {"units": "1"}),
        },
        {
            "precision": ("precision", list(by_precision), {"units": "1"}),
            "case": ("case", labels, {"units": "1"}),
            "method": ("method", methods, {"units": "1"}),
            "component": ("component", list(COMPONENTS), {"units": "1"}),
        },
    )  # fmt: skip


def _metrics(by_precision: CellsByPrecision, labels, methods) -> dict[str, Any]:
    metrics: dict[str, Any] = {"cases": len(labels), "methods": len(methods)}
    for precision, rows in by_precision.items():
        cells = [cell for row in rows for cell in row]
        for code in CODES:
            metrics[f"{code}_{precision}"] = sum(cell.quality == code for cell in cells)
        metrics[f"silent_failures_{precision}"] = sum(cell.is_silent_failure for cell in cells)
    return metrics


def _table(by_precision: CellsByPrecision, labels, methods) -> Table:
    rows = []
    for precision, cases in by_precision.items():
        for m, method in enumerate(methods):
            cells = [row[m] for row in cases]
            worst_z = [float(np.nanmax(c.z_rms)) for c in cells if np.isfinite(c.z_rms).any()]
            counts = (sum(cell.quality == code for cell in cells) for code in CODES)
            wrong = sum(cell.is_silent_failure for cell in cells)
            rows.append((precision, method, *counts, wrong, max(worst_z, default=float("nan"))))
    heads = ("precision", "method", *CODES, "silent failures", "largest error over its band")
    return Table(
        heads,
        tuple(rows),
        f"Of {len(labels)} cases. Good: converged, and nothing speaks against it; doubtful: "
        "converged, with a warning on its bands; failed: not converged, or a residual that no band "
        "survives; refused: not tried. A silent failure is called good, and its error of p or q is "
        f"beyond {LARGEST_Z:g} standard errors rms.",
    )


def _sections(
    ds: xarray.Dataset, by_precision: CellsByPrecision, labels, methods, table
) -> tuple[Section, ...]:
    marks = dict(zip(CODES, ("", "?", "!", "-"), strict=True))
    codes = ds["quality"].values

    def panels(values, pattern) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Panels by precision."""
        return {
            precision: (
                values[i],
                np.array([
                    [_word(v, pattern) + marks[code] for v, code in zip(row, named, strict=True)]
                    for row, named in zip(values[i], codes[i], strict=True)
                ]),
            )
            for i, precision in enumerate(by_precision)
        }  # fmt: skip

    def error(component: str):
        values = 100 * ds["error"].sel(component=component).values
        shown = panels(values, "{:.2g}")
        return matrices(shown, labels, methods, f"error of {component} [%]", (1.0, 1e3))

    def z_rms():
        shown = panels(_worst(ds["z_rms"].values), "{:.2g}")
        label = "rms error of p or q, the larger, over its standard error"
        return matrices(shown, labels, methods, label, (0.1, 1e2))

    def condition():
        shown = panels(ds["condition"].values, "{:.0e}")
        return matrices(shown, labels, methods, "condition number", (1.0, 1e16))

    key = (
        "A question mark: doubtful; an exclamation mark: failed; a dash: refused. The reasons are "
        "in the last table."
    )
    return (
        Section(
            "Errors",
            ("Relative, of the deviation from the mean. A large error is no instability where the "
             "signal does not tell: the band then has to be as wide.",),
            {"error_p": lambda: error("p"), "error_q": lambda: error("q")},
            {"error_p": key, "error_q": key},
        ),
        Section(
            "Errors over their bands",
            ("About one or less is honest; much above one without a mark would be a silent "
             "failure.",),
            {"z_rms": z_rms},
            {"z_rms": key},
            (table,),
        ),
        Section(
            "Condition numbers",
            ("Of what each path solves: the stacked rows of model and prior at each wavenumber "
             "(spectral), the posterior precision, which squares them (direct), and about that of "
             "conjugate gradients (iterative).",),
            {"condition": condition},
            {"condition": key},
        ),
        Section("Words", (), tables=(_words(by_precision, labels, methods),)),
        Section(
            "What was assumed",
            ("The cases stand in the configuration, hard_cases.cases: each is what it changes of "
             "the scene in plain view, one draw of the noise.",),
        ),
    )  # fmt: skip


def _worst(values: np.ndarray) -> np.ndarray:
    """The larger of p's and q's, NaN where both are unknown."""
    return np.where(np.isnan(values).all(-1), np.nan, np.max(np.nan_to_num(values), axis=-1))


def _word(value: float, pattern: str) -> str:
    return "" if np.isnan(value) else pattern.format(value).replace("e+0", "e").replace("e+", "e")


def _words(by_precision: CellsByPrecision, labels, methods) -> Table:
    """The warnings and refusals, each sentence once for each case."""
    said: dict[tuple[str, str], list[str]] = {}
    for precision, rows in by_precision.items():
        for label, row in zip(labels, rows, strict=True):
            for method, cell in zip(methods, row, strict=True):
                for word in cell.reasons:
                    said.setdefault((label, word), []).append(f"{method} ({precision})")
    rows = [(label, ", ".join(by), word) for (label, word), by in said.items()]
    return Table(("case", "by", "in words"), tuple(rows))
