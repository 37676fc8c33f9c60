"""Scans of known features, simulated on finer cells than those that they are fitted on.

The Cramer-Rao bound of a parameter is the least standard deviation of any unbiased estimate: with
J the derivative of the noise-free signal y and S the noise's covariance, the root of the diagonal
of (J^T S^-1 J)^-1 (Kay, Fundamentals of Statistical Signal Processing, 1993, ch. 3).

Every scan over a feature of a surface has its own noise and its own position of the feature, so
that edges fall anywhere within the cells; the noise is estimated from each fit's residual.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...errors import BadInput, refuse
from ...forward.feature import Feature
from ...forward.noise import Noise, total_spectrum
from ...forward.noise import draw as draw_noise
from ...forward.scan import ConstantSpeed, Motion
from ...forward.scene import Scene
from ...forward.sensor import Sensor
from ...forward.shape import Shape
from ...forward.surface import Cylinder, Ridge, StepDown, StepUp, Tape
from ...forward.surface_feature import (
    CylinderFeature,
    RidgeFeature,
    StepDownFeature,
    StepUpFeature,
    SurfaceFeature,
    TapeFeature,
)
from ...grid import Line, Periodic, as_real, half_spectrum_weights
from ...numerics import is_flat
from ...resolution import cell_m, margin_m
from ..gridding.cells import Window, check_cells
from ..nonlinear import Solver, Spectrum
from .contact import MOVES, PLACE, cell_for
from .cylinder import contact_of
from .fit import FeatureFitter
from .model import FeatureModel

STEP = 1e-3  # of a parameter's scale: for the bound's differences


@dataclass(frozen=True)
class SampledScan:
    """A sensor that slides at constant speed and is read `rate_hz` times a second, with noise.

    `job`: the group of the configuration that gives the rate.
    """

    job: str
    rate_hz: float
    sensor: Sensor
    scan: ConstantSpeed
    noises: tuple[Noise, ...]

    def motion(self, start_m: float, length_m: float) -> Motion:
        """The motion over a stretch of x.

        Raises `BadInput` for a speed of 0, less than two samples in a depth, and a stretch of less
        than four depths.
        """
        speed, depth = float(self.scan.speed_m_per_s), float(self.sensor.depth_m)
        refuse(
            speed == 0,
            "scan.speed_m_per_s is 0: a static touch scans no feature, give another value.",
        )
        step = abs(speed) / self.rate_hz
        refuse(
            not 2 * step <= depth <= length_m / 4,
            f"The scan of {length_m:.4g} m has samples {step:.4g} m apart: give "
            f"{self.job}.sample_rate_hz with two samples per film depth of {depth:.4g} m, "
            "and a scan of at least four depths.",
        )
        time = np.arange(int(length_m / step) + 1) / self.rate_hz
        return Motion.from_speed(time, speed, start_m + (length_m if speed < 0 else 0.0))


@dataclass(frozen=True)
class SyntheticScan:
    """A sensor along a constant scan of samples evenly in time, its noise, and the `fine` model of
    its signal."""

    sensor: Sensor
    scan: ConstantSpeed
    motion: Motion
    noises: tuple[Noise, ...]
    fine: FeatureModel

    @classmethod
    def along(cls, line: Line, sampled: SampledScan) -> "SyntheticScan":
        """Of features of traction, from one end of a line to the other."""
        motion = sampled.motion(float(line.start_m), line.n * float(line.cell_m))
        cell = cell_m("simulated_load", float(sampled.sensor.depth_m))
        fine = FeatureModel.along(sampled.sensor, motion, cell)
        return cls(sampled.sensor, sampled.scan, motion, sampled.noises, fine)

    @property
    def shape(self) -> tuple[int, int]:
        """(element, sample)."""
        return len(self.sensor.elements), int(self.motion.time_s.size)

    def power(self, signal: Float[np.ndarray, "e sample"]) -> Float[np.ndarray, " k"]:
        """The noise's power per sample, given the noise-free signal."""
        rms = jnp.asarray(float(np.sqrt(np.mean(signal**2))))
        spacing = jnp.abs(self.motion.position_m[1] - self.motion.position_m[0])
        line = Periodic(self.shape[1], spacing)
        power = np.asarray(total_spectrum(self.noises, line, self.scan, rms))
        refuse(
            not bool(np.all(power > 0)),
            "There is no noise to weight the fit by: give a noise above 0, such as noise=[snr].",
        )
        return power

    def noise(self, key, power: np.ndarray, draws: int) -> Float[np.ndarray, "draw e sample"]:
        """Independent draws of the noise."""
        keys = jax.random.split(key, draws)
        drawn = jax.vmap(lambda each: draw_noise(each, jnp.asarray(power), *self.shape))(keys)
        return np.asarray(drawn)

    def signal(
        self, name: str, feature: Feature, given: Mapping[str, float]
    ) -> Float[np.ndarray, "e sample"]:
        """The noise-free signal of one feature of traction of this shape, amplitude and
        friction."""
        own = {part: given[part] for part in (*feature.axes, feature.amplitude)}
        if feature.friction is None:
            own[feature.shear] = given["friction"] * given[feature.amplitude]
        offset = {"offset": jnp.zeros(self.shape[0])} if self.fine.free_offset else {}
        return np.asarray(self.fine.with_features({name: feature})({name: own} | offset))


