"""Scans of a known truth, and what a faulty measurement makes of them (faults.yaml)."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import scipy.signal
import yaml

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

FAULTS = Path(__file__).with_name("faults.yaml")
DEPTH_M, SPEED, RATE_HZ, SAMPLES = 0.75e-3, 0.04, 2000.0, 1000
WINDOW, NOMINAL_PA, EDGE_M = Window(-0.005, 0.025), 2e4, 1e-5
FINER = 2.0  # times narrower cells than those of the fit: what makes a signal does not invert it
CORRELATION_M = 2e-4  # of sliding noise
ORIENTATIONS = ("1_to_x_3_to_z", "1_to_z_3_to_x")
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
    """

    scene: ScannedScene
    motion: Motion
    signal: np.ndarray
    noise: np.ndarray
    sliding: float
    rng: Rng
    feature: Feature | SurfaceFeature
    stated_times: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def pressure(self, line: Line) -> np.ndarray:
        """The true pressure (n,) [Pa] on a line's cells, of a feature of traction."""
        assert isinstance(self.feature, Feature)
        truth = dict(self.scene.truth) | {"half_width_m": self.scene.truth["width_m"] / 2}
        profile = np.asarray(self.feature.profile(truth).cell_average(line))
        return truth["pressure_Pa"] * profile

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
        speed = SPEED * times.pop("speed", 1.0)
        depth = DEPTH_M * times.pop("depth", 1.0)
        facts: dict[str, Any] = {"sensor": _description(scene.elements, depth)}
        if scene.is_of_surface:
            facts |= {"nominal_pressure_Pa": NOMINAL_PA, "contact_window_m": list(WINDOW)}
        time_s = np.arange(signal.shape[1]) / RATE_HZ
        channels = tuple(f"voltage_{e}_V" for e in range(scene.elements))
        return Recording(signal, time_s, np.full(time_s.shape, speed), channels, facts)

    def whitener(self) -> WhitePlusOU:
        """Of the stated noise: the white one, and that of sliding."""
        white = np.full(self.signal.shape, self.scene.white)
        sliding = max(self.sliding, 1e-6 * self.scene.white)
        return WhitePlusOU(np.asarray(self.motion.position_m), white, sliding, CORRELATION_M)


def scan(scene: ScannedScene, rng: Rng, depth_times: float = 1.0, is_other: bool = False) -> Scan:
    """A scan without fault; `depth_times`: the film's depth over its usual one; `is_other`: of a
    feature of the other family."""
    position = SPEED / RATE_HZ * np.arange(SAMPLES)
    motion = Motion.from_speed(np.arange(SAMPLES) / RATE_HZ, np.full(SAMPLES, SPEED), 0.0)
    signal = _signal(scene, _sensor(scene.elements, DEPTH_M * depth_times), motion, is_other)
    sliding = scene.sliding * float(np.sqrt(np.mean(signal**2)))
    noise = scene.white * rng.normal(size=signal.shape)
    noise += sliding * _ornstein_uhlenbeck(rng, signal.shape, position[1] / CORRELATION_M)
    feature = scene.other if is_other else scene.feature
    return Scan(scene, motion, signal, noise, sliding, rng, feature)


def _sensor(elements: int, depth_m: float) -> Sensor:
    films = [Film(depth_m, angle, 0.7e-3, 8e-3).with_strip_average() for angle in (0, np.pi / 2)]
    return Sensor(films[:elements], HalfSpace(0.5, 7e5), CurrentAmplifier(1e6))


def _description(elements: int, depth_m: float) -> dict[str, Any]:
    films = [
        {"orientation": each, "strip_width_m": 0.7e-3, "active_length_m": 8e-3}
        for each in ORIENTATIONS[:elements]
    ]
    return {"depth_m": depth_m, "feedback_resistance_ohm": 1e6, "elements": films}


