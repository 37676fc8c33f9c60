"""Rigs with a known truth, and the files that their loggers write of two ridges.

Signals are those of finer cells than an inversion has, along the stage's own motion. Nothing of
the truth is in a file but what a logger sees.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface_feature import RidgeFeature
from srsinv.grid import Line, as_real
from srsinv.inverse.features.contact import cell_for
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.gridding.cells import Window

FINER = 2.3  # times as many cells as a fit has, and in no simple ratio to them
TURN_S = 0.1  # for turning back
EDGE_M = 1e-5
FILM = {"strip_width_m": 7e-4, "active_length_m": 8e-3}
RIDGES = {
    "known": {"height_m": 20e-6, "width_m": 2e-3, "position_m": 0.0},
    "unknown": {"height_m": 25e-6, "width_m": 1.5e-3, "position_m": 1.2e-3},
}
PER_SI = {"s": 1, "ms": 1e3, "us": 1e6, "m": 1, "cm": 100, "mm": 1e3, "um": 1e6, "V": 1, "mV": 1e3}
Rng = np.random.Generator


@dataclasses.dataclass(frozen=True)
class Format:
    """How a logger writes: `columns` are (quantity, header, unit, digits after the point), of the
    quantities time, position, speed, 1 and 2 (the channels) and 0, which is of no interest."""

    columns: tuple[tuple[Any, str, str, int], ...] = (
        ("time", "Time (ms)", "ms", 4), (1, "Ch A [V]", "V", 6), (2, "Ch B [V]", "V", 6),
        ("position", "Stage pos (mm)", "mm", 4),
    )  # fmt: skip
    separator: str = ","
    decimal: str = "."
    suffix: str = ".csv"
    preamble: str = ""
    newline: str = "\n"
    encoding: str = "utf-8"


@dataclasses.dataclass(frozen=True)
class Rig:
    """A rig as it is, its motion, and what disturbs it.

    - `gains`: one for each strip, negative where the wiring turns a signal around.
    - `angle_deg`, `offset_m`: of the second strip.
    - `passes`: every other one back; `backwards`: the first one goes towards -x.
    - `noise`: white, of the largest sample; `hum` and `drift` (at the end) of the signal's rms.
    - `lost`, `blank`: rows that are not there, and that are empty.
    - `origin_m`: what the stage says where the known ridge is; `start_s`: the logger's first time.
    - `stated`: what the laboratory writes into the sidecar; `also`: what it adds to all
      commands, and `to_invert` to the inversion.
    """

    name: str
    depth_m: float = 1.2e-3
    angle_deg: float = 45.0
    offset_m: float = 1.5e-3
    gains: tuple[float, ...] = (95.0, 110.0)
    friction: float = 0.35
    nominal_pressure_Pa: float = 2e4
    speed_m_per_s: float = 0.02
    rate_hz: float = 2000.0
    half_m: float = 0.015
    passes: int = 1
    backwards: bool = False
    ripple: float = 0.0
    noise: float = 0.06
    hum: float = 0.0
    mains_Hz: float = 50.06
    drift: float = 0.0
    lost: int = 0
    blank: int = 0
    origin_m: float = 0.0
    start_s: float = 0.0
    format: Format = Format()
    stated: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    also: tuple[str, ...] = ()
    to_invert: tuple[str, ...] = ()

    @property
    def truth(self) -> dict[str, float]:
        """What a calibration looks for."""
        truth = {f"gain_{n}": abs(gain) for n, gain in enumerate(self.gains, 1)}
        truth |= {"depth_m": self.depth_m, "base_friction": self.friction}
        second = {"angle_2_deg": self.angle_deg, "offset_2_m": self.offset_m}
        return truth | (second if len(self.gains) > 1 else {})

    @property
    def sensor(self) -> Sensor:
        """Of its strips, each averaging over its width."""
        films = [
            Film(self.depth_m, strips=2),
            Film(self.depth_m, np.deg2rad(self.angle_deg), strips=2, offset_m=self.offset_m),
        ]  # fmt: skip
        films = [film.with_strip_average() for film in films[: len(self.gains)]]
        return Sensor(films, HalfSpace(0.5, 7e5), CurrentAmplifier(1e6))

    @property
    def motion(self) -> Motion:
        """Along x, the known ridge at zero."""
        rate, speed = self.rate_hz, self.speed_m_per_s
        steady = np.full(int(2 * self.half_m / speed * rate), speed)
        steady *= 1 + self.ripple * np.sin(2 * np.pi * 7.3 * np.arange(steady.size) / rate)
        turn = -steady[0] * np.sin(np.linspace(-np.pi / 2, np.pi / 2, int(TURN_S * rate)))
        parts = [(-1) ** i * part for i in range(self.passes) for part in (steady, turn)]
        speeds = np.concatenate(parts[: max(2 * self.passes - 1, 1)])
        way = -1 if self.backwards else 1
        return Motion.from_speed(np.arange(speeds.size) / rate, way * speeds, -way * self.half_m)


def model_of(rig: Rig) -> FeatureModel:
    """Of a ridge on a window around the scan."""
    half = rig.half_m + 10 * rig.depth_m
    cell = cell_for({"ridge": RidgeFeature(EDGE_M)}, rig.depth_m) / FINER
    model = FeatureModel.on_window(
        rig.sensor, rig.motion, Window(-half, half), cell, rig.nominal_pressure_Pa
    )
    return model.with_features({"ridge": RidgeFeature(EDGE_M)})


def parameters(rig: Rig, ridge: Mapping[str, float]) -> dict[str, Any]:
    """Of the model, with a ridge."""
    values = {"gain": 1.0, "nominal_pressure_Pa": rig.nominal_pressure_Pa,
              "base_friction": rig.friction}  # fmt: skip
    own = {**ridge, "edge_length_m": EDGE_M}
    common = {key: as_real(value) for key, value in values.items()}
    return {"ridge": {key: as_real(value) for key, value in own.items()}, **common}


def pressure(model: FeatureModel, rig: Rig, line: Line) -> Float[np.ndarray, " n"]:
    """The true pressure [Pa] on a line's cells, of the unknown ridge, less the plate's."""
    params = parameters(rig, RIDGES["unknown"])
    return np.asarray(model.cell_traction(params, line))[0]


def write(rig: Rig, folder: Path, model: FeatureModel) -> dict[str, Path]:
    """The rig's files of both ridges."""
    rng, paths = np.random.default_rng(sum(map(ord, rig.name))), {}
    for name, ridge in RIDGES.items():
        paths[name] = folder / f"{name}{rig.format.suffix}"
        text = _text(rig, _logged(rig, ridge, model, rng), rng)
        paths[name].write_bytes(text.encode(rig.format.encoding))
    return paths


