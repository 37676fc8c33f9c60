"""Design of a sensor by the gradient of the error that a task expects, beside a grid search."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from srsinv import config, parts
from srsinv.errors import choice, mapping, number, refuse, whole
from srsinv.forward.noise import exponential_spectrum, total_spectrum
from srsinv.forward.scan import ConstantSpeed
from srsinv.grid import Line, Periodic
from srsinv.inverse.detection import needed_known
from srsinv.progress import stage
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity, significant

from .figures import descents, profiles
from .geometry import DesignSpace, check_cells, parameters, with_elements
from .outcome import EQUAL, Study, design_dataset
from .search import Criterion, descend, search_grid, starts
from .tasks import Task, TractionError, direction_error, least_height

MOST_ELEMENTS = 8
MOST_DESIGNS = 1_000_000  # on a grid: minutes, and 100 MB
WORDS = {  # of a task: its error
    "error": "Error of {parts}",
    "least_height": "Least detectable ridge",
    "direction": "Standard error of the direction",
}


def run(cfg: config.Config) -> Result:
    """The best films for the task within the bounds, by gradient and by a grid, beside the given
    sensor.

    Raises `BadInput` for a line that is not periodic, noise that depends on the signal or is zero,
    and settings out of range.
    """
    given = cfg["design"]
    for key in ("error", "ridge", "strip"):
        mapping(f"design.{key}", given[key])
    name = choice("design.task", given["task"], list(WORDS))
    wanted = f"a whole number from 1 to {MOST_ELEMENTS}"
    count = whole("design.elements", given["elements"], wanted, least=1, most=MOST_ELEMENTS)
    begin = whole("design.starts", given["starts"], "a whole number from 1", least=1)
    wanted = f"a whole number from 1 to {MOST_DESIGNS}"
    most = whole("design.grid_designs", given["grid_designs"], wanted, least=1, most=MOST_DESIGNS)
    growth = number(
        "design.growth", given["growth"], "a fraction above 0, up to 1", above=0, most=1
    )
    free = parameters(given)
    single = config.precision_name(cfg) == "float32"
    refuse(single, "precision is float32, but gradients are exact to 1e-4 then: give float64.")
    with config.precision(cfg):
        line, scan, sensor = config.line(cfg), config.scan(cfg), config.sensor(cfg)
        noise = _noise(cfg, line, scan)
        task = _task(cfg, name, line)
        space = DesignSpace(with_elements(sensor, count), free)
        check_cells(space, float(line.cell_m), line.n * float(line.cell_m))
        with stage("differentiating the error"):
            criterion = Criterion.checked(space, task, line, scan, noise)
        points = starts(criterion.base, begin, config.seed(cfg))
        with stage(f"descending from {begin} starts"):
            descent = descend(criterion, points)
        with stage("searching a grid"):
            grid = search_grid(criterion, most)
        with stage("computing tolerances"):
            study = Study.of(criterion, sensor, descent, grid, float(growth))
            data = design_dataset(study, **_by_contact(cfg, name, line, study))
    facts = {
        "task": name, "seed": cfg["seed"], "speed_m_per_s": float(scan.speed_m_per_s),
        "length_m": line.n * float(line.cell_m), "noise": ", ".join(cfg["noise"]),
        "effects_on": listed(cfg["effects"]), "skin": sensor.skin.words,
        "words": WORDS[name].format(parts=_parts(given)), "growth": growth, **_facts(given, name),
    }  # fmt: skip
    shown = sections(__file__, profiles=profiles, descents=descents)
    return Result(_title(study, facts["words"]), data.assign_attrs(facts), shown)


def _parts(given: Mapping[str, Any]) -> str:
    return "p and q" if given["error"]["friction"] is None else "p"


def _noise(cfg: config.Config, line: Line, scan: ConstantSpeed) -> Any:
    """The noise's power over the wavenumbers, which may not follow from a signal."""
    refuse(not isinstance(line, Periodic), "grid.line is open: give grid.line=periodic.")
    scan.require_onwards()
    noises = config.noises(cfg)
    power, louder = (np.asarray(total_spectrum(noises, line, scan, rms)) for rms in (1.0, 2.0))
    refuse(
        not np.array_equal(power, louder) or not power.min() > 0,
        "The noise is zero or in proportion to the signal, but a design needs one of its own "
        "level: give noise=[johnson] or noise=[white].",
    )
    return jnp.asarray(power)


def _task(cfg: config.Config, name: str, line: Line) -> Task:
    given = cfg["design"]
    if name == "least_height":
        return least_height(*_ridge(cfg, line))
    if name == "direction":
        return direction_error(line, parts.scene(given["strip"], cfg["skin"]))
    settings, friction = given["error"], given["error"]["friction"]
    wanted = {"rms_p_Pa": "pressure in Pa", "rms_q_Pa": "shear in Pa", "correlation_m": "length"}
    rms_p, rms_q, correlation = (
        number(f"design.error.{key}", settings[key], f"a positive {words}", above=0)
        for key, words in wanted.items()
    )
    shape = exponential_spectrum(line.k, line.cell_m, correlation)
    if friction is None:
        return TractionError(jnp.stack([rms_p**2 * shape, rms_q**2 * shape]), None, line.n)
    mu = number("design.error.friction", friction, "a number, of either sign, or null")
    return TractionError(jnp.asarray(rms_p**2 * shape)[None], jnp.asarray(float(mu)), line.n)


def _ridge(cfg: config.Config, line: Line) -> tuple[Any, ...]:
    given, fine = cfg["design"], config.line(cfg, cfg["grid"]["refinement"])
    needed = needed_known(given["false_alarm"], given["detection"])
    return line, fine, parts.scene(given["ridge"], cfg["skin"]), needed


def _by_contact(cfg: config.Config, name: str, line: Line, study: Study) -> dict[str, float]:
    """The least height of the given sensor and of the optimum by the traction per height of a ridge
    of that height, beside which the skin may lift off."""
    if name != "least_height":
        return {}
    by_contact = {}
    for which, height in (("given", study.given), ("optimum", study.optimum)):
        task = least_height(*_ridge(cfg, line), height_m=height)
        by_contact[f"least_height_contact_{which}_m"] = study.with_task(task, which)
    return by_contact


def _facts(given: Mapping[str, Any], name: str) -> dict[str, Any]:
    """What the page says of the task."""
    if name == "error":
        return {key: value for key, value in given["error"].items() if value is not None}
    if name == "least_height":
        return {key: given[key] for key in ("false_alarm", "detection")}
    return {}


def _title(study: Study, words: str) -> str:
    """The finding: both errors, their ratio, and what the grid says."""
    task = study.criterion.task
    best, given = (
        f"{significant(100 * each, 3)} %" if task.units == "1" else quantity(each, task.units)
        for each in (study.optimum, study.given)
    )
    factor = study.given / study.optimum
    better = "nothing better" if study.gain_of_grid < EQUAL else "a better design"
    return (
        f"{words}: {best} by the optimum, {given} by the given sensor, a factor of "
        f"{significant(factor, 3)}; the grid finds {better}"
    )