def _signal(scene: ScannedScene, sensor: Sensor, motion: Motion, is_other: bool) -> np.ndarray:
    feature, own = scene.other if is_other else scene.feature, dict(scene.truth)
    params: dict[str, Any] = {"one": own}
    if scene.is_of_surface:
        assert isinstance(feature, SurfaceFeature)
        own["edge_length_m"] = EDGE_M
        params |= {"base_friction": scene.friction, "nominal_pressure_Pa": NOMINAL_PA, "gain": 1.0}
        model = FeatureModel.on_window(sensor, motion, WINDOW, EDGE_M / 5 / FINER, NOMINAL_PA)
    else:
        own["shear_Pa"] = scene.friction * own["pressure_Pa"]
        own["half_width_m"] = own["width_m"] / 2
        model = FeatureModel.along(sensor, motion, DEPTH_M / 32 / FINER)
    return np.array(model.with_features({"one": feature})(params))


def _ornstein_uhlenbeck(rng: Rng, shape: tuple[int, ...], step: float) -> np.ndarray:
    """Of unit variance, correlated as exp(-step) from one sample to the next."""
    decay = np.exp(-step)
    white = rng.normal(size=shape) * np.sqrt(1 - decay**2)
    white[:, 0] /= np.sqrt(1 - decay**2)
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -decay], white, axis=-1))


# --- the faults ------------------------------------------------------------------------------


@cache
def faults() -> dict[str, dict[str, Any]]:
    """The faults by their names: what each does, and its strengths."""
    return yaml.safe_load(FAULTS.read_text(encoding="utf-8"))


def suits(fault: Mapping[str, Any], scene: ScannedScene) -> bool:
    """Whether a fault makes sense in a scene."""
    return scene.elements == 2 or fault.get("only") != "two"


def faulty(fault: Mapping[str, Any], scene: ScannedScene, seed: int) -> Scan:
    """A scan with a fault."""
    strengths = {key: each for key, each in fault.items() if key not in ("does", "only")}
    rng = np.random.default_rng(seed)
    if fault["does"] == "wrong_depth":
        made = scan(scene, rng, depth_times=strengths["times"])
        return dataclasses.replace(made, stated_times={"depth": 1.0})
    if fault["does"] == "wrong_family":
        return scan(scene, rng, is_other=True)
    return DOES[fault["does"]](scan(scene, rng), **strengths)


def _nothing(made: Scan) -> Scan:
    return made


def _dead(made: Scan, element: int) -> Scan:
    recorded = made.recorded
    recorded[element] = made.noise[element]
    return made.recording_of(recorded)


def _stuck(made: Scan, element: int, **where: float) -> Scan:
    recorded, n = made.recorded, made.signal.shape[1]
    start, stop = int(where["from"] * n), int(where["to"] * n)
    recorded[element, start:stop] = recorded[element, start]
    return made.recording_of(recorded)


def _swapped(made: Scan) -> Scan:
    return made.recording_of(made.recorded[::-1])


def _flipped(made: Scan, elements: list[int]) -> Scan:
    recorded = made.recorded
    present = [e for e in elements if e < len(recorded)]
    recorded[present] = -recorded[present]
    return made.recording_of(recorded)


def _glued(made: Scan, crosstalk: float, own_noise: bool) -> Scan:
    """The second channel with so much of the first in place of its own."""
    recorded = made.recorded
    source = made.signal if own_noise else made.recorded
    mixed = crosstalk * source[0] + (1 - crosstalk) * source[1]
    recorded[1] = mixed + own_noise * made.noise[1]
    return made.recording_of(recorded)


def _louder_noise(made: Scan, element: int, times: float) -> Scan:
    added = np.zeros_like(made.noise)
    added[element] = (times - 1) * made.noise[element]
    return made.plus(added)


def _hum(made: Scan, frequency_hz: float, of_rms: float) -> Scan:
    time_s = np.arange(made.signal.shape[1]) / RATE_HZ
    wave = np.sin(2 * np.pi * (frequency_hz * time_s + made.rng.random()))
    return made.plus(np.sqrt(2) * of_rms * made.rms * wave[None])


def _drift(made: Scan, of_rms: float) -> Scan:
    return made.plus(of_rms * made.rms * np.linspace(0, 1, made.signal.shape[1])[None])


