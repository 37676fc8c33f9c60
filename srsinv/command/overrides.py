"""Checks of the user's overrides against the configuration before anything is run.

Hydra reports a mistake as a paragraph that names its own internals. Here every override is compared
with the configuration that the chosen options compose to, so that a refusal can name the nearest
valid name, and one that no job would read is refused too. Further errors of Hydra and OmegaConf
become one sentence in [`refusing`][].
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, cast

from hydra._internal.hydra import Hydra
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.types import (
    Override,
    QuotedString,
    RangeSweep,
    Transformer,
)
from hydra.types import RunMode
from omegaconf import OmegaConf

from ..errors import BadInput, nearest_name, refuse
from .help import experiments, groups
from .reads import keys_read
from .typed import composing, text_of

_ABSENT = object()
MOST_JOBS = 10_000  # of one sweep
_NAMED = 3  # experiments that a sentence names
_MOST_LISTED = 12  # options and keys that a sentence names
_ALL_KEYS = "srsinv --cfg job lists all keys"
SEVERAL = ("effects", "feature", "method", "noise")  # groups of which none may be chosen


def check(
    hydra: Hydra,
    overrides: Sequence[Override],
    root: Path,
    multirun: bool,
    config_dir: str | None = None,
) -> None:
    """Raise `BadInput` for the first override of an absent key, or of one that the job does not
    read, or with a value that does not fit."""
    for override in overrides:
        refuse(
            override.is_sweep_override() and not multirun,
            f"'{text_of(override)}' gives several values; sweep over them with -m, "
            "or write a list as key=[a,b]",
        )
    jobs = math.prod(map(_count, overrides))
    refuse(jobs == 0, "the sweep has no jobs: give at least one value, as -m seed=0,1.")
    refuse(
        jobs > MOST_JOBS,
        f"the sweep has {jobs:g} jobs, more than {MOST_JOBS}: give fewer values.",
    )
    searchpath = [text_of(o) for o in overrides if o.key_or_group == "hydra.searchpath"]
    choices, values = [], []
    for override in overrides:
        options = _options(hydra, override.key_or_group, searchpath)
        if options and not isinstance(override.value(), dict):
            _check_choice(override, options, root)
            choices.append(_alternatives(override))
        elif text_of(override) not in searchpath:
            values.append(override)
    typed = [(each.package or each.key_or_group).replace("/", ".") for each in overrides]
    usual = _compose(hydra, searchpath) if config_dir else None
    jobs = [name for o in values if o.key_or_group == "job" for name in _values(o)]
    for chosen in itertools.product(*choices) if overrides else ():
        base = _compose(hydra, [*searchpath, *chosen])
        added: list[str] = []
        for override in values:
            _check_value(override, base, added, root)
        for job in jobs or [base.get("job")]:
            keys = keys_read(job, root)
            if keys is not None:
                read = {key: value for key, value in base.items() if key in keys}
                # What differs by an experiment of the user's own is the user's, too.
                own = [key for key in base if usual and base[key] != usual.get(key)]
                _check_read([*typed, *own], job, dict.fromkeys(keys - read.keys()) | read, root)


def _check_read(keys: Iterable[str], job: str, read: dict[str, Any], root: Path) -> None:
    """Refuse keys that a job does not read; `read`: the part of the configuration that it reads."""
    for key in keys:
        top = key.partition(".")[0]
        if top in read or top == "hydra":
            continue
        able = {each.name: keys_read(each.job, root) for each in experiments(root) if each.runnable}
        names = [name for name, its in able.items() if its and top in its]
        names = sorted(names, key=lambda name: len(able[name] or ()))[:_NAMED]
        others = [f"experiment={' or '.join(names)} reads it"] if names else []
        near = _nearest_key(key, read)
        hints = [near, *others] if near != _ALL_KEYS or not others else others
        raise BadInput(f"job {job} does not read '{key}': {'; '.join(hints)}")


def _compose(hydra: Hydra, overrides: list[str]) -> dict[str, Any]:
    with composing():
        config = hydra.compose_config("config", overrides, run_mode=RunMode.RUN)
        return cast(dict[str, Any], OmegaConf.to_container(config, resolve=False))


def _options(hydra: Hydra, group: str, searchpath: list[str]) -> list[str]:
    loader = hydra.config_loader
    with composing():
        return loader.get_group_options(group, ObjectType.CONFIG, "config", searchpath)


def _check_choice(override: Override, options: list[str], root: Path) -> None:
    group = override.key_or_group
    absent = set()
    if group == "experiment":
        absent = {each.name for each in experiments(root) if not each.runnable}
        options = [name for name in options if name not in absent]
    refuse(
        override.is_delete(),
        f"'{text_of(override)}' would leave no {group}; {_choices(options)}",
    )
    refuse(
        [] in _values(override) and group not in SEVERAL,
        f"'{text_of(override)}' would leave no {group}; {_choices(options)}",
    )
    for name in _chosen(override):
        refuse(
            name is None,
            f"'{text_of(override)}' chooses nothing; leave it out, or {_choices(options)}",
        )
        refuse(
            name in absent,
            f"experiment '{name}' runs only in a clone of the repository; {_choices(options)}",
        )
        near = nearest_name(name, options)
        hint = f"the nearest is '{near}'; " if near else ""
        refuse(
            name not in options,
            f"there is no {group} '{name}'; {hint}{_choices(options)}",
        )


def _chosen(override: Override) -> Iterator[str | None]:
    """The options that a choice names: one, several of a sweep, several of a list."""
    for value in _values(override):
        for name in value if isinstance(value, list) else [value]:
            yield None if name is None else str(_unquoted(name))


def _values(override: Override) -> list[Any]:
    if not override.is_sweep_override():
        return [] if override.is_delete() else [override.value()]
    if not override.is_discrete_sweep():
        return []
    return list(override.sweep_iterator(Transformer.identity))


def _count(override: Override) -> float:
    """Factor of an override on the number of jobs."""
    value = override.value()
    if isinstance(value, RangeSweep):  # not listed: it may be endless
        first, last, step = (float(v or 0) for v in (value.start, value.stop, value.step))
        return max(math.ceil((last - first) / step), 0) if step else math.inf
    return len(_values(override)) if override.is_discrete_sweep() else 1


def _alternatives(override: Override) -> list[str]:
    """The overrides that a sweep over one choice stands for; one for a single choice."""
    if not override.is_sweep_override():
        return [text_of(override)]
    key = override.get_key_element()
    return [f"{key}={value}" for value in override.sweep_string_iterator()]


def _check_value(override: Override, base: dict[str, Any], added: list[str], root: Path) -> None:
    key = override.key_or_group
    if any(key == parent or key.startswith(f"{parent}.") for parent in added):
        return
    old = _look_up(base, key)
    parent = _look_up(base, key.rpartition(".")[0]) if "." in key else base
    is_open = key.startswith("hydra.") or _is_collection(parent)
    if old is _ABSENT and is_open and (override.is_add() or override.is_force_add()):
        added.append(key)
        return
    if old is _ABSENT:
        hint = _unchosen(key, base, root) or _nearest_key(key, base)
        raise BadInput(f"there is no key '{key}'; {hint}")
    refuse(
        override.is_delete() and not is_open,
        f"'~{key}' would remove a value that the job needs; set it with {key}=VALUE",
    )
    if not key.startswith("hydra."):  # Hydra checks its own
        for new in _values(override):
            _check_fit(key, old, new, base)


def _check_fit(key: str, old: Any, new: Any, base: dict[str, Any]) -> None:
    new = _unquoted(new)
    if isinstance(old, dict) and isinstance(new, dict) and not _is_collection(old):
        for name, value in new.items():
            inner = f"{key}.{name}"
            if name not in old:
                raise BadInput(f"there is no key '{inner}'; {_nearest_key(inner, base)}")
            _check_fit(inner, old[name], value, base)
    if isinstance(new, str) and "${" in new:
        return
    are_numbers = isinstance(old, list) and bool(old) and all(map(_is_number, old))
    if new is None and not are_numbers and (not isinstance(old, dict) or _is_collection(old)):
        return
    if isinstance(old, bool):
        fits, wanted = isinstance(new, bool), "true or false"
    elif isinstance(old, Real):
        fits, wanted = _is_number(new) or isinstance(new, list), "a number"
    elif are_numbers:
        fits = isinstance(new, list) and all(map(_is_number, new))
        wanted = "a list of numbers"
    elif isinstance(old, dict):
        # A word may stand in place of what is all left open, as recording.tolerance=default.
        is_word = new in ("none", "default") and all(value is None for value in old.values())
        fits, wanted = isinstance(new, dict) or is_word, f"its own keys ({_listed(old)})"
    else:
        return
    example = f"; it is {old} unless given" if not isinstance(old, dict) else ""
    was = "null" if new is None else repr(new)
    refuse(not fits, f"'{key}' takes {wanted}, not {was}{example}")


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _look_up(node: Any, key: str) -> Any:
    """The value at a dotted key, an interpolation as None (of no known type), or `_ABSENT`."""
    for part in key.split("."):
        if isinstance(node, list) and part.isdigit() and int(part) < len(node):
            node = node[int(part)]
        elif isinstance(node, dict) and part in node:
            node = node[part]
        else:
            return _ABSENT
        if isinstance(node, str) and "${" in node:
            return None
    return node


def _is_collection(node: Any) -> bool:
    """Whether a mapping holds named parts, to which the user may add; elsewhere no job would read a
    new key."""
    return isinstance(node, dict) and all(isinstance(value, dict) for value in node.values())


def _nearest_key(key: str, base: dict[str, Any]) -> str:
    parent, _, leaf = key.rpartition(".")
    siblings = _look_up(base, parent) if parent else None
    if isinstance(siblings, dict):
        near = nearest_name(leaf, siblings)
        if near:
            return f"the nearest is '{parent}.{near}'"
        many = len(siblings) > _MOST_LISTED
        return _ALL_KEYS if many else f"'{parent}' has {_listed(siblings)}"
    keys = [name for name in _dotted(base) if not name.startswith("hydra")]
    leaves = {name.rpartition(".")[2]: name for name in reversed(keys)}
    for word, names in ((leaf, leaves), (key, {name: name for name in keys})):
        if near := nearest_name(word, names):
            return f"the nearest is '{names[near]}'"
    return _ALL_KEYS


def _dotted(node: Any, prefix: str = "") -> Iterator[str]:
    pairs = node.items() if isinstance(node, dict) else enumerate(node)
    for name, value in pairs:
        yield f"{prefix}{name}"
        if isinstance(value, dict | list):
            yield from _dotted(value, f"{prefix}{name}.")


def _unquoted(value: Any) -> Any:
    return value.text if isinstance(value, QuotedString) else value


def _unchosen(key: str, base: dict[str, Any], root: Path) -> str:
    """What to type where a key is of an option, as an effect, that is not chosen; else nothing."""
    group, _, rest = key.partition(".")
    name, chosen = rest.partition(".")[0], base.get(group)
    if group not in SEVERAL or not isinstance(chosen, dict | None):
        return ""
    if name in (chosen or {}) or name not in groups(root).get(group, ()):
        return ""
    return f"choose {name} too, by '{group}=[{','.join([*(chosen or {}), name])}]'"


def _choices(options: Sequence[str]) -> str:
    """The words for what may be chosen."""
    if len(options) > _MOST_LISTED:
        return "srsinv --help lists all"
    return f"choose one of {_listed(options)}"


def _listed(names: Iterable[object]) -> str:
    return ", ".join(str(name) for name in names) or "none"
