"""Linearity of the rig: the charge's first harmonic over the amplitude of a vibrating edge."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import xarray
from matplotlib.figure import Figure
from scipy.optimize import brentq

from srsinv import config, plot
from srsinv.errors import choice, number, number_range, numbers, refuse, shown, whole
from srsinv.forward.indentation import Indentation, has_indentation
from srsinv.forward.knife_edge import KnifeEdge
from srsinv.forward.sensor import Sensor
from srsinv.forward.vibration import harmonics
from srsinv.report.result import Result, dataset
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity

NAME = "linearity"
CONTROLS = ("load", "displacement")
SAMPLES = 4096  # of a period: where the edge leaves the skin the charge has a kink
SINE = np.sin(2 * np.pi * np.arange(SAMPLES) / SAMPLES)
PAPER_DB = 3.0

Curve = Callable[[np.ndarray], np.ndarray]
Response = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def run(cfg: config.Config) -> Result:
    """First harmonic and distortion of the charge over the amplitude, for edges of some radii.

    Raises `BadInput` for a sensor that has not one element, a displacement on a skin where none is
    defined, and refusals of the configuration's parts.
    """
    given = _checked(cfg[NAME])
    with config.precision(cfg):
        sensor = config.at_rest(cfg).sensor
        sensor.require_elements(1)
        edges = [KnifeEdge(r, np.deg2rad(given["direction_deg"])) for r in given["radii_m"]]
        drives = [Drive(sensor, edge, given) for edge in edges]
        controls = given["controls"] or [c for c in CONTROLS if all(d.allows(c) for d in drives)]
        swept = [[drive.swept(control) for drive in drives] for control in controls]
        half = [e.half_width_m(sensor.skin, given["preload_N_per_m"]).item() for e in edges]
    level, distortion, at_3_dB = (
        np.array([[one[i] for one in row] for row in swept]) for i in range(3)
    )
    data = dataset(
        _variables(level, distortion, at_3_dB, given["amplitude"], half),
        {"control": (controls, "1"), "radius": (given["radii_m"], "m"),
         "amplitude": (given["amplitude"], "1")},
        skin=sensor.skin.words, effects_on=listed(cfg["effects"]), depth_m=float(sensor.depth_m),
        preload_N_per_m=given["preload_N_per_m"], place_m=given["place_m"],
        direction_deg=given["direction_deg"],
    )  # fmt: skip
    return Result(_title(data), data, sections(__file__, gain=draw_gain))


def _checked(settings: Any) -> dict[str, Any]:
    """The settings within their bounds, and the amplitudes over the preload, 1 among them."""
    given, wanted = dict(settings), "lengths in metres that are at least 0"
    given["radii_m"] = numbers(f"{NAME}.radii_m", given["radii_m"], wanted, least=0)
    controls = given["controls"]
    refuse(
        not (controls is None or (isinstance(controls, list) and controls)),
        f"{NAME}.controls is {shown(controls)}: give a list of {', '.join(CONTROLS)}, or null.",
    )
    for each in controls or ():
        choice(f"{NAME}.controls", each, CONTROLS)
    wanted = "positive numbers, over the preload, up to 100"
    low, high = number_range(
        f"{NAME}.amplitude_range", given["amplitude_range"], wanted, above=0, most=100
    )
    refuse(
        low > 1,
        f"{NAME}.amplitude_range begins at {low:g} of the preload, where the edge leaves the skin: "
        "give a least amplitude up to 1.",
    )
    wanted = "a whole number from 3 to 2000"
    count = whole(f"{NAME}.amplitudes", given["amplitudes"], wanted, least=3, most=2000)
    inside = [1.0] if low <= 1 <= high else []
    given["amplitude"] = np.union1d(np.geomspace(low, high, count), inside)
    number(f"{NAME}.preload_N_per_m", given["preload_N_per_m"], "a positive load in N/m", above=0)
    number(f"{NAME}.place_m", given["place_m"], "a position in metres")
    wanted, direction = "an angle from -90 to 90 degrees", given["direction_deg"]
    number(f"{NAME}.direction_deg", direction, wanted, least=-90, most=90)
    return given


@dataclass(frozen=True)
class Drive:
    """An edge over the resting film, its load or its displacement driven by a sine."""

    sensor: Sensor
    edge: KnifeEdge
    given: Mapping[str, Any]

    def allows(self, control: str) -> bool:
        """Whether the control is defined: a displacement needs a rigid core and a radius."""
        depth = float(self.sensor.depth_m)
        return control == "load" or has_indentation(self.edge, self.sensor.skin, depth)

    def response(self, control: str) -> Response:
        """From amplitudes over the preload to the first harmonic over what proportionality to small
        amplitudes gives, and the root of the squares of the others over the first."""
        most = 1 + self.given["amplitude"][-1]
        load_of, small = self._by_load() if control == "load" else self._by_displacement(most)
        largest = float(np.max(load_of(np.array([most]))))
        charge = self.edge.charge_of_load(self.sensor, self.given["place_m"], largest)

        def response(amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            load = load_of(np.maximum(1 + amplitude[:, None] * SINE[None], 0.0))
            each = np.abs(harmonics(charge(load)[0, 0]))
            first = each[:, 1]
            return first / (amplitude * abs(small)), np.linalg.norm(each[:, 2:], axis=1) / first

        return response

    def _by_load(self) -> tuple[Curve, float]:
        """The load [N/m] of a drive over its mean, and the amplitude of the charge over a small one
        of the drive."""
        preload = self.given["preload_N_per_m"]
        small = self.edge.charge_per_load(self.sensor, self.given["place_m"], preload).item()
        return lambda drive: preload * drive, preload * small

    def _by_displacement(self, most: float) -> tuple[Curve, float]:
        """The same for a displacement, of drives up to `most` times the preload's indentation."""
        relation = Indentation(self.edge, self.sensor.skin, float(self.sensor.depth_m))
        preload = np.array([self.given["preload_N_per_m"]], float)
        depth, softness = (f(preload).item() for f in (relation.indentation_m, relation.per_load))
        largest, (_, small) = float(preload[0]) * most, self._by_load()
        per_drive = small / preload[0] * depth / softness
        return lambda drive: relation.load_N_per_m(depth * drive, largest), float(per_drive)

    def swept(self, control: str) -> tuple[np.ndarray, np.ndarray, float]:
        """Deviation from proportionality [dB] and distortion (amplitude,), and the least amplitude
        at which the deviation is that of the paper, NaN if nowhere."""
        response, amplitude = self.response(control), self.given["amplitude"]

        def excess(at: float) -> float:
            return abs(20 * float(np.log10(response(np.array([at]))[0][0]))) - PAPER_DB

        gain, distortion = response(amplitude)
        level = 20 * np.log10(gain)
        outside = np.flatnonzero(np.abs(level) >= PAPER_DB)
        if not outside.size:
            return level, distortion, float("nan")
        after = outside[0]
        if after == 0:
            return level, distortion, float(amplitude[0])
        crossing = brentq(excess, float(amplitude[after - 1]), float(amplitude[after]))
        return level, distortion, cast(float, crossing)