class FittedDraw(NamedTuple):
    """(value, standard error) of each parameter in SI units, and whether the fit converged."""

    parameters: Mapping[str, tuple[float, float]]
    is_converged: bool


@dataclass(frozen=True)
class KnownFeature(abc.ABC):
    """A feature of known parameters in a synthetic scan, which can be fitted to draws of its
    recording."""

    on: SyntheticScan
    name: str
    truth: Mapping[str, float]

    @abc.abstractmethod
    def signal(self, truth: Mapping[str, float]) -> Float[np.ndarray, "e sample"]:
        """The noise-free signal of any parameters."""

    @property
    @abc.abstractmethod
    def scales(self) -> dict[str, float]:
        """The scale of each parameter that is fitted, in its SI unit."""

    @abc.abstractmethod
    def fit_draws(self, key: jax.Array, draws: int) -> Sequence[FittedDraw]:
        """The fits of `draws` recordings."""

    @cached_property
    def power(self) -> Float[np.ndarray, " k"]:
        """The noise's power per sample."""
        return self.on.power(self.signal(self.truth))

    @property
    def snr_dB(self) -> float:
        """The signal-to-noise ratio, of rms values."""
        rms = float(np.sqrt(np.mean(self.signal(self.truth) ** 2)))
        noise = np.sqrt(half_spectrum_weights(self.on.shape[1]) @ self.power)
        return float(20 * np.log10(rms / noise))

    def bounds(self) -> dict[str, float]:
        """The Cramer-Rao bound of each parameter that is fitted, in its SI unit.

        From central differences of the simulation at the truth, apart from the fit, its cells and
        its derivatives.
        """
        elements, samples = self.on.shape
        columns = [self._whitened_slope(part, size) for part, size in self.scales.items()]
        if self.on.fine.free_offset:
            columns += list(np.repeat(np.eye(elements), samples, axis=1) / np.sqrt(self.power[0]))
        jacobian = np.array(columns)
        length = np.linalg.norm(jacobian, axis=1)
        covariance = np.linalg.inv(jacobian @ jacobian.T / np.outer(length, length))
        least = np.sqrt(np.diagonal(covariance)) / length
        return {part: float(each) for part, each in zip(self.scales, least, strict=False)}

    def _whitened_slope(self, part: str, size: float) -> np.ndarray:
        step, at = STEP * size, self.truth[part]
        above, below = (self.signal({**self.truth, part: at + s * step}) for s in (1, -1))
        change = np.fft.rfft((above - below) / (2 * step))
        return np.fft.irfft(change / np.sqrt(self.power), self.on.shape[1]).ravel()


@dataclass(frozen=True)
class KnownLoad(KnownFeature):
    """A feature of traction. The noise's spectrum is known to its fits, which all start where the
    search puts the feature in the first recording."""

    feature: Feature
    fitter: FeatureFitter

    def signal(self, truth: Mapping[str, float]) -> Float[np.ndarray, "e sample"]:
        return self.on.signal(self.name, self.feature, truth)

    @property
    def scales(self) -> dict[str, float]:
        known = {"friction"} if self.feature.friction is not None else set()
        amplitude, depth = self.feature.amplitude, float(self.on.sensor.depth_m)
        return {
            part: abs(value) if part == amplitude else depth if part.endswith("_m") else 1.0
            for part, value in self.truth.items()
            if part not in known
        }

    def fit_draws(self, key: jax.Array, draws: int) -> list[FittedDraw]:
        ys = self.signal(self.truth) + self.on.noise(key, self.power, draws)
        model, fits = self.fitter.many(self.name, self.feature, ys, known_noise(self.power))
        return [
            FittedDraw(model.loading.report(model.features, each), each.converged) for each in fits
        ]


