"""Conformal bands of a recording's inversion, from recordings of passes over known surfaces."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray

from .. import config
from ..errors import refuse
from ..forward.film import Film
from ..inverse.conformal import Conformal
from ..inverse.estimate import COMPONENTS
from ..inverse.line.problem import LineProblem
from ..inverse.method import Method
from ..inverse.problem import Problem
from ..progress import steps
from ..recording.known_passes import CalibrationPasses, KnownPass
from ..report.data import dataset, scalars
from ._recorded import check_invertible, on_cells

SAME_SPEED = 0.1  # relative difference of two mean speeds that count as one
SAME = 1e-6  # the same of facts of the sensor: it is rounding
CONFORMAL = "conformal"  # what a method's name has behind it
FACTS: Mapping[str, Callable[[Film], Any]] = {
    "depth_m": lambda film: film.depth_m,
    "angle_deg": lambda film: np.rad2deg(film.angle_rad),
    "strip_width_m": lambda film: film.width_m,
    "active_length_m": lambda film: film.length_m,
    "offset_m": lambda film: film.offset_m,
}


def with_conformal(
    cfg: config.Config, methods: Mapping[str, Method], problem: Problem, unit: str
) -> tuple[dict[str, Method], xarray.Dataset | None]:
    """The methods, each with its bands scaled by passes over known surfaces behind it, and what the
    page says of the passes; the methods alone where the configuration has no passes.

    Raises `BadInput` for p and q that are relative, for passes of another sensor, direction or
    speed, and for a known traction that does not cover its scan.
    """
    known = config.known_passes(cfg)
    if known is None:
        return dict(methods), None
    refuse(
        unit != "Pa",
        "traction_unit=relative has no unit, but the known tractions of bands=conformal are in Pa: "
        "give traction_unit=Pa, or bands=model.",
    )
    pairs = []
    with steps("passes over known surfaces", known.passes) as each:
        pairs.extend(_pair(cfg, own, problem) for own in each)
    every: dict[str, Method] = {}
    for name, method in methods.items():
        every[name] = method
        every[f"{name} {CONFORMAL}"] = Conformal.of_passes(
            method, pairs, confidence=known.confidence, share=known.share
        )
    return every, _dataset(known, every)


def _pair(cfg: config.Config, known: KnownPass, own: Problem) -> tuple[LineProblem, np.ndarray]:
    """The problem of a pass on cells, and its traction there."""
    recording = config.recording(config.of_file(cfg, known.path))
    check_invertible(recording, "Pa")
    problem = config.recorded_problem(cfg, recording)
    _check_alike(problem, own)
    gridded = on_cells(problem)
    x, half = np.asarray(gridded.line.x), float(gridded.line.cell_m) / 2
    scanned, (first, last) = x[gridded.observed_cells], known.position_m[[0, -1]]
    refuse(
        scanned[0] < first or scanned[-1] > last,
        f"{recording.name}: its known traction is from {first:.4g} to {last:.4g} m, but the scan "
        f"is from {scanned[0]:.4g} to {scanned[-1]:.4g} m: give p and q along the whole scan.",
    )
    return gridded, known.cell_means(np.append(x - half, x[-1] + half))


def _check_alike(one: Problem, own: Problem) -> None:
    """Refuse a pass that is not exchangeable with the recording to invert."""
    counts = [len(each.sensor.elements) for each in (one, own)]
    remedy = "give passes of the same sensor, with the same facts in their sidecars."
    refuse(
        counts[0] != counts[1],
        f"{one.name} has {counts[0]} element{'s' * (counts[0] > 1)}, and {own.name} has "
        f"{counts[1]}: {remedy}",
    )
    for n, films in enumerate(zip(one.sensor.elements, own.sensor.elements, strict=True), 1):
        for fact, of in FACTS.items():
            its, wanted = (float(of(film)) for film in films)
            refuse(
                abs(its - wanted) > SAME * max(abs(its), abs(wanted)),
                f"{one.name}: {fact} of element {n} is {its:.6g}, and that of {own.name} is "
                f"{wanted:.6g}: {remedy}",
            )
    refuse(
        one.motion.directions != own.motion.directions,
        f"{one.name} and {own.name} are not scanned in the same directions: give passes that are.",
    )
    speeds = [float(np.mean(np.abs(np.asarray(each.motion.speed_m_per_s)))) for each in (one, own)]
    refuse(
        abs(speeds[0] - speeds[1]) > SAME_SPEED * speeds[1],
        f"{one.name} has a mean speed of {speeds[0]:.4g} m/s, and {own.name} has {speeds[1]:.4g} "
        f"m/s: give passes whose speed differs by {100 * SAME_SPEED:.0f} % at most.",
    )


def _dataset(known: CalibrationPasses, methods: Mapping[str, Method]) -> xarray.Dataset:
    """The factors of each method, and the passes."""
    made = {name: each for name, each in methods.items() if isinstance(each, Conformal)}
    factors = [[float(each.factor_p), float(each.factor_q)] for each in made.values()]
    names = [name.removesuffix(f" {CONFORMAL}") for name in made]
    numbers = {
        "conformal_passes": len(known.passes),
        "conformal_confidence": known.confidence,
        "conformal_share": known.share,
    }
    return dataset(
        {"conformal_factor": (("calibrated", "component"), factors, "1"), **scalars(numbers)},
        {"calibrated": (names, "1"), "component": (list(COMPONENTS), "1")},
        passes=", ".join(each.path.name for each in known.passes),
    )
