"""Coverage of the fit of a surface's feature: recordings simulated on finer cells, each fitted.

Every recording has its own noise and its own position of the feature, so that edges fall anywhere
within the cells; the noise is estimated from each fit's residual.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import BadInput, is_number, refuse, shown
from ..forward.scene import Scene
from ..forward.surface import Ridge, Shape, StepDown, StepUp, Tape
from ..forward.surface_feature import (
    RidgeFeature,
    StepDownFeature,
    StepUpFeature,
    SurfaceFeature,
    TapeFeature,
)
from ..grid import as_real
from ..inverse.cells import Window, check_cells
from ..inverse.features.contact import MOVES, PLACE, cell_for
from ..inverse.features.fit import FeatureFitter
from ..inverse.features.model import FeatureModel
from ..inverse.nonlinear import Solver
from ..progress import stage
from ..resolution import margin_m
from .judged import STEP, FitStatistics, Quantity, bounds_of, ratio_dB
from .simulated_features import SampledScan, SyntheticScan

FINER = 2.5  # times as many cells as the fit has, and in no simple ratio to them
MOVED_M = 0.5e-3  # largest shift of the feature from its nominal position
FEATURES: Mapping[type[Shape], type[SurfaceFeature]] = {
    Ridge: RidgeFeature,
    Tape: TapeFeature,
    StepUp: StepUpFeature,
    StepDown: StepDownFeature,
}


@dataclass(frozen=True)
class SyntheticSurfaceScan(SyntheticScan):
    """A synthetic scan of one feature of a surface, on fine cells; `fit_cells` are the fit's."""

    name: str
    model: FeatureModel
    rest: Mapping[str, Any]
    edge_length_m: float
    fit_cells: int
    known: ClassVar[str] = "estimated by the fit"
    start: ClassVar[str] = "by search in the first recording, of the place alone in the others"

    @property
    def cells(self) -> str:
        return f"{self.model.line.n} cells in the window, where the fit has {self.fit_cells}"

    def signal(self, truth: Mapping[str, float]) -> np.ndarray:
        """The noise-free signal (element, sample) of the feature's parameters and the friction."""
        own = {part: as_real(value) for part, value in truth.items() if part != "base_friction"}
        own["edge_length_m"] = as_real(self.edge_length_m)
        base = as_real(truth["base_friction"])
        return np.asarray(self.model(dict(self.rest) | {self.name: own, "base_friction": base}))


@dataclass(frozen=True)
class KnownShape:
    """A scene's only shape as a feature to be fitted, its true parameters and the friction."""

    name: str
    feature: SurfaceFeature
    truth: dict[str, float]
    nominal_pressure_Pa: float


def known_shape(
    scene: Scene, names: Sequence[str], features: Mapping[str, SurfaceFeature]
) -> KnownShape:
    """That of a scene, whose surfaces have these names.

    Raises `BadInput` for another number than one, a shape that no feature fits, and features of
    another shape.
    """
    surface = scene.contact_scene
    shapes: tuple[Any, ...] = surface.surface.shapes if surface else ()
    kind = FEATURES.get(type(shapes[0])) if len(shapes) == 1 else None
    if surface is None or kind is None:
        kinds = ", ".join(kind.__name__ for kind in FEATURES)
        raise BadInput(
            f"The scene has {len(shapes)} surfaces ({', '.join(names)}): coverage takes one that "
            f"can be fitted ({kinds}), such as scene=ridge."
        )
    others = [name for name, each in features.items() if type(each) is not kind]
    refuse(
        bool(others),
        f"feature names {', '.join(others)}, and what coverage fits to the scene of a surface is "
        f"the scene's own shape ({kind.__name__}): leave feature out.",
    )
    shape: Any = shapes[0]
    base = float(surface.surface.base_friction)
    feature = kind(float(shape.edge_length_m))
    truth = {part: float(getattr(shape, part)) for part in feature.axes}
    for part in feature.frictions:
        own = getattr(shape, part)
        truth[part] = base if own is None else float(own)
    truth["base_friction"] = base
    return KnownShape(names[0], feature, truth, float(surface.nominal_pressure_Pa))


