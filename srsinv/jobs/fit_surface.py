"""Fit of features of a surface to a recording: its data, fitter and page sections."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float

from ..errors import mapping, number, refuse, shown
from ..forward.scan import Motion
from ..forward.sensor import Sensor
from ..forward.surface_feature import SurfaceFeature
from ..inverse.feature_result import FeatureFit
from ..inverse.sliding_noise import Levels
from ..inverse.surface_fit import SurfaceFitter
from ..inverse.surface_model import SurfaceFeatures, SurfaceModel, cell_for, checked_pressure
from ..recording import Recording
from ..report import figures
from ..report.outcome import Section
from . import build
from .recorded import check_cells, coloured_noises, contact_window, nominal_pressure


@dataclass(frozen=True)
class Measured:
    """A recording prepared for a fit: `y` and `noise` as [`nonlinear.fit`][] has them.

    `noise_rms` is the white noise per sample.
    """

    recording: Recording
    sensor: Sensor
    motion: Motion
    y: Float[np.ndarray, "e sample"]
    noise: Any
    noise_rms: float


@dataclass(frozen=True)
class Candidate:
    """Fitted features, with the noise assumed, and the time [s].

    `levels`: of the noise, where it is estimated from the residual.
    """

    fit: FeatureFit
    noise: Any
    levels: Levels | None
    time_s: float


def surface_fitter(
    cfg: build.Config, data: Measured, features: SurfaceFeatures, settings: Mapping[str, Any]
) -> Callable[[Any], Candidate]:
    """The fitter of features of a surface, with the sidecar's edges."""
    facts = data.recording.sidecar
    pressure = checked_pressure(nominal_pressure(data.recording))
    features = {name: _with_edge(name, each, facts) for name, each in features.items()}
    window = contact_window(facts, data.motion.position_m, float(data.sensor.depth_m))
    cell = cell_for(features, float(data.sensor.depth_m))
    check_cells(data.recording.name, window.length_m, cell)
    fitter = SurfaceFitter(
        data.sensor, data.motion, features, window, pressure,
        _names("fit.free", settings["free"]), build.solver(cfg),
    )  # fmt: skip
    start = _start(settings["start"], features)
    white_given = build.part(build.part(cfg, "noise"), "white").get("rms") is not None
    known = data.noise if white_given or coloured_noises(cfg) else None

    def one(chosen) -> Candidate:
        fitted = fitter({name: features[name] for name in chosen}, data.y, known, start)
        noise = known
        if fitted.levels is not None:
            position = np.asarray(data.motion.position_m)
            noise = fitted.levels.whitener(position, np.isfinite(data.y))
        return Candidate(fitted.fit, noise, fitted.levels, 0.0)

    return one


def _with_edge(name: str, feature: SurfaceFeature, facts: Mapping[str, Any]) -> SurfaceFeature:
    if feature.edge_length_m is not None:
        return feature
    known = build.part(facts, "feature").get("edge_length_m")
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


def _start(given: Any, features: SurfaceFeatures) -> dict[str, float]:
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


def ground(data: Measured, best: FeatureFit) -> tuple[tuple[str, str], ...]:
    """Page rows of the plate under the features."""
    model = best.model
    if not isinstance(model, SurfaceModel):
        return (("traction", "features over a uniform background, on an open line"),)
    line = model.line
    cells = f"{line.n} cells of {1e6 * float(line.cell_m):.3g} um"
    edges = ", ".join(f"{1e6 * f.edge_m:.3g} um" for f in model.features.values())
    return (
        ("surface", f"repeats with the contact window, {1e3 * float(line.cell_m * line.n):.4g} mm "
         f"in {cells}; beyond it the plate"),
        ("nominal pressure", f"{data.recording.sidecar.get('nominal_pressure_Pa'):.4g} Pa, the "
         "mean over the window"),
        ("edges", f"rise over {edges}" if edges else "none"),
    )  # fmt: skip
