"""The facts that may stand beside a recording: every key, and what its value is.

This is the one table of them. It is closed: a key that is not here is refused, a number is a number
(never a text), and free text is allowed in `description` alone. Facts come from untrusted files, so
that none names a class or a function.
"""

from collections.abc import Collection, Mapping
from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from srsinv.errors import BadInput, echo, nearest_name, refuse

from ._fact_types import (
    Channels,
    Description,
    Detrending,
    Drift,
    Frequencies,
    Gain,
    Interval,
    Mains,
    Matrix,
    Names,
    Number,
    Numbers,
    Orientation,
    Polarity,
    PositionUnit,
    Positive,
    Quiet,
    SkinModel,
    SpeedUnit,
    Strips,
    Text,
    TimeUnit,
    Unusable,
    Ways,
    Wiring,
    is_text,
)
from ._recording import TOLERANCE_WORDS
from ._table import LONGEST_NAME

_MOST_LISTED = 12  # keys that a sentence names
_TEMPLATE = "experiment=inspect_recording writes a sidecar with the usual keys"
# Keys that no command line has.
_SIDECAR_ALONE = ("description", "scan_length_m", "sensor", "skin", "feature", "rig_error")


class Facts(BaseModel):
    """A mapping with these keys and no others."""

    model_config = ConfigDict(extra="forbid", protected_namespaces=())


class PiezoFacts(Facts):
    """Charge per stress [C/N]."""

    d1: Number = None
    d2: Number = None
    d3: Number = None


class ElementFacts(Facts):
    """One film element."""

    orientation: Orientation = None
    angle_deg: Number = None
    strip_width_m: Positive = None
    active_length_m: Positive = None
    offset_m: Number = None
    offset_y_m: Number = None
    turn_deg: Number = None
    depth_m: Positive = None
    strips: Strips = None


class SensorFacts(Facts):
    """The film elements and their readout."""

    depth_m: Positive = None
    feedback_resistance_ohm: Positive = None
    piezo_constants_C_per_N: PiezoFacts | None = None
    strips: Strips = None
    elements: list[ElementFacts] | None = None


class SkinFacts(Facts):
    """The rubber above and around the film."""

    model: SkinModel = None
    youngs_modulus_Pa: Positive = None
    poisson_ratio: Number = None


class FeatureFacts(Facts):
    """Facts on the surface's feature."""

    edge_length_m: Positive = None


class RigErrorFacts(Facts):
    """What a calibration determined, in the order of `parameters`, and what it did not."""

    parameters: Names = None
    values: Numbers = None
    stderr: Numbers = None
    covariance: Matrix = None
    not_determined: Names = None
    warnings: Description = None


class ToleranceFacts(Facts):
    """Standard uncertainties of what is stated, each in the unit of the fact; of gain and speed a
    fraction."""

    depth_m: Positive = None
    gain: Positive = None
    angle_deg: Positive = None
    offset_m: Positive = None
    strip_width_m: Positive = None
    speed: Positive = None
    poisson_ratio: Positive = None
    youngs_modulus_Pa: Positive = None
    nominal_pressure_Pa: Positive = None
    edge_length_m: Positive = None


class RecordingFacts(Facts):
    """All that a sidecar or a caller may state about a recording."""

    description: Description = None
    channels: Channels = None
    time_column: Text = None
    time_unit: TimeUnit = None
    speed_column: Text = None
    speed_unit: SpeedUnit = None
    position_column: Text = None
    position_unit: PositionUnit = None
    signal_unit: Text = None
    polarity: Polarity = None
    gain: Gain = None
    sample_rate_hz: Positive = None
    speed_m_per_s: Number = None
    scan_start_m: Number = None
    scan_length_m: Number = None
    nominal_pressure_Pa: Number = None
    contact_window_m: Interval = None
    mains_Hz: Mains = None
    backlash_m: Number = None
    turn_margin_m: Positive = None
    drift: Drift = None
    quiet_s: Quiet = None
    ways: Ways = None
    unusable: Unusable = None
    wiring: Wiring = None
    detrend: Detrending = None
    high_pass_Hz: Positive = None
    notch_Hz: Frequencies = None
    notch_width_Hz: Positive = None
    sensor: SensorFacts | None = None
    skin: SkinFacts | None = None
    feature: FeatureFacts | None = None
    rig_error: RigErrorFacts | None = None
    tolerance: ToleranceFacts | None = None

    @field_validator("tolerance", mode="before")
    @classmethod
    def _word_is_no_mapping(cls, given: Any) -> Any:
        return None if given in TOLERANCE_WORDS else given


def check_facts(name: str, facts: Mapping[str, Any]) -> None:
    """Refuse facts about the recording `name` that the table does not have. Raises `BadInput`."""
    _check_keys(name, facts)
    try:
        RecordingFacts.model_validate(facts)
    except ValidationError as error:
        first = min(error.errors(include_url=False), key=lambda each: len(each["loc"]))
        raise BadInput(f"{name}: {_sentence(first)}") from None


def _check_keys(name: str, value: Any) -> None:
    """Refuse keys that are no printable text, wherever they are."""
    if isinstance(value, list):
        for each in value:
            _check_keys(name, each)
    elif isinstance(value, Mapping):
        for key, each in value.items():
            refuse(
                not is_text(key),
                f"{name}: {echo(key)} cannot be a key: keys are text of at most {LONGEST_NAME} "
                "printable characters.",
            )
            _check_keys(name, each)


def _sentence(error: Any) -> str:
    path = error["loc"]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)[1:]
    known = _keys_at(path[:-1])
    if error["type"] == "extra_forbidden":
        near = nearest_name(path[-1], known)
        listed = f"there are {', '.join(known)}" if len(known) <= _MOST_LISTED else _TEMPLATE
        hint = f"the nearest is {near}" if near else listed
        return (
            f"there is no key {echo(key)}: {hint}; correct it in the sidecar or on the "
            "command line, or put free text into description."
        )
    expected = error.get("ctx", {}).get("expected") or (
        "a list" if error["type"] == "list_type" else f"a mapping ({', '.join(_keys_at(path))})"
    )
    expected = f"{', '.join(TOLERANCE_WORDS)} or {expected}" if path == ("tolerance",) else expected
    typed = _typed([str(part) for part in path])
    command_line = f" or on the command line ({typed}=...)" if typed else ""
    return (
        f"{key} is {echo(error['input'])} where {expected} is expected: correct it in the sidecar"
        f"{command_line}."
    )


def _typed(path: list[str]) -> str:
    """The key of the command line that a fact is in, or nothing where it has none."""
    own, *below = path
    if own == "sensor" and below and below[0] != "feedback_resistance_ohm":
        return f"sensor.{below[0]}"  # lists and mappings are typed whole
    if own == "sensor" and below:
        return f"amplifier.{below[0]}"
    return "" if own in _SIDECAR_ALONE else f"recording.{own}"


def _keys_at(path: Collection[str | int]) -> list[str]:
    """The keys that the table has at a place."""
    facts: Any = RecordingFacts
    for part in path:
        if isinstance(part, str):
            facts = _facts_in(facts.model_fields[part].annotation)
    return list(facts.model_fields)


def _facts_in(annotation: Any) -> Any:
    """The table in an annotation such as `list[ElementFacts] | None`."""
    if isinstance(annotation, type) and issubclass(annotation, Facts):
        return annotation
    return next((facts for each in get_args(annotation) if (facts := _facts_in(each))), None)
