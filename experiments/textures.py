"""Rough surfaces: their spectra from the signal, and classification by them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import mapping, number, refuse, whole
from srsinv.inverse.texture import (
    Bands,
    confusion,
    expected_power,
    height_spectra,
    tapered_power,
)
from srsinv.inverse.texture_scans import TextureScans, TextureSensor
from srsinv.progress import stage
from srsinv.report.result import Result, dataset, scalars
from srsinv.report.section import sections
from srsinv.report.text import listed
from srsinv.targets import make

CONTACTS = {"full": "pressure_Pa", "light": "light_pressure_Pa"}  # and the key of each pressure
CLASSIFICATIONS = {  # and the end of its accuracy's name in metrics.json
    "pressed full, linear law": "",
    "pressed lightly, linear law": "_light_linear_law",
    "pressed lightly, learned": "_light_learned",
}
Variables = dict[str, tuple[Any, ...]]


def run(cfg: config.Config) -> Result:
    """Spectra of the heights by dividing the signal's by the sensor's, and confusion matrices.

    Raises `BadInput` for surfaces that are not rough, a friction that is not known, more than one
    element, and numbers out of range.
    """
    given = cfg["textures"]
    named = mapping("textures.surfaces", given["surfaces"])
    refuse(len(named) < 2, f"textures.surfaces names {len(named)}: give two or more rough ones.")
    draws, learning, bands = (_count(given, key) for key in ("draws", "learning_draws", "bands"))
    pressures = tuple(_pressure(given, key) for key in CONTACTS.values())
    with config.precision(cfg):
        surfaces = {
            name: make(node, f"textures.surfaces.{name}", "rough") for name, node in named.items()
        }
        refinement = int(config.part(cfg, "grid")["refinement"])
        lines = config.line(cfg), config.line(cfg, refinement)
        skin = make(cfg["skin"], "skin", "half_space")
        parts = config.sensor(cfg), config.scan(cfg), skin, config.friction(cfg)
        sensor = TextureSensor(lines, refinement, *parts)
        samples = _samples(given["stretch_m"], sensor)
        with stage("sliding over the textures"):
            count, noises = draws + learning, config.noises(cfg)
            scans = sensor.scans(surfaces, pressures, count, noises, config.seed(cfg))
        truth = np.stack([sensor.density(surface) for surface in surfaces.values()])

    power = np.abs(np.fft.rfft(scans.signals)) ** 2 / sensor.line.n
    in_bands = Bands(sensor.k, sensor.gain, scans.noise, sensor.last, bands)
    spectra = height_spectra(in_bands, power[:, :, :draws], truth)
    _check_visible(surfaces, spectra.usable)
    chosen = _classified(sensor, scans, truth, samples, draws)
    accuracy = np.trace(chosen, axis1=1, axis2=2) / chosen.sum(axis=(1, 2))
    numbers = {
        "draws": draws, "stretch_m": samples * sensor.cell_m, "coverage_90": spectra.coverage,
    }  # fmt: skip
    variables = _scanned(sensor, scans, power[:, :, 0]) | {
        "height_density_true": (("texture", "wavenumber"), truth, "m^3"),
        "chosen": (("classification", "truth", "candidate"), chosen, "1"),
        "accuracy": ("classification", accuracy, "1", "accuracy{accuracy_of}"),
    }
    data = dataset(
        variables | _heights(spectra) | scalars(numbers),
        _coordinates(list(surfaces), sensor, in_bands),
        **{f"pressure_{name}_Pa": each for name, each in zip(CONTACTS, pressures, strict=True)},
        friction=sensor.mu,
        refinement=sensor.refinement,
        noise=", ".join(cfg["noise"]),
        effects_on=listed(cfg["effects"]),
    )
    for name, words in (("truth", "true texture"), ("candidate", "chosen")):
        data[name].attrs["long_name"] = words
    right = [f"{100 * each:.0f} %" for each in accuracy]
    title = (
        f"Textures by the spectrum of {1e3 * numbers['stretch_m']:.3g} mm: {right[0]} right in "
        f"full contact, {right[2]} under light pressure"
    )
    return Result(title, data, sections(__file__, spectra=height_densities))


def _classified(
    sensor: TextureSensor, scans: TextureScans, truth: np.ndarray, samples: int, draws: int
) -> np.ndarray:
    """Short stretches of each texture by the nearest reference, of the law and the known texture
    or learned from further draws: counts (classification, texture, texture)."""
    pieces = tapered_power(scans.signals, samples)
    law = expected_power(sensor.gain * truth + scans.noise, sensor.line.n, samples)
    learned = pieces[1, :, draws:].mean(axis=1)
    cases = (pieces[0], law), (pieces[1], law), (pieces[1], learned)
    return np.stack([confusion(piece[:, :draws], references) for piece, references in cases])


def _scanned(sensor: TextureSensor, scans: TextureScans, power: np.ndarray) -> Variables:
    """The first scan of each texture, and the noise."""
    of, unit = ("contact", "texture"), sensor.unit
    name = "contact_fraction_{contact}_{texture}"
    return {
        "signal": ((*of, "x"), scans.signals[:, :, 0], unit),
        "signal_power": ((*of, "wavenumber"), power, f"({unit})^2"),
        "noise_power": ("wavenumber", scans.noise, f"({unit})^2"),
        "contact_fraction": (of, scans.contact_fraction, "1", name),
    }


def height_densities(ds: xarray.Dataset) -> Figure:
    """Density of heights: true, from one recording with its band, and under light pressure."""
    k, band, low_k = ds["wavenumber"].values[1:], ds["band"].values, ds["band"].values[0] / 1.5
    density, low, high = (
        ds[f"height_density{end}"].sel(contact="full").values for end in ("", "_low", "_high")
    )
    light, usable = ds["height_density_mean"].sel(contact="light").values, ds["usable"].values == 1
    shown = np.concatenate([each[usable] for each in (low, high, light)])
    shown = shown[shown > 0]
    across = plot.PanelAxis("wavenumber k", "rad/m", True, (low_k, 1.3 * band[-1]))
    up = plot.PanelAxis("density of height", "m^3", True, (shown.min() / 5, 5 * shown.max()))
    dots = {"linestyle": "none", "markersize": 4}
    parts = []
    for t, name in enumerate(ds["texture"].values):
        truth = ds["height_density_true"].values[t, 1:]
        curves = [plot.Curve(np.where(truth > 0, truth, np.nan), "true", look={"color": "#000000"})]
        for which, label, colour in (
            (usable[t], "full contact, one recording, 90 %", "#0072b2"),
            (~usable[t], "the same, less signal than noise", "#b5bcc2"),
        ):
            positive = which & (density[t] > 0)
            ends = np.where(positive, low[t], np.nan), np.where(positive, high[t], np.nan)
            look = {**dots, "color": colour, "marker": "o"}
            middle = np.where(positive, density[t], np.nan)
            curves.append(plot.Curve(middle, label, x=band, band=ends, has_bars=True, look=look))
        look = {**dots, "color": "#d55e00", "marker": "D"}
        mean = np.where(usable[t], light[t], np.nan)
        curves.append(plot.Curve(mean, "light pressure, mean of the draws", x=band, look=look))
        parts.append(plot.Panel(curves, across, up, k, str(name).capitalize()))
    return plot.panels([parts], height_in=3.4)


def _heights(spectra) -> Variables:
    """The estimated densities, of one recording and of the mean."""
    of, shortest = ("contact", "texture", "band"), spectra.limits[:, 1]
    return {
        "height_density": (of, spectra.densities[:, :, 0], "m^3"),
        "height_density_low": (of, spectra.low[:, :, 0], "m^3"),
        "height_density_high": (of, spectra.high[:, :, 0], "m^3"),
        "height_density_mean": (of, spectra.mean, "m^3"),
        "height_density_expected": (of[1:], spectra.expected, "m^3"),
        "usable": (of[1:], spectra.usable.astype(np.int8), "1"),
        "limits": (("texture", "end"), spectra.limits, "rad/m"),
        "limit_wavenumber": ("texture", shortest, "rad/m",
                             "limit_wavenumber_{texture}_rad_per_m"),
        "limit_wavelength": ("texture", 2 * np.pi / shortest, "m",
                             "limit_wavelength_{texture}_m"),
        "height_power_ratio": (of[:2], spectra.ratio, "1",
                               "height_power_ratio_{contact}_{texture}"),
    }  # fmt: skip


def _coordinates(names: list[str], sensor: TextureSensor, bands: Bands) -> Variables:
    return {
        "contact": (list(CONTACTS), "1"),
        "texture": (names, "1"),
        "truth": (names, "1"),
        "candidate": (names, "1"),
        "classification": (list(CLASSIFICATIONS), "1"),
        "accuracy_of": ("classification", list(CLASSIFICATIONS.values()), "1"),
        "x": (np.asarray(sensor.line.x), "m"),
        "wavenumber": (sensor.k, "rad/m"),
        "band": (bands.middle, "rad/m"),
        "end": (["longest", "shortest"], "1"),
    }


def _count(given: Mapping[str, Any], key: str) -> int:
    return whole(f"textures.{key}", given[key], "a whole number from 1", least=1)


def _pressure(given: Mapping[str, Any], key: str) -> float:
    return number(f"textures.{key}", given[key], "a positive pressure in Pa", above=0)


def _samples(stretch_m: Any, sensor: TextureSensor) -> int:
    """The number of cells in a stretch."""
    wanted, cell_m = "a positive length within the line", sensor.cell_m
    most = sensor.line.n * cell_m
    stretch = number("textures.stretch_m", stretch_m, wanted, above=4 * cell_m, most=most)
    return int(stretch / cell_m)


def _check_visible(names, usable: np.ndarray) -> None:
    hidden = [name for name, row in zip(names, usable, strict=True) if not row.any()]
    refuse(
        bool(hidden),
        f"The noise hides {', '.join(hidden)} at every wavenumber: give rougher surfaces in "
        "textures.surfaces, or less noise.",
    )
