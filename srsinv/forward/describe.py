"""A sensor from its description: the mapping that configurations and sidecars write alike."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import BadInput, choice, echo, mapping, number, refuse
from .film import ORIENTATIONS_RAD, Film, Piezo

_LENGTH = "a positive length in metres"
_PIEZO = ("d1", "d2", "d3")
_ELEMENT_KEYS = {
    "orientation",
    "angle_deg",
    "strip_width_m",
    "active_length_m",
    "offset_m",
    "offset_y_m",
    "turn_deg",
    "depth_m",
    "strips",
}


def elements(description: Mapping[str, Any]) -> tuple[Film, ...]:
    """The film elements of `description`, each at its offset, without any effect.

    `depth_m`, `piezo_constants_C_per_N` {d1, d2, d3}, `strips` and `elements`, a list or a mapping
    by name, each with `orientation` ("1_to_x_3_to_z", "1_to_z_3_to_x") or `angle_deg`,
    `strip_width_m`, `active_length_m`, `offset_m`, `offset_y_m`, `turn_deg` (of the strip about z),
    and its own `depth_m` or `strips` where they differ.

    Raises `BadInput` for values that are missing, of the wrong type or out of range.
    """
    listed = description.get("elements")
    if not listed:
        raise BadInput(
            "No film element is known: give sensor.elements (orientation, strip_width_m, "
            "active_length_m), or a sidecar that lists them."
        )
    refuse(
        not isinstance(listed, Mapping | list | tuple),
        f"sensor.elements is {echo(listed)}: give a mapping or a list of elements, each with "
        "orientation, strip_width_m and active_length_m.",
    )
    named = listed.items() if isinstance(listed, Mapping) else enumerate(listed)
    return tuple(_film(str(name), part, description) for name, part in named)


def _film(name: str, part: Any, description: Mapping[str, Any]) -> Film:
    wanted = "a mapping with orientation, strip_width_m and active_length_m"
    mapping(f"sensor.elements.{name}", part, wanted)
    unknown = sorted(set(part) - _ELEMENT_KEYS)
    refuse(
        bool(unknown),
        f"sensor.elements.{name} has no key {unknown and unknown[0]!r}: its keys are "
        f"{', '.join(sorted(_ELEMENT_KEYS))}.",
    )

    def known(key: str, wanted: str, default: float | None = None) -> float:
        choices = (part.get(key), description.get(key), default)
        value = next((v for v in choices if v is not None), None)
        if value is None:
            raise BadInput(
                f"No {key} is known for element {name}: give sensor.{key} or "
                f"sensor.elements.{name}.{key}, in SI units."
            )
        return float(number(f"sensor.elements.{name}.{key}", value, wanted))

    return Film(
        depth_m=known("depth_m", _LENGTH),
        angle_rad=_angle(name, part),
        width_m=known("strip_width_m", _LENGTH),
        length_m=known("active_length_m", _LENGTH),
        piezo=_piezo(description.get("piezo_constants_C_per_N")),
        strips=known("strips", "a whole number from 1", 1.0),
        offset_m=known("offset_m", "a length in metres, of either sign", 0.0),
        offset_y_m=known("offset_y_m", "a length in metres, of either sign", 0.0),
        turn_rad=np.deg2rad(known("turn_deg", "an angle in degrees from +x toward +y", 0.0)),
    )


def _piezo(given: Any) -> Piezo:
    key = "sensor.piezo_constants_C_per_N"
    constants = {} if given is None else mapping(key, given, "a mapping of d1, d2 and d3")
    unknown = sorted(set(constants) - set(_PIEZO), key=str)
    refuse(bool(unknown), f"{key} has no key {unknown and unknown[0]!r}: give d1, d2 and d3.")
    return Piezo(**constants)


def _angle(name: str, part: Mapping[str, Any]) -> float:
    key = f"sensor.elements.{name}"
    if part.get("angle_deg") is not None:
        return float(np.deg2rad(number(f"{key}.angle_deg", part["angle_deg"], "degrees, or null")))
    orientation = choice(f"{key}.orientation", part.get("orientation"), ORIENTATIONS_RAD)
    return ORIENTATIONS_RAD[orientation]