def _logged(
    rig: Rig, ridge: Mapping[str, float], model: FeatureModel, rng: Rng
) -> dict[Any, Float[np.ndarray, " row"]]:
    """The columns in SI units."""
    motion = rig.motion
    time_s = np.asarray(motion.time_s)
    clean = np.asarray(model(parameters(rig, ridge)))
    size = np.std(clean)
    signal = clean + rig.noise * np.abs(clean).max() * rng.normal(size=clean.shape)
    for multiple, of_whole in ((1, 1.0), (3, 0.4)):
        phase = 2 * np.pi * multiple * rig.mains_Hz * time_s + rng.uniform(0, 6, (len(clean), 1))
        signal += rig.hum * size * 1.31 * of_whole * np.sin(phase)
    walk = np.cumsum(rng.normal(size=clean.shape), axis=1) / np.sqrt(time_s.size)
    signal = np.array(rig.gains)[:, None] * (signal + rig.drift * size * walk)
    return {
        "time": rig.start_s + time_s,
        "position": rig.origin_m + np.asarray(motion.position_m),
        "speed": np.asarray(motion.speed_m_per_s),
        0: rng.normal(23.0, 0.1, time_s.size),
        **dict(enumerate(signal, 1)),
    }


def _text(rig: Rig, logged: Mapping[Any, np.ndarray], rng: Rng) -> str:
    form = rig.format
    columns = [each for each in form.columns if each[0] in logged]
    scaled = [logged[key] * PER_SI.get(unit.split("/")[0], 1) for key, _, unit, _ in columns]
    digits = [f"%.{count}f" for *_, count in columns]
    rows = [
        form.separator.join(f % v for f, v in zip(digits, row, strict=True)).replace(
            ".", form.decimal
        )
        for row in zip(*scaled, strict=True)
    ]
    spoilt = rng.choice(np.arange(100, len(rows) - 100), rig.lost + rig.blank, replace=False)
    for row in spoilt[: rig.blank]:
        rows[row] = form.separator * (len(columns) - 1)
    lost = set(spoilt[rig.blank :].tolist())
    rows = [row for at, row in enumerate(rows) if at not in lost]
    header = form.separator.join(name for _, name, *_ in columns)
    return form.preamble + form.newline.join([header, *rows]) + form.newline
