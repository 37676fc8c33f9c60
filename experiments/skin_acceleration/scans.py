"""Simulated scans of textures by two sensors of one finger: films and a skin accelerometer."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from srsinv.compiled import compiled
from srsinv.errors import mapping, number, refuse
from srsinv.forward.contact import press
from srsinv.forward.noise import Noise, total_spectrum
from srsinv.forward.noise import draw as draw_noise
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.skin_accelerometer import AXES, SkinAccelerometer
from srsinv.forward.snap_back import SnapBackNoise
from srsinv.forward.surface import Rough
from srsinv.grid import Convolution, Line, Periodic, as_real

HIGHEST_FLOOR_PA = 1e5  # far above the pressure of a finger
ROUGH = ("rms_m", "longest_m", "shortest_m", "hurst")


class Texture(NamedTuple):
    """A kind of surface: its roughness, its coefficient of friction, and its bursts per second."""

    surface: Rough
    friction: float
    burst_rate_hz: float

    @classmethod
    def of_set(cls, name: str, common: Mapping[str, Any], differs: Any) -> "list[Texture]":
        """The textures of a set: `common`, but for the lists of values in `differs`.

        Raises `BadInput` for another key, lists that are none or of different lengths, and values
        out of range.
        """
        key = f"skin_acceleration.sets.{name}"
        lists = mapping(key, differs, f"lists of values of {', '.join(common)}")
        for each, values in lists.items():
            refuse(each not in common, f"{key} names {each}: choose from {', '.join(common)}.")
            refuse(
                not isinstance(values, list) or len(values) < 2,
                f"{key}.{each} is {values}: give a list of two or more values.",
            )
        lengths = {len(values) for values in lists.values()}
        refuse(
            len(lengths) != 1,
            f"{key} has lists of {sorted(lengths)} values: give each as many.",
        )
        return [
            cls.of(key, {**common, **{each: values[i] for each, values in lists.items()}})
            for i in range(lengths.pop())
        ]

    @classmethod
    def of(cls, key: str, given: Mapping[str, Any]) -> "Texture":
        """The texture that a mapping describes. Raises `BadInput` for values out of range."""
        friction = float(number(f"{key}.friction", given["friction"], "a number"))
        wanted = "a number of bursts per second, at least 0"
        rate = float(number(f"{key}.burst_rate_hz", given["burst_rate_hz"], wanted, least=0))
        return cls(Rough(*(given[each] for each in ROUGH)), friction, rate)


class Bursts(NamedTuple):
    """Bursts of stick-slip: rms shear over the nominal pressure, length [m], decay [s]."""

    shear_fraction: float
    patch_m: float
    decay_s: float


class Finger(NamedTuple):
    """Films and an accelerometer that slide over a periodic line; `lines` are those of the samples
    and of the simulated contact, `refinement` times finer."""

    lines: tuple[Periodic, Periodic]
    refinement: int
    sensor: Sensor
    accelerometer: SkinAccelerometer
    scan: ConstantSpeed
    skin: HalfSpace
    noises: tuple[Noise, ...]
    bursts: Bursts

    @classmethod
    def checked(cls, lines: tuple[Line, Line], *parts: Any) -> "Finger":
        """Raises `BadInput` for a line that is not periodic, a speed that is not positive, and a
        sensor without noise."""
        coarse, fine = lines
        if not isinstance(coarse, Periodic) or not isinstance(fine, Periodic):
            refuse(True, "grid.line is open, but a texture has no end: give grid.line=periodic.")
            raise AssertionError
        finger = cls((coarse, fine), *parts)
        finger.scan.require_onwards()
        refuse(
            not finger.noise_powers(1.0).sum(axis=-1).min() > 0,
            "A sensor without noise detects and classifies everything: give noise=[johnson], and "
            "accelerometer.noise_density_m_per_s2_per_rtHz above 0.",
        )
        return finger

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return float(self.scan.sample_rate_hz(self.lines[0]))

    @property
    def resonance_Hz(self) -> float:
        """Frequency of the accelerometer's undamped mass."""
        return float(self.accelerometer.resonance_rad_per_s) / (2 * np.pi)

    def pressed(
        self, texture: Texture, place: int, pressure_Pa: float, surfaces: int, spread: float
    ) -> Float[np.ndarray, "surface n"]:
        """Pressure [Pa] on the finer line under so many surfaces of a texture, the `place`-th of
        its set: the same ones at every nominal pressure."""
        rows = []
        for i in range(surfaces):
            random = np.random.default_rng([place, i])
            rms = texture.surface.rms_m * np.exp(spread * random.normal())
            seed = int(random.integers(2**31))
            surface = dataclasses.replace(texture.surface, rms_m=rms, seed=seed)
            rows.append(_pressed(surface, self.lines[1], self.skin, as_real(pressure_Pa)))
        return np.stack(rows)

    def scans(
        self,
        textures: Sequence[Texture],
        pressures: Float[np.ndarray, "texture surface n"],
        nominal_Pa: float,
        key: Any,
    ) -> Float[np.ndarray, "row texture surface m"]:
        """Signals with noise of the films, and of the accelerometer in the last row."""
        fine, texts = self.lines[1], len(textures)
        operators = (
            fine.operator(self.sensor.output(self.scan)),
            self.accelerometer.operator(fine, self.scan),
        )
        shear = self.bursts.shear_fraction * nominal_Pa
        signals, keys = [], jax.random.split(key, (texts, pressures.shape[1] + 1))
        for i, texture in enumerate(textures):
            bursts = SnapBackNoise.recorded_by(
                self.sensor, texture.burst_rate_hz, shear, self.bursts.patch_m,
                self.bursts.decay_s, self.accelerometer.contact_m,
            )  # fmt: skip
            signals.append(_signals(
                operators, self.accelerometer, bursts, self.lines[0], self.scan, self.refinement,
                jnp.asarray(pressures[i]), as_real(texture.friction), keys[i, 1:],
            ))  # fmt: skip
        clean = np.swapaxes(np.stack(signals), 1, 2)  # texture, row, surface, sample
        return np.swapaxes(clean + self._noise(clean, keys[:, 0]), 0, 1)

    def texture_power(self, pressures: Float[np.ndarray, "surface n"]) -> Float[np.ndarray, " k"]:
        """Power per sample [Pa^2] of the pressure on the finer line, the mean over surfaces."""
        power = np.mean(np.abs(np.fft.rfft(pressures)) ** 2, axis=0)
        power = power[: self.lines[0].n // 2 + 1] / (self.lines[1].n * self.refinement)
        power[0] = 0.0
        return power

    def transfers(self, friction: float) -> Complex[np.ndarray, "k row"]:
        """Signals of the films and of an accelerometer of either axis, over the pressure p of a
        texture with q = mu p."""
        stages = [self.sensor.output(self.scan)]
        stages += [self.on(axis).output(self.scan) for axis in AXES]
        both = np.concatenate([np.asarray(each.transfer(self.lines[0].k)) for each in stages])
        return (both[:, 0] + friction * both[:, 1]).T

    def on(self, axis: str) -> SkinAccelerometer:
        """The accelerometer mounted along another axis."""
        return dataclasses.replace(self.accelerometer, axis=axis)

    def floors(
        self, friction: float
    ) -> tuple[Float[np.ndarray, " band"], Float[np.ndarray, "reading band"]]:
        """Wavenumbers [rad/m], and the rms pressure [Pa] of a texture that equals the noise in 1
        Hz, of the first film and of an accelerometer of either axis.

        Means of the power over a twelfth of the wavenumber: a contact has as many zeros of its
        response as waves. NaN above `HIGHEST_FLOOR_PA`.
        """
        k = np.asarray(self.lines[0].k)
        edges = np.unique(np.round(np.geomspace(1, k.size, int(12 * np.log(k.size)))).astype(int))
        count = np.diff(edges)

        def mean(values):
            return np.add.reduceat(values[: edges[-1]], edges[:-1], axis=0) / count

        gain = np.abs(self.transfers(friction)[:, [0, -2, -1]]) ** 2
        film, mass = self.noise_powers(0.0)
        # A power per sample covers half of the rate.
        noise = np.stack([film, mass, mass]) / (self.rate_hz / 2)
        floor = np.array([np.sqrt(mean(n) / mean(g)) for n, g in zip(noise, gain.T, strict=True)])
        return mean(k), np.where(floor < HIGHEST_FLOOR_PA, floor, np.nan)

    def noise_powers(self, film_rms: float) -> Float[np.ndarray, "2 k"]:
        """Power per sample of the noise of a film, and of an accelerometer."""
        line = self.lines[0]
        film = np.asarray(total_spectrum(self.noises, line, self.scan, film_rms))
        rms = float(self.accelerometer.noise_rms_m_per_s2(self.rate_hz))
        return np.stack([film, np.full(film.shape, rms**2)])

    def _noise(self, clean, keys) -> Float[np.ndarray, "texture row surface m"]:
        """Noise of signals (texture, row, surface, sample)."""
        film_rms = float(np.sqrt(np.mean(clean[:, :-1] ** 2)))
        film, mass = self.noise_powers(film_rms)
        rows, (surfaces, n) = clean.shape[1], clean.shape[2:]
        powers = jnp.asarray(np.stack([film] * (rows - 1) + [mass]))
        return np.stack([
            np.stack([np.asarray(draw_noise(jax.random.fold_in(key, row), powers[row], surfaces, n))
                      for row in range(rows)])
            for key in keys
        ])  # fmt: skip


@compiled
def _pressed(surface: Rough, line: Line, skin: HalfSpace, nominal) -> Float[Any, " n"]:
    return press(line, skin, surface.height(line), nominal).pressure_Pa


@compiled
def _signals(
    operators: tuple[Convolution, Convolution],
    accelerometer: SkinAccelerometer,
    bursts: SnapBackNoise,
    line: Line,
    scan: ConstantSpeed,
    refinement: int,
    pressures,
    friction,
    keys,
) -> Float[Any, "surface row m"]:
    """Signals without noise: of the texture, and of bursts that both sensors have in common."""
    film, mass = operators

    def one(given):
        p, key = given
        traction = jnp.stack([p, friction * p])
        texture = jnp.concatenate([film(traction), mass(traction)])[:, ::refinement]
        shared = (bursts.draw(key, line, scan, as_real(1.0)),
                  accelerometer.events(bursts, key, line, scan))  # fmt: skip
        return texture + jnp.concatenate(shared)

    return jax.lax.map(one, (pressures, keys))
