"""Recordings of a feature of a surface, simulated on finer cells than those that it is fitted on.

Every recording has its own noise and its own position of the feature, so that edges fall anywhere
within the cells; the noise is estimated from each fit's residual.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...errors import BadInput, refuse
from ...forward.scene import Scene
from ...forward.shape import Shape
from ...forward.surface import Ridge, StepDown, StepUp, Tape
from ...forward.surface_feature import (
    RidgeFeature,
    StepDownFeature,
    StepUpFeature,
    SurfaceFeature,
    TapeFeature,
)
from ...grid import as_real
from ...resolution import margin_m
from ..cells import Window, check_cells
from ..nonlinear import Solver
from .contact import MOVES, PLACE, cell_for
from .fit import FeatureFitter
from .model import FeatureModel
from .synthetic import STEP, FittedDraw, KnownFeature, SampledScan, SyntheticScan

FINER = 2.5  # times as many cells as the fit has, and in no simple ratio to them
MOVED_M = 0.5e-3  # largest shift of the feature from its nominal position
FEATURES: Mapping[type[Shape], type[SurfaceFeature]] = {
    Ridge: RidgeFeature,
    Tape: TapeFeature,
    StepUp: StepUpFeature,
    StepDown: StepDownFeature,
}


@dataclass(frozen=True)
class SceneShape:
    """A scene's only shape as a feature to be fitted, its true parameters and the friction."""

    name: str
    feature: SurfaceFeature
    truth: dict[str, float]
    nominal_pressure_Pa: float

    @classmethod
    def of(
        cls, scene: Scene, names: Sequence[str], features: Mapping[str, SurfaceFeature]
    ) -> "SceneShape":
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
                f"The scene has {len(shapes)} surfaces ({', '.join(names)}): coverage takes one "
                f"that can be fitted ({kinds}), such as scene=ridge."
            )
        others = [name for name, each in features.items() if type(each) is not kind]
        refuse(
            bool(others),
            f"feature names {', '.join(others)}, and what coverage fits to the scene of a surface "
            f"is the scene's own shape ({kind.__name__}): leave feature out.",
        )
        shape: Any = shapes[0]
        base = float(surface.surface.base_friction)
        feature = kind(float(shape.edge_length_m))
        truth = {part: float(getattr(shape, part)) for part in feature.axes}
        for part in feature.frictions:
            own = getattr(shape, part)
            truth[part] = base if own is None else float(own)
        truth["base_friction"] = base
        return cls(names[0], feature, truth, float(surface.nominal_pressure_Pa))


@dataclass(frozen=True)
class KnownShape(KnownFeature):
    """A feature of a surface, sampled in a window but for its margins. Its fits start by a search
    in the first recording, and of the place alone in the others."""

    feature: SurfaceFeature
    fitter: FeatureFitter
    nominal_pressure_Pa: float

    @classmethod
    def in_window(
        cls, shape: SceneShape, sampled: SampledScan, window: Window, solver: Solver
    ) -> "KnownShape":
        """Raises `BadInput` for a window with too many cells, and for scans as
        [`SampledScan.motion`][] does."""
        sensor, named = sampled.sensor, {shape.name: shape.feature}
        depth, pressure = float(sensor.depth_m), shape.nominal_pressure_Pa
        margin = margin_m("traction", depth)
        motion = sampled.motion(window.start_m + margin, window.length_m - 2 * margin)
        cell = cell_for(named, depth)
        check_cells("coverage.window_m", window.length_m, cell / FINER)
        fitter = FeatureFitter.on_window(sensor, motion, named, window, pressure, solver=solver)
        fine = FeatureModel.on_window(sensor, motion, window, cell / FINER, pressure)
        on = SyntheticScan(sensor, sampled.scan, motion, sampled.noises, fine.with_features(named))
        return cls(on, shape.name, shape.truth, shape.feature, fitter, pressure)

    def signal(self, truth: Mapping[str, float]) -> Float[np.ndarray, "e sample"]:
        own = {part: as_real(value) for part, value in truth.items() if part != "base_friction"}
        own["edge_length_m"] = as_real(self.feature.edge_m)
        common = {
            "nominal_pressure_Pa": as_real(self.nominal_pressure_Pa),
            "gain": as_real(1.0),
            "base_friction": as_real(truth["base_friction"]),
        }
        if self.on.fine.free_offset:
            common["offset"] = jnp.zeros(self.on.shape[0])
        return np.asarray(self.on.fine({self.name: own, **common}))

    @property
    def scales(self) -> dict[str, float]:
        """Edges move by whole cells: steps of what moves them go over some."""
        depth, cell = float(self.on.sensor.depth_m), float(self.on.fine.line.cell_m)

        def scale(part: str) -> float:
            if part == "height_m":
                return 10 * abs(self.truth[part])
            if part in MOVES:
                return 4 * cell / STEP
            return depth if part.endswith("_m") else 1.0

        return {part: scale(part) for part in self.truth}

    def fit_draws(self, key: jax.Array, draws: int) -> list[FittedDraw]:
        key, place = jax.random.split(key)
        moved = np.asarray(jax.random.uniform(place, (draws,), minval=-MOVED_M, maxval=MOVED_M))
        read, start = [], None
        for off, noise in zip(moved, self.on.noise(key, self.power, draws), strict=True):
            shifted = {**self.truth, PLACE: self.truth[PLACE] + float(off)}
            fitted = self.fitter(
                {self.name: self.feature}, self.signal(shifted) + noise, start=start
            )
            own = dict(fitted.parameters)
            start = start or {part: own[part][0] for part in self.feature.axes if part != PLACE}
            own[PLACE] = own[PLACE][0] - float(off), own[PLACE][1]
            read.append(FittedDraw(own, fitted.status == "converged"))
        return read
