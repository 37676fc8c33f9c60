"""Scans of a laboratory and the files that its logger writes, with what a laboratory has and no fit
knows of.

Signals are those of line loads and a contact of their own (tests/reference/line_rig.py): grip that
stays at an edge, shear that turns over while the skin slips, friction that goes by the pressure.
"""

import dataclasses
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from tests.reference.line_rig import D1, D3, Strip, charges, ridge_pressure

RESISTANCE_OHM, WIDTH_M, LENGTH_M, ZONE_M = 1e6, 7e-4, 8e-3, 6e-4
EDGE_M, NOMINAL_PA, MODULUS_PA = 5e-5, 2e4, 7e5 / (1 - 0.5**2)
AROUND_M, RATE_HZ = 0.01, 1000.0  # the window goes so far beyond the scan
TURN_S = 0.06  # for turning back
GRID_M, COARSE_M = 1.5e-5, 2.5e-5  # between splines' knots; cells that are more than one line load
ACROSS, ACROSS_WEIGHTS = np.polynomial.legendre.leggauss(5)  # of a strip's width
INSIDE, INSIDE_WEIGHTS = np.polynomial.legendre.leggauss(3)  # of a cell
KNOWN = {"height_m": 2e-5, "width_m": 2e-3, "position_m": 0.0}
LATER = {"height_m": 2.5e-5, "width_m": 1.5e-3, "position_m": 4e-4}


@dataclasses.dataclass(frozen=True)
class Lab:
    """A rig, what it scans, and what disturbs it.

    - `depth_m`, `angle_2_deg`, `offset_2_m`: of the films; `friction` of the plate.
    - `edges`: friction of the two edges, of a tape; `follows`: "motion" or "edge", as of a `Tape`.
    - `with_pressure`: a in mu (p / p0)^a.
    - `bump_m`, `pitch_m`, `amplitude_Pa`: length of a Gaussian bump of pressure, or pitch of a
      grating, in place of the feature.
    - `half_m`: half of the scan's length.
    - `rest_s`: for which the sensor stands still at first.
    - `is_back`: whether the scan turns; `slip_m`: over which shear turns over then, `linear` or
      `exponential`.
    - `noise`: white, of the largest sample; `hum` of the signal's rms, of `hum_Hz`.
    - `step_m`: of an encoder; `has_positions`: whether it is read at all.
    - `speed_times`: what is recorded of the speed; `gain_drift`: by the end.
    """

    depth_m: float = 7.5e-4
    angle_2_deg: float = 45.0
    offset_2_m: float = 1.5e-3
    friction: float = 0.45
    edges: tuple[float, float] | None = None
    follows: str = "motion"
    with_pressure: float = 0.0
    bump_m: float = 0.0
    pitch_m: float = 0.0
    amplitude_Pa: float = 3e3
    half_m: float = 8e-3
    rest_s: float = 0.5
    is_back: bool = True
    slip_m: float = 0.0
    turns_over: str = "linear"
    speed_m_per_s: float = 0.02
    rate_hz: float = RATE_HZ
    noise: float = 0.01
    hum: float = 0.0
    hum_Hz: float = 50.0
    step_m: float = 0.0
    has_positions: bool = True
    speed_times: float = 1.0
    gain_drift: float = 0.0

    @property
    def window_m(self) -> tuple[float, float]:
        """The stretch that is pressed on."""
        return -self.half_m - AROUND_M, self.half_m + AROUND_M

    @property
    def facts(self) -> dict[str, Any]:
        """What the laboratory states, rightly."""
        films = [
            {"angle_deg": angle, "strip_width_m": WIDTH_M, "active_length_m": LENGTH_M,
             "offset_m": offset}
            for angle, offset in ((0.0, 0.0), (self.angle_2_deg, self.offset_2_m))
        ]  # fmt: skip
        sensor = {"depth_m": self.depth_m, "feedback_resistance_ohm": RESISTANCE_OHM,
                  "elements": films}  # fmt: skip
        return {
            "sensor": sensor, "skin": {"youngs_modulus_Pa": 7e5, "poisson_ratio": 0.5},
            "nominal_pressure_Pa": NOMINAL_PA, "contact_window_m": list(self.window_m),
            "feature": {"edge_length_m": EDGE_M},
        }  # fmt: skip

    @property
    def rig(self) -> dict[str, float]:
        """What a calibration looks for, but for the feature's place."""
        return {"gain_1": 1.0, "gain_2": 1.0, "depth_m": self.depth_m,
                "angle_2_deg": self.angle_2_deg, "offset_2_m": self.offset_2_m,
                "base_friction": self.friction}  # fmt: skip

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and speeds: at rest, across, and back."""
        steady = np.full(
            round(2 * self.half_m / self.speed_m_per_s * self.rate_hz), self.speed_m_per_s
        )
        turn = np.cos(np.linspace(0, np.pi, round(TURN_S * self.rate_hz))) * self.speed_m_per_s
        rest = np.zeros(round(self.rest_s * self.rate_hz))
        parts = [rest, steady, turn, -steady] if self.is_back else [rest, steady]
        speed = np.concatenate(parts)
        path = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)]) / self.rate_hz
        return path - self.half_m, speed


class Load(NamedTuple):
    """Cells (their `edges`), the pressure on them, and the friction onwards and back."""

    edges: np.ndarray
    pressure: np.ndarray
    frictions: tuple[np.ndarray, np.ndarray]

    @property
    def excess(self) -> np.ndarray:
        """The pressure less the nominal one."""
        return self.pressure - NOMINAL_PA

    def cell_means(self, values: np.ndarray, x: np.ndarray, cell_m: float) -> np.ndarray:
        """Means of what is uniform in the load's cells over others, about `x`."""
        below = np.append(0.0, np.cumsum(values * np.diff(self.edges)))
        ends = (np.interp(x + sign * cell_m / 2, self.edges, below) for sign in (1, -1))
        after, before = ends
        return (after - before) / cell_m


