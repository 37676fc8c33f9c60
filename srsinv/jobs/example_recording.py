"""Recordings as a lab's rig writes them, simulated: a known ridge and another, to try things on."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray
from jaxtyping import Float
from matplotlib.figure import Figure

from .. import config, plot
from ..errors import echo, mapping, number, number_range, refuse, whole
from ..forward.scan import Motion
from ..forward.surface_feature import RidgeFeature
from ..grid import as_real
from ..inverse.features.contact import cell_for
from ..inverse.features.model import FeatureModel
from ..inverse.gridding.cells import Window
from ..recorded import sensor_of
from ..recording import Recording
from ..report.data import dataset
from ..report.result import Result
from ..report.section import sections

FINER = 2.5  # times as many cells as a fit has, and in no simple ratio to them
COLUMNS = ("Time (ms)", "Ch A [V]", "Ch B [V]", "Stage pos (mm)")
FORMATS = ("%.4f", "%.6f", "%.6f", "%.4f")  # digits as a logger writes them
RIDGE = ("height_m", "width_m", "position_m")
DISTURBANCES = {"passes": 1, "hum": 0.0, "drift": 0.0, "lost_rows": 0}
GAINS = "give one number for each element"
MOST_OF_A_PASS = 1_000_000  # samples
TURN_S = 0.1  # for turning back
LINES_HZ = {50.08: 1.0, 150.24: 0.4}  # of hum, and their relative sizes
NUMBERS = {
    "friction": "a number",
    "speed_m_per_s": "a speed in m/s",
    "sample_rate_hz": "a rate in Hz",
    "noise_rms_V": "a voltage, before the gain",
}


def run(cfg: config.Config) -> Result:
    """The job: simulate every ridge, and write each as a file of columns with its sidecar."""
    with config.precision(cfg):
        settings = mapping("example", config.part(cfg, "example"))
        ridges = mapping("example.ridges", settings.get("ridges"))
        refuse(
            not ridges,
            "example.ridges is empty: give one by name, with height_m, width_m and position_m.",
        )
        for key, wanted in NUMBERS.items():
            number(f"example.{key}", settings.get(key), wanted)
        rng = np.random.default_rng(config.seed(cfg))
        tables = {str(name): _table(str(name), settings, rng) for name in ridges}
        sidecar = "# What is known of the rig.\n" + json.dumps(settings["rig"], indent=1) + "\n"
        files = {f"{name}.csv": _csv(table) for name, table in tables.items()}
        files |= {f"{name}.yaml": sidecar for name in tables}  # JSON is YAML
        common = {"base_friction": settings["friction"]}
        truth = {n: {part: each[part] for part in RIDGE} | common for n, each in ridges.items()}
        files["truth.json"] = json.dumps(truth, indent=1) + "\n"
        pages = sections("example_recording", signals=signals)
        count = f"{len(tables)} example recording{'s' * (len(tables) > 1)}"
        title = f"{count} of a rig with two films: {', '.join(tables)}"
        return Result(title, _dataset(tables), pages, files)


def _table(
    name: str, settings: Mapping[str, Any], rng: np.random.Generator
) -> Float[np.ndarray, "4 row"]:
    """A recording's columns, in the order and the units of `COLUMNS`; lost rows are NaN."""
    ridge = mapping(f"example.ridges.{name}", settings["ridges"][name])
    for part in RIDGE:
        number(f"example.ridges.{name}.{part}", ridge.get(part), "a length in metres")
    beside = DISTURBANCES | {key: each for key, each in ridge.items() if key not in RIDGE}
    for key, value in beside.items():
        refuse(key not in DISTURBANCES, f"example.ridges.{name} has no key {key}.")
        number(f"example.ridges.{name}.{key}", value, "a number that is at least 0", least=0)
    wanted = "a whole number from {}".format
    passes = whole(f"example.ridges.{name}.passes", beside["passes"], wanted(1), least=1)
    lost = whole(f"example.ridges.{name}.lost_rows", beside["lost_rows"], wanted(0), least=0)
    rig = dict(settings["rig"])
    refuse(not isinstance(rig["gain"], list), f"example.rig.gain is {echo(rig['gain'])}: {GAINS}.")
    gain = np.array([float(number("example.rig.gain", each)) for each in rig["gain"]])[:, None]
    in_m = "positions in metres"
    start_m, end_m = number_range("example.rig.contact_window_m", rig["contact_window_m"], in_m)
    lead_m = (end_m - start_m) / 8
    rate_hz, speed = (
        float(number(f"example.{each}", settings[each], "a positive number", above=0))
        for each in ("sample_rate_hz", "speed_m_per_s")
    )
    count = (end_m - start_m - 2 * lead_m) / speed * rate_hz
    refuse(
        not 1 <= count <= MOST_OF_A_PASS,
        f"example.speed_m_per_s and example.sample_rate_hz make {count:.3g} samples "
        f"per pass: give values that make 1 to {MOST_OF_A_PASS}.",
    )
    steady = np.full(int(count), speed)
    speeds = _there_and_back(steady, int(TURN_S * rate_hz), passes)
    time_s = np.arange(speeds.size) / rate_hz
    motion = Motion.from_speed(time_s, speeds, start_m + lead_m)
    clean = _signal(name, rig, ridge, settings["friction"], motion)
    noise = rng.normal(scale=float(settings["noise_rms_V"]), size=clean.shape)
    noise = noise + np.std(clean) * _disturbances(time_s, clean.shape, beside, rng)
    table = np.vstack([1e3 * time_s, gain * (clean + noise), 1e3 * np.asarray(motion.position_m)])
    within = np.arange(100, max(speeds.size - 100, 100))
    refuse(
        lost > within.size,
        f"example.ridges.{name}.lost_rows is {lost}: give at most {within.size} of "
        f"the {speeds.size} rows.",
    )
    table[:, rng.choice(within, lost, replace=False)] = np.nan
    return table


