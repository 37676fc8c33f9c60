"""The sidecar: what the experimenter knows about a recording, beside it as JSON or YAML."""

import datetime
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import yaml

from srsinv.errors import BadInput, is_number, refuse

SUFFIXES = (".json", ".yaml", ".yml")
_TEXTS = ("time_unit", "signal_unit")
_MAPPINGS = ("sensor", "skin", "feature")
_PIEZO = {"d1", "d2", "d3"}
_SHOWN = 80  # characters of a wrong value
_SCALARS = ("speed_m_per_s", "sample_rate_hz", "scan_length_m", "scan_start_m")
_HAS_UNIT = re.compile(r"_(m|s|hz|Hz|rad|deg|ohm|Pa|V|N)$")


def merge(sidecar: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """`sidecar` with the values of `known` laid over it, mappings merged in depth.

    None in `known` means not given. Neither argument is changed.
    """
    merged = dict(sidecar)
    for key, value in known.items():
        if isinstance(value, Mapping):
            below = merged.get(key)
            merged[key] = merge(below if isinstance(below, Mapping) else {}, value)
        elif value is not None:
            merged[key] = value
    return merged


def read_sidecar(recording: Path, given: Path | None) -> dict[str, Any]:
    """The mapping in `given`, else in the sidecar beside `recording`, else an empty one.

    Raises `BadInput` for a file that is absent, unreadable or not a mapping, and where two sidecars
    stand beside the recording.
    """
    if given is None:
        beside = [path for path in map(recording.with_suffix, SUFFIXES) if path.is_file()]
        refuse(
            len(beside) > 1,
            f"{recording.name}: there are {len(beside)} sidecars beside it, "
            f"{', '.join(path.name for path in beside)}: name one by recording.sidecar=FILE.",
        )
        return _read(beside[0]) if beside else {}
    refuse(
        given.suffix.lower() not in SUFFIXES,
        f"{given.name}: a sidecar ends in {', '.join(SUFFIXES)}, not in {given.suffix!r}: "
        "write it as JSON or YAML.",
    )
    return _read(given)


def _read(path: Path) -> dict[str, Any]:
    return parse(path.name, _text(path), "JSON" if path.suffix.lower() == ".json" else "YAML")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadInput(
            f"{path}: this sidecar cannot be read ({error.strerror}): check recording.sidecar=..."
        ) from error
    except UnicodeDecodeError as error:
        raise BadInput(f"{path.name}: this sidecar is not UTF-8 text: save it as such.") from error


def parse(name: str, text: str, kind: Literal["JSON", "YAML"]) -> dict[str, Any]:
    """The mapping in `text`, in plain JSON types; `name` is what a refusal calls it."""
    try:
        content = _from_json(text) if kind == "JSON" else _from_yaml(text)
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise BadInput(f"{name}: {_reason(error)}: correct the sidecar's {kind}.") from error
    refuse(
        not isinstance(content, dict),
        f"{name}: the sidecar holds {str(content)[:40]!r} where a mapping of names to values is "
        "expected: write it as such.",
    )
    return content


def _from_json(text: str) -> Any:
    def no_constant(constant: str):
        raise ValueError(f"{constant} is not a JSON number")

    return json.loads(text, parse_constant=no_constant)


def _from_yaml(text: str) -> Any:
    # An alias can grow into any amount of data, or refer to itself; a sidecar needs none.
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, yaml.SafeLoader)):
        raise ValueError("aliases (*name) are not taken, only values written out")
    return _plain(yaml.safe_load(text))


def _plain(value: Any) -> Any:
    """YAML's wider types in JSON's, so that every sidecar can be saved."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, datetime.date):
        return value.isoformat()
    return value if isinstance(value, str | int | float | None) else str(value)


def _reason(error: Exception) -> str:
    """A parser's complaint in one line, without the text that it quotes."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem and error.problem_mark:
        mark = error.problem_mark
        return f"line {mark.line + 1}, column {mark.column + 1}: {error.problem}"
    return " ".join(str(error).split()) or type(error).__name__


