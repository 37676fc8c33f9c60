"""Detection limit of a ridge and resolution limit of a pair, over depth, noise and speed."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import BadInput, number, refuse, whole
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import Scene
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import Ridge
from srsinv.grid import Line, Periodic
from srsinv.inverse.detection import (
    last_crossing,
    needed_known,
    power_law_exponent,
    resolved_wavelength_m,
)
from srsinv.inverse.ridge_detection import RidgeDetection
from srsinv.report.result import Result, dataset, scalars
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity

AXES = {  # what is varied: key of its range, quantity, unit
    "depth": ("depth_range_m", "film depth", "m"),
    "noise": ("noise_range_V", "noise of a sample, rms", "V"),
    "speed": ("speed_range_m_per_s", "speed", "m/s"),
}
LIMITS = ("least_height", "narrowest_pair", "resolved_wavelength")


def run(cfg: config.Config) -> Result:
    """The limits along three axes, one quantity varied at a time.

    Raises `BadInput` for another scene than one ridge, noise that is not white, and ranges that do
    not increase.
    """
    given = cfg["detection_limit"]
    axes = {name: _range(given, key, "points") for name, (key, *_) in AXES.items()}
    heights = _range(given, "height_range_m", "heights")
    wanted = _range(given, "distance_range_m", "distances")
    positive = "a positive number in Hz"
    rate = number("detection_limit.sample_rate_hz", given["sample_rate_hz"], positive, above=0)
    needed = needed_known(given["false_alarm"], given["detection"])
    with config.precision(cfg):
        parts = config.line(cfg), config.scene(cfg), config.sensor(cfg), config.scan(cfg)
        setup = _setup(*parts)
        distances = _distances(wanted, setup)
        tractions = setup.tractions(heights, distances)
        noise = setup.noise_rms(config.noises(cfg), tractions, rate)
        detectability = setup.detectability(tractions, rate)

        def limits(depth: float, noise: float, speed: float) -> tuple[float, ...]:
            ridge, pair, stderr = detectability(depth, speed)
            return (
                last_crossing(heights, needed * noise / ridge),
                last_crossing(distances, given["relative_precision"] * noise * stderr / distances),
                resolved_wavelength_m(depth, pair[-1] / noise),
            )

        base = {
            "depth": float(setup.sensor.depth_m),
            "noise": noise,
            "speed": float(setup.scan.speed_m_per_s),
        }
        here = limits(**base)
        curves = {
            name: np.array([limits(**(base | {name: float(value)})) for value in values]).T
            for name, values in axes.items()
        }

    data = _dataset(axes, curves, here, (heights[0], distances[0])).assign(
        dataset(scalars({
            "least_distance_m": distances[0],
            "noise_rms_V": noise,
            "strength_needed": needed,
            "contact_converged": tractions.converged,
        }), {})
    )  # fmt: skip
    facts = _facts(setup, base) | {"effects_on": listed(cfg["effects"])}
    title = (
        f"A ridge {quantity(here[0], 'm', digits=2)} high is detected through "
        f"{1e3 * base['depth']:.3g} mm of skin, a pair {1e3 * here[1]:.2g} mm apart resolved"
    )
    shown = sections(__file__, heights=least_height, pairs=narrowest_pair)
    return Result(title, data.assign_attrs(given, **facts), shown)


def _dataset(axes, curves, here, floors) -> xarray.Dataset:
    """Limits over the axes, at this sensor, at the ends of each axis, and the power of the axis
    that each follows above the least tried, `floors`."""
    by = np.array([[curves[name][i] for name in axes] for i in range(2)])  # (limit, axis, value)
    exponent = [
        [power_law_exponent(axes[name], each, floor) for name, each in zip(axes, row, strict=True)]
        for row, floor in zip(by, floors, strict=True)
    ]
    against = {
        f"{limit}_against_{name}": (name, curves[name][i], "m")
        for i, limit in enumerate(LIMITS)
        for name in AXES
    }
    by_axis = ("limit", "axis")
    return dataset(
        against
        | {
            "at_the_ends": ((*by_axis, "end"), by[..., [0, -1]], "m", "{limit}_at_{end}_{axis}_m"),
            "exponent": (by_axis, exponent, "1", "{limit}_against_{axis}_exponent"),
        }
        | scalars({f"{limit}_m": value for limit, value in zip(LIMITS, here, strict=True)}),
        {name: (axes[name], unit) for name, (*_, unit) in AXES.items()}
        | {"limit": (list(LIMITS[:2]), "1"), "axis": (list(AXES), "1"),
           "end": (["least", "most"], "1")},
    )  # fmt: skip


def least_height(ds: xarray.Dataset) -> Figure:
    """The least detectable height over each axis; a dot is this sensor."""
    return _against(ds, {"least_height": ""}, "least detectable height")


def narrowest_pair(ds: xarray.Dataset) -> Figure:
    """The narrowest pair resolved by a fit, and the wavelengths recovered without a model."""
    lines = {"narrowest_pair": "narrowest pair, by a fit",
             "resolved_wavelength": "shortest wave, without a model"}  # fmt: skip
    look = {"color": "#000000", "linestyle": ":"}
    least = plot.Mark(float(ds["least_distance_m"]), "least distance tried", "y", look=look)
    return _against(ds, lines, "distance", least)


def _against(ds: xarray.Dataset, lines: Mapping[str, str], words: str, *marks) -> Figure:
    shown = np.concatenate([ds[f"{key}_against_{name}"].values for key in lines for name in AXES])
    ends = np.nanmin(shown) / 1.3, np.nanmax(shown) * 1.3
    parts = []
    for name, (_, what, unit) in AXES.items():
        curves = [plot.Curve(ds[f"{key}_against_{name}"].values, lines[key]) for key in lines]
        dot = {"marker": "o", "linestyle": "none"}
        curves += [
            plot.Curve([float(ds[f"{key}_m"])], lines[key], x=[ds.attrs[f"{name}_here"]], look=dot)
            for key in lines
        ]
        up = plot.PanelAxis(words, "m", True, ends)
        parts.append(
            plot.Panel(curves, plot.PanelAxis(what, unit, True), up, ds[name].values, "", marks)
        )
    return plot.panels([parts], height_in=2.8)


def _facts(setup: RidgeDetection, base: Mapping[str, float]) -> dict[str, Any]:
    return {f"{name}_here": value for name, value in base.items()} | {
        "ridge_height_m": float(setup.ridge.height_m),
        "ridge_width_m": float(setup.ridge.width_m),
        "nominal_pressure_Pa": float(setup.scene.nominal_pressure_Pa),
        "base_friction": float(setup.scene.surface.base_friction),
        "elements": len(setup.sensor.elements),
    }


def _range(given: Mapping[str, Any], key: str, count: str) -> np.ndarray:
    name, ends = f"detection_limit.{key}", given[key]
    refuse(
        not isinstance(ends, list) or len(ends) != 2,
        f"{name} is {ends}: give [least, greatest].",
    )
    low = number(name, ends[0], "[least, greatest], both positive", above=0)
    high = number(name, ends[1], "[least, greatest], the second the larger", above=low)
    name, wanted = f"detection_limit.{count}", "a whole number from 3"
    return np.geomspace(low, high, whole(name, given[count], wanted, least=3))


def _setup(line: Line, scene: Scene, sensor: Sensor, scan: ConstantSpeed) -> RidgeDetection:
    surface = scene.contact_scene
    ridge = surface and surface.surface.only(Ridge)
    if surface is None or ridge is None:
        raise BadInput("The scene is not one ridge: use scene=ridge.")
    refuse(not isinstance(line, Periodic), "grid.line is open: give periodic.")
    speed = float(scan.speed_m_per_s)
    refuse(speed <= 0, f"scan.speed_m_per_s is {speed}: give a positive speed in m/s.")
    return RidgeDetection(line, surface, ridge, sensor, scan)


def _distances(wanted: np.ndarray, setup: RidgeDetection) -> np.ndarray:
    """The wanted distances in whole pairs of cells."""
    line, step = setup.line, 2 * float(setup.line.cell_m)
    distances = step * np.unique(np.round(wanted / step))
    width, window = float(setup.ridge.width_m), line.n * float(line.cell_m)
    ends = [float(wanted[0]), float(wanted[-1])]
    refuse(
        not width + step < distances[0] < distances[-1] < window / 2,
        f"detection_limit.distance_range_m is {ends}: give distances above "
        f"the ridge's width {width:g} m by more than two cells ({step:g} m), and below half the "
        f"window's {window:g} m.",
    )
    return distances