def _there_and_back(
    steady: Float[np.ndarray, " pass"], turning: int, passes: int
) -> Float[np.ndarray, " row"]:
    """Speeds of so many passes, every other one back."""
    turn = -steady[0] * np.sin(np.linspace(-np.pi / 2, np.pi / 2, turning))
    parts = [(-1) ** i * part for i in range(passes) for part in (steady, turn)]
    return np.concatenate(parts[: max(2 * passes - 1, 1)])


def _disturbances(
    time_s: Float[np.ndarray, " row"],
    shape: tuple[int, ...],
    beside: Mapping[str, Any],
    rng: np.random.Generator,
) -> Float[np.ndarray, "e row"]:
    """Hum and drift, over the signal's rms."""
    made = np.zeros(shape)
    if beside["hum"]:
        whole = np.sqrt(sum(size**2 for size in LINES_HZ.values()) / 2)
        for frequency, size in LINES_HZ.items():
            phase = 2 * np.pi * frequency * time_s + rng.uniform(0, 6, size=(shape[0], 1))
            made += beside["hum"] / whole * size * np.sin(phase)
    if beside["drift"]:
        steps = rng.normal(size=shape) / np.sqrt(time_s.size)
        made += beside["drift"] * np.cumsum(steps, axis=1)
    return made


def _signal(
    name: str, rig: Mapping[str, Any], ridge: Mapping[str, Any], friction: float, motion: Motion
) -> Float[np.ndarray, "e sample"]:
    """The voltage [V] of each film along the motion, without noise."""
    none = np.zeros((len(rig["gain"]), motion.time_s.size))
    channels = tuple(COLUMNS[1:-1])
    moved = np.asarray(motion.time_s), np.asarray(motion.speed_m_per_s)
    known = Recording(none, *moved, channels, dict(rig), name=name)
    sensor = sensor_of(known)
    feature = RidgeFeature(rig["feature"]["edge_length_m"])
    pressure, window = float(rig["nominal_pressure_Pa"]), Window(*rig["contact_window_m"])
    cell = cell_for({name: feature}, float(sensor.depth_m)) / FINER
    model = FeatureModel.on_window(sensor, motion, window, cell, pressure)
    own = {part: as_real(float(ridge[part])) for part in RIDGE}
    values = {"gain": 1.0, "nominal_pressure_Pa": pressure, "base_friction": friction}
    common = {key: as_real(float(value)) for key, value in values.items()}
    own["edge_length_m"] = as_real(feature.edge_m)
    return np.asarray(model.with_features({name: feature})({name: own, **common}))


def _csv(table: Float[np.ndarray, "4 row"]) -> str:
    """The rows; of those that are lost every other one is blank, the rest are not there."""
    lost = np.cumsum(np.isnan(table[0]))
    rows = (
        "," * (len(COLUMNS) - 1) if np.isnan(row[0])
        else ",".join(form % value for form, value in zip(FORMATS, row, strict=True))
        for row, before in zip(table.T, lost, strict=True)
        if np.isfinite(row[0]) or before % 2
    )  # fmt: skip
    return "\n".join([",".join(COLUMNS), *rows]) + "\n"


def _dataset(tables: Mapping[str, Float[np.ndarray, "4 row"]]) -> xarray.Dataset:
    longest = max(table.shape[1] for table in tables.values())
    whole = np.full((len(tables), 4, longest), np.nan)
    for row, table in enumerate(tables.values()):
        whole[row, :, : table.shape[1]] = table
    each = ("recording", "row")
    return dataset(
        {
            "time": (each, 1e-3 * whole[:, 0], "s"),
            "position": (each, 1e-3 * whole[:, -1], "m"),
            "signal": (("recording", "channel", "row"), whole[:, 1:-1], "V"),
        },
        {"recording": (list(tables), "1"), "channel": (["Ch A", "Ch B"], "1")},
    )


def signals(ds: xarray.Dataset) -> Figure:
    """The channels of each recording over the stage's position."""
    channels = [str(channel) for channel in ds["channel"].values]
    across, up = plot.PanelAxis("stage position", "m"), plot.PanelAxis("signal", "V")
    parts = [
        plot.Panel(
            [plot.Curve(values, name) for values, name in zip(rows, channels, strict=True)],
            across, up, x, str(title), [],
        )
        for title, rows, x in zip(
            ds["recording"].values, ds["signal"].values, ds["position"].values, strict=True
        )
    ]  # fmt: skip
    return plot.panels(parts, height_in=1.9)
