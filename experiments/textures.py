"""Rough surfaces: their spectra from the signal, and classification by them."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray

from srsinv import config
from srsinv.errors import BadInput, mapping, number, refuse, whole
from srsinv.forward.contact import press
from srsinv.forward.noise import Noise, total_spectrum
from srsinv.forward.noise import draw as draw_noise
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Rough
from srsinv.grid import Line, Periodic
from srsinv.inverse.texture import Bands, expected_power, nearest, tapered_power
from srsinv.progress import stage
from srsinv.report.figures import textures as draw
from srsinv.report.outcome import Outcome, Section, Table
from srsinv.report.text import listed
from srsinv.targets import make

CONTACTS = ("full", "light")
CLASSIFICATIONS = {  # contact of the stretches, and their references
    "pressed full, linear law": (0, "law"),
    "pressed lightly, linear law": (1, "law"),
    "pressed lightly, learned": (1, "learned"),
}


@dataclass(frozen=True)
class TextureSettings:
    """`textures` of the configuration: the pressures of full and of light contact, the numbers of
    draws of each texture, of further ones to learn from, and of bands of wavenumber."""

    pressures_Pa: tuple[float, float]
    draws: int
    learning_draws: int
    bands: int

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> "TextureSettings":
        """Those given. Raises `BadInput` for numbers out of range."""
        counts = [
            whole(f"textures.{key}", given[key], "a whole number from 1", least=1)
            for key in ("draws", "learning_draws", "bands")
        ]
        full, light = (
            number(f"textures.{key}", given[key], "a positive pressure in Pa", above=0)
            for key in ("pressure_Pa", "light_pressure_Pa")
        )
        return cls((full, light), *counts)


class Slid(NamedTuple):
    """Scans of each texture: noisy `signals` (contact, texture, draw, x), those after `draws` for
    learning; the `contact_fraction` that touches (contact, texture); and the true density of
    heights, `truth` (texture, k) [m^3]."""

    texture_sensor: "TextureSensor"
    names: list[str]
    signals: np.ndarray
    contact_fraction: np.ndarray
    truth: np.ndarray
    draws: int
    samples: int


class Spectra(NamedTuple):
    """Densities of height [m^3] in bands of wavenumber, by the linear law.

    `densities`, with its band of 90 % from `low` to `high` (contact, texture, draw, band); `mean`
    of the draws (contact, texture, band); `expected`, and whether it is `usable` (texture, band),
    with its `limits` (texture, end) [rad/m]. `ratio` (contact, texture): estimated power over the
    true one.
    """

    middle: np.ndarray
    power: np.ndarray
    densities: np.ndarray
    low: np.ndarray
    high: np.ndarray
    mean: np.ndarray
    expected: np.ndarray
    usable: np.ndarray
    limits: np.ndarray
    ratio: np.ndarray

    @property
    def coverage(self) -> float:
        """Fraction of bands in full contact that hold the expected density."""
        expected = self.expected[:, None]
        inside = (self.low[0] <= expected) & (expected <= self.high[0])
        return float(inside[np.broadcast_to(self.usable[:, None], inside.shape)].mean())


def run(cfg: config.Config) -> Outcome:
    """Spectra of the heights by dividing the signal's by the sensor's, and a confusion matrix.

    Raises `BadInput` for surfaces that are not rough, a friction that is not known, more than one
    element, and numbers out of range.
    """
    given, seed = cfg["textures"], config.seed(cfg)
    named = mapping("textures.surfaces", given["surfaces"])
    refuse(len(named) < 2, f"textures.surfaces names {len(named)}: give two or more rough ones.")
    settings = TextureSettings.checked(given)
    with config.precision(cfg):
        surfaces = {
            name: make(node, f"textures.surfaces.{name}", "rough") for name, node in named.items()
        }
        refinement = int(config.part(cfg, "grid")["refinement"])
        lines = config.line(cfg), config.line(cfg, refinement)
        parts = config.sensor(cfg), config.scan(cfg), config.noises(cfg)
        skin = make(cfg["skin"], "skin", "half_space")
        texture_sensor = TextureSensor(*lines, refinement, *parts, skin, config.friction(cfg))
        slid = _slid(texture_sensor, surfaces, settings, _samples(given, texture_sensor), seed)
    spectra = _spectra(slid, settings.bands)
    chosen = _chosen(slid)
    metrics = _metrics(slid, spectra, chosen)
    dataset = _dataset(slid, spectra, chosen)
    assumed = (
        f"Half space; q = {cfg['friction']} p everywhere, known; periodic line, the data from "
        f"cells {refinement} times finer; noise: {', '.join(cfg['noise'])}, its power known; "
        f"effects on: {listed(cfg['effects'])}."
    )
    return Outcome(
        "Textures by the spectrum of their signal",
        metrics,
        dataset,
        _sections(dataset, settings, metrics, assumed),
        _table(slid, spectra, chosen),
    )


def _samples(given: Mapping[str, Any], texture_sensor: "TextureSensor") -> int:
    """The number of cells in a stretch."""
    stretch = number(
        "textures.stretch_m",
        given["stretch_m"],
        "a positive length within the line",
        above=4 * texture_sensor.cell_m,
        most=texture_sensor.line.n * texture_sensor.cell_m,
    )
    return int(stretch / texture_sensor.cell_m)


def _slid(
    texture_sensor: "TextureSensor",
    surfaces: Mapping[str, Rough],
    settings: TextureSettings,
    samples: int,
    seed: int,
) -> Slid:
    draws = settings.draws
    with stage("sliding over the textures"):
        signals, contact_fraction = texture_sensor.signals(
            surfaces, settings.pressures_Pa, draws + settings.learning_draws, seed
        )
    truth = np.stack([texture_sensor.density(surface) for surface in surfaces.values()])
    names = list(surfaces)
    return Slid(texture_sensor, names, signals, contact_fraction, truth, draws, samples)


def _spectra(slid: Slid, count: int) -> Spectra:
    """Spectra from whole windows."""
    texture_sensor, draws = slid.texture_sensor, slid.draws
    bands = Bands(
        texture_sensor.k,
        texture_sensor.gain,
        texture_sensor.noise,
        texture_sensor.blind_from,
        count,
    )
    power = np.abs(np.fft.rfft(slid.signals)) ** 2 / texture_sensor.line.n
    expected = bands.average(slid.truth)
    usable = bands.usable(power[0, :, :draws].mean(axis=1))
    hidden = ~usable.any(axis=-1)
    refuse(
        bool(hidden.any()),
        f"The noise hides {', '.join(np.array(slid.names)[hidden])} at every "
        "wavenumber: give rougher surfaces in textures.surfaces, or less noise.",
    )
    mean = bands.density(power[:, :, :draws].mean(axis=2))[0]
    weights = usable * bands.sum(texture_sensor.gain)
    densities, low, high = bands.density(power[:, :, :draws])
    return Spectra(
        middle=bands.middle,
        power=power,
        densities=densities,
        low=low,
        high=high,
        mean=mean,
        expected=expected,
        usable=usable,
        limits=np.stack([bands.limits(row) for row in usable]),
        ratio=np.sum(weights * mean, axis=-1) / np.sum(weights * expected, axis=-1),
    )


def _chosen(slid: Slid) -> np.ndarray:
    """Classification of short stretches by the nearest known spectrum: counts (classification,
    texture, texture)."""
    texture_sensor, draws = slid.texture_sensor, slid.draws
    pieces = tapered_power(slid.signals, slid.samples)
    law = expected_power(
        texture_sensor.gain * slid.truth + texture_sensor.noise, texture_sensor.line.n, slid.samples
    )
    references = {"law": law, "learned": pieces[1, :, draws:].mean(axis=1)}
    return np.stack([
        _counted(nearest(pieces[contact, :, :draws], references[kind]))
        for contact, kind in CLASSIFICATIONS.values()
    ])  # fmt: skip


def _accuracy(chosen: np.ndarray) -> np.ndarray:
    return np.trace(chosen, axis1=1, axis2=2) / chosen.sum(axis=(1, 2))


def _metrics(slid: Slid, spectra: Spectra, chosen: np.ndarray) -> dict[str, Any]:
    metrics: dict[str, Any] = {
        "draws": slid.draws,
        "stretch_m": slid.samples * slid.texture_sensor.cell_m,
    }
    kinds = ("", "_light_linear_law", "_light_learned")
    for kind, value in zip(kinds, _accuracy(chosen), strict=True):
        metrics[f"accuracy{kind}"] = float(value)
    metrics["coverage_90"] = spectra.coverage
    for t, name in enumerate(slid.names):
        shortest = float(spectra.limits[t, 1])
        metrics[f"limit_wavenumber_{name}_rad_per_m"] = shortest
        metrics[f"limit_wavelength_{name}_m"] = 2 * np.pi / shortest
        for c, contact in enumerate(CONTACTS):
            metrics[f"height_power_ratio_{contact}_{name}"] = float(spectra.ratio[c, t])
            metrics[f"contact_fraction_{contact}_{name}"] = float(slid.contact_fraction[c, t])
    return metrics


def _dataset(slid: Slid, spectra: Spectra, chosen: np.ndarray) -> xarray.Dataset:
    texture_sensor, of = slid.texture_sensor, ("contact", "texture", "band")
    variables = {
        "height_density": (of, spectra.densities[:, :, 0], "m^3"),
        "height_density_low": (of, spectra.low[:, :, 0], "m^3"),
        "height_density_high": (of, spectra.high[:, :, 0], "m^3"),
        "height_density_mean": (of, spectra.mean, "m^3"),
        "height_density_expected": (("texture", "band"), spectra.expected, "m^3"),
        "height_density_true": (("texture", "wavenumber"), slid.truth, "m^3"),
        "usable": (("texture", "band"), spectra.usable.astype(np.int8), "1"),
        "limits": (("texture", "end"), spectra.limits, "rad/m"),
        "signal": (("contact", "texture", "x"), slid.signals[:, :, 0], texture_sensor.unit),
        "signal_power": (
            (*of[:2], "wavenumber"),
            spectra.power[:, :, 0],
            f"({texture_sensor.unit})^2",
        ),
        "noise_power": (("wavenumber",), texture_sensor.noise, f"({texture_sensor.unit})^2"),
        "contact_fraction": (("contact", "texture"), slid.contact_fraction, "1"),
        "chosen": (("classification", "truth", "candidate"), chosen, "1"),
        "accuracy": (("classification",), _accuracy(chosen), "1"),
    }
    coordinates = {
        "contact": (list(CONTACTS), "1"),
        "texture": (slid.names, "1"),
        "truth": (slid.names, "1"),
        "candidate": (slid.names, "1"),
        "classification": (list(CLASSIFICATIONS), "1"),
        "x": (np.asarray(texture_sensor.line.x), "m"),
        "wavenumber": (texture_sensor.k, "rad/m"),
        "band": (spectra.middle, "rad/m"),
        "end": (["longest", "shortest"], "1"),
    }
    return xarray.Dataset(
        {name: (dims, values, {"units": u}) for name, (dims, values, u) in variables.items()},
        {name: (name, values, {"units": u}) for name, (values, u) in coordinates.items()},
    )


def _table(slid: Slid, spectra: Spectra, chosen: np.ndarray) -> Table:
    right = zip(CLASSIFICATIONS, _accuracy(chosen), strict=True)
    return Table(
        ("texture", "shortest wavelength [mm]", "touches, full", "power over true, full",
         "touches, light", "power over true, light"),
        tuple(
            (name, f"{2e3 * np.pi / limit:.3g}", f"{full:.0%}", full_ratio, f"{light:.0%}",
             light_ratio)
            for name, limit, full, full_ratio, light, light_ratio in zip(
                slid.names, spectra.limits[:, 1], slid.contact_fraction[0],
                spectra.ratio[0], slid.contact_fraction[1],
                spectra.ratio[1], strict=True,
            )
        ),
        "; ".join(f"right, {case}: {accuracy:.0%}" for case, accuracy in right) + ".",
    )  # fmt: skip


class TextureSensor:
    """The sensor on a line, q = mu p known: signals of surfaces, and their spectra.

    Signals come from cells of the line `fine`, `refinement` times as many. Raises `BadInput` for
    more than one element, a friction that is not known, and a line that is not periodic.
    """

    def __init__(
        self,
        line: Line,
        fine: Line,
        refinement: int,
        sensor: Sensor,
        scan: ConstantSpeed,
        noises: tuple[Noise, ...],
        skin: HalfSpace,
        mu: float | None,
    ):
        self.line, self.fine, self.refinement = line, fine, refinement
        self.sensor, self.scan, self.noises, self.skin = sensor, scan, noises, skin
        elements = len(sensor.elements)
        refuse(elements != 1, f"sensor has {elements} elements: give 1, use sensor=one_element.")
        if mu is None:
            raise BadInput("friction is null: give mu of q = mu p, such as 0.4.")
        refuse(
            not isinstance(line, Periodic),
            "grid.line is open: a texture has no end, use grid.line=periodic.",
        )
        self.cell_m, self.k = float(self.line.cell_m), np.asarray(self.line.k)
        self.unit = self.sensor.amplifier.unit
        stage = self.sensor.output(self.scan)
        transfer = np.asarray(stage.transfer(self.line.k))[0]
        # Signal power per sample of a unit density of height, all in contact.
        stiffness = np.asarray(self.skin.contact_modulus_Pa) * self.k / 2
        self.gain = np.abs((transfer[0] + mu * transfer[1]) * stiffness) ** 2 / self.cell_m
        # Up to the first zero of the strip's response, and well within the sampling.
        widths = [float(film.width_m) for film in self.sensor.elements]
        self.blind_from = min(2 * np.pi / max(widths), 0.9 * self.k[-1])
        operator = self.fine.operator(stage)

        @eqx.filter_jit
        def signal_and_contact(height, nominal):
            p = press(self.fine, self.skin, height, nominal).pressure_Pa
            signal = operator(jnp.stack([p, mu * p]))[0, :: self.refinement]
            return signal, jnp.mean(p > 0)

        self._signal_and_contact = signal_and_contact

    def signals(self, surfaces, pressures, draws: int, seed: int):
        """Noisy signals (contact, texture, draw, x), each of its own realisation and noise, and the
        contact fraction (contact, texture)."""
        seeds = np.random.SeedSequence(seed).generate_state(len(surfaces) * draws) >> 1
        seeds = seeds.reshape(len(surfaces), draws)
        heights = [
            [dataclasses.replace(surface, seed=int(s)).height(self.fine) for s in row]
            for surface, row in zip(surfaces.values(), seeds, strict=True)
        ]
        simulated = [
            [[self._signal_and_contact(h, jnp.asarray(p)) for h in row] for row in heights]
            for p in pressures
        ]
        clean = np.array([[[signal for signal, _ in row] for row in each] for each in simulated])
        contact_fraction = np.array(
            [[[touch for _, touch in row] for row in each] for each in simulated]
        )
        spectrum = total_spectrum(
            self.noises, self.line, self.scan, jnp.sqrt(jnp.mean(jnp.asarray(clean[0]) ** 2))
        )
        self.noise = np.asarray(spectrum)
        flat = clean.reshape(-1, self.line.n)
        noise = draw_noise(jax.random.key(seed), spectrum, *flat.shape)
        return clean + np.asarray(noise).reshape(clean.shape), contact_fraction.mean(axis=-1)

    def density(self, surface: Rough) -> np.ndarray:
        """The surface's spectral density of height [m^3] at the line's wavenumbers."""
        k = jnp.arange(1, (self.fine.n + 1) // 2) * self.line.k[1]
        level = surface.rms_m**2 * self.line.n * self.cell_m / (2 * jnp.sum(surface.power(k)))
        return np.asarray(level * surface.power(self.line.k))


def _counted(chosen: np.ndarray) -> np.ndarray:
    """Number of draws (texture, draw) assigned to each texture."""
    return np.stack([np.bincount(row, minlength=len(chosen)) for row in chosen])


def _sections(
    ds: xarray.Dataset, settings: TextureSettings, metrics, assumed: str
) -> tuple[Section, ...]:
    full, light = (f"{1e-3 * pressure:g} kPa" for pressure in settings.pressures_Pa)
    return (
        Section(
            "Signals",
            (f"Each texture under {full}, where the skin touches everywhere or nearly, and under "
             f"{light}, where it touches the summits.",),
            {"texture_signals": lambda: draw.signals(ds)},
            {"texture_signals": "One realisation of each texture, with noise."},
        ),
        Section(
            "Spectra of the heights",
            ("The signal's power less that of the noise, over the sensor's gain squared, is the "
             "power of p; in full contact p(k) = E* |k| h(k)/2, so that the heights' follows. "
             "Averaged over bands of wavenumber; the band of 90 % is chi-square's, two degrees of "
             f"freedom for each wave. Over all draws it covers {metrics['coverage_90']:.0%}.",
             "Beyond the limits the noise is more than the signal: a rate feels little of long "
             "waves, and the depth takes away short ones. Bands end at the wavelength of the "
             "strip's width, to which it is blind.",
             "Where the skin touches the summits alone the law does not hold: the recovered power "
             "is too low, by the ratios in the table."),
            {"texture_spectra": lambda: draw.spectra(ds)},
            {"texture_spectra": "Bars: one recording and its 90 % band, full contact. Diamonds: "
             "the same law under light pressure, mean over the draws."},
        ),
        Section(
            "Told apart",
            (f"Stretches of {1e3 * metrics['stretch_m']:.3g} mm, each of a new realisation with "
             "new noise, under a Hann window, go to the texture under whose spectrum they are most "
             "likely (Whittle's likelihood). Spectra come from the linear law and the known "
             "texture, or were learned from other stretches under the same pressure.",),
            {"texture_confusion": lambda: draw.confusion(ds)},
            {"texture_confusion": "Rows: what was there; columns: what was chosen."},
        ),
        Section("What was assumed", (assumed,)),
    )  # fmt: skip
