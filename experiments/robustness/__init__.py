"""Faults of recordings, and what each inversion makes of them: a study that is kept.

A recording is a simulated scan of a strip of known pressure and friction, with one of the faults of
faults.yaml, inverted as a user would: the sensor as it is stated, the noise that of the recording.
"""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from srsinv import __version__, config
from srsinv.errors import BadInput, check_name, number, refuse, whole
from srsinv.inverse.estimate import coverage_90, relative_error
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.method import Method
from srsinv.inverse.problem import Problem
from srsinv.jobs.trials import Row, Trial, TrialRows, TrialTiming
from srsinv.modules import with_fields
from srsinv.recorded import problem_of, ready
from srsinv.report.result import Result
from srsinv.report.section import sections

from .answers import HINDSIGHT, answers, title
from .faults import faults, faulty, suits
from .figures import by_fault
from .hindsight import best_in_hindsight
from .scans import SCENES

TRACTION_SCENES = [name for name, scene in SCENES.items() if not scene.is_of_surface]
POINTLESS = ("dead",)  # what these do leaves no p and q apart: of the faults by name alone


class Recorded(NamedTuple):
    """A recording's problem, without its warnings, and on its cells; the true p and q (2, n) [Pa]
    there; the warnings."""

    problem: Problem
    on_cells: LineProblem
    truth: np.ndarray
    warnings: tuple[str, ...]


def run(cfg: config.Config) -> Result:
    """Every fault in every draw by every method, and by the best weights in hindsight.

    Raises `BadInput` for a fault that there is not, no draw, cells that are no length, and a file
    of rows that cannot be read or written.
    """
    settings = config.part(cfg, "robustness")
    chosen = _chosen(settings["faults"])
    wanted = "a whole number from 1 to 1000"
    draws = whole("robustness.draws", settings["draws"], wanted, least=1, most=1000)
    wanted = "a positive length in metres"
    cell_m = float(number("robustness.cell_m", settings["cell_m"], wanted, above=0))
    rests_on = {"version": __version__, "cell_m": cell_m}
    rests_on |= {key: cfg[key] for key in ("seed", "precision")}
    with config.precision(cfg):
        methods = config.methods(cfg)
        nodes = dict(zip(methods, config.part(cfg, "method").values(), strict=True))
        rows = TrialRows(
            TrialTiming(failures=(BadInput,)), settings["rows"], "robustness.rows", rests_on
        )
        trials = list(_trials(methods, nodes, chosen, draws, config.seed(cfg), cell_m))
        done = rows.of_all(trials, "recordings with a fault")
    data = answers(
        done, TRACTION_SCENES, chosen, list(methods), draws, cell_m=cell_m, seed=config.seed(cfg)
    )
    return Result(title(data), data, sections(__file__, by_fault=by_fault))


def _chosen(names: Any) -> list[str]:
    """The faults to be tried; null: all that leave p and q to be found."""
    scenes = [SCENES[name] for name in TRACTION_SCENES]
    possible = [
        name for name, each in faults().items() if any(suits(each, scene) for scene in scenes)
    ]
    if names is None:
        return [name for name in possible if faults()[name]["does"] not in POINTLESS]
    refuse(
        not isinstance(names, list | tuple) or not names,
        f"robustness.faults is {names!r}: give a list of faults, or null for all.",
    )
    for name in names:
        check_name("robustness.faults", name, possible)
    return list(dict.fromkeys(names))


def _trials(
    methods: Mapping[str, Method],
    nodes: Mapping[str, Any],
    chosen: list[str],
    draws: int,
    seed: int,
    cell_m: float,
) -> Iterator[Trial]:
    """Recording by recording: the best weights in hindsight, then every method."""
    held = lru_cache(1)(recorded)
    for scene in TRACTION_SCENES:
        for fault in chosen:
            strengths = faults()[fault]
            if not suits(strengths, SCENES[scene]):
                continue
            for draw in range(draws):
                own = scene, fault, seed + draw, cell_m
                at = {"scene": scene, "fault": fault, "draw": draw}
                yield Trial(
                    {**at, "method": HINDSIGHT},
                    lambda own=own: lambda: hindsight_of(held(*own)),
                    dict,
                    rests_on={"fault": strengths},
                )
                for name, method in methods.items():
                    yield Trial(
                        {**at, "method": name},
                        lambda own=own, method=method: lambda: answer_of(held(*own), method),
                        dict,
                        rests_on={"fault": strengths, "method": nodes[name]},
                    )


def recorded(scene: str, fault: str, seed: int, cell_m: float) -> Recorded:
    """A recording as a user states it; with one element the friction is known."""
    of = SCENES[scene]
    made = faulty(faults()[fault], of, seed)
    friction = of.friction if of.elements == 1 else None
    stated = problem_of(ready(made.recording), friction=friction, cell_m=cell_m)
    # A problem with warnings of its own would be compiled anew: they come back with the answer.
    bare = with_fields(stated, warnings=())
    on_cells = bare.to_grid()
    return Recorded(bare, on_cells, made.traction(on_cells.line), stated.warnings)


def hindsight_of(given: Recorded) -> Row:
    """Errors of p and q by the best weights."""
    return {"error": best_in_hindsight(given.on_cells, given.truth).tolist()}


def answer_of(given: Recorded, method: Method) -> Row:
    """Errors of p and q, what their 90 % bands cover, the quality and why it is not good."""
    estimate = method(given.problem).with_warnings(given.warnings)
    observed, value = given.on_cells.observed_cells, np.asarray(estimate.value)
    stderr = np.asarray(estimate.stderr)
    return {
        "error": relative_error(value, given.truth, observed).tolist(),
        "coverage": coverage_90(value, stderr, given.truth, observed).tolist(),
        "quality": str(estimate.quality),
        "reasons": " ".join(estimate.reasons),
    }
