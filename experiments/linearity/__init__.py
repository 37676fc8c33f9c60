"""Linearity of the rig: the charge's first harmonic over the amplitude of a vibrating edge."""

from typing import Any

import numpy as np
import xarray

from srsinv import config
from srsinv.errors import choice, echo, number, number_range, numbers, refuse, whole
from srsinv.forward.knife_edge import KnifeEdge
from srsinv.report.data import dataset
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed

from .drive import PAPER_DB, Drive
from .figures import draw_gain

NAME = "linearity"
CONTROLS = ("load", "displacement")


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
        f"{NAME}.controls is {echo(controls)}: give a list of {', '.join(CONTROLS)}, or null.",
    )
    for each in controls or ():
        choice(f"{NAME}.controls", each, CONTROLS)
    wanted = "positive numbers, over the preload, up to 100"
    low, high = number_range(
        f"{NAME}.amplitude_range", given["amplitude_range"], wanted, above=0, most=100
    )
    refuse(
        low > 1,
        f"{NAME}.amplitude_range begins at {low:g} of the preload, where the edge "
        "leaves the skin: give a least amplitude up to 1.",
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
    each = [
        f"{float(w):.2g} dB for a given {c}"
        for c, w in zip(data["control"].values, worst, strict=True)
    ]
    return (
        f"From {100 * amplitude[0]:.3g} to {100 * top:.3g} % of the preload the response is "
        f"proportional within {' and '.join(each)}; the paper measured {PAPER_DB:g} dB"
    )
