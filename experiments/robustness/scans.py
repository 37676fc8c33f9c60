"""Simulated scans of a known truth: what is scanned, by which rig, and how it is recorded."""

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import scipy.signal

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.feature import Axis, Feature, HertzFeature, StripFeature
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.shape import Shape
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Bump
from srsinv.forward.surface_feature import HEIGHT, POSITION, WIDTH, RidgeFeature, SurfaceFeature
from srsinv.grid import Line
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.gridding.cells import Window
from srsinv.inverse.nonlinear import WhitePlusOU
from srsinv.recording import Recording

DEPTH_M, SPEED, RATE_HZ, SAMPLES = 0.75e-3, 0.04, 2000.0, 1000
WINDOW, NOMINAL_PA, EDGE_M = Window(-0.005, 0.025), 2e4, 1e-5
FINER = 2.0  # times narrower cells than those of the fit: what makes a signal does not invert it
CORRELATION_M = 2e-4  # of sliding noise
ORIENTATIONS = ("1_to_x_3_to_z", "1_to_z_3_to_x")
MODULUS_PA, POISSON, STRIP_WIDTH_M, SECOND_DEG = 7e5, 0.5, 0.7e-3, 90.0
LENGTH_M, RESISTANCE_OHM = 8e-3, 1e6
Rng = np.random.Generator


class BumpFeature(SurfaceFeature):
    """A rounded bump, of a standard deviation of half its width."""

    axes: ClassVar[Mapping[str, Axis]] = {
        "height_m": HEIGHT,
        "width_m": WIDTH,
        "position_m": POSITION,
    }

    def shape(self, own: Mapping[str, Any]) -> Shape:
        return Bump(own["height_m"], own["width_m"] / 2, own["position_m"])


@dataclasses.dataclass(frozen=True)
class ScannedScene:
    """What is scanned: a feature's `truth` by its parameters' names, by so many `elements`, with
    `white` noise per sample and `sliding` noise, a fraction of the signal's rms.

    - `other`: the feature of another family with the same parameters.
    - `friction`: of the whole surface.
    """

    feature: Feature | SurfaceFeature
    other: Feature | SurfaceFeature
    truth: Mapping[str, float]
    friction: float
    elements: int = 2
    white: float = 5e-7
    sliding: float = 0.0

    @property
    def is_of_surface(self) -> bool:
        """Whether the feature acts through contact."""
        return self.feature.is_of_surface

    @property
    def parameters(self) -> dict[str, float]:
        """The truth, by the names of a fit's parameters."""
        return {**self.truth, "base_friction" if self.is_of_surface else "friction": self.friction}


@dataclasses.dataclass(frozen=True)
class TrueRig:
    """What makes a signal: as it is stated, but for what a fault has changed.

    - `depth_m`, `strip_width_m` [m]: of every film; `second_deg`, `second_offset_m`: the second
      element's angle from the first [deg], and how far it sits beside it [m].
    - `youngs_modulus_Pa`, `poisson_ratio`: of the skin; `nominal_pressure_Pa`: of a contact.
    """

    depth_m: float = DEPTH_M
    strip_width_m: float = STRIP_WIDTH_M
    second_deg: float = SECOND_DEG
    second_offset_m: float = 0.0
    youngs_modulus_Pa: float = MODULUS_PA
    poisson_ratio: float = POISSON
    nominal_pressure_Pa: float = NOMINAL_PA

    def sensor(self, elements: int) -> Sensor:
        """The sensor, of one element or two."""
        places = (0.0, 0.0), (np.deg2rad(self.second_deg), self.second_offset_m)
        films = [
            Film(self.depth_m, angle, self.strip_width_m, LENGTH_M, offset_m=offset)
            for angle, offset in places[:elements]
        ]
        films = [film.with_strip_average() for film in films]
        skin = HalfSpace(self.poisson_ratio, self.youngs_modulus_Pa)
        return Sensor(films, skin, CurrentAmplifier(RESISTANCE_OHM))


STRIP = {"position_m": 9.3e-3, "width_m": 3.8e-3, "pressure_Pa": 6000.0}
RIDGE = {"height_m": 4e-5, "width_m": 6e-4, "position_m": 0.01}
RIDGE_SCENE = "ridge, two elements"
SCENES = {
    "strip, two elements": ScannedScene(StripFeature(), HertzFeature(), STRIP, 0.45),
    "strip, one element": ScannedScene(StripFeature(), HertzFeature(), STRIP, 0.45, elements=1),
    RIDGE_SCENE: ScannedScene(
        RidgeFeature(EDGE_M), BumpFeature(EDGE_M), RIDGE, 0.4, white=1e-6, sliding=0.005
    ),
}


