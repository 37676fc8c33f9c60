"""Signals of known features along one constant scan, for jobs that evaluate the feature fit.

They are simulated on cells several times finer than those of the fit.
"""

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..errors import BadInput, number, refuse, shown
from ..forward.feature import Feature
from ..forward.noise import Noise, total_spectrum
from ..forward.noise import draw as draw_noise
from ..forward.scan import ConstantSpeed, Motion
from ..forward.sensor import Sensor
from ..grid import Line, Periodic
from ..inverse.features.model import FeatureModel
from ..inverse.nonlinear import Spectrum
from ..resolution import cell_m, in_words

UNITS = {"N_per_m": "N/m", "Pa": "Pa", "rad": "rad", "m": "m"}


def sample_rate(job: str, given: Mapping[str, Any]) -> float:
    """The samples per second that a job's settings give. Raises `BadInput` for none above 0."""
    wanted = "the samples per second, above 0"
    return float(number(f"{job}.sample_rate_hz", given["sample_rate_hz"], wanted, above=0))


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
            "scan.speed_m_per_s is 0: a touch at rest scans no feature, give a speed.",
        )
        step = abs(speed) / self.rate_hz
        refuse(
            not 2 * step <= depth <= length_m / 4,
            f"The scan of {length_m:.4g} m has samples {step:.4g} m apart: with film {depth:.4g} m "
            f"deep give a {self.job}.sample_rate_hz with at least two in a depth, and a scan of "
            "at least four depths.",
        )
        time = np.arange(int(length_m / step) + 1) / self.rate_hz
        return Motion.from_speed(time, speed, start_m + (length_m if speed < 0 else 0.0))


@dataclass(frozen=True)
class SyntheticScan(abc.ABC):
    """A sensor along a constant scan of samples evenly in time, and its noise.

    `known`, `start`: in words, the fit's knowledge of the noise, and its starts.
    """

    known: ClassVar[str]
    start: ClassVar[str]
    sensor: Sensor
    scan: ConstantSpeed
    motion: Motion
    noises: tuple[Noise, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """(element, sample)."""
        return len(self.sensor.elements), int(self.motion.time_s.size)

    @property
    def free_offset(self) -> bool:
        """Whether each element has an unknown constant."""
        return self.sensor.amplifier.offset is None

    @property
    @abc.abstractmethod
    def cells(self) -> str:
        """Resolution of the simulation, in words."""

    def power(self, rms: float) -> Float[np.ndarray, " k"]:
        """The noise's power per sample, given the rms of the noise-free signal."""
        spacing = jnp.abs(self.motion.position_m[1] - self.motion.position_m[0])
        line = Periodic(self.shape[1], spacing)
        power = np.asarray(total_spectrum(self.noises, line, self.scan, jnp.asarray(rms)))
        refuse(
            not bool(np.all(power > 0)),
            "There is no noise to judge a fit by: name one above zero, such as noise=[snr].",
        )
        return power

    def noise(self, key, power: np.ndarray, draws: int) -> Float[np.ndarray, "draw e sample"]:
        """Independent draws of the noise."""
        keys = jax.random.split(key, draws)
        drawn = jax.vmap(lambda each: draw_noise(each, jnp.asarray(power), *self.shape))(keys)
        return np.asarray(drawn)


@dataclass(frozen=True)
class SyntheticTractionScan(SyntheticScan):
    """A synthetic scan of features of traction, on fine cells."""

    fine: FeatureModel
    known: ClassVar[str] = "its spectrum known to the fit"
    start: ClassVar[str] = "where the search puts the feature in the first draw, for all draws"

    @property
    def cells(self) -> str:
        return (
            f"{in_words('simulated_load')} cells in a depth, where the fit has {in_words('load')}"
        )

    def signal(self, name: str, feature: Feature, own: Mapping[str, Any]) -> np.ndarray:
        """The noise-free signal (element, sample) of one feature."""
        offset = {"offset": jnp.zeros(self.shape[0])} if self.fine.free_offset else {}
        return np.asarray(self.fine.with_features({name: feature})({name: dict(own)} | offset))


def synthetic_scan(line: Line, sampled: SampledScan) -> SyntheticTractionScan:
    """The scan from one end of a line to the other."""
    motion = sampled.motion(float(line.start_m), line.n * float(line.cell_m))
    cell = cell_m("simulated_load", float(sampled.sensor.depth_m))
    fine = FeatureModel.along(sampled.sensor, motion, cell)
    return SyntheticTractionScan(sampled.sensor, sampled.scan, motion, sampled.noises, fine)


def known_noise(power: np.ndarray) -> Any:
    """The noise as the fit takes it: one standard deviation where it is white."""
    white = np.ptp(power) <= 1e-12 * power.max()
    return float(np.sqrt(power[0])) if white else Spectrum(power)


def parameters(feature: Feature, given: Mapping[str, float]) -> dict[str, float]:
    """A model's parameters from the shape, the amplitude and the friction."""
    own = {name: given[name] for name in (*feature.axes, feature.amplitude)}
    if feature.friction is None:
        own[feature.shear] = given["friction"] * given[feature.amplitude]
    return own


def named(key: str, given: Any, name: str, feature: Feature) -> Mapping[str, Any]:
    """The mapping at `key`, refused where it does not hold just the feature's parameters."""
    wanted = (*feature.axes, feature.amplitude, "friction")
    held = given.get(name) if isinstance(given, Mapping) else None
    if not isinstance(held, Mapping) or set(held) != set(wanted):
        have = ", ".join(map(str, held)) if isinstance(held, Mapping) else shown(held)
        raise BadInput(f"{key}.{name} has {have}: give {', '.join(wanted)}.")
    return held


def unit_of(name: str) -> str:
    """The SI unit at the end of a parameter's name."""
    return next((unit for end, unit in UNITS.items() if name.endswith(f"_{end}")), "1")
