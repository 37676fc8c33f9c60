"""A sensor from its description: the mapping that configurations and sidecars write alike."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import BadInput, refuse
from .film import ORIENTATIONS_RAD, Film, LineEffect, Offset, Piezo, StripWidth

EFFECTS = ("strip_width",)
_ELEMENT_KEYS = {
    "orientation",
    "angle_deg",
    "strip_width_m",
    "active_length_m",
    "offset_m",
    "depth_m",
    "strips",
}


def elements(
    description: Mapping[str, Any], effects: Sequence[str], also: Sequence[LineEffect] = ()
) -> tuple[Film, ...]:
    """The film elements of `description`.

    - `description`: `depth_m`, `piezo_constants_C_per_N` {d1, d2, d3}, `strips` and `elements`, a
      list or a mapping by name, each with `orientation` ("1_to_x_3_to_z", "1_to_z_3_to_x") or
      `angle_deg`, `strip_width_m`, `active_length_m`, `offset_m`, and its own `depth_m` or `strips`
      where they differ.
    - `effects`: which named effects act ("strip_width"); `also`: effects that every element gets.

    Raises `BadInput` for what is missing, of the wrong type or out of range.
    """
    for name in effects:
        refuse(
            name not in EFFECTS,
            f"There is no effect {name!r}: effects holds any of {', '.join(EFFECTS)}.",
        )
    listed = description.get("elements")
    if not listed:
        raise BadInput(
            "No film element is known: give sensor.elements (orientation, strip_width_m, "
            "active_length_m), or a sidecar that lists them."
        )
    named = listed.items() if isinstance(listed, Mapping) else enumerate(listed)
    return tuple(_film(str(name), part, description, effects, also) for name, part in named)


def _film(name: str, part: Any, description: Mapping[str, Any], effects, also) -> Film:
    refuse(
        not isinstance(part, Mapping),
        f"sensor.elements.{name} is {part!r}: give a mapping with orientation, strip_width_m and "
        "active_length_m.",
    )
    unknown = sorted(set(part) - _ELEMENT_KEYS)
    refuse(
        bool(unknown),
        f"sensor.elements.{name} has no key {unknown and unknown[0]!r}: its keys are "
        f"{', '.join(sorted(_ELEMENT_KEYS))}.",
    )

    def number(key: str, default: float | None = None) -> float:
        choices = (part.get(key), description.get(key), default)
        value = next((v for v in choices if v is not None), None)
        if value is None:
            raise BadInput(
                f"No {key} is known for element {name}: give sensor.{key} or "
                f"sensor.elements.{name}.{key}, in SI units."
            )
        refuse(
            isinstance(value, bool) or not isinstance(value, (int, float)),
            f"sensor.elements.{name}.{key} is {value!r}: give a number.",
        )
        return float(value)

    width = number("strip_width_m")
    along: list[LineEffect] = list(also)
    if "strip_width" in effects:
        along.append(StripWidth(width))
    if offset := number("offset_m", 0.0):
        along.append(Offset(offset))
    return Film(
        depth_m=number("depth_m"),
        angle_rad=_angle(name, part),
        width_m=width,
        length_m=number("active_length_m"),
        piezo=Piezo(**(description.get("piezo_constants_C_per_N") or {})),
        effects=along,
        strips=int(number("strips", 1.0)),
    )


def _angle(name: str, part: Mapping[str, Any]) -> float:
    if part.get("angle_deg") is not None:
        return float(np.deg2rad(part["angle_deg"]))
    orientation = part.get("orientation")
    refuse(
        orientation not in ORIENTATIONS_RAD,
        f"sensor.elements.{name}.orientation is {orientation!r}: give one of "
        f"{', '.join(ORIENTATIONS_RAD)}, or angle_deg.",
    )
    return ORIENTATIONS_RAD[str(orientation)]
