"""Scans over a cylinder, simulated apart from the fit: by solved contact on dense cells.

The fit takes Hertz's pressure at Gauss's nodes on cells of a thirtieth of the film's depth. Here
the pressure is that of the contact solver under the circle itself, in cells of 0.4 micrometres
across the cylinder, and the signal is the Fourier integral of those cells, one by one.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from srsinv.forward.contact import press
from srsinv.forward.oblique import turned
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import Cylinder
from srsinv.forward.surface_feature import CylinderFeature
from srsinv.grid import Periodic
from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.problem import Problem

WINDOWS = 16  # after which the signal repeats
LAST_WAVE = 40.0  # in depths: e^-40 of a load is left
STEPS = {"radius_m": 0.1, "sine_squared": 1e-4}  # of the bound's differences, the first relative
MOVED_M = 0.5e-3  # farthest place of a drawn cylinder from the middle
NAME = "cylinder"


@dataclasses.dataclass(frozen=True)
class CylinderScan:
    """A sensor that scans a cylinder, which bears all of the load.

    - `radius_m` [m], `angle_deg`: of its axis from straight across; `friction`: mu.
    - `load_N_per_m`: per length along the scan, the nominal pressure times the window `window_m`.
    - `snr_dB`: of rms values; `rate_hz`: samples in a second; `speed_m_per_s`; `length_m`: of the
      scan in the window's middle; `cells`: of the contact, in the window.
    """

    sensor: Sensor
    radius_m: float
    angle_deg: float
    load_N_per_m: float
    snr_dB: float
    friction: float = 0.4
    window_m: float = 24e-3
    length_m: float = 12e-3
    speed_m_per_s: float = 0.05
    rate_hz: float = 2000.0
    cells: int = 2**16

    @cached_property
    def motion(self) -> Motion:
        """The scan at constant speed."""
        samples = round(self.length_m / self.speed_m_per_s * self.rate_hz) + 1
        return Motion.from_speed(
            np.arange(samples) / self.rate_hz, self.speed_m_per_s, -self.length_m / 2
        )

    @property
    def nominal_pressure_Pa(self) -> float:
        """The mean pressure over the window."""
        return self.load_N_per_m / self.window_m

    @property
    def sine_squared(self) -> float:
        """sin(angle)^2."""
        return float(np.sin(np.radians(self.angle_deg)) ** 2)

    @cached_property
    def pressure(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], float]:
        """The touched cells across the cylinder: centres [m], pressure [Pa], and their width."""
        cell = self.window_m * float(np.sqrt(1 - self.sine_squared)) / self.cells
        line = Periodic(self.cells, cell, -(self.cells - 1) / 2 * cell)
        height = Cylinder(self.radius_m).height(line)
        contact = press(line, self.sensor.skin, height, self.nominal_pressure_Pa)
        assert bool(contact.converged)
        p = np.asarray(contact.pressure_Pa)
        return np.asarray(line.x)[p > 0], p[p > 0], cell

    @property
    def half_width_m(self) -> float:
        """Half the width of the contact [m]: of Hertz's pressure with the same second moment."""
        x, p, _ = self.pressure
        return float(2 * np.sqrt(p @ x**2 / p.sum()))

    @cached_property
    def _spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """Wavenumbers along the scan, and the signal's spectrum (part, e, k): without friction, and
        with one unit of it more."""
        x, p, cell = self.pressure
        angle = float(np.arcsin(np.sqrt(self.sine_squared)))
        c = float(np.cos(angle))
        last, step = LAST_WAVE / float(self.sensor.depth_m), 2 * np.pi / (WINDOWS * self.window_m)
        k = step * np.arange(1, int(last * c / step))
        across = k / c
        load = cell * np.sinc(across * cell / (2 * np.pi)) * (np.exp(-1j * np.outer(across, x)) @ p)
        charge = np.asarray(turned(self.sensor, angle).charge().transfer(jnp.asarray(across)))
        gain = float(self.sensor.amplifier.at_speed(jnp.asarray(self.speed_m_per_s)))
        parts = charge.swapaxes(0, 1) * (1j * k) ** self.sensor.amplifier.order
        parts = gain * parts * load / c * step / np.pi
        # What the sum leaves of the integral at the kink that the response to shear has at k = 0.
        kink = (2 * parts[..., :1].real - parts[..., 1:2].real / 2) / 12
        return np.append(0.0, k), np.concatenate([kink, parts], axis=-1)

    def signal(self, position_m: float = 0.0, friction: float | None = None, order: int = 0):
        """The signal (e, sample) of the cylinder where the scan crosses it at `position_m`, or its
        derivative of this `order` by x."""
        k, (normal, shear) = self._spectrum
        mu = self.friction if friction is None else friction
        along = np.exp(1j * np.outer(k, np.asarray(self.motion.position_m) - position_m))
        return np.real((normal + mu * shear) * (1j * k) ** order @ along)

    @cached_property
    def noise_rms(self) -> float:
        """The noise's rms."""
        return float(np.sqrt(np.mean(self.signal() ** 2))) * 10 ** (-self.snr_dB / 20)

    def bounds(self, is_angle_known: bool, is_load_known: bool = True) -> dict[str, float]:
        """Cramer-Rao bounds of what a fit reports, by central differences of the simulation."""
        per_friction = self.signal(friction=1.0) - self.signal(friction=0.0)
        columns = {"position_m": -self.signal(order=1), "base_friction": per_friction}
        columns["radius_m"] = self._slope("radius_m", STEPS["radius_m"] * self.radius_m)
        if not is_angle_known:
            step = STEPS["sine_squared"]
            columns["angle_rad"] = self._slope("sine_squared", step) * np.sin(
                2 * np.radians(self.angle_deg)
            )
        if not is_load_known:
            columns["nominal_pressure_Pa"] = self._slope("load_N_per_m", 0.05 * self.load_N_per_m)
            columns["nominal_pressure_Pa"] *= self.window_m
        rows = np.stack([each.ravel() for each in columns.values()]) / self.noise_rms
        size = np.linalg.norm(rows, axis=1)
        covariance = np.linalg.inv(rows @ rows.T / np.outer(size, size))
        return dict(zip(columns, (np.sqrt(np.diag(covariance)) / size).tolist(), strict=True))

    def _slope(self, name: str, step: float) -> np.ndarray:
        above, below = (self._changed(name, sign * step).signal() for sign in (1, -1))
        return (above - below) / (2 * step)

    def _changed(self, name: str, by: float) -> "CylinderScan":
        if name != "sine_squared":
            return dataclasses.replace(self, **{name: getattr(self, name) + by})
        angle = np.degrees(np.arcsin(np.sqrt(self.sine_squared + by)))
        return dataclasses.replace(self, angle_deg=float(angle))

    def problem(self, position_m: float, rng: np.random.Generator) -> Problem:
        """A recording with noise."""
        signal = self.signal(position_m)
        half = self.window_m / 2
        return Problem(
            self.sensor,
            self.motion,
            signal + self.noise_rms * rng.normal(size=signal.shape),
            self.noise_rms,
            nominal_pressure_Pa=self.nominal_pressure_Pa,
            window_m=(-half, half),
        )

    def truth(self, position_m: float) -> dict[str, float]:
        """The true values of what a fit reports."""
        return {
            "radius_m": self.radius_m,
            "position_m": position_m,
            "angle_rad": float(np.radians(self.angle_deg)),
            "base_friction": self.friction,
            "nominal_pressure_Pa": self.nominal_pressure_Pa,
        }


