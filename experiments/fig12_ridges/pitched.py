"""A sensor that slides over ridges on a pitch: contact with them, and the waves in its signal.

Between flat ridges of half width a and height H on a pitch L the skin, a half space of the plane
modulus E*, reaches the plate at the load per ridge (a row of flat punches)

    P = pi E* H / (2 arccosh(1 / sin(pi a / L))).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from srsinv.errors import BadInput, refuse
from srsinv.forward.contact import Contact
from srsinv.forward.film import Film
from srsinv.forward.noise import Noise, with_noise
from srsinv.forward.operator import PositionInterpolation
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import Scene, SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import Ridges
from srsinv.grid import Line, Periodic

_TOUCH_LOADS = (0.8, 0.95)  # of the closed form's, at which the gap between ridges is evaluated


class PitchSweep(NamedTuple):
    """Contact with ridges, and the amplitude of the wave at their pitch in the signal.

    - `amplitude`, `amplitude_other` [V]: of the sensor's film and of another one, in the scene.
    - `by_height`, `by_pressure` [V]: of the sensor's film, over heights and nominal pressures in
      place of the scene's.
    - `pressure` [Pa] and `gap` [m] (n,): of the scene's contact.
    - `touch_load`: the load per ridge [N/m] at which the skin reaches the plate between them.
    - `converged`: whether all contacts did.
    """

    amplitude: float
    amplitude_other: float
    by_height: Float[np.ndarray, " height"]
    by_pressure: Float[np.ndarray, " load"]
    pressure: Float[np.ndarray, " n"]
    gap: Float[np.ndarray, " n"]
    touch_load: float
    converged: bool


class PitchRecord(NamedTuple):
    """Samples of a scan over ridges: positions `x` [m], the signal [V] without noise and with it,
    `data`; the noise's `power` per sample [V^2] at the wavenumbers of x, and how many samples a
    ridge has, `per_pitch`."""

    x: Float[np.ndarray, " sample"]
    signal: Float[np.ndarray, " sample"]
    data: Float[np.ndarray, " sample"]
    power: Float[np.ndarray, " k"]
    per_pitch: float


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
            f"The window has {pitches:.4g} pitches: give grid.line=periodic, and a "
            "grid.length_m of a whole number of pitches.",
        )
        scan.require_onwards()
        return cls(line, surface, ridges, sensor, scan)

    @property
    def pitch_m(self) -> float:
        """The ridges' distance."""
        return float(self.ridges.pitch_m)

    @property
    def frequency_hz(self) -> float:
        """The frequency at which ridges pass."""
        return float(self.scan.speed_m_per_s) / self.pitch_m

    def record(
        self,
        pressure: Float[np.ndarray, " n"],
        ridges: int,
        rate_hz: float,
        noises: tuple[Noise, ...],
        key: Array,
    ) -> "PitchRecord":
        """The signal of a pressure [Pa] on the line, sampled at `rate_hz` over whole ridges, with
        noise. Raises `BadInput` without any."""
        step = float(self.scan.speed_m_per_s) / rate_hz
        samples = Periodic(round(ridges * rate_hz / self.frequency_hz), step, 0.0)
        field = self.sensor.operator(self.line, self.scan)
        traction = self.scene.traction(self.line, self.scan.direction, jnp.asarray(pressure))
        clean = jax.jit(lambda t: PositionInterpolation(self.line, samples.x)(field(t)))(traction)
        noisy, power, _ = with_noise(noises, samples, self.scan, clean, key)
        refuse(not bool(jnp.all(power > 0)), "There is no noise: give noise=[johnson].")
        x, signal, data, power = map(np.asarray, (samples.x, clean[0], noisy[0], power))
        return PitchRecord(x, signal, data, power, rate_hz / self.frequency_hz)

    def sweep(
        self,
        heights_m: Float[np.ndarray, " height"],
        pressures_Pa: Float[np.ndarray, " load"],
        other: Film,
    ) -> PitchSweep:
        """The waves at the pitch of the sensor's film over heights and nominal pressures, and of an
        `other` film."""
        height, load = float(self.ridges.height_m), float(self.scene.nominal_pressure_Pa)
        per_pitch = self.touch_load_closed_form / self.pitch_m
        points = [
            *((each, load) for each in heights_m),
            *((height, each) for each in pressures_Pa),
            *((height, each * per_pitch) for each in _TOUCH_LOADS),
            (height, load),
        ]
        size, pressure, gap, converged = self._waves(other, points)
        by_height, by_pressure = np.split(size[: -len(_TOUCH_LOADS) - 1, 0], [len(heights_m)])
        here = float(size[-1, 0]), float(size[-1, 1])
        own = pressure[-1], gap[-1], self._touch_load(gap[-len(_TOUCH_LOADS) - 1 : -1])
        return PitchSweep(*here, by_height, by_pressure, *own, bool(converged.all()))

    def _waves(self, other: Film, points: list[tuple[float, float]]) -> tuple[np.ndarray, ...]:
        """For `points` of height [m] and nominal pressure [Pa] the amplitude [V] of both films'
        waves (point, film), pressure and gap (point, n), and whether the contact converged."""
        both = Sensor((*self.sensor.elements, other), self.sensor.skin, self.sensor.amplifier)
        field = both.operator(self.line, self.scan)
        wave = round(self.line.n * float(self.line.cell_m) / self.pitch_m)

        def one(given):
            scene = eqx.tree_at(
                lambda own: (own.surface.shapes[0].height_m, own.nominal_pressure_Pa),
                self.scene,
                tuple(given),
            )
            contact: Contact = scene.contact(self.line)
            signal = field(scene.traction(self.line, self.scan.direction, contact.pressure_Pa))
            size = 2 * jnp.abs(jnp.fft.rfft(signal)[:, wave]) / self.line.n
            return size, contact.pressure_Pa, contact.gap_m, contact.converged

        solved = jax.jit(lambda given: jax.lax.map(one, given))(jnp.asarray(points, float))
        return tuple(np.asarray(each) for each in solved)

    @property
    def facts(self) -> dict[str, float | int | str]:
        """Ridges, contact, film and motion, as attributes of a dataset."""
        film = self.sensor.elements[0]
        return {
            "height_m": float(self.ridges.height_m),
            "pitch_m": self.pitch_m,
            "nominal_Pa": float(self.scene.nominal_pressure_Pa),
            "skin": self.scene.skin.words,
            "friction": float(self.scene.surface.base_friction),
            "depth_m": float(film.depth_m),
            "strips": int(film.strips),
            "strip_width_m": float(film.width_m),
            "speed_m_per_s": float(self.scan.speed_m_per_s),
        }

    @property
    def touch_load_closed_form(self) -> float:
        """Load per ridge [N/m] at which the skin reaches the plate between flat ridges."""
        half = np.sin(np.pi * float(self.ridges.width_m) / 2 / self.pitch_m)
        k = 2 * np.pi / self.pitch_m
        # E* of a half space
        plane = 2 / (k * float(np.abs(self.scene.skin.compliance(jnp.asarray([k]))[0])))
        return float(np.pi * plane * float(self.ridges.height_m) / (2 * np.arccosh(1 / half)))

    def _touch_load(self, gaps: Float[np.ndarray, "2 n"]) -> float:
        """The load of the closed form by contact: where the line through the gaps [m] between
        ridges at the `_TOUCH_LOADS` reaches zero."""
        loads = self.touch_load_closed_form * np.asarray(_TOUCH_LOADS)
        from_ridge = np.asarray((self.line.x - self.ridges.position_m) % self.pitch_m)
        between = gaps[:, np.abs(from_ridge - self.pitch_m / 2).argmin()]
        slope = (between[1] - between[0]) / (loads[1] - loads[0])
        return float(loads[1] - between[1] / slope)
