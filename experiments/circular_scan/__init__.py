"""Direction of a ridge from one circle over it, and the angle's effect on a straight scan."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from srsinv import config
from srsinv.errors import number, numbers, refuse, whole
from srsinv.forward.oblique import gain_of_angle
from srsinv.forward.planar import Circle, ObliqueRidge, PathScan
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Periodic
from srsinv.inverse.planar.finder import Direction, DirectionFinder
from srsinv.inverse.planar.signal import RidgeShape
from srsinv.progress import stage
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed

from .direction import angle_bounds_deg
from .figures import errors, on_the_circle

LEAST = 1e-12  # of a ridge's width [m] and load [N/m]
ABOVE, FROM_2 = f"a number above {LEAST:g}", "a whole number from 2"
BOUND_DEG = np.arange(0.0, 181.0, 5.0)  # angles at which the Cramer-Rao bound is drawn
Variables = dict[str, tuple[Any, ...]]


def run(cfg: config.Config) -> Result:
    """Directions estimated on a circle with noise, and the straight scan's gain over the angle.

    Raises `BadInput` for no direction, a shown one that is not tried, and refusals of the
    configuration's parts.
    """
    settings = cfg["circular_scan"]
    truth, snr, count = _settings(settings)
    tried = np.linspace(0.0, 90.0, count)
    rng = np.random.default_rng(config.seed(cfg))
    with config.precision(cfg):
        sensor, circle = config.sensor(cfg), Circle(**settings["circle"])
        circling = PathScan(sensor, circle)
        finder = DirectionFinder(circling, RidgeShape())
        ridges = [ObliqueRidge(np.deg2rad(angle), **settings["ridge"]) for angle in truth]
        with stage("finding the directions"):
            clean = np.stack([circling(ridge) for ridge in ridges])
            rms = np.sqrt(np.mean(clean**2, axis=(1, 2)))
            noise = 10 ** (-snr / 20) * rms[:, None, None]
            signals = clean + noise * rng.normal(size=clean.shape)
            directions = [finder(signal) for signal in signals]
        bound = angle_bounds_deg(circling, settings["ridge"], BOUND_DEG, snr)
        gains = _gains(sensor, config.scan(cfg), settings["ridge"], tried)

    data = dataset(
        _directions(truth, rms, signals, directions)
        | gains
        | {"angle_bound": ("bound_angle", bound, "deg"),
           "way": ("sample", circle.angle_rad * circle.radius_m, "m")},
        {"direction": (truth, "deg"), "element": (list(cfg["sensor"]["elements"]), "1"),
         "sample": (np.rad2deg(circle.angle_rad), "deg"),
         "bound_angle": (BOUND_DEG, "deg"), "scan_angle": (tried, "deg")},
        shown_deg=settings["shown_deg"],
        snr_dB=snr,
        effects_on=listed(cfg["effects"]),
    )  # fmt: skip
    greatest = float(data["direction_error_deg_greatest"])
    title = f"One circle at {snr:g} dB gives a ridge's direction within {greatest:.2g}°"
    return Result(title, data, sections(__file__, signals=on_the_circle, errors=errors))


def _settings(given: Mapping[str, Any]) -> tuple[np.ndarray, float, int]:
    """The true angles [deg], the ratio of signal to noise [dB] and the number of straight scans."""
    angles = numbers("circular_scan.angles_deg", given["angles_deg"], "angles in degrees")
    for name in ("width_m", "load_N_per_m"):
        number(f"circular_scan.ridge.{name}", given["ridge"][name], ABOVE, above=LEAST)
    refuse(
        not set(given["shown_deg"]) <= set(given["angles_deg"]),
        f"circular_scan.shown_deg is {given['shown_deg']}: give some of "
        f"circular_scan.angles_deg, {given['angles_deg']}.",
    )
    count = whole("circular_scan.gain_angles", given["gain_angles"], FROM_2, least=2)
    return np.array(angles), number("circular_scan.snr_dB", given["snr_dB"], "a ratio in dB"), count


def _directions(
    truth: np.ndarray, rms: np.ndarray, signals: np.ndarray, directions: Sequence[Direction]
) -> Variables:
    """The signals and the fit of each true direction [deg], with the error of its angle."""
    estimate, stderr = np.array([each.parameters["angle_deg"] for each in directions]).T
    error = (estimate - truth + 90) % 180 - 90
    along, fitted = ("direction", "element", "sample"), [each.signal for each in directions]
    return {
        "signal": (along, signals, "V"),
        "fitted_signal": (along, fitted, "V"),
        "signal_rms": ("direction", rms, "V"),
        "angle_estimate": ("direction", estimate, "deg"),
        "angle_stderr": ("direction", stderr, "deg"),
        "angle_error": ("direction", error, "deg", "direction_error_deg_at_{direction}"),
        **scalars({
            "direction_error_deg_greatest": np.abs(error).max(),
            "direction_stderr_deg_greatest": stderr.max(),
            "signal_rms_greatest_over_least": rms.max() / rms.min(),
        }),
    }  # fmt: skip


def _gains(
    sensor: Sensor, scan: ConstantSpeed, ridge: Mapping[str, float], tried: np.ndarray
) -> Variables:
    """The gain of straight scans over the ridge at the angles `tried` [deg]."""
    line = Periodic(2048, 0.1e-3, -102.4e-3)
    p = UniformStrip(1.0, ridge["width_m"]).cell_average(line)
    traction = jnp.stack([p, ridge["friction"] * p])
    gain = gain_of_angle(sensor, scan, line, traction, np.deg2rad(tried))
    at_60 = [np.interp(60.0, tried, row) for row in gain]
    return {
        "gain": (("element", "scan_angle"), gain, "1"),
        "gain_at_60_deg": ("element", at_60, "1", "gain_straight_at_60_deg_{element}"),
    }