def check_sidecar(name: str, facts: Mapping[str, Any]) -> None:
    """Refuse what cannot be right in `facts`, the merged sidecar of recording `name`."""
    _check_numbers(name, "", facts, has_unit=False)
    for key in _MAPPINGS:
        part = facts.get(key)
        _expect(name, key, part, part is None or isinstance(part, Mapping), "a mapping")
    for key in _TEXTS:
        value = facts.get(key)
        _expect(name, key, value, value is None or isinstance(value, str), "one word")
    sensor = facts.get("sensor") or {}
    scalars = {key: facts.get(key) for key in _SCALARS}
    scalars["sensor.depth_m"] = sensor.get("depth_m")
    for key, value in scalars.items():
        _expect(name, key, value, value is None or is_number(value), "one number")
    for key in ("sample_rate_hz", "sensor.depth_m"):
        value = scalars[key]
        _expect(name, key, value, value is None or value > 0, "a number above 0")
    piezo = sensor.get("piezo_constants_C_per_N")
    right = piezo is None or (isinstance(piezo, Mapping) and set(piezo) <= _PIEZO)
    _expect(name, "sensor.piezo_constants_C_per_N", piezo, right, "a mapping of d1, d2 and d3")
    window = facts.get("contact_window_m")
    right = window is None or _is_interval(window)
    _expect(name, "contact_window_m", window, right, "[start, end] with start below end")
    _check_each(name, facts, "polarity", lambda value: value in (1, -1), "1 or -1")
    _check_each(name, facts, "gain", lambda value: value > 0, "a number above 0")


def _check_each(
    name: str, facts: Mapping[str, Any], key: str, right: Callable[[Any], bool], expected: str
) -> None:
    """A fact that is one number, or one for each channel."""
    value = facts.get(key)
    for each in value if isinstance(value, list | tuple) else [value]:
        _expect(name, key, each, each is None or (is_number(each) and right(each)), expected)


def check_elements(name: str, facts: Mapping[str, Any], channels: tuple[str, ...]) -> None:
    """Refuse a sidecar whose film elements are not as many as the channels read."""
    elements = (facts.get("sensor") or {}).get("elements")
    if elements is None:
        return
    _expect(name, "sensor.elements", elements, isinstance(elements, list | tuple), "a list")
    refuse(
        len(elements) != len(channels),
        f"{name}: the sidecar's sensor.elements lists {len(elements)} but {len(channels)} signal "
        f"columns are read ({', '.join(channels)}): give one element for each in the sidecar, or "
        "choose columns by recording.channels=[...].",
    )


def _check_numbers(name: str, key: str, value: Any, *, has_unit: bool) -> None:
    """A key that carries a unit holds finite numbers (YAML reads 7e-4 as text, for one)."""
    if isinstance(value, Mapping):
        items = [(f"{key}.{part}".lstrip("."), part, item) for part, item in value.items()]
    elif isinstance(value, list | tuple):
        items = [(f"{key}[{index}]", "", item) for index, item in enumerate(value)]
    else:
        right = not has_unit or value is None or is_number(value)
        _expect(name, key, value, right, "a finite number (such as 7.5e-4)")
        return
    for path, part, item in items:
        _check_numbers(name, path, item, has_unit=has_unit or bool(_HAS_UNIT.search(part)))


def _is_interval(value: Any) -> bool:
    pair = isinstance(value, list | tuple) and len(value) == 2 and all(map(is_number, value))
    return pair and value[0] < value[1]


def _expect(name: str, key: str, value: Any, right: bool, expected: str) -> None:
    refuse(
        not right,
        f"{name}: {key if key.isprintable() else repr(key)} is {_short(value)} where {expected} is "
        "expected: correct it in the sidecar or on the command line.",
    )


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