@lru_cache(maxsize=8)
def load(lab: Lab, height_m: float, width_m: float, place_m: float) -> Load:
    """The load of a feature, of the bump or of the grating."""
    corners = [place_m - width_m / 2, place_m + width_m / 2]
    if lab.bump_m or lab.pitch_m:
        edges = np.linspace(*lab.window_m, 3001)
        x = (edges[1:] + edges[:-1]) / 2
        shape = np.exp(-(((x - place_m) / lab.bump_m) ** 2)) if lab.bump_m else _grating(x, lab)
        pressure = NOMINAL_PA + lab.amplitude_Pa * shape
    else:
        shape = height_m, width_m, place_m, EDGE_M
        edges, pressure = ridge_pressure(*shape, lab.window_m, MODULUS_PA, NOMINAL_PA)
        x = (edges[1:] + edges[:-1]) / 2
    plate = lab.friction * (np.maximum(pressure, 0.0) / NOMINAL_PA) ** lab.with_pressure
    if lab.edges is None:
        return Load(edges, pressure, (plate, plate))
    zones = [np.exp(-(((x - corner) / ZONE_M) ** 2)) for corner in corners]
    swapped = zones[::-1] if lab.follows == "motion" else zones
    frictions = (
        plate + sum((own - lab.friction) * zone for own, zone in zip(lab.edges, each, strict=True))
        for each in (zones, swapped)
    )
    onwards, back = frictions
    return Load(edges, pressure, (onwards, back))


def _grating(x: np.ndarray, lab: Lab) -> np.ndarray:
    inside = (np.abs(x) < lab.half_m) * np.cos(np.pi / 2 * x / lab.half_m)
    return inside**2 * np.cos(2 * np.pi * x / lab.pitch_m)


