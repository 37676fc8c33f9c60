"""The keys of the configuration, with their defaults and the comments behind them."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from srsinv.report.text import unit_of

PACKAGE = re.compile(r"^# @package (\S+)", re.MULTILINE)
COMMENT = re.compile(r"(?:^|\s)#\s?(.*)$")
UNITS = {"_ohm": "Ω", "_F": "F", "_C_per_N": "C/N", "_K": "K", "_dB": "dB", "_m2": "m²"}
SKIPPED = {"defaults", "hydra", "job", "_target_"}


@dataclass(frozen=True)
class Key:
    """A key as it is typed, its default as YAML, its SI unit, the comment behind it, and the first
    comment of its file."""

    name: str
    default: str
    unit: str
    comment: str
    file_comment: str


def read_file(path: Path, prefix: str) -> list[Key]:
    """The keys of a file, in its order; `prefix` is where the configuration holds them."""
    text = path.read_text("utf-8")
    lines = text.splitlines()
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    package = PACKAGE.search(text)
    prefix = prefix if package is None else package[1].replace("_global_", "")
    file_comment = next(
        (line.lstrip("# ") for line in lines if line.startswith("#") and "@package" not in line), ""
    )
    return [] if node is None else list(_keys(node, prefix, lines, file_comment))


def _keys(node: Any, prefix: str, lines: list[str], file_comment: str) -> Iterator[Key]:
    for key, value in node.value:
        if key.value in SKIPPED and not prefix.count("."):
            continue
        if key.value == "_target_":
            continue
        name = f"{prefix}.{key.value}".strip(".")
        if isinstance(value, yaml.MappingNode) and value.value:
            inherited = _comment(lines[key.start_mark.line])
            for each in _keys(value, name, lines, file_comment):
                yield each if each.comment else replace(each, comment=inherited)
            continue
        end = value.end_mark.line - (value.end_mark.column == 0 and value.end_mark.line > 0)
        end = max(end, key.start_mark.line)
        comment = _comment(lines[key.start_mark.line]) or _comment(lines[min(end, len(lines) - 1)])
        yield Key(name, _default(value, lines), _unit(name), comment, file_comment)


def _default(value: Any, lines: list[str]) -> str:
    start, end = value.start_mark, value.end_mark
    if start.line == end.line:
        return lines[start.line][start.column : end.column].strip() or "null"
    return yaml.safe_dump(_plain(value), default_flow_style=True, width=10_000).strip()


def _plain(node: Any) -> Any:
    return yaml.SafeLoader("").construct_document(node) if node else None


def _unit(name: str) -> str:
    """The unit at the end of a key's name, else at the end of the key above it."""
    for part in reversed(name.split(".")[-2:]):
        further = next((unit for end, unit in UNITS.items() if part.endswith(end)), "1")
        unit = unit_of(part) if further == "1" else further
        if unit != "1":
            return unit
    return ""


def _comment(line: str) -> str:
    found = COMMENT.search(_outside_quotes(line))
    return "" if found is None else line[found.start(1) :].strip()


def _outside_quotes(line: str) -> str:
    return re.sub(r"\"[^\"]*\"|'[^']*'", lambda quoted: "_" * len(quoted[0]), line)


@cache
def read_groups(configs: Path) -> dict[str, dict[str, list[Key]]]:
    """The keys of every option of every group; "." holds those of config.yaml. A key without a
    comment of its own has that of the same key in a sibling."""
    found: dict[str, dict[str, list[Key]]] = {
        ".": {"config": read_file(configs / "config.yaml", "")}
    }
    for path in sorted(configs.rglob("*.yaml")):
        group = path.parent.relative_to(configs).as_posix()
        if group not in (".", "experiment") and not group.startswith("hydra"):
            found.setdefault(group, {})[path.stem] = read_file(path, group)
    comments = _comments(found)
    return {
        group: {option: _filled(keys, comments) for option, keys in options.items()}
        for group, options in found.items()
    }


def own_keys(configs: Path, name: str) -> list[Key]:
    """The keys that an experiment sets. A key of a group has the comment of the option that the
    experiment chooses."""
    groups = read_groups(configs)
    path = configs / "experiment" / f"{name}.yaml"
    chosen = set(re.findall(r"override /(\w+): (\w+)", path.read_text("utf-8")))
    known: dict[str, str] = {}
    for is_chosen in (True, False):
        for group, options in groups.items():
            for option, keys in options.items():
                if ((group, option) in chosen) == is_chosen:
                    known = {key.name: key.comment for key in keys} | known
    keys = read_file(path, "")
    keys = [replace(key, comment=known.get(key.name) or key.comment) for key in keys]
    return _filled(keys, _comments(groups))


def undocumented(configs: Path) -> list[str]:
    """The keys without a comment."""
    groups = read_groups(configs)
    everywhere = [key for options in groups.values() for keys in options.values() for key in keys]
    for path in sorted((configs / "experiment").glob("*.yaml")):
        everywhere += own_keys(configs, path.stem)
    return sorted({key.name for key in everywhere if not key.comment})


def _comments(groups: dict[str, dict[str, list[Key]]]) -> dict[str, str]:
    """Comments by the names of keys, see `_names`, the first of each."""
    found: dict[str, str] = {}
    for key in (key for options in groups.values() for own in options.values() for key in own):
        for name in _names(key.name) if key.comment else ():
            found.setdefault(name, key.comment)
    return found


def _names(name: str) -> tuple[str, str]:
    """A key's name, and that of the same key in a sibling: sensor.elements.*.strip_width_m."""
    *above, _, last = ["", *name.split(".")]
    return name, ".".join([*above, "*", last])


def _filled(keys: list[Key], comments: dict[str, str]) -> list[Key]:
    def comment(key: Key) -> str:
        # In a scene that an experiment lists, the group stands below further names.
        places = (key.name.split(".", above)[above] for above in range(key.name.count(".") or 1))
        known = (comments[name] for place in places for name in _names(place) if name in comments)
        return key.comment or next(known, "")

    return [replace(key, comment=comment(key)) for key in keys]
