"""Recordings for inversion: which can be inverted, and on which line of cells."""

from collections.abc import Iterable
from typing import Any

from ..errors import choice, refuse
from ..inverse.bursts.method import BurstInversion
from ..inverse.line.problem import LineProblem
from ..inverse.problem import Problem
from ..progress import stage
from ..recording import Recording
from ..recording.even import check_volts
from ..resolution import cell_m


def on_cells(problem: Problem, purpose: str | None = None) -> LineProblem:
    """A recording's problem on an open line over its contact window.

    Cells are as wide as the configuration has them; where it leaves that open, as the `purpose`
    asks for (see resolution.py), or as [`Problem.to_grid`][] has it. Raises `BadInput` for a
    recording that cannot be inverted.
    """
    depth = float(problem.sensor.depth_m)
    with stage("gridding the signals"):
        return problem.to_grid(cell_m(purpose, depth) if purpose else None)


def traction_unit_named(given: Any) -> str:
    """The unit of p and q: Pa, or "1" where the sensor's or the amplifier's gain is not known and
    they are relative."""
    return {"Pa": "Pa", "relative": "1"}[choice("traction_unit", given, ("Pa", "relative"))]


def check_invertible(recording: Recording, unit: str, methods: Iterable[Any] = ()) -> None:
    """Refuse a recording that cannot give p and q in this unit, or by these methods."""
    if unit == "Pa":
        check_volts(recording)
    seeks_bursts = any(isinstance(each, BurstInversion) for each in methods)
    refuse(
        seeks_bursts and recording.sidecar.get("unusable") != "keep",
        f"{recording.name}: bursts stand out of the noise, and method=bursts needs samples that "
        "else are taken as missing: give recording.unusable=keep.",
    )
    refuse(
        unit == "1" and recording.sidecar.get("nominal_pressure_Pa") is not None,
        f"{recording.name}: recording.nominal_pressure_Pa is in Pa, but "
        "traction_unit=relative has no unit: leave one of them out.",
    )