def _variables(
    level: np.ndarray,
    distortion: np.ndarray,
    at_3_dB: np.ndarray,
    amplitude: np.ndarray,
    half: list[float],
) -> dict[str, tuple[Any, ...]]:
    along = ("control", "radius", "amplitude")
    touching = amplitude <= 1
    worst = np.abs(level[..., touching]).max(-1)
    at = "{control}_at_{radius}_m"
    return {
        "first_harmonic": (along, 10 ** (level / 20) * amplitude, "1"),
        "deviation": (along, level, "dB"),
        "distortion": (along, distortion, "1"),
        "greatest_deviation": (along[:2], worst, "dB", f"deviation_{at}_dB"),
        "distortion_at_preload": (along[:2], distortion[..., touching][..., -1], "1",
                                  f"distortion_{at}"),
        "amplitude_at_3_dB": (along[:2], at_3_dB, "1",
                              f"amplitude_at_3_dB_{at}"),
        "half_width": ("radius", half, "m", "half_width_at_{radius}_m"),
    }  # fmt: skip


def _title(data: xarray.Dataset) -> str:
    amplitude = data["amplitude"].values
    top = amplitude[amplitude <= 1][-1]
    worst = data["greatest_deviation"].max("radius")
    each = [f"{float(w):.2g} dB by {c}" for c, w in zip(data["control"].values, worst, strict=True)]
    return (
        f"From {100 * amplitude[0]:.3g} to {100 * top:.3g} % of the preload the response is "
        f"proportional within {' and '.join(each)}; the paper measured {PAPER_DB:g} dB"
    )


def draw_gain(ds: xarray.Dataset) -> Figure:
    """Deviation from proportionality and distortion over amplitude, a column for each control."""
    marks = [plot.Mark(1.0, "the edge leaves the skin")]

    def one(control: str, name: str, word: str, **settings: Any) -> plot.Panel:
        own = ds[name].sel(control=control)
        lines = {f"radius {quantity(r, 'm')}": own.sel(radius=r) for r in ds["radius"].values}
        return plot.panel(
            lines, quantity=word, along="amplitude over the preload's", title=f"{control} given",
            marks=marks, **settings,
        )  # fmt: skip

    kinds = (
        ("first_harmonic", "first harmonic", {"log": "xy"}),
        ("deviation", "deviation", {"log": "x"}),
        ("distortion", "distortion", {"log": "xy"}),
    )
    return plot.panels([
        [one(str(c), name, word, **more) for c in ds["control"].values]
        for name, word, more in kinds
    ])  # fmt: skip
