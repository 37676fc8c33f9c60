"""Detection limit of a ridge and resolution limit of a pair, over depth, noise and speed."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.errors import number, refuse, whole
from srsinv.inverse.detection import needed_known, power_law_exponent
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity

from .figures import AXES, least_height, narrowest_pair
from .ridges import RidgeDetection, RidgeLimits

LIMITS = RidgeLimits._fields


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
        line, scene = config.line(cfg), config.scene(cfg)
        sensor, scan = config.sensor(cfg), config.scan(cfg)
        setup = RidgeDetection.checked(line, scene, sensor, scan)
        distances = setup.pair_distances("detection_limit.distance_range_m", wanted)
        tractions = setup.tractions(heights, distances)
        noise_rms = setup.noise_rms(config.noises(cfg), tractions, rate)
        limits = setup.limits(tractions, rate, needed, given["relative_precision"])
        depth_m, speed = float(sensor.depth_m), float(scan.speed_m_per_s)
        here = {"depth": depth_m, "noise": noise_rms, "speed": speed}
        at = limits(**here)
        curves = {
            name: np.array([limits(**(here | {name: float(value)})) for value in values]).T
            for name, values in axes.items()
        }

    numbers = {f"{name}_m": value for name, value in at._asdict().items()} | {
        "least_distance_m": distances[0],
        "noise_rms_V": noise_rms,
        "strength_needed": needed,
        "contact_converged": tractions.converged,
    }
    facts = {f"{name}_here": value for name, value in here.items()} | {
        "ridge_height_m": float(setup.ridge.height_m),
        "ridge_width_m": float(setup.ridge.width_m),
        "nominal_pressure_Pa": float(setup.scene.nominal_pressure_Pa),
        "base_friction": float(setup.scene.surface.base_friction),
        "elements": len(setup.sensor.elements),
    }
    data = _dataset(axes, curves, (heights[0], distances[0]), numbers)
    data = data.assign_attrs(given, **facts, effects_on=listed(cfg["effects"]))
    shown = sections(__file__, heights=least_height, pairs=narrowest_pair)
    title = (
        f"A ridge {quantity(at.least_height, 'm', digits=2)} high is detected through "
        f"{1e3 * depth_m:.3g} mm of skin; a pair {1e3 * at.narrowest_pair:.2g} mm apart is resolved"
    )
    return Result(title, data, shown)


def _dataset(
    axes: Mapping[str, np.ndarray],
    curves: Mapping[str, np.ndarray],
    floors: tuple[float, float],
    numbers: Mapping[str, Any],
) -> xarray.Dataset:
    """Each limit over each axis, `curves` (limit, value); of the first two their values at the ends
    of the axis and the power of it that they follow above the least tried, `floors`."""
    ends = [[curves[name][i, [0, -1]] for name in axes] for i in range(2)]
    exponent = [
        [power_law_exponent(axes[name], curves[name][i], floor) for name in axes]
        for i, floor in enumerate(floors)
    ]
    by = ("limit", "axis")
    return dataset(
        {
            **{f"{limit}_against_{name}": (name, curves[name][i], "m")
               for i, limit in enumerate(LIMITS) for name in axes},
            "at_the_ends": ((*by, "end"), ends, "m", "{limit}_at_{end}_{axis}_m"),
            "exponent": (by, exponent, "1", "{limit}_against_{axis}_exponent"),
            **scalars(numbers),
        },
        {name: (values, AXES[name][-1]) for name, values in axes.items()}
        | {"limit": (list(LIMITS[:2]), "1"), "axis": (list(axes), "1"),
           "end": (["least", "most"], "1")},
    )  # fmt: skip


def _range(given: Mapping[str, Any], key: str, count: str) -> np.ndarray:
    name, ends = f"detection_limit.{key}", given[key]
    refuse(
        not isinstance(ends, list) or len(ends) != 2,
        f"{name} is {ends}: give [least, greatest].",
    )
    low = number(name, ends[0], "[least, greatest], both positive", above=0)
    high = number(name, ends[1], "[least, greatest] in increasing order", above=low)
    name, wanted = f"detection_limit.{count}", "a whole number from 3"
    return np.geomspace(low, high, whole(name, given[count], wanted, least=3))
