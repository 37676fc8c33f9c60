"""Recordings on a line of cells: the problem that an inversion solves, and what it assumes."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import choice, refuse
from ..forward.sensor import Sensor
from ..inverse.cells import FEW, refuse_reversing, sample_spacing_m
from ..inverse.line_problem import LineProblem
from ..inverse.problem import Problem
from ..recording import Recording
from ..recording.even import STEADY, check_volts
from ..resolution import cell_m
from .recorded import Rows, effects_rows, times_rows


@dataclass(frozen=True)
class RecordingProblem:
    """A recording and the problem of inverting it on a line, p and q in `traction_unit`; `assumed`:
    its assumptions in words."""

    recording: Recording
    sensor: Sensor
    speed_m_per_s: float
    problem: LineProblem
    traction_unit: str
    assumed: Rows


@dataclass(frozen=True)
class StatedSettings:
    """What a page states of the configuration as it is given: the effects that are on, mu of
    q = mu p or null, and how the times of the file are taken."""

    effects: Iterable[str]
    friction: Any
    times: Any


def recording_problem(
    recording: Recording,
    problem: Problem,
    traction_unit: str,
    stated: StatedSettings,
    purpose: str | None = None,
) -> RecordingProblem:
    """The problem of a recording, on an open line over its contact window.

    Cells are `recording.cell_m` wide; where that is null, as the `purpose` asks for (see
    resolution.py), or as [`Problem.on_line`][] has it. Raises
    `BadInput` for a recording that cannot be inverted.
    """
    depth = float(problem.sensor.depth_m)
    on_line = problem.on_line(cell_m(purpose, depth) if purpose else None)
    speed = float(np.mean(recording.speed_m_per_s))
    assumed = _assumed(stated, recording, problem, on_line, traction_unit)
    assert on_line.sensor is not None
    return RecordingProblem(recording, on_line.sensor, speed, on_line, traction_unit, assumed)


def traction_unit_named(given: Any) -> str:
    """The unit of p and q: Pa, or "1" where the sensor's or the amplifier's gain is not known and
    they are relative."""
    return {"Pa": "Pa", "relative": "1"}[choice("traction_unit", given, ("Pa", "relative"))]


def check_invertible(recording: Recording, unit: str) -> None:
    """Refuse a recording that turns back, or that cannot give p and q in this unit."""
    refuse_reversing(recording.name, recording.speed_m_per_s)
    if unit == "Pa":
        check_volts(recording)
    refuse(
        unit == "1" and recording.sidecar.get("nominal_pressure_Pa") is not None,
        f"{recording.name}: nominal_pressure_Pa is given, and traction_unit=relative makes p a "
        "number without a unit: leave one of them out.",
    )


def _assumed(
    stated: StatedSettings,
    recording: Recording,
    problem: Problem,
    on_line: LineProblem,
    traction_unit: str,
) -> Rows:
    unit, line, nominal = recording.signal_unit, on_line.line, problem.nominal_pressure_Pa
    spacing = sample_spacing_m(problem.motion)
    block, noise = round(float(line.cell_m) / spacing), problem.noise
    return (
        ("recording", f"{recording.name}, {recording.time_s.size} samples {1e6 * spacing:.4g} um "
         f"apart"),
        *times_rows(recording, stated.times),
        ("cells", f"{line.n} of {1e6 * float(line.cell_m):.4g} um, "
         + _filled_with(recording, block)),
        ("line", "open: p and q are deviations from a uniform background, zero outside the window"),
        ("window", f"{1e3 * float(line.x[0]):.4g} to {1e3 * float(line.x[-1]):.4g} mm; beyond the "
         "scan's ends the traction is estimated from what can still be felt there"),
        ("nominal pressure", "not known" if nominal is None else f"{nominal:.4g} Pa"),
        ("skin", problem.sensor.skin.words),
        ("amplifier", type(problem.sensor.amplifier).__name__),
        ("noise", f"white, {float(noise.rms):.3g} {unit} per sample, "
         + ("given" if not noise.is_estimate
            else "from the highest wavenumbers of the recording")),
        *effects_rows(stated.effects),
        ("p and q", "apart" if stated.friction is None else f"q = {stated.friction} p"),
        *((("unit of p and q", "relative: the signal's unit over the sensor's assumed gain, which "
            "nobody measured"),) if traction_unit == "1" else ()),
    )  # fmt: skip


def _filled_with(recording: Recording, block: int) -> str:
    """Computation of cells from samples, in words."""
    steady = recording.is_constant_speed(STEADY)
    if steady and not np.isfinite(recording.signal).all():
        return (
            f"each with the mean of those of {block} samples that are there; cells with less than "
            f"{FEW:.0%} of them are missing"
        )
    if steady:
        return f"each with the mean of {block} samples (as the model has it, too)"
    speed = recording.speed_m_per_s
    return (
        f"each with the signal at the mean speed of {speed.mean():.4g} m/s that explains its "
        f"samples best (the speed goes from {speed.min():.4g} to {speed.max():.4g} m/s); cells "
        "passed too fast or too slowly to tell are missing"
    )
