"""Sidecar templates: facts only the experimenter has are blank, those in the file are filled in."""

import json
from collections.abc import Mapping
from typing import Any

from ._units import PER_S, split_unit
from .inspection import UNKNOWN, Inspection

# Facts that only the experimenter has, and the hint to write there.
SIGNAL = {
    "polarity": "1, or -1 where the wiring turns the signal around; or one for each channel",
    "gain": "recorded signal per volt of the film's amplifier; or one for each channel",
}
SENSOR = {
    "depth_m": "depth of the film below the skin's surface, such as 0.00075",
    "feedback_resistance_ohm": "of the current amplifier, such as 1000000.0",
}
ELEMENT = {
    "orientation": "1_to_x_3_to_z or 1_to_z_3_to_x, or angle_deg in its place",
    "strip_width_m": "such as 0.0007",
    "active_length_m": "such as 0.008",
    "offset_m": "along x from the sensor's origin; null is 0",
}
CONTACT = {
    "nominal_pressure_Pa": "pressure beside the feature: normal force over area of contact",
    "contact_window_m": "[start, end] of the contact along x, such as [-0.005, 0.025]",
}
FEATURE = {"edge_length_m": "rise of the feature's edge from 10 to 90 %, divided by 2.2"}
_SPEED = {"speed_m_per_s": "of sliding along x, where it was constant; below 0 towards -x"}
_RATE = {"sample_rate_hz": "samples a second: the file has no times"}
# Keys without which no inversion in Pa is possible, where they are blank.
_ESSENTIAL = (
    "sample_rate_hz", "speed_m_per_s", "sensor.depth_m", "sensor.feedback_resistance_ohm",
    "sensor.elements.orientation", "sensor.elements.strip_width_m",
    "sensor.elements.active_length_m",
)  # fmt: skip


def essential(inspection: Inspection) -> list[str]:
    """The blank keys that an inversion to p and q in Pa needs."""
    blank = blanks(inspection)
    keys = [key for key in _ESSENTIAL if key in blank]
    volts = all(signal.unit == "V" for signal in inspection.signals.values())
    return keys if volts or "gain" not in blank else ["gain", *keys]


def blanks(inspection: Inspection) -> dict[str, str]:
    """The keys that the sidecar's template leaves blank, with the hint to write there."""
    scan = {
        key: text for key, text in _scan(inspection).items() if inspection.facts.get(key) is None
    }
    sensor = inspection.facts.get("sensor") or {}
    named = {f"sensor.{key}": text for key, text in SENSOR.items() if sensor.get(key) is None}
    if sensor.get("elements") is None:
        named |= {f"sensor.elements.{key}": text for key, text in ELEMENT.items()}
    feature = inspection.facts.get("feature") or {}
    named |= {f"feature.{key}": text for key, text in FEATURE.items() if feature.get(key) is None}
    return scan | named


def sidecar_template(inspection: Inspection) -> str:
    """The template as YAML, a comment to each key; a null in it is as if not given."""
    facts = inspection.facts
    sensor, feature = facts.get("sensor") or {}, facts.get("feature") or {}
    lines = [
        f"# What srsinv has to be told of {inspection.name!a}.",
        "# Fill in what you know, leave null what you do not (it is as if not given), and put this",
        "# file beside the recording, in place of another sidecar.",
        "",
        "# As the file shows it; correct what was guessed wrong.",
        *_guessed(inspection),
        "",
        "# What only the experimenter knows.",
        *_lines(facts, _scan(inspection)),
        "sensor:",
        *_lines(sensor, SENSOR, "  "),
        *_elements(inspection, sensor.get("elements")),
        *_rest(sensor, {*SENSOR, "elements"}, "  "),
        "feature:",
        *_lines(feature, FEATURE, "  "),
        *_rest(feature, {*FEATURE}, "  "),
        *_rest(facts, {*_scan(inspection), *_LAYOUT, "sensor", "feature"}, ""),
        *_suggested(inspection),
    ]
    return "\n".join(lines) + "\n"


_LAYOUT = ("channels", "time_unit", "signal_unit")


def _suggested(inspection: Inspection) -> list[str]:
    """Comments that become facts by removing their #: hum and drift that were found."""
    found = inspection.disturbances.overrides if inspection.disturbances else ()
    pairs = [each.removeprefix("recording.").split("=") for each in found]
    lines = [f"# {key}: {value}" for key, value in pairs if inspection.facts.get(key) is None]
    return [
        "",
        "# Hum and drift that were found: remove the # to invert with them.",
        *lines,
    ] * bool(lines)


def _scan(inspection: Inspection) -> dict[str, str]:
    moving = inspection.speed_m_per_s is not None or inspection.position_m is not None
    stamped = inspection.of_role("time")
    return SIGNAL | ({} if moving else _SPEED) | ({} if stamped else _RATE) | CONTACT


def _guessed(inspection: Inspection) -> list[str]:
    columns = inspection.of_role("signal")
    units = {column.unit for column in columns}
    unit = units.pop() if len(units) == 1 else UNKNOWN
    reason = columns[0].reason if unit != UNKNOWN else "not stated: V, mV, counts, ..."
    facts = {
        "channels": [column.name for column in columns],
        "time_unit": inspection.time_unit,
        "signal_unit": None if unit == UNKNOWN else unit,
    }
    comments = {"channels": "the signals, in the order of sensor.elements"}
    if any(split_unit(column.name, PER_S)[1] is None for column in inspection.of_role("time")):
        comments["time_unit"] = inspection.time_source
    comments["signal_unit"] = reason
    return _lines(facts, comments)


def _elements(inspection: Inspection, known: Any) -> list[str]:
    """A line for each film element: as known, or one blank for each signal."""
    if known is not None and not isinstance(known, list):
        return [f"  elements: {_inline(known)}"]
    signals = [column.name for column in inspection.of_role("signal")]
    names = [f" # {_inline(name)}" for name in signals]
    elements = [dict.fromkeys(ELEMENT)] * len(names) if known is None else known
    notes = [f"  # {key}: {text}" for key, text in ELEMENT.items()]
    lines = [f"    - {_inline(element)}" for element in elements]
    named = map("".join, zip(lines, names, strict=True)) if len(lines) == len(names) else lines
    return [*notes, "  elements:", *named]


def _lines(facts: Mapping[str, Any], comments: Mapping[str, str], indent: str = "") -> list[str]:
    return [
        f"{indent}{key}: {_inline(facts.get(key))} # {comment}" for key, comment in comments.items()
    ]


def _rest(facts: Mapping[str, Any], shown: set[str], indent: str) -> list[str]:
    """Further known facts, so that the template can replace the old sidecar."""
    return [
        f"{indent}{_inline(key)}: {_inline(value)}"
        for key, value in facts.items()
        if key not in shown
    ]


def _inline(value: Any) -> str:
    """A value as YAML on one line. JSON is YAML, and quotes all text: a column may be named 1e5."""
    return json.dumps(value, ensure_ascii=False)
