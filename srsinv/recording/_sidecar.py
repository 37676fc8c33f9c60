"""Sidecars: the experimenter's facts about a recording, beside it as JSON or YAML.

Both are read into text, numbers, truth values, null, lists and mappings, and nothing else: no
tags, no aliases, no dates, no key twice. YAML is read by the rules of its version 1.2, in which
1.0e7 is a number and 1_100 is text.
"""

import json
import math
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml

from srsinv.errors import BadInput, echo, refuse

from ..files import mapping_of, parse_json, path_of, read_bytes

SUFFIXES = (".json", ".yaml", ".yml")
MOST_BYTES = 2**18  # a thousand elements with all their keys take half of it
DEEPEST = 20  # mappings and lists within each other
MOST_VALUES = 50_000
_OF_RIG = ("gain", "polarity", "sensor", "rig_error")  # facts that a calibration determines
_INT = re.compile(r"[-+]?[0-9]{1,400}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def merge(sidecar: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """`sidecar` with the values of `known` laid over it, mappings merged in depth.

    None in `known` means not given. Neither argument is changed.
    """
    merged = dict(sidecar)
    for key, value in known.items():
        if isinstance(value, Mapping):
            below = merged.get(key)
            within = merge(below if isinstance(below, Mapping) else {}, value)
            if within or below is None:  # a word, as tolerance: none, stays where nothing is given
                merged[key] = within
        elif value is not None:
            merged[key] = list(value) if isinstance(value, tuple) else value
    return merged


class Sidecars(NamedTuple):
    """The files that are named beside a recording: its sidecar, and that of a calibration."""

    sidecar: str | os.PathLike[str] | None = None
    calibration: str | os.PathLike[str] | None = None

    @classmethod
    def of_settings(cls, settings: Mapping[str, Any]) -> "Sidecars":
        """As the configuration's `recording` names them."""
        return cls(settings.get("sidecar"), settings.get("calibration"))

    def facts(self, path: Path, own: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """What they state of the recording at `path`, over its `own` facts; of the rig the
        calibration has the last word, of all else the first."""
        given = None if self.sidecar is None else path_of(self.sidecar, "recording.sidecar")
        beside = merge(own or {}, read_sidecar(path, given))
        if self.calibration is None:
            return beside
        key = "recording.calibration"
        rig = read_sidecar(path, path_of(self.calibration, key), key)
        return merge(merge(rig, beside), {key: rig[key] for key in _OF_RIG if key in rig})


def read_sidecar(
    recording: Path, given: Path | None, key: str = "recording.sidecar"
) -> dict[str, Any]:
    """The mapping in `given`, the file that `key` of the configuration names, else in the sidecar
    beside `recording`, else an empty one.

    Raises `BadInput` for a file that is absent, unreadable or not a mapping, and where two sidecars
    stand beside the recording.
    """
    if given is None:
        # A link that leads nowhere counts too: it is refused, not passed over.
        named = [path for path in map(recording.with_suffix, SUFFIXES) if path != recording]
        beside = [path for path in named if os.path.lexists(path)]
        refuse(
            len(beside) > 1,
            f"{recording.name}: the file has {len(beside)} sidecars, "
            f"{', '.join(path.name for path in beside)}: name one by "
            "recording.sidecar=FILE.",
        )
        return _read(beside[0], key) if beside else {}
    refuse(
        given.suffix.lower() not in SUFFIXES,
        f"{key} is {given.name}: a sidecar ends in {', '.join(SUFFIXES)}, not in {given.suffix!r}: "
        "write it as JSON or YAML.",
    )
    return _read(given, key)


def _read(path: Path, key: str) -> dict[str, Any]:
    try:
        text = read_bytes(path, what="sidecar", key=key, most=MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path.name}: this sidecar is not UTF-8 text: save it as such.") from error
    return parse(path.name, text, "JSON" if path.suffix.lower() == ".json" else "YAML")


def parse(name: str, text: str, kind: Literal["JSON", "YAML"]) -> dict[str, Any]:
    """The mapping in `text`, in JSON's types; refusals call it `name`.

    Raises `BadInput` for text that is too long or nested too deeply, that repeats a key, or that is
    no mapping.
    """
    try:
        refuse(
            len(text) > MOST_BYTES,
            f"longer than {MOST_BYTES} characters",
        )
        content = parse_json(text) if kind == "JSON" else _from_yaml(text)
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise BadInput(f"{name}: {_reason(error)}: correct the sidecar's {kind}.") from error
    refuse(
        not isinstance(content, dict),
        f"{name}: the sidecar is {echo(content)}, not a mapping of names to values: "
        "write it as lines of name: value.",
    )
    return content


def _from_yaml(text: str) -> Any:
    """The value of one document, built from the parser's events, which need no recursion."""
    events = yaml.parse(text, _Loader)
    starts: list[tuple[Any, list[Any]]] = [(None, [])]  # open collections and their content
    documents = values = 0
    for event in events:
        documents += isinstance(event, yaml.DocumentStartEvent)
        values += isinstance(event, yaml.NodeEvent)
        _check_event(event, len(starts) - 1, documents, values)
        if isinstance(event, yaml.ScalarEvent):
            starts[-1][1].append(_scalar(event))
        elif isinstance(event, yaml.CollectionStartEvent):
            starts.append((event, []))
        elif isinstance(event, yaml.CollectionEndEvent):
            start, held = starts.pop()
            is_mapping = isinstance(start, yaml.MappingStartEvent)
            starts[-1][1].append(mapping_of(_pairs(held)) if is_mapping else held)
    return next(iter(starts[0][1]), None)


def _check_event(event: Any, depth: int, documents: int, values: int) -> None:
    """Raise `ValueError` for YAML that no sidecar needs."""
    if isinstance(event, yaml.AliasEvent):
        # An alias can grow into any amount of data, or refer to itself.
        raise ValueError("aliases (*name) are not taken, only values written out")
    if getattr(event, "tag", None) not in (None, "!"):
        raise ValueError(f"tags ({echo(event.tag)}) are not taken, only values written out")
    if depth > DEEPEST or values > MOST_VALUES or documents > 1:
        raise ValueError(
            f"more than one document, {DEEPEST} levels or {MOST_VALUES} values, which no sidecar "
            "needs"
        )


def _pairs(held: list[Any]) -> Iterator[tuple[str, Any]]:
    """Keys and values, from alternating events. A key is taken as text."""
    for key, value in zip(held[::2], held[1::2], strict=True):
        if not isinstance(key, str | int | float | None):
            raise ValueError("a key is not text")
        yield key if isinstance(key, str) else json.dumps(key), value


def _scalar(event: Any) -> Any:
    """A scalar by YAML 1.2's core rules, decimal numbers alone; quoted scalars are text."""
    text = event.value
    if not event.implicit[0]:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if _INT.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if text.lower().lstrip("+-") in (".inf", ".nan"):
        return math.inf if "inf" in text.lower() else math.nan
    return text


def _reason(error: Exception) -> str:
    """A parser's complaint in one line, without the text that it quotes."""
    if isinstance(error, RecursionError):
        return f"nested more than {DEEPEST} deep"
    if isinstance(error, yaml.MarkedYAMLError) and error.problem and error.problem_mark:
        mark = error.problem_mark
        return f"line {mark.line + 1}, column {mark.column + 1}: {error.problem}"
    return " ".join(str(error).split()) or type(error).__name__


def check_elements(name: str, facts: Mapping[str, Any], channels: tuple[str, ...]) -> None:
    """Refuse a sidecar whose film elements are not as many as the channels read."""
    elements = (facts.get("sensor") or {}).get("elements")
    refuse(
        elements is not None and len(elements) != len(channels),
        f"{name}: the sidecar's sensor.elements lists {len(elements or ())} elements, "
        f"but the signal columns are {', '.join(channels)}: give one element for "
        "each, or choose columns by recording.channels=[...].",
    )