def clean_signal(lab: Lab, made: Load) -> np.ndarray:
    """The signals (2, sample) [V] without noise.

    With the shear's state m from -1 (back) to 1 (onwards) the charge is C_p + (1 + m)/2 C_on -
    (1 - m)/2 C_back, and the signal its derivative in time.
    """
    x, speed = lab.motion()
    state, turning = _states(lab, speed)
    onwards, back = (each * made.pressure - lab.friction * NOMINAL_PA for each in made.frictions)
    grid = np.arange(x.min() - 4 * GRID_M, x.max() + 5 * GRID_M, GRID_M)
    rows = []
    for angle, offset in ((0.0, 0.0), (np.deg2rad(lab.angle_2_deg), lab.offset_2_m)):
        strip = Strip(lab.depth_m, angle, 0.0, 0.0, WIDTH_M * LENGTH_M)
        loads = np.stack([made.excess, onwards, back])
        of_p, of_on, of_back = _charge_splines(strip, grid + offset, grid, made.edges, loads)
        uniform = (D3 - D1) * np.sin(2 * angle) * lab.friction * NOMINAL_PA
        sliding = (1 + state) / 2 * of_on(x, 1) - (1 - state) / 2 * of_back(x, 1)
        over = turning * ((of_on(x) + of_back(x)) / 2 + uniform)
        rows.append(strip.area_m2 * (speed * (of_p(x, 1) + sliding) + over))
    return RESISTANCE_OHM * np.stack(rows)


def _states(lab: Lab, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shear's state and its derivative in time."""
    back = speed < 0
    if not lab.slip_m:
        return np.where(back, -1.0, 1.0), np.zeros(speed.size)
    since = np.cumsum(np.where(back, -speed, 0.0)) / lab.rate_hz
    if lab.turns_over == "linear":
        state = 1 - 2 * np.minimum(since / lab.slip_m, 1)
        slope = np.where(since < lab.slip_m, -2 / lab.slip_m, 0.0)
    else:
        state = 2 * np.exp(-since / lab.slip_m) - 1
        slope = -(state + 1) / lab.slip_m
        state = np.where(state < -1 + 1e-6, -1.0, state)
    return state, slope * np.where(back, -speed, 0.0)


def _charge_splines(
    strip: Strip, at: np.ndarray, grid: np.ndarray, edges: np.ndarray, loads: np.ndarray
) -> list[CubicSpline]:
    """Charges per area over the grid's places, by pressure and by shear onwards and back."""
    middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    wide = width > COARSE_M
    inside = (middle[wide, None] + width[wide, None] / 2 * INSIDE).ravel()
    places = np.concatenate([middle[~wide], inside])

    def lines(load: np.ndarray) -> np.ndarray:
        own = load * width
        return np.concatenate([own[~wide], (own[wide, None] * INSIDE_WEIGHTS / 2).ravel()])

    by_p, *by_q = map(lines, loads)
    total = np.zeros((3, grid.size))
    for node, weight in zip(ACROSS, ACROSS_WEIGHTS / 2, strict=True):
        for some in np.array_split(np.arange(grid.size), 16):
            away = at[some, None] + node * WIDTH_M / 2 - places
            from_p, from_q = charges(strip, away, 0.5)
            total[0, some] += weight * from_p @ by_p
            total[1:, some] += weight * np.stack([from_q @ each for each in by_q])
    return [CubicSpline(grid, row) for row in total]


def recorded(lab: Lab, made: Load, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The columns that the logger writes."""
    x, speed = lab.motion()
    time_s = np.arange(x.size) / lab.rate_hz
    clean = clean_signal(lab, made)
    turned = np.abs(_states(lab, speed)[0]) == 1  # what turns over is larger than the feature
    signal = clean + lab.noise * np.abs(clean[:, turned]).max() * rng.normal(size=clean.shape)
    sliding = np.sqrt(np.mean(clean[:, speed != 0] ** 2))
    phase = 2 * np.pi * (lab.hum_Hz * time_s + rng.random((2, 1)))
    signal += np.sqrt(2) * lab.hum * sliding * np.sin(phase)
    signal *= 1 + lab.gain_drift * time_s / time_s[-1]
    origin = rng.random()  # of the counts: steps, which the file's positions have no part of
    seen = lab.step_m * (np.round(x / lab.step_m + origin) - origin) if lab.step_m else x
    where = {"position_m": seen} if lab.has_positions else {}
    how_fast = {} if lab.step_m else {"speed_m_per_s": lab.speed_times * speed}
    return {"time_s": time_s, **where, **how_fast,
            "voltage_0_V": signal[0], "voltage_1_V": signal[1]}  # fmt: skip


def write(folder: Path, columns: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> Path:
    """The logger's file and its sidecar."""
    path = folder / "scan.csv"
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, "%.9g", ",", header=",".join(columns), comments="")
    path.with_suffix(".json").write_text(json.dumps(facts))
    return path