@dataclasses.dataclass(frozen=True)
class Scan:
    """A scan: its `signal` without noise and its `noise`, both (e, sample) [V], and what made them.

    - `sliding`: rms of that part of the noise; `feature`: what was scanned.
    - `stated_times`: what is stated of a fact over its true value, by the fact's name.
    - `others`: what was scanned beside it: features of the same family, by their parameters.
    """

    scene: ScannedScene
    motion: Motion
    signal: np.ndarray
    noise: np.ndarray
    sliding: float
    rng: Rng
    feature: Feature | SurfaceFeature
    stated_times: Mapping[str, float] = dataclasses.field(default_factory=dict)
    others: tuple[Mapping[str, float], ...] = ()

    def pressure(self, line: Line) -> np.ndarray:
        """The true pressure (n,) [Pa] on a line's cells, of features of traction."""
        assert isinstance(self.feature, Feature)
        total = np.zeros(line.n)
        for each in (self.scene.truth, *self.others):
            truth = dict(each) | {"half_width_m": each["width_m"] / 2}
            profile = np.asarray(self.feature.profile(truth).cell_average(line))
            total += truth["pressure_Pa"] * profile
        return total

    def traction(self, line: Line) -> np.ndarray:
        """The true p and q (2, n) [Pa] on a line's cells, of features of traction."""
        p = self.pressure(line)
        return np.stack([p, self.scene.friction * p])

    @property
    def recorded(self) -> np.ndarray:
        """The signal with its noise."""
        return self.signal + self.noise

    @property
    def rms(self) -> float:
        """Of the noise-free signal, over all elements."""
        return float(np.sqrt(np.mean(self.signal**2)))

    @property
    def peak(self) -> float:
        """The largest value of the noise-free signal."""
        return float(np.max(np.abs(self.signal)))

    def plus(self, added: np.ndarray) -> "Scan":
        """With something added to what is recorded."""
        return dataclasses.replace(self, noise=self.noise + added)

    def recording_of(self, recorded: np.ndarray) -> "Scan":
        """With this recorded in place of what was, to the last digit."""
        return dataclasses.replace(self, signal=recorded, noise=np.zeros_like(recorded))

    @property
    def recording(self) -> Recording:
        """As it is stored, with the facts as stated."""
        scene, times = self.scene, dict(self.stated_times)
        signal = self.recorded
        speed = SPEED * times.get("speed", 1.0)
        rate = RATE_HZ * times.get("sample_rate", 1.0)
        facts: dict[str, Any] = {"sensor": _description(scene.elements)}
        if scene.is_of_surface:
            facts |= {"nominal_pressure_Pa": NOMINAL_PA, "contact_window_m": list(WINDOW)}
        time_s = np.arange(signal.shape[1]) / rate
        channels = tuple(f"voltage_{e}_V" for e in range(scene.elements))
        return Recording(signal, time_s, np.full(time_s.shape, speed), channels, facts)

    def whitener(self) -> WhitePlusOU:
        """Of the stated noise: the white one, and that of sliding."""
        white = np.full(self.signal.shape, self.scene.white)
        sliding = max(self.sliding, 1e-6 * self.scene.white)
        return WhitePlusOU(np.asarray(self.motion.position_m), white, sliding, CORRELATION_M)


def scan(
    scene: ScannedScene,
    rng: Rng,
    rig: TrueRig | None = None,
    is_other: bool = False,
    others: tuple[Mapping[str, float], ...] = (),
) -> Scan:
    """A scan without fault, by a `rig`, of a feature, of the other family where `is_other`, and of
    `others` beside it."""
    position = SPEED / RATE_HZ * np.arange(SAMPLES)
    motion = Motion.from_speed(np.arange(SAMPLES) / RATE_HZ, np.full(SAMPLES, SPEED), 0.0)
    feature = scene.other if is_other else scene.feature
    signal = clean_signal(scene, feature, rig or TrueRig(), motion, others)
    sliding = scene.sliding * float(np.sqrt(np.mean(signal**2)))
    noise = scene.white * rng.normal(size=signal.shape)
    noise += sliding * ornstein_uhlenbeck(rng, signal.shape, position[1] / CORRELATION_M)
    return Scan(scene, motion, signal, noise, sliding, rng, feature, others=others)


def _description(elements: int) -> dict[str, Any]:
    """The sensor as it is stated."""
    films = [
        {"orientation": each, "strip_width_m": STRIP_WIDTH_M, "active_length_m": LENGTH_M}
        for each in ORIENTATIONS[:elements]
    ]
    return {"depth_m": DEPTH_M, "feedback_resistance_ohm": RESISTANCE_OHM, "elements": films}


def clean_signal(
    scene: ScannedScene,
    feature: Feature | SurfaceFeature,
    rig: TrueRig,
    motion: Motion,
    others: tuple[Mapping[str, float], ...] = (),
) -> np.ndarray:
    """The signal (e, sample) [V] of a feature, and of `others` beside it, without noise."""
    sensor, truths = rig.sensor(scene.elements), (scene.truth, *others)
    own = {f"feature {i}": _parameters(scene, each) for i, each in enumerate(truths)}
    params: dict[str, Any] = dict(own)
    if scene.is_of_surface:
        nominal_Pa = rig.nominal_pressure_Pa
        params |= {"base_friction": scene.friction, "nominal_pressure_Pa": nominal_Pa, "gain": 1.0}
        model = FeatureModel.on_window(sensor, motion, WINDOW, EDGE_M / 5 / FINER, nominal_Pa)
    else:
        model = FeatureModel.along(sensor, motion, DEPTH_M / 32 / FINER)
    return np.array(model.with_features(dict.fromkeys(own, feature))(params))


def _parameters(scene: ScannedScene, truth: Mapping[str, float]) -> dict[str, float]:
    """All that a feature's model takes."""
    if scene.is_of_surface:
        return {**truth, "edge_length_m": EDGE_M}
    shear_Pa = scene.friction * truth["pressure_Pa"]
    return {**truth, "shear_Pa": shear_Pa, "half_width_m": truth["width_m"] / 2}


def ornstein_uhlenbeck(rng: Rng, shape: tuple[int, ...], step: float) -> np.ndarray:
    """Of unit variance, correlated as exp(-step) from one sample to the next."""
    decay = np.exp(-step)
    white = rng.normal(size=shape) * np.sqrt(1 - decay**2)
    white[:, 0] /= np.sqrt(1 - decay**2)
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -decay], white, axis=-1))