def window_given(given: Any) -> Window:
    """What `coverage.window_m` gives. Raises `BadInput` for anything but [start, end]."""
    pair = isinstance(given, list | tuple) and len(given) == 2 and all(map(is_number, given))
    refuse(
        not pair or not given[0] < given[1],
        f"coverage.window_m is {shown(given)}: give [start, end] in metres.",
    )
    return Window(float(given[0]), float(given[1]))


def statistics_of_shape(
    shape: KnownShape, sampled: SampledScan, window: Window, solver: Solver, key, draws: int
) -> tuple[SyntheticSurfaceScan, dict[str, FitStatistics]]:
    """Statistics of the shape fitted to `draws` recordings."""
    on, fitter = _scan_and_fitter(shape, sampled, window, solver)
    name, truth, clean = shape.name, shape.truth, on.signal(shape.truth)
    rms = float(np.sqrt(np.mean(clean**2)))
    power = on.power(rms)
    key, place = jax.random.split(key)
    moved = np.asarray(jax.random.uniform(place, (draws,), minval=-MOVED_M, maxval=MOVED_M))
    noise = on.noise(key, power, draws)
    read, converged, start = [], 0, None
    with stage(f"fitting {draws} recordings of {name}"):
        for off, added in zip(moved, noise, strict=True):
            shifted = {**truth, "position_m": truth["position_m"] + float(off)}
            fitted = fitter({name: shape.feature}, on.signal(shifted) + added, start=start)
            own = dict(fitted.parameters)
            start = start or {part: own[part][0] for part in shape.feature.axes if part != PLACE}
            own["position_m"] = own["position_m"][0] - float(off), own["position_m"][1]
            read.append(own)
            converged += fitted.status == "converged"
    depth, cell = float(on.sensor.depth_m), float(on.model.line.cell_m)
    sizes = {part: _size(part, truth, depth, cell) for part in truth}
    bounds = bounds_of(on, on.signal, truth, sizes, power)
    quantities = tuple(
        Quantity(
            name, part, float(truth[part]), bound,
            np.array([each[part][0] for each in read]),
            np.array([each[part][1] for each in read]),
        )
        for part, bound in bounds.items()
    )  # fmt: skip
    ratio = ratio_dB(rms, power, on.shape[1])
    return on, {name: FitStatistics(quantities, converged, ratio)}


def _scan_and_fitter(
    shape: KnownShape, sampled: SampledScan, window: Window, solver: Solver
) -> tuple[SyntheticSurfaceScan, FeatureFitter]:
    """The scan of the window but for its margins, on cells that are finer than the fit's."""
    sensor, named, pressure = sampled.sensor, {shape.name: shape.feature}, shape.nominal_pressure_Pa
    depth = float(sensor.depth_m)
    margin = margin_m("traction", depth)
    motion = sampled.motion(window.start_m + margin, window.length_m - 2 * margin)
    cell = cell_for(named, depth)
    check_cells("coverage.window_m", window.length_m, cell / FINER)
    fitter = FeatureFitter.on_window(sensor, motion, named, window, pressure, solver=solver)
    fine = FeatureModel.on_window(sensor, motion, window, cell / FINER, pressure)
    fine = fine.with_features(named)
    rest = {"nominal_pressure_Pa": as_real(pressure), "gain": as_real(1.0)}
    if sensor.amplifier.offset is None:
        rest["offset"] = jnp.zeros(len(sensor.elements))
    on = SyntheticSurfaceScan(
        sensor, sampled.scan, motion, sampled.noises,
        shape.name, fine, rest, shape.feature.edge_m, fitter.model.line.n,
    )  # fmt: skip
    return on, fitter


def _size(part: str, truth: Mapping[str, float], depth: float, cell: float) -> float:
    """Scale of the step of the bound's differences; edges move by whole cells."""
    if part == "height_m":
        return 10 * abs(truth[part])
    if part in MOVES:
        return 4 * cell / STEP
    return depth if part.endswith("_m") else 1.0
