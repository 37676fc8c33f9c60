"""What a fact beside a recording may be: numbers, texts and lists, each with the words that a
refusal has for it."""

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import PlainValidator
from pydantic_core import PydanticCustomError

from srsinv.errors import is_number

from ..files import is_broken
from ._table import LONGEST_NAME, MOST_COLUMNS
from ._units import PER_M, PER_M_PER_S, PER_S

LONGEST_TEXT = 10_000  # characters of a description
WAYS = ("both", "onwards", "back")
UNUSABLE = ("missing", "keep")
WIRINGS = ("as_found", "as_stated")
ORIENTATIONS = ("1_to_x_3_to_z", "1_to_z_3_to_x")


def _wanted(expected: str, fits: Callable[[Any], bool]) -> PlainValidator:
    """Validator by `fits`, which a refusal describes as `expected`; null: as if not given."""

    def checked(value: Any) -> Any:
        if value is not None and not fits(value):
            raise PydanticCustomError("expected", "{expected}", {"expected": expected})
        return value

    return PlainValidator(checked)


def _is_positive(value: Any) -> bool:
    return is_number(value) and value > 0


def is_text(value: Any, most: int = LONGEST_NAME) -> bool:
    """Printable text; a surrogate or a control character could be neither shown nor saved."""
    return isinstance(value, str) and len(value) <= most and not is_broken(value)


def _is_interval(value: Any) -> bool:
    pair = isinstance(value, list) and len(value) == 2 and all(map(is_number, value))
    return pair and value[0] < value[1]


def _is_list(value: Any, fits: Callable[[Any], bool]) -> bool:
    return isinstance(value, list) and len(value) <= MOST_COLUMNS and all(map(fits, value))


def _is_frequencies(value: Any) -> bool:
    return _is_positive(value) or (_is_list(value, _is_positive) and value != [])


def _is_channels(value: Any) -> bool:
    if isinstance(value, list):
        return 0 < len(value) <= MOST_COLUMNS and all(map(_is_channel, value))
    return _is_channel(value)


def _is_channel(value: Any) -> bool:
    return is_text(value) and value != ""


def _each(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """One number, or one for each channel (null: as if not given)."""

    def all_fit(value: Any) -> bool:
        listed = value if isinstance(value, list) else [value]
        return len(listed) <= MOST_COLUMNS and all(v is None or fits(v) for v in listed)

    return all_fit


def _one_of(*options: str) -> PlainValidator:
    return _wanted(f"one of {', '.join(options)}", lambda v: isinstance(v, str) and v in options)


Number = Annotated[float | None, _wanted("a finite number (such as 7.5e-4)", is_number)]
Positive = Annotated[float | None, _wanted("a number above 0", _is_positive)]
Ways = Annotated[str | None, _one_of(*WAYS)]
Unusable = Annotated[str | None, _one_of(*UNUSABLE)]
Wiring = Annotated[str | None, _one_of(*WIRINGS)]
Strips = Annotated[
    float | None,
    _wanted("a whole number from 1", lambda v: is_number(v) and v >= 1 and v == int(v)),
]
Text = Annotated[
    str | None, _wanted(f"text of at most {LONGEST_NAME} printable characters", is_text)
]
Description = Annotated[
    str | None,
    _wanted(
        f"text of at most {LONGEST_TEXT} characters",
        lambda v: isinstance(v, str) and is_text(" ".join(v.split()), LONGEST_TEXT),
    ),
]
Interval = Annotated[list[float] | None, _wanted("[start, end], the start below", _is_interval)]
Channels = Annotated[
    list[str] | str | None,
    _wanted(f"a list of column names, each of up to {LONGEST_NAME} characters", _is_channels),
]
Polarity = Annotated[
    list[float | None] | float | None,
    _wanted("1 or -1, or one for each channel", _each(lambda v: is_number(v) and v in (1, -1))),
]
Gain = Annotated[
    list[float | None] | float | None,
    _wanted("a number above 0, or one for each channel", _each(_is_positive)),
]
Mains = Annotated[
    list[float] | float | str | None,
    _wanted(
        "auto, or the frequencies of lines in Hz",
        lambda v: v in ("auto", []) or _is_frequencies(v),
    ),
]
Frequencies = Annotated[
    list[float] | float | None,
    _wanted("a frequency in Hz above 0, or a list of them", _is_frequencies),
]
Detrending = Annotated[str | None, _one_of("constant", "linear")]
Drift = Annotated[
    list[float | None] | float | str | None,
    _wanted(
        "auto, or a number that is at least 0, or one for each channel",
        lambda v: v == "auto" or _each(lambda each: is_number(each) and each >= 0)(v),
    ),
]
Quiet = Annotated[
    list[Any] | str | None,
    _wanted(
        "auto, or [start, end] in seconds, or a list of such pairs",
        lambda v: v == "auto" or _is_interval(v) or _is_list(v, _is_interval),
    ),
]
TimeUnit = Annotated[str | None, _one_of(*PER_S)]
SpeedUnit = Annotated[str | None, _one_of(*PER_M_PER_S)]
PositionUnit = Annotated[str | None, _one_of(*PER_M)]
Orientation = Annotated[str | None, _one_of(*ORIENTATIONS)]
SkinModel = Annotated[str | None, _one_of("half_space")]


Names = Annotated[
    list[str] | None,
    _wanted("a list of names", lambda v: _is_list(v, lambda each: is_text(each))),
]
Numbers = Annotated[
    list[float] | None, _wanted("a list of numbers", lambda v: _is_list(v, is_number))
]
Matrix = Annotated[
    list[list[float]] | None,
    _wanted("rows of numbers", lambda v: _is_list(v, lambda row: _is_list(row, is_number))),
]
