"""Limits of the inversions: hard cases by every method, in both precisions."""

from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import BadInput, choice, mapping, refuse
from srsinv.forward.simulation import Simulation
from srsinv.inverse.estimate import COMPONENTS, deviation
from srsinv.inverse.line_problem import LineProblem
from srsinv.inverse.method import Method
from srsinv.inverse.quality import Quality
from srsinv.inverse.simulated import noisy_problem
from srsinv.parts import merged
from srsinv.progress import stage
from srsinv.report.plot.matrix import compact
from srsinv.report.result import Result, dataset, scalars
from srsinv.report.section import sections

PRECISIONS = ("float64", "float32")
MARKS = {Quality.GOOD: "", Quality.DOUBTFUL: "?", Quality.FAILED: "!", "refused": "–"}
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


def run(cfg: config.Config) -> Result:
    """Every case by every method in every precision.

    Raises `BadInput` for an invalid precision, and for no case or method.
    """
    settings, methods = config.part(cfg, "hard_cases"), list(config.methods(cfg))
    cases = config.part(settings, "cases")
    refuse(not cases, "hard_cases.cases is empty: give a case by name, none: {label: nothing}.")
    precisions = [choice("hard_cases.precisions", p, PRECISIONS) for p in settings["precisions"]]
    rows: dict[str, list[list[Cell]]] = {}
    for name, changes in cases.items():
        hard = dict(mapping(f"hard_cases.cases.{name}", changes))
        label = str(hard.pop("label", name))
        refuse(label in rows, f"Two cases of hard_cases.cases are {label!r}: name them apart.")
        with stage(f"hard case: {label}"):
            own, rows[label] = merged(cfg, hard), []
            for precision in precisions:
                with jax.enable_x64(precision == "float64"):
                    cells = _row(
                        config.methods(own).values(),
                        lambda own=own: _problem_of(
                            config.simulation(own), config.random_key(own), config.friction(own)
                        ),
                    )
                rows[label].append(cells)
    data = _dataset(rows, precisions, methods)
    failures = int(data["is_silent_failure"].sum())
    answers = int((data["quality"] != "refused").sum())
    title = (
        f"{failures or 'No'} silent failure{'s' * (failures > 1)} among {answers} answers to "
        f"{len(rows)} hard cases by {len(methods)} methods"
    )
    return Result(title, data, sections(__file__, marked=marked))


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


def _dataset(
    rows: dict[str, list[list[Cell]]], precisions: Sequence[str], methods: Sequence[str]
) -> xarray.Dataset:
    """`rows`: cells (precision, method) by the case's label."""

    def each(get: Callable[[Cell], Any]) -> np.ndarray:
        """(precision, case, method, ...)."""
        cells = [[[get(cell) for cell in row] for row in case] for case in rows.values()]
        return np.swapaxes(np.array(cells), 0, 1)

    along = ("precision", "case", "method")
    quality, silent = each(lambda c: c.quality), each(lambda c: c.is_silent_failure)
    count = [(quality == code).sum(axis=(1, 2)) for code in MARKS]
    return dataset(
        {
            "error": ((*along, "component"), each(lambda c: c.error), "1"),
            "z_rms": ((*along, "component"), each(lambda c: c.z_rms), "1"),
            "condition": (along, each(lambda c: c.condition), "1"),
            "quality": (along, quality, "1"),
            "reasons": (along, each(lambda c: " ".join(c.reasons)), "1"),
            "is_silent_failure": (along, silent, "1"),
            "count": (("code", "precision"), count, "1", "{code}_{precision}"),
            "silent_failures": (
                "precision", silent.sum(axis=(1, 2)), "1", "silent_failures_{precision}",
            ),
            **scalars({"cases": len(rows), "methods": len(methods)}),
        },
        {
            "precision": (precisions, "1"),
            "case": (list(rows), "1"),
            "method": (methods, "1"),
            "component": (list(COMPONENTS), "1"),
            "code": ([str(code) for code in MARKS], "1"),
        },
        largest_z=LARGEST_Z,
    )  # fmt: skip


def marked(ds: xarray.Dataset, name: str, *, factor: float = 1.0, **settings: Any) -> Figure:
    """The matrix of `factor` times a variable by case and method, with the mark of each quality."""
    text = np.vectorize(
        lambda value, code: ("" if np.isnan(value) else compact(value)) + MARKS[code],
        otypes=[object],
    )
    shown = ds.assign({name: ds[name].copy(data=factor * ds[name].values)})
    words = xarray.apply_ufunc(text, shown[name], ds["quality"])
    return plot.matrix(shown.assign(words=words), name, "words", panels="precision", **settings)
