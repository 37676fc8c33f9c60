"""Rough surfaces: their spectra from the signal, and classification by them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.errors import mapping, number, refuse, whole
from srsinv.progress import stage
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed
from srsinv.targets import make

from .figures import height_densities
from .scans import TextureScans, TextureSensor
from .texture import HeightSpectra

CONTACTS = {"full": "pressure_Pa", "light": "light_pressure_Pa"}  # and the key of each pressure
CLASSIFICATIONS = {  # and the end of its accuracy's name in metrics.json
    "pressed full, linear law": "",
    "pressed lightly, linear law": "_light_linear_law",
    "pressed lightly, learned": "_light_learned",
}


def run(cfg: config.Config) -> Result:
    """Spectra of the heights by dividing the signal's by the sensor's, and confusion matrices.

    Raises `BadInput` for surfaces that are not rough, a friction that is not known, more than one
    element, and numbers out of range.
    """
    given = cfg["textures"]
    named = mapping("textures.surfaces", given["surfaces"])
    refuse(len(named) < 2, f"textures.surfaces names {len(named)}: give two or more rough ones.")
    (draws, learning, bands), pressures = _settings(given)
    with config.precision(cfg):
        surfaces = {
            name: make(node, f"textures.surfaces.{name}", "rough") for name, node in named.items()
        }
        times, skin = int(cfg["grid"]["refinement"]), make(cfg["skin"], "skin", "half_space")
        lines = config.line(cfg), config.line(cfg, times)
        parts = config.sensor(cfg), config.scan(cfg), skin, config.friction(cfg)
        sensor = TextureSensor(lines, times, *parts)
        samples = sensor.cells_in(given["stretch_m"])
        with stage("sliding over the textures"):
            noise = config.noises(cfg), config.seed(cfg)
            scans = sensor.scans(surfaces, tuple(pressures.values()), draws + learning, *noise)
        truth = {name: sensor.density(surface) for name, surface in surfaces.items()}
    drawn = scans._replace(signals=scans.signals[:, :, :draws])
    spectra = sensor.spectra(drawn, truth, bands)
    chosen = sensor.confusions(scans, truth, samples, draws)
    numbers = {"draws": draws, "stretch_m": samples * sensor.cell_m}
    data = _dataset(sensor, drawn, truth, spectra, chosen).assign(dataset(scalars(numbers), {}))
    data = data.assign_attrs(
        **{f"pressure_{name}_Pa": each for name, each in pressures.items()}, friction=sensor.mu,
        refinement=times, noise=", ".join(cfg["noise"]), effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    full, _, learned = (f"{100 * each:.0f} %" for each in data["accuracy"].values)
    title = f"Spectra of {1e3 * numbers['stretch_m']:.3g} mm classify {full} of the textures "
    title += f"correctly in full contact, {learned} in light contact"
    return Result(title, data, sections(__file__, spectra=height_densities))


def _settings(given: Mapping[str, Any]) -> tuple[list[int], dict[str, float]]:
    """Counts of draws, of further ones and of bands; the pressures by their names."""
    counts = [whole(f"textures.{key}", given[key], "a whole number from 1", least=1)
              for key in ("draws", "learning_draws", "bands")]  # fmt: skip
    wanted = "a positive pressure in Pa"
    pressures = {name: number(f"textures.{key}", given[key], wanted, above=0)
                 for name, key in CONTACTS.items()}  # fmt: skip
    return counts, pressures


def _dataset(
    sensor: TextureSensor,
    scans: TextureScans,
    truth: Mapping[str, np.ndarray],
    spectra: HeightSpectra,
    chosen: np.ndarray,
) -> xarray.Dataset:
    """The first scan of each texture, the densities estimated from it, and the counts."""
    of, names, unit = ("contact", "texture"), list(truth), sensor.unit
    right = np.trace(chosen, axis1=1, axis2=2) / chosen.sum(axis=(1, 2))
    data = dataset(
        {
            "signal": ((*of, "x"), scans.signals[:, :, 0], unit),
            "signal_power": ((*of, "wavenumber"), scans.power[:, :, 0], f"({unit})^2"),
            "noise_power": ("wavenumber", scans.noise, f"({unit})^2"),
            "contact_fraction": (of, scans.contact_fraction, "1",
                                 "contact_fraction_{contact}_{texture}"),
            "height_density_true": (("texture", "wavenumber"), list(truth.values()), "m^3"),
            "chosen": (("classification", "truth", "candidate"), chosen, "1"),
            "accuracy": ("classification", right, "1", "accuracy{accuracy_of}"),
            **_heights(spectra),
        },
        {"contact": (list(CONTACTS), "1"), "texture": (names, "1"), "truth": (names, "1"),
         "candidate": (names, "1"), "classification": (list(CLASSIFICATIONS), "1"),
         "accuracy_of": ("classification", list(CLASSIFICATIONS.values()), "1"),
         "x": (np.asarray(sensor.line.x), "m"), "wavenumber": (sensor.k, "rad/m"),
         "band": (spectra.middle, "rad/m"), "end": (["longest", "shortest"], "1")},
    )  # fmt: skip
    for name, words in (("truth", "true texture"), ("candidate", "chosen")):
        data[name].attrs["long_name"] = words
    return data


def _heights(spectra: HeightSpectra) -> dict[str, tuple[Any, ...]]:
    """The estimated densities, of one recording and of the mean, and how far they go."""
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
        **scalars({"coverage_90": spectra.coverage}),
    }  # fmt: skip
