"""The sidecar that a calibration leaves: the rig, and how its logger writes files.

What else was stated of the known recording (its times, motion, stretches, load and noise) is of
that recording alone, and stays in its own sidecar.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import refuse
from ..forward.film import Film
from ..inverse.problem import Problem
from ..inverse.rig.calibration import Calibration
from ..recording import Reader, Recording, facts_of
from ._written_files import Target

# The first line of a sidecar: JSON is YAML, and the checksum tells one that was edited by hand.
HEADER = "# Written by srsinv experiment=calibrate; SHA-256 of the lines below: {}"
OF_FILE = ("channels", "time_column", "time_unit", "position_column", "position_unit",
           "speed_column", "speed_unit", "signal_unit")  # fmt: skip


@dataclass(frozen=True)
class Wiring:
    """What the file, its sidecar and the configuration state of its channels, `facts`, of which
    gain and polarity are in the recording's numbers already."""

    facts: Mapping[str, Any]

    def in_volts(self, recording: Recording) -> Recording:
        """The recording as voltages at a gain that is to be found, whatever its unit."""
        return replace(recording, signal_unit="V")

    def factor(self, n: int) -> float:
        """Recorded signal per volt of channel `n`, from 1, as far as it is stated."""
        gain, polarity = (_of_channel(self.facts.get(key), n) for key in ("gain", "polarity"))
        return gain * polarity

    def total(self, calibration: Calibration) -> dict[str, tuple[float, float]]:
        """The parameters, gains being those of the file's numbers, without their sign."""
        total = dict(calibration.parameters)
        for name in [name for name in total if name.startswith("gain_")]:
            factor = abs(self.factor(int(name.removeprefix("gain_"))))
            value, error = total[name]
            total[name] = abs(value) * factor, error * factor
        return total


def wiring_of(settings: Mapping[str, Any], reader: Reader) -> Wiring:
    """That of the recording which the configuration's `recording` names."""
    refuse(settings.get("path") is None, "No recording is named: give recording.path=FILE.")
    return Wiring(facts_of(settings, reader))


def _of_channel(given: Any, n: int) -> float:
    value = given[n - 1] if isinstance(given, list | tuple) and n <= len(given) else given
    return 1.0 if value is None or isinstance(value, list | tuple) else float(value)


def sidecar_of(
    recording: Recording, problem: Problem, calibration: Calibration, wiring: Wiring
) -> str:
    """The sidecar's text."""
    facts: dict[str, Any] = {
        key: wiring.facts[key] for key in OF_FILE if wiring.facts.get(key) is not None
    }
    if recording.sidecar.get("skin"):
        facts["skin"] = dict(recording.sidecar["skin"])
    value = {name: float(np.asarray(each)) for name, each in calibration.fit.value.items()
             if name != "offset"}  # fmt: skip
    films = calibration.model.sensor_of(value).elements
    gains = [value[f"gain_{n}"] * wiring.factor(n) for n in range(1, len(films) + 1)]
    facts["gain"] = [abs(gain) for gain in gains]
    facts["polarity"] = [-1 if gain < 0 else 1 for gain in gains]
    sensor = dict(recording.sidecar.get("sensor") or {})
    sensor["depth_m"] = value["depth_m"]
    resistance = getattr(problem.sensor.amplifier, "feedback_resistance_ohm", None)
    if resistance is not None:
        sensor["feedback_resistance_ohm"] = float(resistance)
    sensor["elements"] = [
        {
            "angle_deg": float(np.rad2deg(film.angle_rad)),
            "strip_width_m": float(film.width_m),
            "active_length_m": float(film.length_m),
            "offset_m": value.get(f"offset_{n}_m", float(film.offset_m)),
            "depth_m": float(film.depth_m),
            "strips": int(film.strips),
            **_in_plane(film),
        }
        for n, film in enumerate(films, 1)
    ]
    facts["sensor"] = sensor
    facts["rig_error"] = _uncertainty(calibration, wiring)
    return _headed(f"{json.dumps(facts, indent=1, allow_nan=False)}\n")


def _in_plane(film: Film) -> dict[str, float]:
    """The turn about z and the place along y, where the element has them."""
    turn = 0.0 if film.turn_rad is None else float(np.rad2deg(film.turn_rad))
    facts = {"turn_deg": turn, "offset_y_m": float(film.offset_y_m)}
    return {key: value for key, value in facts.items() if value}


def _headed(text: str) -> str:
    return f"{HEADER.format(hashlib.sha256(text.encode()).hexdigest())}\n{text}"


def _is_own(path: Path) -> bool:
    """Whether a file is as `sidecar_of` wrote it."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return text == _headed(text.partition("\n")[2])


def _uncertainty(calibration: Calibration, wiring: Wiring) -> dict[str, Any]:
    """Values and covariance of what is determined of the rig; that of the scan is left out."""
    total = wiring.total(calibration)
    own = [name for name in total if name not in ("position_m", "base_friction")]
    names = [name for name in own if np.isfinite(total[name][1])]
    places = [list(total).index(name) for name in names]
    # Of a gain its number in the file's terms over the fit's, where that is not 0.
    scale = np.ones(len(names))
    for i, name in enumerate(names):
        value = calibration.parameters[name][0]
        if value and name.startswith("gain_"):
            scale[i] = total[name][0] / value
    covariance = np.outer(scale, scale) * calibration.covariance[np.ix_(places, places)]
    return {
        "parameters": names,
        "values": [total[name][0] for name in names],
        "stderr": [total[name][1] for name in names],
        "covariance": covariance.tolist(),
        "not_determined": [name for name in own if name not in names],
        "warnings": " ".join(calibration.warnings) or None,
    }


SIDECAR = Target(
    "calibration.write", "a sidecar", "calibration", (".yaml", ".yml"),
    _is_own,
)  # fmt: skip
