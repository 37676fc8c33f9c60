"""Radius and orientation of a cylinder from one straight scan, far below the resolution limit."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.errors import number, numbers, refuse, whole
from srsinv.numerics import BAND_90
from srsinv.progress import stage
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity

from .figures import errors, estimates, signals, widths
from .scans import CylinderDraw, CylinderScan, fitted_draws

ABOVE, NAMES = "a positive number, in SI units", {"radius": "radius_m", "angle": "angle_rad"}


def run(cfg: config.Config) -> Result:
    """Fits of simulated scans over cylinders of several radii, with the Cramer-Rao bound of each.

    Raises `BadInput` for radii, a load, a window or a rate that are not positive, and for an angle
    that is not above 0 and below 90 degrees.
    """
    given = cfg["cylinder"]
    radii = np.array(numbers("cylinder.radii_m", given["radii_m"], "radii in metres"))
    refuse(not radii.size or min(radii) <= 0, "cylinder.radii_m: give one or more above 0.")
    draws = whole("cylinder.draws", given["draws"], "a whole number from 2", least=2)
    wanted = "an angle above 0 and below 90 degrees"
    angle = float(number("cylinder.angle_deg", given["angle_deg"], wanted, above=0, below=90))
    settings = {
        name: float(number(f"cylinder.{name}", given[name], ABOVE, above=0))
        for name in ("load_N_per_m", "window_m", "length_m", "rate_hz")
    }
    snr = number("cylinder.snr_dB", given["snr_dB"], "a ratio in dB")
    friction = number("cylinder.friction", given["friction"], "a number, of either sign")
    with config.precision(cfg):
        sensor, speed = config.sensor(cfg), float(config.scan(cfg).speed_m_per_s)
        cells = whole("cylinder.cells", given["cells"], "a whole number from 1024", least=1024)
        rest = {"friction": float(friction), "speed_m_per_s": speed, **settings}
        scans = [
            CylinderScan(sensor, float(each), angle, snr_dB=snr, cells=cells, **rest)
            for each in radii
        ]
        fits = []
        for i, scan in enumerate(scans):
            with stage(f"fitting a radius of {quantity(scan.radius_m, 'm')}"):
                fits.append(fitted_draws(scan, draws, [int(cfg["seed"]), i], False))
        depth = float(sensor.depth_m)
        facts = {**given, "depth_m": depth, "elements": len(sensor.elements)}
        data = _dataset(scans, fits, sensor.element_names)
    resolved = 2 * np.pi * depth / np.log(10 ** (snr / 20))
    data = data.assign(dataset(scalars({"resolved_wavelength_m": resolved}), {}).data_vars)
    data = data.assign_attrs(facts, effects_on=listed(cfg["effects"]))
    least, worst = data.isel(radius=0), float(data["error_over_bound"].max())
    relative = 100 * float(least["radius_rms"]) / float(radii[0])
    title = (
        f"A contact {quantity(float(least['contact_width']), 'm')} wide gives a cylinder's radius "
        f"of {quantity(float(radii[0]), 'm')} to {relative:.2g} %; errors are at most {worst:.3g} "
        "times the bound"
    )
    shown = sections(__file__, widths=widths, errors=errors, estimates=estimates, signals=signals)
    return Result(title, data, shown)


def _dataset(
    scans: Sequence[CylinderScan], fits: Sequence[Sequence[CylinderDraw]], elements: list[str]
) -> xarray.Dataset:
    bounds = [scan.bounds(is_angle_known=False) for scan in scans]
    by, variables = ("radius", "draw"), {}
    for name, own in NAMES.items():
        unit = own.rpartition("_")[2]
        error = np.array([[draw.error(own) for draw in each] for each in fits])
        ends = np.array([[_interval(draw, own) for draw in each] for each in fits])
        low, high = ends[..., 0], ends[..., 1]
        truth = np.array([[draw.truth[own] for draw in each] for each in fits])
        rms, bound = np.sqrt(np.mean(error**2, axis=1)), [each[own] for each in bounds]
        variables |= {
            f"{name}_estimate": (by, truth + error, unit),
            f"{name}_low": (by, low, unit),
            f"{name}_high": (by, high, unit),
            f"{name}_rms": ("radius", rms, unit),
            f"{name}_bound": ("radius", bound, unit),
            f"{name}_held": ("radius", np.mean((low <= truth) & (truth <= high), axis=1), "1"),
        }
    over = [variables[f"{name}_rms"][1] / variables[f"{name}_bound"][1] for name in NAMES]
    middle = len(scans) // 2
    estimate = fits[middle][0].estimate
    identified = [np.mean([np.isfinite(d.stderr("radius_m")) for d in each]) for each in fits]
    variables |= {
        "error_over_bound": (("parameter", "radius"), over, "1",
                             "{parameter!s}_rms_over_bound_{radius}"),
        "identified": ("radius", identified, "1", "radius_identified_{radius}"),
        "contact_width": ("radius", [2 * scan.half_width_m for scan in scans], "m"),
        "signal": (("element", "position"), estimate.data, "V"),
        "fitted_signal": (("element", "position"), estimate.fitted, "V"),
        "whitened_residual": (("element", "position"), np.asarray(estimate.whitened), "1"),
        **scalars({"shown_radius_m": scans[middle].radius_m}),
    }  # fmt: skip
    coordinates: Mapping[str, Any] = {
        "radius": ([scan.radius_m for scan in scans], "m"),
        "parameter": (list(NAMES), "1"),
        "element": (elements, "1"),
        "position": (np.asarray(scans[middle].motion.position_m), "m"),
    }
    return dataset(variables, coordinates)


def _interval(draw: CylinderDraw, name: str) -> tuple[float, float]:
    """The 90 % interval: by the profile where the standard error gives none."""
    value, half = draw.estimate.parameters[name][0], BAND_90 * draw.stderr(name)
    return draw.estimate.asymmetric.get(name, (value - half, value + half))