class CylinderDraw(NamedTuple):
    """An estimate of one draw, and the truth."""

    estimate: FeatureEstimate
    truth: Mapping[str, float]

    def error(self, name: str) -> float:
        """The estimate of a parameter less its truth."""
        return self.estimate.parameters[name][0] - self.truth[name]

    def stderr(self, name: str) -> float:
        """Its standard error, infinite where the fit gives none."""
        return self.estimate.parameters[name][1]


def fitted_draws(
    scan: CylinderScan,
    draws: int,
    seed: int | Sequence[int],
    is_angle_known: bool,
    also: tuple[str, ...] = (),
) -> list[CylinderDraw]:
    """Fits of draws of noise and of the cylinder's position. The first is searched for; the others
    start at the first one's shape and are searched along the scan."""
    rng, made = np.random.default_rng(seed), []
    reach = [-2 * MOVED_M, 2 * MOVED_M]
    feature = CylinderFeature(scan.angle_deg if is_angle_known else None, position_range_m=reach)
    method = FeatureFit({NAME: feature}, also=also)
    for _ in range(draws):
        position = float(rng.uniform(-MOVED_M, MOVED_M))
        estimate = method(scan.problem(position, rng))
        if not made:
            found = estimate.parameters
            start = {part: found[part][0] for part in feature.reported if part != "position_m"}
            method = FeatureFit({NAME: feature}, also=also, start=start)
        made.append(CylinderDraw(estimate, scan.truth(position)))
    return made
