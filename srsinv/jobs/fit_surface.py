"""Fit of features of a surface to a recording: its method and page sections."""

from collections.abc import Mapping
from typing import Any

import xarray

from ..errors import mapping, number, refuse, shown
from ..forward.surface_feature import SurfaceFeature
from ..inverse.cells import check_cells
from ..inverse.features.contact import cell_for, checked_pressure
from ..inverse.features.estimate import FeatureEstimate
from ..inverse.features.loading import Features
from ..inverse.features.method import FeatureFit
from ..inverse.nonlinear import Solver
from ..inverse.problem import Problem
from ..report import figures
from ..report.outcome import Section
from .recorded import RecordedProblem


def surface_fit(
    recorded: RecordedProblem,
    features: Features,
    solver: Solver,
    settings: Mapping[str, Any],
) -> FeatureFit:
    """The fit of features of a surface, with the sidecar's edges. Raises `BadInput` where what it
    needs to know of the recording is missing, and for settings that it does not take."""
    problem, facts = recorded.problem, recorded.recording.sidecar
    checked_pressure(problem.nominal_pressure_Pa)
    features = {name: _with_edge(name, each, facts) for name, each in features.items()}
    cell = cell_for(features, float(problem.sensor.depth_m))
    check_cells(problem.name, problem.window.length_m, cell)
    free = _names("fit.free", settings["free"])
    return FeatureFit(features, solver, free, _start(settings["start"], features))


def _with_edge(name: str, feature: SurfaceFeature, facts: Mapping[str, Any]) -> SurfaceFeature:
    if feature.edge_length_m is not None:
        return feature
    known = (facts.get("feature") or {}).get("edge_length_m")
    refuse(
        known is None,
        f"The length over which the edges of {name} rise is not known, and the data cannot tell it "
        f"from the width: give feature.{name}.edge_length_m, or feature.edge_length_m in the "
        "sidecar.",
    )
    return feature.with_edge(known)


def _names(key: str, given: Any) -> tuple[str, ...]:
    listed = [] if given is None else [given] if isinstance(given, str) else given
    right = isinstance(listed, list | tuple) and all(isinstance(each, str) for each in listed)
    refuse(not right, f"{key} is {shown(given)}: give a list of parameters' names.")
    return tuple(listed)


def _start(given: Any, features: Features) -> dict[str, float]:
    """Values to start from, by the names that results have."""
    start = {} if given is None else dict(mapping("fit.start", given))
    several = len(features) > 1
    own = [f"{n}_{a}" if several else a for n, f in features.items() for a in f.axes]
    for name, value in start.items():
        refuse(
            name not in own,
            f"fit.start names {name!r}, which is not searched for: name any of {', '.join(own)}.",
        )
        number(f"fit.start.{name}", value, "a number, in SI units, or leave it out")
    return start


def contact_section(ds: xarray.Dataset) -> tuple[Section, ...]:
    """Page section of the contact with a fitted surface."""
    if "gap" not in ds:
        return ()
    return (
        Section(
            "Contact",
            ("The fitted surface, and the skin pressed onto it: pressure and shear follow from the "
             "height by contact of the skin, taken as a half space, and by the friction.",),
            {"contact": lambda: figures.contact(ds)},
            {"contact": "Heights are positive into the finger. Where the skin lies on the surface "
             "it is pressed; beside an edge it may lift off."},
        ),
    )  # fmt: skip


def ground(problem: Problem, best: FeatureEstimate) -> tuple[tuple[str, str], ...]:
    """Page rows of the plate under the features of a surface; else of the background."""
    if "height" not in best.model.loading.PROFILES:
        return (("traction", "features over a uniform background, on an open line"),)
    line = best.model.line
    cells = f"{line.n} cells of {1e6 * float(line.cell_m):.3g} um"
    edges = ", ".join(f"{1e6 * feature.edge_m:.3g} um" for feature in best.features.values())
    return (
        ("surface", f"repeats with the contact window, {1e3 * float(line.cell_m * line.n):.4g} mm "
         f"in {cells}; beyond it the plate"),
        ("nominal pressure", f"{problem.nominal_pressure_Pa:.4g} Pa, the mean over the window"),
        ("edges", f"rise over {edges}" if edges else "none"),
    )  # fmt: skip