def _offset(made: Scan, of_rms: float) -> Scan:
    return made.plus(np.full_like(made.signal, of_rms * made.rms))


def _impulses(made: Scan, count: int, of_peak: float) -> Scan:
    added = np.zeros_like(made.signal)
    at = made.rng.choice(added.size, count, replace=False)
    added.ravel()[at] = of_peak * made.peak * made.rng.choice([-1, 1], count)
    return made.plus(added)


def _pink_noise(made: Scan, of_rms: float) -> Scan:
    n = made.signal.shape[1]
    weights = 1 / np.sqrt(np.maximum(np.arange(n // 2 + 1), 1))
    weights[0] = 0.0
    pink = np.fft.irfft(weights * np.fft.rfft(made.rng.normal(size=made.signal.shape)), n)
    return made.plus(of_rms * made.rms * pink / np.sqrt(np.mean(pink**2)))


def _clipped(made: Scan, at_peak_times: float) -> Scan:
    limit = at_peak_times * made.peak
    return made.recording_of(np.clip(made.recorded, -limit, limit))


def _quantised(made: Scan, step_of_peak: float) -> Scan:
    step = step_of_peak * made.peak
    return made.recording_of(step * np.round(made.recorded / step))


def _jitter(made: Scan, samples: float) -> Scan:
    n = made.signal.shape[1]
    at = np.arange(n) + samples * made.rng.normal(size=n)
    signal = np.stack([np.interp(at, np.arange(n), row) for row in made.signal])
    return made.recording_of(signal + made.noise)


def _places(made: Scan, bursts: int, samples: int) -> np.ndarray:
    starts = made.rng.choice(made.signal.shape[1] - samples, bursts, replace=False)
    return np.unique(starts[:, None] + np.arange(samples))


def _missing_rows(made: Scan, bursts: int, samples: int) -> Scan:
    """Samples that were lost and leave no gap: those after them move up."""
    left = np.delete(made.recorded, _places(made, bursts, samples), axis=1)
    missing = made.signal.shape[1] - left.shape[1]
    rest = made.scene.white * made.rng.normal(size=(len(left), missing))
    return made.recording_of(np.concatenate([left, rest], axis=1))


def _zeroed_rows(made: Scan, bursts: int, samples: int) -> Scan:
    recorded = made.recorded
    recorded[:, _places(made, bursts, samples)] = 0.0
    return made.recording_of(recorded)


def _low_pass(made: Scan, cutoff_hz: float) -> Scan:
    """A filter of first order that is not modelled, before the noise."""
    n = 4 * made.signal.shape[1]
    response = 1 / (1 + 1j * np.fft.rfftfreq(n, 1 / RATE_HZ) / cutoff_hz)
    filtered = np.fft.irfft(response * np.fft.rfft(made.signal, n), n)[:, : made.signal.shape[1]]
    return made.recording_of(filtered + made.noise)


def _wrong_speed(made: Scan, times: float) -> Scan:
    return dataclasses.replace(made, stated_times={"speed": 1 / times})


def _wrong_gain(made: Scan, times: float, elements: list[int]) -> Scan:
    """Films that give more charge than stated; the amplifier's noise is the same."""
    factor = np.ones((len(made.signal), 1))
    factor[[e for e in elements if e < len(factor)]] = times
    return dataclasses.replace(made, signal=factor * made.signal)


DOES: Mapping[str, Callable[..., Scan]] = {
    "nothing": _nothing, "dead": _dead, "stuck": _stuck, "swapped": _swapped, "flipped": _flipped,
    "glued": _glued, "louder_noise": _louder_noise, "hum": _hum, "drift": _drift,
    "offset": _offset, "impulses": _impulses, "pink_noise": _pink_noise, "clipped": _clipped,
    "quantised": _quantised, "jitter": _jitter, "lost_rows": _missing_rows,
    "lost_as_zeros": _zeroed_rows, "low_pass": _low_pass, "wrong_speed": _wrong_speed,
    "wrong_gain": _wrong_gain,
}  # fmt: skip