def known_noise(power: Float[np.ndarray, " k"]) -> Any:
    """The noise as the fit takes it: one standard deviation where it is white."""
    return float(np.sqrt(power[0])) if is_flat(power) else Spectrum(power)


FINER = 2.5  # times as many cells as the fit has, and in no simple ratio to them
MOVED_M = 0.5e-3  # largest shift of the feature from its nominal position
FEATURES: Mapping[type[Shape], type[SurfaceFeature]] = {
    Cylinder: CylinderFeature,
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
        cls,
        scene: Scene,
        names: Sequence[str],
        features: Mapping[str, SurfaceFeature],
        angle_deg: float | None = None,
    ) -> "SceneShape":
        """That of a scene, whose surfaces have these names.

        `angle_deg`: of a cylinder, where it is to be fitted; None: it is known to be 0. Raises
        `BadInput` for another number than one, a shape that no feature fits, and features of
        another shape.
        """
        surface = scene.contact_scene
        shapes: tuple[Any, ...] = surface.surface.shapes if surface else ()
        kind = FEATURES.get(type(shapes[0])) if len(shapes) == 1 else None
        if surface is None or kind is None:
            kinds = ", ".join(kind.__name__ for kind in FEATURES)
            raise BadInput(
                f"The scene has {len(shapes)} surfaces ({', '.join(names)}): give exactly one "
                f"of {kinds}, such as scene=ridge."
            )
        others = [name for name, each in features.items() if type(each) is not kind]
        refuse(
            bool(others),
            f"feature names {', '.join(others)}, but coverage on a surface fits the "
            f"scene's own shape ({kind.__name__}): leave feature out.",
        )
        shape: Any = shapes[0]
        base = float(surface.surface.base_friction)
        if kind is CylinderFeature:
            feature = CylinderFeature(0.0 if angle_deg is None else None)
        else:
            wanted = "coverage.angle_deg is of a cylinder: leave it out, or give scene=cylinder."
            refuse(angle_deg is not None, wanted)
            feature = kind(float(shape.edge_length_m))
        angle = {} if angle_deg is None else {"angle_rad": float(np.radians(angle_deg))}
        truth = angle | {
            part: float(getattr(shape, part)) for part in feature.reported if part not in angle
        }
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
        contact = contact_of(named)
        fine = FeatureModel.on_window(
            sensor, motion, window, cell / FINER, pressure, contact=contact
        )
        on = SyntheticScan(sensor, sampled.scan, motion, sampled.noises, fine.with_features(named))
        return cls(on, shape.name, shape.truth, shape.feature, fitter, pressure)

    def signal(self, truth: Mapping[str, float]) -> Float[np.ndarray, "e sample"]:
        own = {part: value for part, value in truth.items() if part != "base_friction"}
        own = {part: as_real(value) for part, value in self.feature.from_reported(own).items()}
        if self.feature.has_edges:
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
            if part in ("height_m", "radius_m"):
                return 10 * abs(self.truth[part])
            if part in MOVES and self.feature.has_edges:
                return 4 * cell / STEP
            return depth if part.endswith("_m") else 1.0

        return {part: scale(part) for part in self.truth}

    def fit_draws(self, key: jax.Array, draws: int) -> list[FittedDraw]:
        key, place = jax.random.split(key)
        moved = np.asarray(jax.random.uniform(place, (draws,), minval=-MOVED_M, maxval=MOVED_M))
        read, start = [], None
        for off, noise in zip(moved, self.on.noise(key, self.power, draws), strict=True):
            truth = {**self.truth, PLACE: self.truth[PLACE] + float(off)}
            fitted = self.fit(truth, noise, start)
            own = dict(fitted.parameters)
            start = start or {part: own[part][0] for part in self.feature.reported if part != PLACE}
            own[PLACE] = own[PLACE][0] - float(off), own[PLACE][1]
            read.append(fitted._replace(parameters=own))
        return read

    def fit(
        self,
        truth: Mapping[str, float],
        noise: Float[np.ndarray, "e sample"],
        start: Mapping[str, float] | None = None,
    ) -> FittedDraw:
        """The fit of a feature of any parameters, in one draw of the noise."""
        y = self.signal(truth) + noise
        fitted = self.fitter({self.name: self.feature}, y, start=start)
        return FittedDraw(fitted.parameters, fitted.status == "converged")
