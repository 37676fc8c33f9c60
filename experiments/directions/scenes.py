"""Ridges and gratings at random, and three more passes over them: proposed ones or a fixed pattern.

Signals are simulated at four times the samples and with finer quadrature than the fits take, those
of a grating ridge by ridge. The fits take a Fourier series for it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from srsinv.forward.planar import (
    ObliqueGrating,
    ObliqueRidge,
    PathScan,
    PlanarPath,
    StraightPass,
)
from srsinv.forward.sensor import Sensor
from srsinv.inverse.planar.finder import Direction, DirectionFinder
from srsinv.inverse.planar.next_pass import PassLimits, next_pass
from srsinv.inverse.planar.signal import GratingShape, RidgeShape, StraightFeature

FINER, RIDGES, WIDTH_SHARE, FIT_NODES = 4, 41, 0.3, 3
FIRST_DEG, PATTERN_DEG = 20.0, (0.0, 90.0, 45.0)  # heading of the detecting pass; fixed pattern
SPEED = 0.05  # m/s, of the detecting pass and of the fixed pattern
JOHNSON_V = 0.1287e-6  # per root hertz, of 1 Mohm at 300 K
OFF = 1e300  # noise of a pass that was not made
SHARED = {"angle_deg": (90.0, 52.0), "distance_m": (0.0, 1.5e-3), "load_N_per_m": (3.0, 3.0),
          "shear_N_per_m": (0.0, 3.0)}  # fmt: skip
PRIORS = {
    "ridge": SHARED | {"width_m": (6e-4, 3e-4)},
    "grating": SHARED | {"pitch_m": (3e-3, 1.5e-3)},
}
RANGES = {
    "ridge": {"width_m": (1.5e-4, 1.5e-3), "distance_m": (-4e-3, 4e-3)},
    "grating": {"pitch_m": (1.5e-3, 5e-3)},
}
SHAPES: dict[str, StraightFeature] = {
    "ridge": RidgeShape(FIT_NODES),
    "grating": GratingShape(WIDTH_SHARE),
}


@dataclass(frozen=True)
class RandomFeature:
    """A feature of a `kind`, and its parameters' `truth` in the order of the shape's names."""

    kind: str
    feature: ObliqueRidge
    truth: Float[np.ndarray, " m"]


def draw_feature(kind: str, rng: np.random.Generator, place_m: float = 1e-3) -> RandomFeature:
    """A ridge or a grating of random direction, place (up to `place_m`), load, size and
    friction."""
    angle, distance = rng.uniform(0, 180), rng.uniform(-place_m, place_m)
    load, friction = rng.uniform(1.0, 4.0), rng.uniform(-0.6, -0.2)
    size = rng.uniform(4e-4, 9e-4) if kind == "ridge" else rng.uniform(1.8e-3, 4.5e-3)
    where = np.deg2rad(angle), distance
    if kind == "ridge":
        feature = ObliqueRidge(*where, load, size, friction)
    else:
        own = {"load_N_per_m": load, "width_m": WIDTH_SHARE * size, "friction": friction}
        feature = ObliqueGrating(*where, size, RIDGES, **own)
    return RandomFeature(kind, feature, np.array([angle, distance, size, load, load * friction]))


def noise_rms(path: PlanarPath) -> float:
    """Johnson noise of a sample [V], up to half the sampling rate."""
    return JOHNSON_V * float(np.sqrt(0.5 / path.interval_s))


def errors(drawn: RandomFeature, found: Direction) -> Float[np.ndarray, " m"]:
    """Errors of the parameters; of the two equivalent angles and of a grating's distances the
    nearest."""
    value, _ = found.posterior(SHAPES[drawn.kind].names)
    turns = np.round((value[0] - drawn.truth[0]) / 180)
    value[0] -= 180 * turns
    value[1] *= -1.0 if turns % 2 else 1.0
    error = value - drawn.truth
    if drawn.kind == "grating":
        error[1] = (error[1] + drawn.truth[2] / 2) % drawn.truth[2] - drawn.truth[2] / 2
    return error


class PassesOver:
    """Passes over one feature by one sensor, the first of which detected it."""

    def __init__(self, sensor: Sensor, drawn: RandomFeature, limits: PassLimits, seed: int):
        self.sensor, self.drawn, self.limits = sensor, drawn, limits
        self._rng = np.random.default_rng(seed)
        first = limits.path(np.deg2rad(FIRST_DEG), SPEED)
        self._first = [(first, self._signal(first))]

    def proposed(self) -> tuple[Direction, list[StraightPass]]:
        """The fit after as many passes as the pattern has, each proposed by those before."""
        made, rms = list(self._first), noise_rms(self._first[0][0])
        for number, _ in enumerate(PATTERN_DEG):
            found, feature = self._fit(made), SHAPES[self.drawn.kind]
            path = next_pass(self.sensor, feature, found, rms, self.limits, seed=number).path
            made.append((path, self._signal(path)))
        return self._fit(made), [path for path, _ in made[1:]]

    def fixed(self, speed_m_per_s: float) -> Direction:
        """The fit after the fixed pattern at this speed."""
        paths = [self.limits.path(np.deg2rad(each), speed_m_per_s) for each in PATTERN_DEG]
        return self._fit([*self._first, *((path, self._signal(path)) for path in paths)])

    def _signal(self, path: StraightPass) -> Float[np.ndarray, "e sample"]:
        fine = np.asarray(PathScan(self.sensor, path.finer(FINER))(self.drawn.feature))
        clean = fine[:, ::FINER]
        return clean + noise_rms(path) * self._rng.standard_normal(clean.shape)

    def _fit(self, made: list[tuple[StraightPass, np.ndarray]]) -> Direction:
        """The fit to the passes made; those to come stand beside them without weight, so that one
        program fits any number."""
        kind, missing = self.drawn.kind, 1 + len(PATTERN_DEG) - len(made)
        made = made + missing * made[:1]
        scans = [PathScan(self.sensor, path) for path, _ in made]
        rms = np.full(len(made), noise_rms(made[0][0]))
        rms[len(made) - missing :] = OFF
        finder = DirectionFinder(scans, SHAPES[kind], RANGES[kind], PRIORS[kind])
        y = np.concatenate([signal for _, signal in made], axis=-1)
        return finder(y, np.repeat(rms, self.limits.samples)[None])
