"""A sensor that slides over ridges on a pitch: contact with them, and the waves in its signal.

Between flat ridges of half width a and height H on a pitch L the skin, a half space of the plane
modulus E*, reaches the plate at the load per ridge (a row of flat punches)

    P = pi E* H / (2 arccosh(1 / sin(pi a / L))).
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import BadInput, refuse
from ..grid import Line, Periodic
from .contact import Contact
from .film import Film
from .operator import PositionInterpolation
from .scan import ConstantSpeed
from .scene import Scene, SurfaceScene
from .sensor import Sensor
from .surface import Ridges

_TOUCH_LOADS = (0.8, 0.95)  # of the closed form's, at which the gap between ridges is evaluated


class PitchWaves(NamedTuple):
    """Waves at the pitch for each of some ridges: their `amplitude` (point, film) [V], `pressure`
    (point, n) [Pa] and `gap` (point, n) [m], and whether all contacts converged."""

    amplitude: Float[np.ndarray, "point film"]
    pressure: Float[np.ndarray, "point n"]
    gap: Float[np.ndarray, "point n"]
    converged: bool


class PitchedScan(NamedTuple):
    """A sensor of one element that slides over ridges, on a periodic line of whole pitches."""

    line: Line
    scene: SurfaceScene
    ridges: Ridges
    sensor: Sensor
    scan: ConstantSpeed

    @classmethod
    def checked(
        cls, line: Line, scene: Scene, sensor: Sensor, scan: ConstantSpeed
    ) -> "PitchedScan":
        """Raises `BadInput` for another surface than ridges, more than one film element, a window
        that does not hold whole pitches, and a speed that is not positive."""
        surface = scene.contact_scene
        ridges = surface and surface.surface.only(Ridges)
        if surface is None or ridges is None:
            raise BadInput("The scene is not one set of ridges: use scene=ridges.")
        sensor.require_elements(1)
        pitches = line.n * float(line.cell_m) / float(ridges.pitch_m)
        refuse(
            not isinstance(line, Periodic) or abs(pitches - round(pitches)) > 1e-6 or pitches < 0.5,
            f"The window holds {pitches:.4g} pitches: give grid.line=periodic and as grid.length_m "
            "a whole number of pitches.",
        )
        speed = float(scan.speed_m_per_s)
        refuse(speed <= 0, f"scan.speed_m_per_s is {speed}: give a positive speed in m/s.")
        return cls(line, surface, ridges, sensor, scan)

    @property
    def pitch_m(self) -> float:
        """The ridges' distance."""
        return float(self.ridges.pitch_m)

    def signal(
        self, pressure: Float[np.ndarray, " n"], x: Float[Array, " sample"]
    ) -> Float[Array, "1 sample"]:
        """The signal [V] of a pressure [Pa] on the line, read at positions x [m]."""
        field = self.sensor.operator(self.line, self.scan)
        traction = self._traction(self.scene, jnp.asarray(pressure))
        return jax.jit(lambda t: PositionInterpolation(self.line, x)(field(t)))(traction)

    def waves(self, other: Film, points: list[tuple[float, float]]) -> PitchWaves:
        """The waves at the pitch of the sensor's film and of an `other`, for ridges and loads:
        `points` of height [m] and nominal pressure [Pa]."""
        both = Sensor((*self.sensor.elements, other), self.sensor.skin, self.sensor.amplifier)
        field = both.operator(self.line, self.scan)
        wave = round(self.line.n * float(self.line.cell_m) / self.pitch_m)

        def one(given):
            scene = eqx.tree_at(_height_and_load, self.scene, tuple(given))
            contact: Contact = scene.contact(self.line)
            signal = field(self._traction(scene, contact.pressure_Pa))
            size = 2 * jnp.abs(jnp.fft.rfft(signal)[:, wave]) / self.line.n
            return size, contact.pressure_Pa, contact.gap_m, contact.converged

        solve = jax.jit(lambda given: jax.lax.map(one, given))
        size, pressure, gap, right = (np.asarray(v) for v in solve(jnp.asarray(points, float)))
        return PitchWaves(size, pressure, gap, bool(right.all()))

    def _traction(self, scene: SurfaceScene, pressure):
        friction = scene.friction(self.line, self.scan.direction)
        return jnp.stack([pressure, self.scan.direction * friction * pressure])

    @property
    def touch_load_closed_form(self) -> float:
        """Load per ridge [N/m] at which the skin reaches the plate between flat ridges."""
        half = np.sin(np.pi * float(self.ridges.width_m) / 2 / self.pitch_m)
        k = 2 * np.pi / self.pitch_m
        # E* of a half space
        plane = 2 / (k * float(np.abs(self.scene.skin.compliance(jnp.asarray([k]))[0])))
        return float(np.pi * plane * float(self.ridges.height_m) / (2 * np.arccosh(1 / half)))

    @property
    def touch_points(self) -> list[tuple[float, float]]:
        """Points of [`PitchedScan.waves`][] of which [`PitchedScan.touch_load`][] takes the
        gaps."""
        per_pitch = self.touch_load_closed_form / self.pitch_m
        return [(float(self.ridges.height_m), each * per_pitch) for each in _TOUCH_LOADS]

    def touch_load(self, gaps: Float[np.ndarray, "2 n"]) -> float:
        """The load per ridge [N/m] of the closed form, by contact: where the line through the gaps
        [m] between ridges at the `touch_points` reaches zero."""
        loads = self.touch_load_closed_form * np.asarray(_TOUCH_LOADS)
        from_ridge = np.asarray((self.line.x - self.ridges.position_m) % self.pitch_m)
        between = gaps[:, np.abs(from_ridge - self.pitch_m / 2).argmin()]
        slope = (between[1] - between[0]) / (loads[1] - loads[0])
        return float(loads[1] - between[1] / slope)


def _height_and_load(scene: Any) -> tuple[Any, Any]:
    return scene.surface.shapes[0].height_m, scene.nominal_pressure_Pa
