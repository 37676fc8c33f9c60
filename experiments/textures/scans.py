"""Simulated scans of rough surfaces, and the linear law from their heights to a sensor's signal.

In full contact p(k) = E* |k| h(k)/2 (docs/explanation/physics/contact.md), so that with q = mu p
known the signal's power is a gain times the density of heights.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from srsinv.compiled import compiled
from srsinv.errors import BadInput, number, refuse
from srsinv.forward.contact import press
from srsinv.forward.noise import Noise, total_spectrum
from srsinv.forward.noise import draw as draw_noise
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Rough
from srsinv.grid import Line, Periodic

from .texture import Bands, HeightSpectra, confusion, expected_power, height_spectra, tapered_power

FINEST = 0.9  # of the highest wavenumber: the sampling's own limit stays out of sight


class TextureScans(NamedTuple):
    """Scans of textures under several pressures, each of its own realisation and noise.

    - `signals`: with noise, in the amplifier's unit; `contact_fraction`: of the cells, the mean of
      the draws; `noise`: its power per sample.
    """

    signals: Float[np.ndarray, "contact texture draw n"]
    contact_fraction: Float[np.ndarray, "contact texture"]
    noise: Float[np.ndarray, " k"]

    @property
    def power(self) -> Float[np.ndarray, "contact texture draw k"]:
        """The signals' power per sample."""
        return np.abs(np.fft.rfft(self.signals)) ** 2 / self.signals.shape[-1]


class TextureSensor:
    """A sensor of one element on a periodic line, q = mu p known.

    - `lines`: those of the samples and of the simulated contact, `refinement` times finer.
    - `k` [rad/m] of the samples; `gain` (k,): the signal's power per sample of a unit density of
      heights, all in contact; `last`: the highest wavenumber [rad/m] to look at, below the first
      zero of the strip's response and the sampling's own limit.

    Raises `BadInput` for more than one element, a friction that is not known, and a line that is
    not periodic.
    """

    def __init__(
        self,
        lines: tuple[Line, Line],
        refinement: int,
        sensor: Sensor,
        scan: ConstantSpeed,
        skin: HalfSpace,
        mu: float | None,
    ):
        self.line, self.fine = lines
        self.scan, self.skin, self.refinement = scan, skin, refinement
        sensor.require_elements(1)
        if mu is None:
            raise BadInput("friction is null: give mu of q = mu p, such as friction=0.4.")
        refuse(
            not isinstance(self.line, Periodic),
            "grid.line is open, but a texture has no end: give grid.line=periodic.",
        )
        self.mu = mu
        self.cell_m, self.k = float(self.line.cell_m), np.asarray(self.line.k)
        self.unit = sensor.amplifier.unit
        stage = sensor.output(scan)
        transfer = np.asarray(stage.transfer(self.line.k))[0]
        stiffness = np.asarray(skin.contact_modulus_Pa) * self.k / 2
        self.gain = np.abs((transfer[0] + mu * transfer[1]) * stiffness) ** 2 / self.cell_m
        width = max(float(film.width_m) for film in sensor.elements)
        self.last = min(2 * np.pi / width, FINEST * self.k[-1])
        self._operator = self.fine.operator(stage)

    def scans(
        self,
        surfaces: Mapping[str, Rough],
        pressures_Pa: tuple[float, ...],
        draws: int,
        noises: tuple[Noise, ...],
        seed: int,
    ) -> TextureScans:
        """Simulated scans; the noise's level is that of the first pressure's signals."""
        seeds = np.random.SeedSequence(seed).generate_state(len(surfaces) * draws) >> 1
        seeds = seeds.reshape(len(surfaces), draws)
        heights = [
            [dataclasses.replace(surface, seed=int(s)).height(self.fine) for s in row]
            for surface, row in zip(surfaces.values(), seeds, strict=True)
        ]

        @compiled
        def signal_and_contact(height, nominal):
            p = press(self.fine, self.skin, height, nominal).pressure_Pa
            signal = self._operator(jnp.stack([p, self.mu * p]))[0, :: self.refinement]
            return signal, jnp.mean(p > 0)

        every = [signal_and_contact(height, jnp.asarray(pressure)) for pressure in pressures_Pa
                 for row in heights for height in row]  # fmt: skip
        shape = len(pressures_Pa), len(surfaces), draws
        clean, touching = (np.array(each).reshape(*shape, -1) for each in zip(*every, strict=True))
        rms = jnp.sqrt(jnp.mean(jnp.asarray(clean[0]) ** 2))
        spectrum = total_spectrum(noises, self.line, self.scan, rms)
        noise = draw_noise(jax.random.key(seed), spectrum, int(np.prod(shape)), self.line.n)
        noisy = clean + np.asarray(noise).reshape(clean.shape)
        return TextureScans(noisy, touching[..., 0].mean(axis=-1), np.asarray(spectrum))

    def spectra(
        self, scans: TextureScans, densities: Mapping[str, Float[np.ndarray, " k"]], count: int
    ) -> HeightSpectra:
        """Densities of height from scans, in up to `count` bands of wavenumber, beside the true
        `densities` of the surfaces. Raises `BadInput` where the noise hides one of them."""
        bands = Bands(self.k, self.gain, scans.noise, self.last, count)
        spectra = height_spectra(bands, scans.power, np.stack(list(densities.values())))
        rows = zip(densities, spectra.usable, strict=True)
        hidden = [name for name, row in rows if not row.any()]
        refuse(
            bool(hidden),
            f"The noise hides {', '.join(hidden)} at every wavenumber: give rougher surfaces in "
            "textures.surfaces, or less noise.",
        )
        return spectra

    def cells_in(self, stretch_m: Any) -> int:
        """The number of cells in a stretch of the line. Raises `BadInput` for fewer than four, and
        more than there are."""
        wanted, most = "a positive length within the line", self.line.n * self.cell_m
        least = 4 * self.cell_m
        stretch_m = number("textures.stretch_m", stretch_m, wanted, above=least, most=most)
        return int(stretch_m / self.cell_m)

    def confusions(
        self,
        scans: TextureScans,
        densities: Mapping[str, Float[np.ndarray, " k"]],
        samples: int,
        draws: int,
    ) -> Int[np.ndarray, "3 truth candidate"]:
        """How many of the first `draws` stretches of so many samples are taken for which surface:
        under the first pressure and under the second one by the law and the true `densities`, and
        under the second one by spectra learned from further draws."""
        pieces = tapered_power(scans.signals, samples)
        power = self.gain * np.stack(list(densities.values())) + scans.noise
        law = expected_power(power, self.line.n, samples)
        learned = pieces[1, :, draws:].mean(axis=1)
        cases = (pieces[0], law), (pieces[1], law), (pieces[1], learned)
        return np.stack([confusion(piece[:, :draws], references) for piece, references in cases])

    def density(self, surface: Rough) -> Float[np.ndarray, " k"]:
        """The surface's spectral density of height [m^3] at the line's wavenumbers."""
        k = jnp.arange(1, (self.fine.n + 1) // 2) * self.line.k[1]
        level = surface.rms_m**2 * self.line.n * self.cell_m / (2 * jnp.sum(surface.power(k)))
        return np.asarray(level * surface.power(self.line.k))
