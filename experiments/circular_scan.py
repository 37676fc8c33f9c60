"""Direction of a ridge from one circle over it, and the angle's effect on a straight scan."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.errors import number, refuse
from srsinv.forward.circular import Circle, Circling, ObliqueRidge
from srsinv.forward.oblique import turned, turned_scan
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Periodic
from srsinv.inverse.direction import Direction, DirectionFinder, angle_bounds_deg
from srsinv.progress import stage
from srsinv.report.result import Result, dataset, scalars
from srsinv.report.section import sections
from srsinv.report.text import listed

BOUND_DEG = np.arange(0.0, 181.0, 5.0)  # angles at which the Cramer-Rao bound is drawn
ALONG = ("direction", "element", "sample")
Variables = dict[str, tuple[Any, ...]]


def run(cfg: config.Config) -> Result:
    """Directions estimated on a circle with noise, and the straight scan's gain over the angle.

    Raises `BadInput` for no direction, a shown one that is not tried, and refusals of the
    configuration's parts.
    """
    settings = cfg["circular_scan"]
    truth, snr = _settings(settings)
    tried = np.linspace(0.0, 90.0, settings["gain_angles"])
    rng = np.random.default_rng(config.seed(cfg))
    with config.precision(cfg):
        sensor, circle = config.sensor(cfg), Circle(**settings["circle"])
        circling, finder = Circling(sensor, circle), DirectionFinder(sensor, circle)
        ridges = [ObliqueRidge(np.deg2rad(angle), **settings["ridge"]) for angle in truth]
        with stage("finding the directions"):
            clean = np.stack([circling(ridge) for ridge in ridges])
            rms = np.sqrt(np.mean(clean**2, axis=(1, 2)))
            noise = 10 ** (-snr / 20) * rms[:, None, None]
            signals = clean + noise * rng.normal(size=clean.shape)
            directions = [finder(signal) for signal in signals]
        gains = _gains(sensor, config.scan(cfg), settings["ridge"], tried)
        bound = angle_bounds_deg(circling, ridges[0], jnp.deg2rad(BOUND_DEG), snr)

    data = dataset(
        {
            "signal": (ALONG, signals, "V"),
            "fitted_signal": (ALONG, np.stack([each.signal for each in directions]), "V"),
            "signal_rms": ("direction", rms, "V"),
            "angle_bound": ("bound_angle", bound, "deg"),
            "way": ("sample", circle.angle_rad * circle.radius_m, "m"),
            **_angles(directions, truth),
            **gains,
            **scalars({"signal_rms_greatest_over_least": rms.max() / rms.min()}),
        },
        {
            "direction": (truth, "deg"),
            "element": (list(cfg["sensor"]["elements"]), "1"),
            "sample": (np.rad2deg(circle.angle_rad), "deg"),
            "bound_angle": (BOUND_DEG, "deg"),
            "scan_angle": (tried, "deg"),
        },
        shown_deg=settings["shown_deg"],
        snr_dB=snr,
        effects_on=listed(cfg["effects"]),
    )
    greatest = float(data["direction_error_deg_greatest"])
    title = f"One circle at {snr:g} dB gives a ridge's direction to {greatest:.2g}°"
    return Result(title, data, sections(__file__, signals=on_the_circle, errors=errors))


def _settings(given: Mapping[str, Any]) -> tuple[np.ndarray, float]:
    """The true angles [deg] and the ratio of signal to noise [dB]."""
    truth = np.asarray(given["angles_deg"], float)
    refuse(not truth.size, "circular_scan.angles_deg is []: give at least one angle in degrees.")
    refuse(
        not set(given["shown_deg"]) <= set(given["angles_deg"]),
        f"circular_scan.shown_deg is {given['shown_deg']}: give some of "
        f"circular_scan.angles_deg, {given['angles_deg']}.",
    )
    return truth, number("circular_scan.snr_dB", given["snr_dB"], "a ratio in dB")


def _angles(directions: Sequence[Direction], truth: np.ndarray) -> Variables:
    estimate, stderr = np.array([each.parameters["angle_deg"] for each in directions]).T
    error = (estimate - truth + 90) % 180 - 90
    return {
        "angle_estimate": ("direction", estimate, "deg"),
        "angle_stderr": ("direction", stderr, "deg"),
        "angle_error": ("direction", error, "deg", "direction_error_deg_at_{direction}"),
        **scalars({
            "direction_error_deg_greatest": np.abs(error).max(),
            "direction_stderr_deg_greatest": stderr.max(),
        }),
    }  # fmt: skip


def on_the_circle(ds: xarray.Dataset) -> Figure:
    """The signals with noise of the directions shown, and the fit to each."""
    way, up = plot.PanelAxis("way along the circle", "m"), plot.PanelAxis("signal", "V")
    data = {"color": "#b5bcc2", "linewidth": 1.0}
    return plot.panels([
        [
            plot.Panel(
                [plot.Curve(noisy.values, "with noise", look=data), plot.Curve(fit.values, "fit")],
                way, up, ds["way"].values, f"Ridge at {angle:g}°, element {name}",
            )
            for name, noisy, fit in zip(ds["element"].values, *of_angle, strict=True)
        ]
        for angle, *of_angle in zip(
            ds["direction"].values, ds["signal"], ds["fitted_signal"], strict=True
        )
    ], height_in=1.7)  # fmt: skip


def errors(ds: xarray.Dataset) -> Figure:
    """The error of each direction with its standard error, over the Cramer-Rao bound."""
    error, stderr, bound = (ds[f"angle_{key}"].values for key in ("error", "stderr", "bound"))
    look = {"linestyle": "none", "marker": "o", "markersize": 4.5}
    zero = plot.Curve(
        0 * bound, "", x=ds["bound_angle"].values, band=(-bound, bound),
        band_label="expected standard error", look={"color": "#6b747c", "linewidth": 0.8},
    )  # fmt: skip
    dots = plot.Curve(
        error, "one draw, ± its standard error", band=(error - stderr, error + stderr),
        has_bars=True, look=look,
    )  # fmt: skip
    across = plot.PanelAxis("true angle of the ridge's normal from x", "deg", limits=(-5.0, 185.0))
    up = plot.PanelAxis("error of the angle", "deg")
    return plot.panels([plot.Panel([zero, dots], across, up, ds["direction"].values)])


@eqx.filter_jit
def _signal(sensor: Sensor, scan, line: Periodic, traction):
    return sensor.operator(line, scan)(traction)


def _gains(sensor: Sensor, scan, ridge, angles_deg: np.ndarray) -> Variables:
    gain = np.array([_gain(sensor, scan, ridge, angle) for angle in angles_deg]).T
    at_60 = [np.interp(60.0, angles_deg, row) for row in gain]
    return {
        "gain": (("element", "scan_angle"), gain, "1"),
        "gain_at_60_deg": ("element", at_60, "1", "gain_straight_at_60_deg_{element}"),
    }


def _gain(sensor: Sensor, scan, ridge, angle_deg: float) -> np.ndarray:
    """Rms signal in time (element,) of a straight scan over the ridge, relative to that at 0."""
    line = Periodic(2048, 0.1e-3, -102.4e-3)
    p = UniformStrip(1.0, ridge["width_m"]).cell_average(line)
    traction = jnp.stack([p, ridge["friction"] * p])
    rms = []
    for angle in (np.deg2rad(angle_deg), 0.0):
        signal = _signal(turned(sensor, angle), turned_scan(scan, angle), line, traction)
        rms.append(np.sqrt(np.mean(np.asarray(signal) ** 2, axis=-1)))
    return rms[0] / rms[1]
