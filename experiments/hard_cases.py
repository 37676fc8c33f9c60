"""Limits of the inversions: hard cases by every method, in both precisions."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import BadInput, choice, mapping, refuse
from srsinv.inverse.diagnostics import MOST_Z
from srsinv.inverse.estimate import COMPONENTS, relative_error, z_rms
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.method import Method
from srsinv.inverse.quality import Quality
from srsinv.inverse.simulated import noisy_problem
from srsinv.parts import merged
from srsinv.progress import stage, steps
from srsinv.report.data import dataset, scalars
from srsinv.report.plot.matrix import compact
from srsinv.report.result import Result
from srsinv.report.section import sections

PRECISIONS = ("float64", "float32")
MARKS = {
    Quality.GOOD: "",
    Quality.DOUBTFUL: "?",
    Quality.NO_BANDS: "±",
    Quality.FAILED: "!",
    "refused": "–",
}
REFUSED = {"error": [np.nan] * 2, "z_rms": [np.nan] * 2, "condition": np.nan, "quality": "refused"}
Answer = dict[str, Any]  # of one method to one case, by the variable's name


def run(cfg: config.Config) -> Result:
    """Every case by every method in every precision.

    Raises `BadInput` for an invalid precision, and for no case or method.
    """
    settings, methods = config.part(cfg, "hard_cases"), list(config.methods(cfg))
    cases = config.part(settings, "cases")
    refuse(not cases, "hard_cases.cases is empty: give a case by name, none: {label: nothing}.")
    precisions = [choice("hard_cases.precisions", p, PRECISIONS) for p in settings["precisions"]]
    refuse(not precisions, "hard_cases.precisions is []: give at least one.")
    answers: dict[str, list[list[Answer]]] = {}  # (precision, method) by the case's label
    with steps("hard cases", cases.items()) as each:
        for name, changes in each:
            hard = dict(mapping(f"hard_cases.cases.{name}", changes))
            label = str(hard.pop("label", name))
            refuse(
                label in answers,
                f"Two of hard_cases.cases have the label {label!r}: give them different labels.",
            )
            own, answers[label] = merged(cfg, hard), []
            with stage(f"hard case: {label}"):
                for precision in precisions:
                    with jax.enable_x64(precision == "float64"):
                        tried = config.methods(own).values()
                        try:
                            sim = config.simulation(own)
                            problem = noisy_problem(
                                sim, config.random_key(own), config.friction(own)
                            )
                        except BadInput as refused:
                            row = [REFUSED | {"reasons": str(refused)} for _ in tried]
                        else:
                            truth = np.asarray(sim.traction(sim.line))
                            row = [_answer(method, problem, truth) for method in tried]
                    answers[label].append(row)
    data = _dataset(answers, precisions, methods)
    failures = int(data["is_silent_failure"].sum())
    given = int((data["quality"] != "refused").sum())
    title = f"{failures or 'No'} silent failure{'s' * (failures > 1)} among {given} answers to "
    title += f"{len(answers)} hard cases by {len(methods)} methods"
    return Result(title, data, sections(__file__, marked=marked))


def _answer(method: Method, problem: LineProblem, truth: np.ndarray) -> Answer:
    """What the method gives, against the true traction; or why it refuses."""
    try:
        estimate = method(problem)
    except BadInput as refused:
        return REFUSED | {"reasons": str(refused)}
    value, cells = np.asarray(estimate.value), problem.observed_cells
    return {
        "error": relative_error(value, truth, cells),
        "z_rms": z_rms(value, np.asarray(estimate.stderr), truth, cells),
        "condition": estimate.stats["condition"],
        "quality": str(estimate.quality),
        "reasons": " ".join(estimate.reasons),
    }


def _dataset(
    answers: dict[str, list[list[Answer]]], precisions: Sequence[str], methods: Sequence[str]
) -> xarray.Dataset:
    cells = np.array(list(answers.values()), object).swapaxes(0, 1)  # (precision, case, method)
    of = {name: np.array([[[cell[name] for cell in row] for row in case] for case in cells])
          for name in (*REFUSED, "reasons")}  # fmt: skip
    along = ("precision", "case", "estimator", "component")
    silent = (of["quality"] == Quality.GOOD) & np.any(of["z_rms"] > MOST_Z, axis=-1)
    count = [(of["quality"] == code).sum(axis=(1, 2)) for code in MARKS]
    failures = silent.sum(axis=(1, 2))
    return dataset(
        {
            **{name: (along[: values.ndim], values, "1") for name, values in of.items()},
            "is_silent_failure": (along[:-1], silent, "1"),
            "count": (("code", "precision"), count, "1", "{code}_{precision}"),
            "silent_failures": ("precision", failures, "1", "silent_failures_{precision}"),
            **scalars({"cases": len(answers), "methods": len(methods)}),
        },
        {
            "precision": (precisions, "1"),
            "case": (list(answers), "1"),
            "estimator": (methods, "1"),
            "component": (list(COMPONENTS), "1"),
            "code": ([str(code) for code in MARKS], "1"),
        },
        largest_z=MOST_Z,
    )


def marked(ds: xarray.Dataset, name: str, *, factor: float = 1.0, **settings: Any) -> Figure:
    """The matrix of `factor` times a variable by case and method, with the mark of each quality."""
    text = np.vectorize(
        lambda value, code: ("" if np.isnan(value) else compact(value)) + MARKS[code],
        otypes=[object],
    )
    shown = ds.assign({name: ds[name].copy(data=factor * ds[name].values)})
    words = xarray.apply_ufunc(text, shown[name], ds["quality"])
    return plot.matrix(shown.assign(words=words), name, "words", panels="precision", **settings)
