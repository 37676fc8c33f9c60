"""Tolerances of stated facts: the standard uncertainty of what nobody calibrated.

What a person states of a rig comes from a ruler, a data sheet or a setting, and is right to some
per cent. Each fact has a standard deviation: that of the sidecar's key `tolerance`, else the
default for a rig that was made by hand (type B of the Guide to the Expression of Uncertainty in
Measurement, JCGM 100:2008). What a calibration determined has the calibration's covariance instead.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ...errors import refuse
from ...forward.sensor import Sensor
from ...forward.skin import HalfSpace
from ...recording._recording import HAND_MADE, NO_TOLERANCE, TOLERANCE_WORDS
from .error import ASSUMED, STATED, RigError
from .setup import number_of_films

# In the fact's own unit, of gain and speed a fraction.
DEFAULTS = {
    "gain": 0.05,
    "angle_deg": 2.0,
    "offset_m": 5e-5,
    "speed": 0.01,
    "poisson_ratio": 0.01,
}
RELATIVE_DEFAULTS = {  # fractions of the fact
    "depth_m": 0.05,
    "strip_width_m": 0.05,
    "youngs_modulus_Pa": 0.1,
    "nominal_pressure_Pa": 0.1,
}
NAMES = (
    "depth_m", "gain", "angle_deg", "offset_m", "strip_width_m", "speed", "poisson_ratio",
    "youngs_modulus_Pa", "nominal_pressure_Pa", "edge_length_m",
)  # fmt: skip
MOST = 0.3  # of a fact that has to be above 0
ABOVE_0 = ("gain", "speed", *RELATIVE_DEFAULTS)
# Of facts that may be 0, in their units: more is no tolerance of a sensor in a finger.
LARGEST = {"angle_deg": 45.0, "offset_m": 0.1, "poisson_ratio": 0.5, "edge_length_m": 0.1}


class StatedFact(NamedTuple):
    """A parameter of [`RigError`][] with its value, and the key of `tolerance` that it goes by."""

    name: str
    key: str
    value: float


def rig_error_of(
    recording: str,
    facts: Mapping[str, Any],
    sensor: Sensor,
    *,
    has_measured_positions: bool,
    nominal_pressure_Pa: float | None,
) -> RigError | None:
    """How well a recording's rig is known, by the keys `rig_error` and `tolerance` of its facts;
    None where all is exact, by the word `none`.

    A rig without a calibration has the default of each fact that has no tolerance of its own. A
    calibrated one has the calibration's errors alone: its gains make up for a modulus, a pressure
    or a speed that is stated a little wrong, in the calibration as in what is measured with it. A
    tolerance that is stated brings the defaults of the other facts with it there, too.

    Where positions are measured the speed has no default: a stage's scale is right to 1e-4 or
    better, and what a tolerance states of it is one of that scale. Raises `BadInput` for a damaged
    `rig_error`, for a tolerance of 0.3 of the fact or more, and one beyond `LARGEST`.
    """
    films = number_of_films(sensor)
    calibrated = RigError.of_facts(recording, facts.get("rig_error"), films)
    given = facts.get("tolerance")
    own = {} if given is None or given in TOLERANCE_WORDS else given
    stated = {key: value for key, value in own.items() if value is not None}
    is_asked_for = bool(stated) or given == HAND_MADE
    if given == NO_TOLERANCE or (calibrated is not None and not is_asked_for):
        return calibrated
    listed = stated_facts(sensor, nominal_pressure_Pa)
    stderr: dict[str, float] = {}
    for fact in listed:
        size = stated.get(fact.key, _default(fact, has_measured_positions))
        if fact.key in stated:
            _check_size(recording, fact, float(stated[fact.key]))
        if size is not None:
            stderr[fact.name] = float(size)
    origins = {fact.name: STATED if fact.key in stated else ASSUMED for fact in listed}
    own = RigError((), np.zeros(0), np.zeros((0, 0))) if calibrated is None else calibrated
    values = {fact.name: fact.value for fact in listed}
    whole = own.beside(stderr, values, origins)
    return whole if whole.names else None


def stated_facts(sensor: Sensor, nominal_pressure_Pa: float | None) -> list[StatedFact]:
    """What is stated of a rig. Angles and offsets count from those of the first element."""
    films = [film for film in sensor.elements if not film.is_backward]
    numbered = list(enumerate(films, 1))
    listed = [StatedFact("depth_m", "depth_m", float(sensor.depth_m))]
    listed += [StatedFact(f"gain_{n}", "gain", 1.0) for n, _ in numbered]
    for n, film in numbered[1:]:
        angle_deg = float(np.rad2deg(film.angle_rad))
        listed.append(StatedFact(f"angle_{n}_deg", "angle_deg", angle_deg))
        listed.append(StatedFact(f"offset_{n}_m", "offset_m", float(film.offset_m)))
    listed += [
        StatedFact(f"strip_width_{n}_m", "strip_width_m", float(film.width_m))
        for n, film in numbered
    ]
    listed.append(StatedFact("speed", "speed", 1.0))
    if isinstance(sensor.skin, HalfSpace):
        skin = sensor.skin
        listed += [
            StatedFact(name, name, float(getattr(skin, name)))
            for name in ("poisson_ratio", "youngs_modulus_Pa")
        ]
    if nominal_pressure_Pa:
        name = "nominal_pressure_Pa"
        listed.append(StatedFact(name, name, float(nominal_pressure_Pa)))
    listed.append(StatedFact("edge_length_m", "edge_length_m", 0.0))
    return listed


def _default(fact: StatedFact, has_measured_positions: bool) -> float | None:
    if fact.key == "speed" and has_measured_positions:
        return None
    if fact.key in RELATIVE_DEFAULTS:
        return RELATIVE_DEFAULTS[fact.key] * fact.value
    return DEFAULTS.get(fact.key)


def _check_size(recording: str, fact: StatedFact, size: float) -> None:
    most = LARGEST.get(fact.key, np.inf)
    refuse(
        size >= most,
        f"{recording}: recording.tolerance.{fact.key} is {size:g}: give a standard "
        f"uncertainty below {most:g}, in the unit of the fact.",
    )
    refuse(
        fact.key in ABOVE_0 and size >= MOST * fact.value,
        f"{recording}: recording.tolerance.{fact.key} is {size:g}: give a standard "
        f"uncertainty below {MOST * fact.value:g}, "
        f"{'as a fraction' if fact.value == 1.0 else 'in the unit of the fact'}.",
    )
