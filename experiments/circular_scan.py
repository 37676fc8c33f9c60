"""Direction of a ridge from one circle over it, and the angle's effect on a straight scan."""

from collections.abc import Collection

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray

from srsinv import config
from srsinv.errors import number, refuse
from srsinv.forward.circular import Circle, Circling, ObliqueRidge
from srsinv.forward.oblique import turned, turned_scan
from srsinv.forward.sensor import Sensor
from srsinv.forward.traction import UniformStrip
from srsinv.grid import Periodic
from srsinv.inverse.direction import DirectionFinder
from srsinv.progress import stage
from srsinv.report import figures
from srsinv.report.figures import curves
from srsinv.report.outcome import Outcome, Section, Table
from srsinv.report.text import listed


def run(cfg: config.Config) -> Outcome:
    """Directions estimated on a circle with noise, and the straight scan's gain over the angle.

    Raises `BadInput` for no direction, a shown one that is not tried, and refusals of the
    configuration's parts.
    """
    settings = cfg["circular_scan"]
    truth = np.asarray(settings["angles_deg"], float)
    refuse(not truth.size, "circular_scan.angles_deg is []: give at least one angle in degrees.")
    refuse(
        not set(settings["shown_deg"]) <= set(settings["angles_deg"]),
        f"circular_scan.shown_deg is {settings['shown_deg']}: give some of "
        f"circular_scan.angles_deg, {settings['angles_deg']}.",
    )
    snr = number("circular_scan.snr_dB", settings["snr_dB"], "a ratio in dB")
    rng = np.random.default_rng(config.seed(cfg))
    with config.precision(cfg):
        sensor, circle = config.sensor(cfg), Circle(**settings["circle"])
        circling, finder = Circling(sensor, circle), DirectionFinder(sensor, circle)
        signals, directions = [], []
        with stage("finding the directions"):
            for angle in truth:
                ridge = ObliqueRidge(np.deg2rad(angle), **settings["ridge"])
                clean = np.asarray(circling(ridge))
                noise = 10 ** (-snr / 20) * np.sqrt(np.mean(clean**2))
                signals.append((clean, clean + noise * rng.normal(size=clean.shape)))
                directions.append(finder(signals[-1][1]))
        tried = np.linspace(0.0, 90.0, settings["gain_angles"])
        gain = np.array([_gain(sensor, config.scan(cfg), settings["ridge"], a) for a in tried])

    estimate, stderr = np.array([each.parameters["angle_deg"] for each in directions]).T
    error = (estimate - truth + 90) % 180 - 90
    rms = np.array([np.sqrt(np.mean(clean**2)) for clean, _ in signals])
    along = ("direction", "element", "sample")
    dataset = xarray.Dataset(
        {
            "signal": (along, np.stack([noisy for _, noisy in signals]), {"units": "V"}),
            "fitted_signal": (along, np.stack([d.signal for d in directions]), {"units": "V"}),
            "signal_rms": ("direction", rms, {"units": "V"}),
            "angle_estimate": ("direction", estimate, {"units": "deg"}),
            "angle_stderr": ("direction", stderr, {"units": "deg"}),
            "angle_error": ("direction", error, {"units": "deg"}),
            "gain": (("element", "scan_angle"), gain.T, {"units": "1"}),
        },
        {
            "direction": ("direction", truth, {"units": "deg"}),
            "element": ("element", list(cfg["sensor"]["elements"]), {"units": "1"}),
            "sample": ("sample", np.rad2deg(circle.angle_rad), {"units": "deg"}),
            "scan_angle": ("scan_angle", tried, {"units": "deg"}),
        },
    )
    metrics = {f"direction_error_deg_at_{a:g}": float(e) for a, e in zip(truth, error, strict=True)}
    metrics["direction_error_deg_greatest"] = float(np.abs(error).max())
    metrics["direction_stderr_deg_greatest"] = float(stderr.max())
    metrics["signal_rms_greatest_over_least"] = float(rms.max() / rms.min())
    for name, row in zip(dataset["element"].values, gain.T, strict=True):
        metrics[f"gain_straight_at_60_deg_{name}"] = float(np.interp(60.0, tried, row))
    rows = [
        (f"{angle:g}", *(f"{each:.3f}" for each in at), 1e6 * float(size))
        for angle, *at, size in zip(truth, estimate, stderr, error, rms, strict=True)
    ]
    return Outcome(
        f"The direction of a ridge from one circle at {snr:g} dB",
        {key: float(value) for key, value in metrics.items()},
        dataset,
        _sections(dataset, float(circle.radius_m), settings["shown_deg"], listed(cfg["effects"])),
        Table(
            ("true [deg]", "found [deg]", "std. error [deg]", "error [deg]", "rms signal [µV]"),
            tuple(rows),
        ),
    )


@eqx.filter_jit
def _signal(sensor: Sensor, scan, line: Periodic, traction):
    return sensor.operator(line, scan)(traction)


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


def _sections(
    ds: xarray.Dataset, radius_m: float, shown_deg: Collection[float], effects: str
) -> tuple[Section, ...]:
    elements = [str(name) for name in ds["element"].values]
    strongest = float(ds["signal_rms"].max() / ds["signal_rms"].min())

    def on_the_circle():
        along = np.deg2rad(ds["sample"].values) * radius_m
        parts = [
            figures.Panel(
                title=f"Ridge at {angle:g}°, element {name}",
                ylabel="signal [µV]",
                lines={
                    "with noise": 1e6 * ds["signal"].values[i, e],
                    "fit": 1e6 * ds["fitted_signal"].values[i, e],
                },
            )
            for i, angle in enumerate(ds["direction"].values)
            for e, name in enumerate(elements)
            if angle in shown_deg
        ]
        return figures.panels(along, parts, "way along the circle")

    def error_figure():
        lines = {
            "error found": np.abs(ds["angle_error"].values),
            "standard error": ds["angle_stderr"].values,
        }
        label = "true angle of the ridge's normal from x [deg]"
        return curves.figure(ds["direction"].values, lines, label, "error of the angle [deg]")

    def straight():
        lines = {name: ds["gain"].values[e] for e, name in enumerate(elements)}
        label = "angle of the ridge's normal from the sliding direction [deg]"
        return curves.figure(ds["scan_angle"].values, lines, label, "rms signal over that at 0 [1]")

    return (
        Section(
            "Direction from a circle",
            ("The finger keeps its orientation on the circle and meets the ridge twice; when tells "
             "where the ridge lies, and friction turns with the velocity.",),
            {"on_the_circle": on_the_circle, "found": error_figure},
            {"on_the_circle": "The fit has five parameters: angle, distance, width, load, shear. "
             "Where the strip lies along the ridge its pulse is short and strong; across it, two "
             "weak ones remain, of the strip's ends.",
             "found": "One draw of noise for each direction, at the same ratio of signal to noise "
             f"whatever the signal's size; the strongest is {strongest:.3g} "
             "times the weakest."},
        ),
        Section(
            "Gain of a straight scan",
            (),
            {"gain": straight},
            {"gain": "The rate falls with the speed across the ridge, u cos(phi), and the strip's "
             "length averages over l sin(phi). Along the ridge a straight scan feels nothing. It "
             "feels the same of phi and -phi; a circle tells them apart."},
        ),
        Section(
            "What was assumed",
            ("Half space; the ridge presses uniformly over its width, and its load and friction do "
             "not change along it; friction lies along the velocity; white noise, the same rms in "
             "every element.",
             f"Effects on: {effects}, and the strip's length. The fit "
             "has the same model as the data."),
        ),
    )  # fmt: skip
