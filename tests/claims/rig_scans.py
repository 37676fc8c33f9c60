"""Random rigs, what is stated of them, and what they record of ridges.

Whatever sets the number of cells or samples follows a depth, so that one compiled program serves
all rigs of as many strips that turn, or do not.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface_feature import RidgeFeature
from srsinv.grid import as_real
from srsinv.inverse.features.contact import cell_for
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.gridding.cells import Window
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.problem import Problem
from srsinv.inverse.rig.error import RigError

TURNING = 0.1  # of a scan, over which the motion slows down and comes back to its speed
FINER = 2.3  # times as many cells as a fit has, and in no simple ratio to them
RIDGE = RidgeFeature(edge_length_m=5e-5)
RANGES = {
    "depth_m": (0.7e-3, 1.6e-3),
    "angle_2_deg": (20.0, 90.0),
    "offset_2_m": (0.5e-3, 3e-3),
    "gain": (50.0, 200.0),  # of either sign
    "friction": (0.1, 0.8),
    "nominal_pressure_Pa": (2e4, 5e4),
    "speed_m_per_s": (0.01, 0.04),
    "height_m": (15e-6, 30e-6),
    "width_m": (1.5e-3, 2.5e-3),
    "position_m": (-1e-3, 1e-3),  # about where the strips' mean place is zero
}
NOISE = 0.03, 0.18  # white, of the largest sample: evenly in the logarithm
STATED = {"depth_m": 0.15, "angle_2_deg": 8.0, "offset_2_m": 4e-4}  # within; of the depth relative
Rng = np.random.Generator
Ridge = Mapping[str, float]


class Setup(NamedTuple):
    """How many `samples` are recorded over a scan and a window of so many depths, and whether the
    strips `average` over their width. The lengths are in no simple ratio to any cell, so that
    rounding never makes one cell more."""

    samples: int = 1000
    scan_depths: float = 20.3
    window_depths: float = 27.9
    average: bool = True


WHOLE = Setup()


class Strips(NamedTuple):
    """Depth of the films, angle and offset of the second one."""

    depth_m: float
    angle_2_deg: float
    offset_2_m: float


@dataclasses.dataclass(frozen=True)
class Rig:
    """A rig as it is and as it is `stated`, the ridge `known` to calibrate on, and a `later` one.

    `gains` has one for each strip; `noise` is white, per sample, over the largest one.
    """

    strips: Strips
    stated: Strips
    gains: tuple[float, ...]
    friction: float
    nominal_pressure_Pa: float
    speed_m_per_s: float
    turns: bool
    setup: Setup
    noise: float
    known: Ridge
    later: Ridge

    @property
    def truth(self) -> dict[str, float]:
        """What a calibration looks for, by its names."""
        truth = {f"gain_{n}": gain for n, gain in enumerate(self.gains, 1)}
        own = self.strips._asdict()
        names = own if len(self.gains) > 1 else ["depth_m"]
        place = self.known["position_m"]
        return truth | {n: own[n] for n in names} | {
            "base_friction": self.friction, "position_m": place
        }  # fmt: skip

    def motion(self, depth_m: float) -> Motion:
        """Over the ridge, or there and back in as many samples, by a scan of so many depths."""
        scan, n = self.setup.scan_depths * depth_m, self.setup.samples
        time = np.arange(n) / n * (2 if self.turns else 1)
        slope = np.clip((1 - time) / TURNING, -1, 1) if self.turns else np.ones(n)
        return Motion.from_speed(
            time * scan / self.speed_m_per_s, slope * self.speed_m_per_s, -scan / 2
        )

    def window_m(self, depth_m: float) -> tuple[float, float]:
        """The stretch of surface that is pressed on, of so many depths."""
        half = self.setup.window_depths / 2 * depth_m
        return -half, half

    def sensor(self, strips: Strips) -> Sensor:
        """Of these strips."""
        depth, angle, offset = strips
        films = [Film(depth, strips=2), Film(depth, np.deg2rad(angle), strips=2, offset_m=offset)]
        films = films[: len(self.gains)]
        if self.setup.average:
            films = [film.with_strip_average() for film in films]
        return Sensor(films, HalfSpace(0.5, 7e5), CurrentAmplifier(1e6))

    def recorded(self, ridge: Ridge, depth_m: float, rng: Rng) -> Float[np.ndarray, "e sample"]:
        """The signals over a ridge, by contact on finer cells than a fit has."""
        window, pressure = Window(*self.window_m(depth_m)), self.nominal_pressure_Pa
        sensor, motion = self.sensor(self.strips), self.motion(depth_m)
        cell = cell_for({"one": RIDGE}, depth_m) / FINER
        model = FeatureModel.on_window(sensor, motion, window, cell, pressure)
        common = model.loading.common() | {"base_friction": self.friction}
        own = {**ridge, "edge_length_m": RIDGE.edge_m}
        params: dict[str, Any] = {key: as_real(value) for key, value in common.items()}
        params["one"] = {key: as_real(value) for key, value in own.items()}
        signal = np.asarray(model.with_features({"one": RIDGE})(params))
        noise = self.noise * np.abs(signal).max() * rng.normal(size=signal.shape)
        return np.array(self.gains)[:, None] * (signal + noise)

    def problem(
        self,
        signal: Float[np.ndarray, "e sample"],
        depth_m: float,
        sensor: Sensor,
        rig: RigError | None = None,
    ) -> Problem:
        """What a fit begins with; the noise is for it to estimate."""
        noise = SampleNoise(float(np.std(np.diff(signal))), is_estimate=True)
        return Problem(
            sensor, self.motion(depth_m), signal, noise, rig=rig,
            nominal_pressure_Pa=self.nominal_pressure_Pa, window_m=self.window_m(depth_m),
        )  # fmt: skip


def random_rig(rng: Rng, strips: int = 2, turns: bool = False, setup: Setup = WHOLE) -> Rig:
    """A rig of parameters even in `RANGES`, stated wrongly by up to `STATED`."""
    one = {name: float(rng.uniform(*within)) for name, within in RANGES.items()}
    true = Strips(*(one[name] for name in Strips._fields))
    off = {name: float(rng.uniform(-most, most)) for name, most in STATED.items()}
    off["depth_m"] *= true.depth_m
    stated = Strips(*(one[name] + off[name] for name in Strips._fields))
    signs = rng.choice([-1.0, 1.0], size=strips)
    gains = tuple(map(float, signs * rng.uniform(*RANGES["gain"], size=strips)))
    middle = true.offset_2_m / 2 if strips > 1 else 0.0

    def ridge() -> dict[str, float]:
        sizes = {n: float(rng.uniform(*RANGES[n])) for n in ("height_m", "width_m", "position_m")}
        return sizes | {"position_m": sizes["position_m"] + middle}

    noise = float(np.exp(rng.uniform(*np.log(NOISE))))
    return Rig(
        true, stated, gains, one["friction"], one["nominal_pressure_Pa"], one["speed_m_per_s"],
        turns, setup, noise, ridge(), ridge(),
    )  # fmt: skip
